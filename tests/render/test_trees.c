/* Trees that were saved: the same hits; changed bytes are found out or harmless; the folder of them
 * is bounded and survives what disks and kills do. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "common/buf.h"
#include "common/mem.h"
#include "worker/render/accel.h"
#include "worker/tree_cache.h"

enum { TRIANGLES = 300, RAYS = 400 };

static uint64_t state = 1;

/* In [-1, 1). */
static double draw(void)
{
    state = state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (double)(state >> 11) * 0x1p-52 - 1;
}

/* Triangles as they are, the same as an instance, and a sphere. */
struct world {
    float positions[9 * TRIANGLES];
    uint32_t indices[3 * TRIANGLES];
    struct accel_mesh mesh;
    struct accel_object objects[3];
    struct accel_input input;
    struct accel_options options;
    struct ray rays[RAYS];
};

static void make_world(struct world *w, bool compact)
{
    memset(w, 0, sizeof *w);
    for (uint32_t i = 0; i < 3 * TRIANGLES; i++) {
        w->indices[i] = i;
        for (uint32_t k = 0; k < 3; k++) {
            double base = i % 3 ? (double)w->positions[3 * (i - i % 3) + k] : 0;
            w->positions[3 * i + k] = (float)(base + draw() * (i % 3 ? 0.2 : 1));
        }
    }
    w->mesh = (struct accel_mesh){w->positions, w->indices, 3 * TRIANGLES, TRIANGLES};
    w->objects[0] = (struct accel_object){.type = ACCEL_TRIANGLES};
    w->objects[1] = (struct accel_object){.type = ACCEL_SPHERE, .radius = 0.2};
    w->objects[2] = (struct accel_object){.type = ACCEL_INSTANCE,
                                          .to_scene = {0.5, 0, 0, 0.25, 0, 0.5, 0, 0, 0, 0, 0.5, 0},
                                          .from_scene = {2, 0, 0, -0.5, 0, 2, 0, 0, 0, 0, 2, 0}};
    w->input = (struct accel_input){&w->mesh, 1, w->objects, 3};
    w->options = (struct accel_options){.builder = JOB_BUILDER_SAH, .compact = compact};
    for (int i = 0; i < RAYS; i++) {
        w->rays[i] = (struct ray){.tmax = 1e30};
        for (int k = 0; k < 3; k++) {
            w->rays[i].org[k] = 2 * draw();
            w->rays[i].dir[k] = draw() - w->rays[i].org[k];
        }
    }
}

static void trace(const struct world *w, const struct accel *a, struct hit *hits)
{
    memset(hits, 0, RAYS * sizeof *hits);
    accel_closest_batch(a, w->rays, RAYS, hits);
}

static void save(const struct world *w, struct buf *out)
{
    struct accel *a;
    buf_init(out);
    assert_int_equal(accel_new(&w->input, &w->options, NULL, &a), ERR_OK);
    assert_false(accel_is_restored(a));
    unsigned char *at = buf_extend(out, accel_trees_bytes(a));
    assert_non_null(at);
    accel_trees_copy(a, 0, out->bytes, at);
    accel_free(a);
}

/* Builds from the bytes, traces, and says whether they were taken. */
static bool restore(const struct world *w, const void *data, size_t bytes, struct hit *hits)
{
    struct accel *a;
    void *copy = data ? mem_alloc_aligned(bytes, 64) : NULL;
    assert_true(copy || !data);
    if (bytes > 0)
        memcpy(copy, data, bytes);
    assert_int_equal(accel_new_saved(&w->input, &w->options, NULL, copy, bytes, &a), ERR_OK);
    bool taken = accel_is_restored(a);
    trace(w, a, hits);
    accel_free(a);
    return taken;
}

