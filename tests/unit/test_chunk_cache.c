/* The chunk cache: what goes in comes out, the disk is not trusted, and it stays within its size.
 */
#include <dirent.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "common/file_io.h"
#include "common/mem.h"
#include "common/package.h"
#include "worker/chunk_cache.h"

enum { RAW_BYTES = 5000 };

static char folder[64];

static int make_folder(void **state)
{
    (void)state;
    (void)snprintf(folder, sizeof folder, "/tmp/test_chunk_cache_XXXXXX");
    return mkdtemp(folder) ? 0 : -1;
}

/* Calls fn for each file two levels down; returns how many there are. */
static size_t for_each_file(void (*fn)(const char *path))
{
    size_t count = 0;
    DIR *top = opendir(folder);
    assert_non_null(top);
    for (struct dirent *d = readdir(top); d; d = readdir(top)) {
        char shard[400];
        (void)snprintf(shard, sizeof shard, "%s/%s", folder, d->d_name);
        DIR *dir = d->d_name[0] == '.' ? NULL : opendir(shard);
        for (struct dirent *f = dir ? readdir(dir) : NULL; f; f = readdir(dir)) {
            char path[800];
            (void)snprintf(path, sizeof path, "%s/%s", shard, f->d_name);
            if (f->d_name[0] == '.')
                continue;
            count++;
            if (fn)
                fn(path);
        }
        if (dir)
            (void)closedir(dir);
    }
    (void)closedir(top);
    return count;
}

static void unlink_file(const char *path)
{
    assert_int_equal(unlink(path), 0);
}

static int remove_folder(void **state)
{
    (void)state;
    (void)for_each_file(unlink_file);
    for (int i = 0; i < 256; i++) {
        char shard[400];
        (void)snprintf(shard, sizeof shard, "%s/%02x", folder, i);
        (void)rmdir(shard);
    }
    return rmdir(folder);
}

/* Contents that zstd cannot shrink, so that sizes are known. */
static void raw_chunk(uint32_t number, unsigned char raw[RAW_BYTES])
{
    uint64_t x = number + 1;
    for (size_t i = 0; i < RAW_BYTES; i++) {
        x = x * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
        raw[i] = (unsigned char)(x >> 56);
    }
}

static digest name_of(uint32_t number)
{
    unsigned char raw[RAW_BYTES];
    raw_chunk(number, raw);
    return digest_of(raw, sizeof raw);
}

static unsigned char *frame_of(uint32_t number, size_t *bytes)
{
    unsigned char raw[RAW_BYTES];
    struct buf frame;
    buf_init(&frame);
    raw_chunk(number, raw);
    assert_int_equal(chunk_compress(raw, sizeof raw, &frame), ERR_OK);
    *bytes = frame.bytes;
    return frame.data;
}

/* Puts a frame, and looks at what comes out of it on the way. */
static enum err keep(struct chunk_cache *c, const digest *name, unsigned char *frame, size_t bytes,
                     uint64_t raw_bytes_max)
{
    struct buf plain;
    buf_init(&plain);
    enum err e = chunk_cache_put(c, name, frame, bytes, raw_bytes_max, &plain);
    digest found = digest_of(plain.data, plain.bytes);
    assert_true(e != ERR_OK || (plain.bytes == RAW_BYTES && digest_equal(&found, name)));
    buf_release(&plain);
    return e;
}

static void put(struct chunk_cache *c, uint32_t number)
{
    size_t bytes;
    unsigned char *frame = frame_of(number, &bytes);
    digest name = name_of(number);
    assert_int_equal(keep(c, &name, frame, bytes, RAW_BYTES), ERR_OK);
}

static enum err get(struct chunk_cache *c, uint32_t number)
{
    unsigned char raw[RAW_BYTES];
    struct buf out;
    digest name = name_of(number);
    buf_init(&out);
    enum err e = chunk_cache_get(c, &name, RAW_BYTES, &out);
    if (e == ERR_OK) {
        raw_chunk(number, raw);
        assert_int_equal(out.bytes, RAW_BYTES);
        assert_memory_equal(out.data, raw, RAW_BYTES);
    }
    buf_release(&out);
    return e;
}

static bool has(struct chunk_cache *c, uint32_t number)
{
    digest name = name_of(number);
    return chunk_cache_has(c, &name);
}

