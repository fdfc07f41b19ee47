/* Chunks: whole on disk, under a name that is on disk too, before they are reported stored; what no
 * package names and nobody has asked for goes, all else stays. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "common/log.h"
#include "common/mem.h"
#include "common/package.h"
#include "master/chunks.h"

enum { STEPS_MAX = 64, PATH_BYTES = 256 };

static char folder[64];
static uv_loop_t loop;

/* --- What is done to the disk: in place of the library's ------------------- */

struct step {
    char what;             /* 's' synced, 'r' renamed */
    char path[PATH_BYTES]; /* of a rename: the new name */
};
static struct step steps[STEPS_MAX];
static int step_count;

static void note_step(char what, const char *path)
{
    assert_true(step_count < STEPS_MAX);
    struct step *s = &steps[step_count++];
    s->what = what;
    (void)snprintf(s->path, sizeof s->path, "%s", path);
}

int fsync(int fd)
{
    char link[64], path[PATH_BYTES] = "";
    (void)snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t bytes = readlink(link, path, sizeof path - 1);
    assert_true(bytes > 0);
    note_step('s', path);
    return (int)syscall(SYS_fsync, fd);
}

int rename(const char *from, const char *to)
{
    note_step('r', to);
    return (int)syscall(SYS_rename, from, to);
}

/* Where a step on a path that ends so comes first, from `at` on; -1: nowhere. */
static int find_step(char what, const char *end, int at)
{
    for (size_t bytes = strlen(end); at < step_count; at++) {
        size_t have = strlen(steps[at].path);
        if (steps[at].what == what && have >= bytes &&
            strcmp(steps[at].path + have - bytes, end) == 0)
            return at;
    }
    return -1;
}

/* --- Set-up ---------------------------------------------------------------- */

static int set_up(void **state)
{
    (void)state;
    (void)snprintf(folder, sizeof folder, "/tmp/test_chunks.XXXXXX");
    assert_non_null(mkdtemp(folder));
    step_count = 0;
    return uv_loop_init(&loop);
}

static int tear_down(void **state)
{
    (void)state;
    char command[128];
    assert_int_equal(uv_loop_close(&loop), 0);
    (void)snprintf(command, sizeof command, "rm -rf '%s'", folder);
    return system(command);
}

static void note_put(void *ctx, enum err e)
{
    assert_int_equal(e, ERR_OK);
    *(int *)ctx = step_count; /* what comes later was not waited for */
}

/* Stores a text as a chunk; the steps until it was reported. */
static int put(struct chunk_store *s, const char *text, digest *name)
{
    struct buf frame;
    int reported = -1;
    buf_init(&frame);
    *name = digest_of(text, strlen(text));
    assert_int_equal(chunk_compress(text, strlen(text), &frame), ERR_OK);
    assert_int_equal(chunks_put(s, name, &frame, note_put, &reported), ERR_OK);
    (void)uv_run(&loop, UV_RUN_DEFAULT);
    return reported;
}

/* --- Tests ------------------------------------------------------------------ */

/* A chunk that was reported stored was once lost with the power: its name had not been synced. */
static void test_names_are_synced(void **state)
{
    (void)state;
    struct chunk_store *s;
    digest name;
    char hex[DIGEST_HEX_BYTES], path[PATH_BYTES], parent[PATH_BYTES];
    assert_int_equal(chunks_open(&loop, folder, &s), ERR_OK);
    int reported = put(s, "a chunk", &name);
    digest_to_hex(&name, hex);
    (void)snprintf(path, sizeof path, "/chunks/%.2s/%s", hex, hex);
    (void)snprintf(parent, sizeof parent, "/chunks/%.2s", hex);
    int renamed = find_step('r', path, 0);
    assert_true(renamed > 0);
    assert_int_equal(find_step('s', ".new", 0), renamed - 1);   /* its contents */
    assert_true(find_step('s', "/chunks", 0) >= 0);             /* the new folder's name */
    assert_true(find_step('s', parent, renamed + 1) > renamed); /* its own */
    assert_int_equal(reported, step_count);
    chunks_close(s);
}

static void note_swept(void *ctx)
{
    *(bool *)ctx = true;
}

static void sweep(struct chunk_store *s, uint64_t before_ms)
{
    bool swept = false;
    digest *roots = mem_alloc_array(1, sizeof *roots);
    assert_non_null(roots);
    assert_int_equal(chunks_sweep(s, roots, 0, before_ms, note_swept, &swept), ERR_OK);
    (void)uv_run(&loop, UV_RUN_DEFAULT);
    assert_true(swept);
}

/* What nobody needs goes; what somebody has asked for since is about to be used. */
static void test_sweep(void **state)
{
    (void)state;
    struct chunk_store *s;
    digest one, two;
    assert_int_equal(chunks_open(&loop, folder, &s), ERR_OK);
    (void)put(s, "one", &one);
    (void)put(s, "two", &two);
    uv_sleep(5);
    uv_update_time(&loop);
    uint64_t now = uv_now(&loop);
    assert_true(chunks_has(s, &one));
    sweep(s, now);
    assert_true(chunks_has(s, &one));
    assert_false(chunks_has(s, &two));
    assert_int_equal(chunks_count(s), 1);
    chunks_close(s);
    assert_int_equal(chunks_open(&loop, folder, &s), ERR_OK); /* what is listed is what was left */
    assert_int_equal(chunks_count(s), 1);
    chunks_close(s);
}

struct answer {
    int got, checked;
    enum err error;
    size_t missing;
};

static void note_got(void *ctx, enum err e, const digest *name, struct blob *frame,
                     uint64_t raw_bytes)
{
    struct answer *a = ctx;
    (void)name;
    (void)frame;
    (void)raw_bytes;
    a->got++;
    a->error = e;
}

static void note_checked(void *ctx, enum err e, struct buf *missing)
{
    struct answer *a = ctx;
    a->checked++;
    a->error = e;
    a->missing = missing->bytes / sizeof(digest);
}

/* Somebody took files out of the folder: who asks for them finds out, and clients are told to send
 * them again; once the master said until its end that they were there. */
static void test_files_that_are_gone(void **state)
{
    (void)state;
    struct chunk_store *s;
    digest names[2];
    struct answer a = {0};
    assert_int_equal(chunks_open(&loop, folder, &s), ERR_OK);
    (void)put(s, "one", &names[0]);
    (void)put(s, "two", &names[1]);
    chunks_close(s);
    assert_int_equal(chunks_open(&loop, folder, &s), ERR_OK); /* nothing is in memory */
    char command[128];
    (void)snprintf(command, sizeof command, "rm -rf '%s'/chunks/*", folder);
    assert_int_equal(system(command), 0);
    for (int i = 0; i < 3; i++)
        chunks_get(s, &names[0], note_got, &a);
    (void)uv_run(&loop, UV_RUN_DEFAULT);
    assert_int_equal(a.got, 3);
    assert_int_equal(a.error, ERR_NOT_FOUND);
    assert_false(chunks_has(s, &names[0]));
    assert_int_equal(chunks_check_package(s, &names[1], note_checked, &a), ERR_OK);
    (void)uv_run(&loop, UV_RUN_DEFAULT);
    assert_int_equal(a.checked, 1);
    assert_int_equal(a.error, ERR_OK);
    assert_int_equal(a.missing, 1);
    assert_false(chunks_has(s, &names[1]));
    assert_true(put(s, "one", &names[0]) > 0);
    assert_true(chunks_has(s, &names[0]));
    chunks_close(s);
}

int main(void)
{
    log_set_level(LOG_ERROR);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_names_are_synced, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_sweep, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_files_that_are_gone, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