static void check_saved(bool compact)
{
    static struct world w;
    static struct hit built[RAYS], restored[RAYS];
    struct buf saved, again;
    make_world(&w, compact);
    save(&w, &saved);
    assert_false(restore(&w, NULL, 0, built));
    assert_true(restore(&w, saved.data, saved.bytes, restored));
    assert_memory_equal(built, restored, sizeof built);
    struct accel *a;
    buf_init(&again);
    void *copy = mem_alloc_aligned(saved.bytes, 64);
    assert_non_null(copy);
    memcpy(copy, saved.data, saved.bytes);
    assert_int_equal(accel_new_saved(&w.input, &w.options, NULL, copy, saved.bytes, &a), ERR_OK);
    assert_int_equal(accel_trees_bytes(a), saved.bytes);
    unsigned char *at = buf_extend(&again, saved.bytes);
    assert_non_null(at);
    for (size_t from = 0, some = 1; from < saved.bytes; from += some, some = 1 + some * 7 % 4001) {
        some = some < saved.bytes - from ? some : saved.bytes - from;
        accel_trees_copy(a, from, some, at + from); /* pieces cut anywhere */
    }
    assert_memory_equal(again.data, saved.data, saved.bytes);
    accel_free(a);
    buf_release(&again);
    w.options.compact = !compact;
    assert_false(restore(&w, saved.data, saved.bytes, restored));
    assert_memory_equal(built, restored, sizeof built);
    buf_release(&saved);
}

static void saved_trees_give_the_same_hits(void **ctx)
{
    (void)ctx;
    check_saved(false);
    check_saved(true);
}

/* Cut short, they are built anew. With any word changed, they are built anew or no ray leaves them
 * (the sanitizers look). */
static void check_hostile(bool compact)
{
    static struct world w;
    static struct hit built[RAYS], found[RAYS];
    struct buf saved;
    make_world(&w, compact);
    save(&w, &saved);
    (void)restore(&w, NULL, 0, built);
    for (size_t bytes = 0; bytes < saved.bytes; bytes += 1 + saved.bytes / 40) {
        assert_false(restore(&w, saved.data, bytes, found));
        assert_memory_equal(built, found, sizeof built);
    }
    size_t taken = 0, refused = 0;
    for (size_t at = 0; at + 4 <= saved.bytes; at += 4 * (1 + saved.bytes / 4 / 1500)) {
        static const uint32_t words[] = {0, UINT32_MAX, 0x7fc00000, 4, 2, 1 << 20};
        uint32_t before, changed = words[at / 4 % 6];
        memcpy(&before, saved.data + at, sizeof before);
        memcpy(saved.data + at, &changed, sizeof changed);
        bool was = restore(&w, saved.data, saved.bytes, found);
        taken += was;
        refused += !was;
        memcpy(saved.data + at, &before, sizeof before);
    }
    assert_true(taken > 100 && refused > 20);
    buf_release(&saved);
}

static void hostile_trees_are_harmless(void **ctx)
{
    (void)ctx;
    check_hostile(false);
    check_hostile(true);
}

/* A tree of some MiB, which is walked in parts: its own references hold; changed ones are found, or
 * no ray leaves them. */
static void large_trees_are_walked_in_parts(void **ctx)
{
    (void)ctx;
    enum { SIDE = 160, CORNERS = 6 * SIDE * SIDE }; /* a bumpy square of triangles */
    static struct world w;
    static struct hit built[RAYS], found[RAYS];
    static float positions[3 * CORNERS];
    static uint32_t indices[CORNERS];
    struct buf saved;
    make_world(&w, false);
    for (uint32_t i = 0; i < CORNERS; i++) {
        static const uint32_t corner[6][2] = {{0, 0}, {1, 0}, {1, 1}, {0, 0}, {1, 1}, {0, 1}};
        uint32_t x = i / 6 % SIDE + corner[i % 6][0], y = i / 6 / SIDE + corner[i % 6][1];
        indices[i] = i;
        positions[3 * i] = (float)x * (2.0f / SIDE) - 1;
        positions[3 * i + 1] = (float)y * (2.0f / SIDE) - 1;
        positions[3 * i + 2] = (float)((x * 7 + y * 13) % 10) * 0.01f;
    }
    w.mesh = (struct accel_mesh){positions, indices, CORNERS, CORNERS / 3};
    save(&w, &saved);
    assert_true(saved.bytes > 2 << 20);
    assert_false(restore(&w, NULL, 0, built));
    assert_true(restore(&w, saved.data, saved.bytes, found));
    assert_memory_equal(built, found, sizeof built);
    size_t refused = 0;
    for (size_t at = 200; at + 4 <= saved.bytes; at += 4 * (1 + saved.bytes / 4 / 400)) {
        static const uint32_t words[] = {0, UINT32_MAX, 28, 1 << 20};
        uint32_t before, changed = words[at / 4 % 4];
        memcpy(&before, saved.data + at, sizeof before);
        memcpy(saved.data + at, &changed, sizeof changed);
        refused += !restore(&w, saved.data, saved.bytes, found);
        memcpy(saved.data + at, &before, sizeof before);
    }
    assert_true(refused > 20);
    buf_release(&saved);
}