static struct chunk_cache *open_cache(bool on_disk, uint64_t bytes_max)
{
    struct chunk_cache *c;
    assert_int_equal(chunk_cache_new(on_disk ? folder : NULL, bytes_max, &c), ERR_OK);
    return c;
}

static void in_and_out(void **state)
{
    (void)state;
    for (int on_disk = 0; on_disk < 2; on_disk++) {
        struct chunk_cache *c = open_cache(on_disk, 1 << 20);
        assert_false(has(c, 1));
        assert_int_equal(get(c, 1), ERR_NOT_FOUND);
        put(c, 1);
        put(c, 1);
        assert_true(has(c, 1));
        assert_int_equal(get(c, 1), ERR_OK);
        assert_true(chunk_cache_bytes(c) >= RAW_BYTES && chunk_cache_bytes(c) < 2 * RAW_BYTES);
        chunk_cache_free(c);
    }
    struct chunk_cache *c = open_cache(true, 1 << 20); /* another process, later */
    assert_int_equal(get(c, 1), ERR_OK);
    chunk_cache_free(c);
}

static void what_is_not_the_chunk_is_refused(void **state)
{
    (void)state;
    struct chunk_cache *c = open_cache(true, 1 << 20);
    size_t bytes;
    digest other = name_of(2), name = name_of(1);
    unsigned char *frame = frame_of(1, &bytes);
    assert_int_equal(keep(c, &other, frame, bytes, RAW_BYTES), ERR_CORRUPT);
    frame = frame_of(1, &bytes);
    assert_int_not_equal(keep(c, &name, frame, bytes, RAW_BYTES - 1), ERR_OK);
    for (size_t at = 0; at < 200; at++) {
        frame = frame_of(1, &bytes);
        frame[at * (bytes / 200)] ^= 0x10;
        enum err e = keep(c, &name, frame, bytes, RAW_BYTES);
        assert_true(e != ERR_OK || get(c, 1) == ERR_OK);
    }
    assert_false(has(c, 2));
    chunk_cache_free(c);
}

static void flip_a_bit(const char *path)
{
    int fd = open(path, O_RDWR);
    unsigned char byte = 0;
    assert_true(fd >= 0 && pread(fd, &byte, 1, RAW_BYTES / 2) == 1);
    byte ^= 1;
    assert_int_equal(pwrite(fd, &byte, 1, RAW_BYTES / 2), 1);
    assert_int_equal(close(fd), 0);
}

static void cut_off(const char *path)
{
    assert_int_equal(truncate(path, RAW_BYTES / 3), 0);
}

static void a_changed_file_is_dropped(void **state)
{
    (void)state;
    void (*const damages[])(const char *) = {flip_a_bit, cut_off, unlink_file};
    for (size_t i = 0; i < sizeof damages / sizeof *damages; i++) {
        struct chunk_cache *c = open_cache(true, 1 << 20);
        put(c, 7);
        assert_int_equal(for_each_file(damages[i]), 1);
        assert_int_equal(get(c, 7), ERR_NOT_FOUND);
        assert_false(has(c, 7));
        assert_int_equal(for_each_file(NULL), 0);
        put(c, 7);
        assert_int_equal(get(c, 7), ERR_OK);
        chunk_cache_free(c);
    }
}

static void the_oldest_go_first(void **state)
{
    (void)state;
    for (int on_disk = 0; on_disk < 2; on_disk++) {
        struct chunk_cache *c = open_cache(on_disk, 4 * (RAW_BYTES + 100));
        for (uint32_t i = 0; i < 4; i++)
            put(c, i);
        assert_true(has(c, 0)); /* used again: now 1 is the oldest */
        chunk_cache_begin(c);
        put(c, 4);
        assert_true(has(c, 0) && !has(c, 1) && has(c, 4));
        assert_true(chunk_cache_bytes(c) <= 4 * (RAW_BYTES + 100));
        for (uint32_t i = 10; i < 20; i++) /* one scene that is too large stays whole */
            put(c, i);
        for (uint32_t i = 10; i < 20; i++)
            assert_int_equal(get(c, i), ERR_OK);
        chunk_cache_begin(c);
        put(c, 30);
        assert_true(chunk_cache_bytes(c) <= 4 * (RAW_BYTES + 100));
        if (on_disk)
            assert_int_equal(for_each_file(NULL), 4);
        chunk_cache_free(c);
    }
}