static void keys_follow_the_geometry(void **ctx)
{
    (void)ctx;
    static struct world w;
    digest a, b;
    make_world(&w, false);
    assert_int_equal(accel_trees_key(&w.input, &w.options, NULL, &a), ERR_OK);
    assert_int_equal(accel_trees_key(&w.input, &w.options, NULL, &b), ERR_OK);
    assert_true(digest_equal(&a, &b));
    w.positions[17] += 1;
    assert_int_equal(accel_trees_key(&w.input, &w.options, NULL, &b), ERR_OK);
    assert_false(digest_equal(&a, &b));
    w.positions[17] -= 1;
    w.options.builder = JOB_BUILDER_MEDIAN;
    assert_int_equal(accel_trees_key(&w.input, &w.options, NULL, &b), ERR_OK);
    assert_false(digest_equal(&a, &b));
    w.options.builder = JOB_BUILDER_SAH;
    w.options.compact = true;
    assert_int_equal(accel_trees_key(&w.input, &w.options, NULL, &b), ERR_OK);
    assert_false(digest_equal(&a, &b));
}

/* --- The folder ------------------------------------------------------------- */

static void give(void *ctx, size_t from, size_t bytes, unsigned char *out)
{
    (void)from;
    memset(out, *(unsigned char *)ctx, bytes);
}

static enum err put(struct tree_cache *c, unsigned char name, size_t bytes)
{
    digest key = {{name}};
    return tree_cache_put(c, &key, bytes, give, &name);
}

/* True if the tree is there, as it was put. */
static bool has(struct tree_cache *c, unsigned char name, size_t bytes)
{
    digest key = {{name}};
    void *data = NULL;
    size_t found = 0;
    if (tree_cache_get(c, &key, NULL, &data, &found) != ERR_OK) {
        assert_null(data);
        return false;
    }
    bool same = found == bytes;
    for (size_t i = 0; same && i < bytes; i++)
        same = ((const unsigned char *)data)[i] == name;
    mem_free(data);
    return same;
}

static char *file_of(const char *folder, unsigned char name)
{
    char hex[DIGEST_HEX_BYTES];
    digest key = {{name}};
    digest_to_hex(&key, hex);
    return mem_sprintf("%s/trees/%s.tree", folder, hex);
}

static void set_age(const char *folder, unsigned char name, time_t when)
{
    char *path = file_of(folder, name);
    struct timespec times[2] = {{.tv_sec = when}, {.tv_sec = when}};
    assert_int_equal(utimensat(AT_FDCWD, path, times, 0), 0);
    mem_free(path);
}

static void the_folder_is_bounded_and_checked(void **ctx)
{
    (void)ctx;
    char folder[] = "/tmp/test_trees.XXXXXX";
    struct tree_cache *c;
    assert_non_null(mkdtemp(folder));
    assert_int_equal(tree_cache_new(folder, 10000, &c), ERR_OK);
    assert_int_equal(put(c, 1, 3000), ERR_OK);
    assert_int_equal(put(c, 2, 3000), ERR_OK);
    assert_true(has(c, 1, 3000) && has(c, 2, 3000) && !has(c, 3, 3000));
    set_age(folder, 1, 2000);
    set_age(folder, 2, 1000);
    assert_int_equal(put(c, 3, 5000), ERR_OK); /* the one used longest ago goes */
    assert_true(has(c, 1, 3000) && !has(c, 2, 3000) && has(c, 3, 5000));
    assert_int_equal(put(c, 4, 20000), ERR_OK); /* larger than all there may be */
    assert_true(!has(c, 4, 20000) && has(c, 3, 5000));

    /* One byte changed on the disk; a file cut short by nothing that we do. */
    char *path = file_of(folder, 3);
    FILE *file = fopen(path, "r+b");
    assert_non_null(file);
    assert_int_equal(fseek(file, 4000, SEEK_SET), 0);
    assert_int_not_equal(fputc(99, file), EOF);
    assert_int_equal(fclose(file), 0);
    assert_false(has(c, 3, 5000));
    assert_int_not_equal(access(path, F_OK), 0); /* dropped */
    mem_free(path);
    path = file_of(folder, 1);
    assert_int_equal(truncate(path, 7), 0);
    assert_false(has(c, 1, 3000));
    mem_free(path);

    /* A file of 1 TiB that takes no room on the disk: never read into memory. */
    assert_int_equal(put(c, 5, 3000), ERR_OK);
    path = file_of(folder, 5);
    assert_int_equal(truncate(path, INT64_C(1) << 40), 0);
    digest key = {{5}};
    void *data = NULL;
    size_t found = 0;
    assert_int_equal(tree_cache_get(c, &key, NULL, &data, &found), ERR_NOT_FOUND);
    assert_int_not_equal(access(path, F_OK), 0); /* dropped */
    mem_free(path);
    tree_cache_free(c);
    char *inside = mem_sprintf("%s/trees", folder);
    assert_int_equal(rmdir(inside), 0);
    assert_int_equal(rmdir(folder), 0);
    mem_free(inside);
}

/* A file with any byte changed, or cut anywhere, is no tree, and is dropped. */
static void a_change_anywhere_is_found(void **ctx)
{
    (void)ctx;
    enum { BYTES = 1500 };
    char folder[] = "/tmp/test_trees.XXXXXX";
    struct tree_cache *c;
    struct stat st;
    assert_non_null(mkdtemp(folder));
    assert_int_equal(tree_cache_new(folder, 10000, &c), ERR_OK);
    char *path = file_of(folder, 1);
    assert_int_equal(put(c, 1, BYTES), ERR_OK);
    assert_int_equal(stat(path, &st), 0);
    for (off_t at = 0; at < st.st_size; at++) {
        unsigned char byte;
        assert_int_equal(put(c, 1, BYTES), ERR_OK);
        assert_true(has(c, 1, BYTES));
        int fd = open(path, O_RDWR);
        assert_true(fd >= 0 && pread(fd, &byte, 1, at) == 1);
        byte ^= (unsigned char)(1u << at % 8);
        assert_true(pwrite(fd, &byte, 1, at) == 1 && close(fd) == 0);
        void *data = NULL;
        size_t bytes = 0;
        enum err e = tree_cache_get(c, &(digest){{1}}, NULL, &data, &bytes);
        /* Of the head, some bytes are of no use. */
        bool pad = at >= 24 && at < 64;
        assert_int_equal(e, pad ? ERR_OK : ERR_NOT_FOUND);
        assert_int_equal(access(path, F_OK) == 0, pad);
        mem_free(data);
        assert_int_equal(put(c, 1, BYTES), ERR_OK);
        assert_int_equal(truncate(path, at), 0);
        assert_false(has(c, 1, BYTES));
    }
    mem_free(path);
    tree_cache_free(c);
    char *inside = mem_sprintf("%s/trees", folder);
    assert_int_equal(rmdir(inside), 0);
    assert_int_equal(rmdir(folder), 0);
    mem_free(inside);
}

enum { KILLED_BYTES = (2 << 20) + 100 }; /* of several writes */

/* Puts tree 6 in a process that is killed at its system call number `call`, on the way into it or
 * out of it by turns. True if it has ended before. */
static bool put_until(struct tree_cache *c, long call)
{
    int status;
    pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) {
        if (ptrace(PTRACE_TRACEME, 0, NULL, NULL) != 0 || raise(SIGSTOP) != 0)
            _exit(2);
        _exit(put(c, 6, KILLED_BYTES) == ERR_OK ? 0 : 1);
    }
    for (long i = 0; i <= call; i++) {
        assert_int_equal(waitpid(child, &status, 0), child);
        if (WIFEXITED(status)) {
            assert_int_equal(WEXITSTATUS(status), 0);
            return true;
        }
        assert_true(WIFSTOPPED(status));
        if (i < call)
            assert_int_equal(ptrace(PTRACE_SYSCALL, child, NULL, NULL), 0);
    }
    assert_int_equal(kill(child, SIGKILL), 0);
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(WIFSIGNALED(status));
    return false;
}

/* What a writer leaves that is killed anywhere: the tree, whole, or none; other trees as they were;
 * and the next writer has its way. */