static void two_workers_share_a_folder(void **state)
{
    (void)state;
    struct chunk_cache *a = open_cache(true, 1 << 20), *b = open_cache(true, 1 << 20);
    put(a, 5);
    assert_true(has(b, 5));
    assert_int_equal(get(b, 5), ERR_OK);
    chunk_cache_free(a);
    chunk_cache_free(b);
}

/* A writer is killed at any moment: the next one finds whole chunks only. */
static void killed_in_mid_write(void **state)
{
    (void)state;
    for (int round = 0; round < 20; round++) {
        pid_t child = fork();
        assert_true(child >= 0);
        if (child == 0) {
            struct chunk_cache *c = open_cache(true, 1 << 20);
            for (uint32_t i = 0;; i++)
                put(c, i % 50);
        }
        (void)usleep((useconds_t)(1000 + 700 * round));
        (void)kill(child, SIGKILL);
        assert_int_equal(waitpid(child, NULL, 0), child);
        struct chunk_cache *c = open_cache(true, 1 << 20);
        for (uint32_t i = 0; i < 50; i++)
            assert_true(!has(c, i) || get(c, i) == ERR_OK);
        chunk_cache_free(c);
    }
}

static void leftovers_of_a_killed_writer_go(void **state)
{
    (void)state;
    struct chunk_cache *c = open_cache(true, 1 << 20);
    char hex[DIGEST_HEX_BYTES], path[300];
    digest name = name_of(1);
    put(c, 1);
    chunk_cache_free(c);
    digest_to_hex(&name, hex);
    (void)snprintf(path, sizeof path, "%s/%.2s/%s.zst.abcdef", folder, hex, hex);
    assert_int_equal(file_write(path, "half", 4), ERR_OK);
    c = open_cache(true, 1 << 20);
    assert_int_equal(for_each_file(NULL), 2); /* young: perhaps another worker is writing it */
    chunk_cache_free(c);
    struct timespec old[2] = {{.tv_sec = 1000}, {.tv_sec = 1000}};
    assert_int_equal(utimensat(AT_FDCWD, path, old, 0), 0);
    c = open_cache(true, 1 << 20);
    assert_int_equal(for_each_file(NULL), 1);
    assert_int_equal(get(c, 1), ERR_OK);
    chunk_cache_free(c);
}

/* A folder that has become unusable costs memory, not the chunk. */
static void a_folder_that_fails(void **state)
{
    (void)state;
    struct chunk_cache *c;
    assert_int_not_equal(chunk_cache_new("/dev/null/x", 1 << 20, &c), ERR_OK);
    c = open_cache(true, 1 << 20);
    char hex[DIGEST_HEX_BYTES], path[300];
    digest name = name_of(3);
    digest_to_hex(&name, hex);
    (void)snprintf(path, sizeof path, "%s/%.2s", folder, hex);
    assert_int_equal(file_write(path, "in the way", 10), ERR_OK); /* where a folder must be */
    put(c, 3);
    assert_int_equal(get(c, 3), ERR_OK);
    chunk_cache_free(c);
    assert_int_equal(unlink(path), 0);
}

static void out_of_memory(void **state)
{
    (void)state;
    bool done = false;
    for (uint64_t n = 0; !done; n++) {
        struct chunk_cache *c = open_cache(true, 1 << 20);
        size_t bytes;
        unsigned char *frame = frame_of(9, &bytes);
        digest name = name_of(9);
        mem_fail_after(n);
        uint64_t calls = mem_call_count();
        enum err e = keep(c, &name, frame, bytes, RAW_BYTES);
        done = mem_call_count() - calls <= n;
        mem_fail_after(UINT64_MAX);
        assert_true(e == ERR_OK || e == ERR_NOMEM);
        assert_true(e != ERR_OK || get(c, 9) == ERR_OK);
        chunk_cache_free(c);
        (void)for_each_file(unlink_file);
    }
}

int main(void)
{
#define IN_FOLDER(test) cmocka_unit_test_setup_teardown(test, make_folder, remove_folder)
    const struct CMUnitTest tests[] = {
        IN_FOLDER(in_and_out),
        IN_FOLDER(what_is_not_the_chunk_is_refused),
        IN_FOLDER(a_changed_file_is_dropped),
        IN_FOLDER(the_oldest_go_first),
        IN_FOLDER(two_workers_share_a_folder),
        IN_FOLDER(killed_in_mid_write),
        IN_FOLDER(leftovers_of_a_killed_writer_go),
        IN_FOLDER(a_folder_that_fails),
        IN_FOLDER(out_of_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