static void a_kill_at_any_call_leaves_no_broken_tree(void **ctx)
{
    (void)ctx;
    char folder[] = "/tmp/test_trees.XXXXXX";
    struct tree_cache *c, *next;
    long call = 1, there = 0, none = 0;
    bool ended = false;
    assert_non_null(mkdtemp(folder));
    char *path = file_of(folder, 6), *inside = mem_sprintf("%s/trees", folder);
    assert_int_equal(tree_cache_new(folder, 3 * KILLED_BYTES, &c), ERR_OK);
    for (; !ended; call++) {
        assert_int_equal(put(c, 1, 3000), ERR_OK);
        ended = put_until(c, call);
        bool is_there = access(path, F_OK) == 0;
        assert_int_equal(tree_cache_new(folder, 3 * KILLED_BYTES, &next), ERR_OK);
        assert_int_equal(has(next, 6, KILLED_BYTES), is_there);
        assert_true(has(next, 1, 3000));
        there += is_there;
        none += !is_there;
        tree_cache_drop(next, &(digest){{6}});
        assert_int_equal(put(next, 6, KILLED_BYTES), ERR_OK);
        assert_true(has(next, 6, KILLED_BYTES));
        tree_cache_drop(next, &(digest){{6}});
        tree_cache_free(next);
    }
    printf("  %ld kills: %ld times no tree, %ld times the tree\n", call - 2, none, there);
    assert_true(none > 10 && there > 1);
    /* What the killed have left counts, and goes when room is wanted. */
    assert_int_equal(tree_cache_new(folder, 1, &next), ERR_OK);
    tree_cache_free(next);
    tree_cache_free(c);
    assert_int_equal(rmdir(inside), 0);
    assert_int_equal(rmdir(folder), 0);
    mem_free(inside);
    mem_free(path);
}

/* One claims a tree, others wait for it: until it is there, until its builder is killed, or until
 * they have waited enough. */
static void one_builds_and_others_wait(void **ctx)
{
    (void)ctx;
    char folder[] = "/tmp/test_trees.XXXXXX";
    struct tree_cache *c, *other;
    struct tree_claim *claim, *second;
    digest key = {{1}};
    assert_non_null(mkdtemp(folder));
    assert_int_equal(tree_cache_new(folder, 10000, &c), ERR_OK);
    assert_int_equal(tree_cache_new(folder, 10000, &other), ERR_OK);
    assert_false(tree_cache_claim(c, &key, 0, &claim));
    assert_non_null(claim);
    assert_false(tree_cache_claim(other, &key, 10, &second));
    assert_null(second); /* it has waited enough: it builds, and holds up nobody */
    assert_int_equal(put(c, 1, 3000), ERR_OK);
    assert_true(tree_cache_claim(other, &key, 0, &second)); /* there, though still claimed */
    assert_null(second);
    assert_true(has(other, 1, 3000));
    tree_cache_release(claim);
    assert_true(tree_cache_claim(other, &key, 0, &second));
    assert_null(second);

    /* A builder that is killed leaves neither tree nor claim. */
    tree_cache_drop(c, &key);
    int said[2];
    assert_int_equal(pipe(said), 0);
    pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) {
        bool mine = !tree_cache_claim(other, &key, 0, &claim) && claim;
        ssize_t ignored = write(said[1], mine ? "y" : "n", 1);
        (void)ignored;
        for (;;)
            (void)pause();
    }
    char answer = 0;
    assert_int_equal(read(said[0], &answer, 1), 1);
    assert_int_equal(answer, 'y');
    assert_false(tree_cache_claim(c, &key, 0, &second));
    assert_null(second);
    assert_int_equal(kill(child, SIGKILL), 0);
    assert_false(tree_cache_claim(c, &key, 60000, &second));
    assert_non_null(second); /* at once, not when patience ends */
    tree_cache_release(second);
    assert_int_equal(waitpid(child, NULL, 0), child);
    (void)close(said[0]);
    (void)close(said[1]);

    tree_cache_free(c);
    tree_cache_free(other);
    char *inside = mem_sprintf("%s/trees", folder);
    assert_int_equal(rmdir(inside), 0); /* no lock is left */
    assert_int_equal(rmdir(folder), 0);
    mem_free(inside);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(saved_trees_give_the_same_hits),
        cmocka_unit_test(hostile_trees_are_harmless),
        cmocka_unit_test(large_trees_are_walked_in_parts),
        cmocka_unit_test(keys_follow_the_geometry),
        cmocka_unit_test(the_folder_is_bounded_and_checked),
        cmocka_unit_test(a_change_anywhere_is_found),
        cmocka_unit_test(a_kill_at_any_call_leaves_no_broken_tree),
        cmocka_unit_test(one_builds_and_others_wait),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
