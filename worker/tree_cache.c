#include "worker/tree_cache.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <time.h>
#include <unistd.h>

#include "common/checksum.h"
#include "common/file_io.h"
#include "common/log.h"
#include "common/mem.h"

struct tree_cache {
    char *folder;
    uint64_t bytes_max;
};

static const char suffix[] = ".tree", lock_suffix[] = ".lock";

enum {
    WAIT_STEP_MS = 2,
    ROOM_SHARE_MAX = 4, /* of the free room, one in so many bytes may be a tree's */
};

static char *path_of(const struct tree_cache *c, const digest *key, const char *end)
{
    char hex[DIGEST_HEX_BYTES];
    digest_to_hex(key, hex);
    return mem_sprintf("%s/%s%s", c->folder, hex, end);
}

void tree_cache_drop(struct tree_cache *c, const digest *key)
{
    char *path = path_of(c, key, suffix);
    if (path)
        (void)unlink(path);
    mem_free(path);
}

/* --- Bound --------------------------------------------------------------- */

struct file {
    char *path;
    uint64_t bytes;
    struct timespec used;
};

static int by_use(const void *a, const void *b)
{
    const struct file *x = a, *y = b;
    if (x->used.tv_sec != y->used.tv_sec)
        return x->used.tv_sec < y->used.tv_sec ? -1 : 1;
    return (x->used.tv_nsec > y->used.tv_nsec) - (x->used.tv_nsec < y->used.tv_nsec);
}

/* Every file of the folder, those of writers that were killed among them. */
static struct file *list_files(const struct tree_cache *c, size_t *count)
{
    struct file *files = NULL;
    size_t capacity = 0;
    DIR *dir = opendir(c->folder);
    *count = 0;
    for (struct dirent *f = dir ? readdir(dir) : NULL; f; f = readdir(dir)) {
        struct stat st;
        char *path = mem_sprintf("%s/%s", c->folder, f->d_name);
        if (!path || stat(path, &st) != 0 || !S_ISREG(st.st_mode) ||
            !mem_grow((void **)&files, *count, &capacity, sizeof *files)) {
            mem_free(path);
            continue;
        }
        files[(*count)++] =
            (struct file){.path = path, .bytes = (uint64_t)st.st_size, .used = st.st_mtim};
    }
    if (dir)
        (void)closedir(dir);
    return files;
}

static void trim(const struct tree_cache *c)
{
    size_t count;
    struct file *files = list_files(c, &count);
    uint64_t bytes = 0;
    for (size_t i = 0; i < count; i++)
        bytes += files[i].bytes;
    if (count > 0)
        qsort(files, count, sizeof *files, by_use);
    for (size_t i = 0; i < count; i++) {
        if (bytes > c->bytes_max && unlink(files[i].path) == 0)
            bytes -= files[i].bytes;
        mem_free(files[i].path);
    }
    mem_free(files);
}

/* --- Life ---------------------------------------------------------------- */

enum err tree_cache_new(const char *folder, uint64_t bytes_max, struct tree_cache **out)
{
    struct tree_cache *c = mem_calloc(1, sizeof *c);
    if (!c)
        return ERR_NOMEM;
    c->bytes_max = bytes_max;
    c->folder = mem_sprintf("%s/trees", folder);
    if (!c->folder) {
        tree_cache_free(c);
        return ERR_NOMEM;
    }
    trim(c);
    *out = c;
    return ERR_OK;
}

void tree_cache_free(struct tree_cache *c)
{
    if (!c)
        return;
    mem_free(c->folder);
    mem_free(c);
}

/* --- The form of a file --------------------------------------------------- */

/* The head, a checksum of each block of the body, the body; numbers as this machine has them. */
struct head {
    char magic[8];
    uint64_t body_bytes, table_sum;
    uint64_t pad[5];
};

enum { BLOCK_BYTES = 1 << 20 };

static const char magic[8] = {'T', 'L', 'Y', 'K', 'E', 'P', 'T', '2'};

static size_t block_count(size_t body_bytes)
{
    return body_bytes / BLOCK_BYTES + (body_bytes % BLOCK_BYTES > 0);
}

static size_t body_at(size_t body_bytes)
{
    return sizeof(struct head) + block_count(body_bytes) * sizeof(uint64_t);
}

static size_t block_bytes(size_t body_bytes, size_t block)
{
    size_t left = body_bytes - block * BLOCK_BYTES;
    return left < BLOCK_BYTES ? left : BLOCK_BYTES;
}

/* --- Reading -------------------------------------------------------------- */

/* A file being read, a block a task. */
struct reading {
    int fd;
    size_t body_bytes;
    uint64_t *sums; /* of its blocks, as the file says */
    unsigned char *body;
    atomic_bool changed;
};

static bool read_at(int fd, void *out, size_t bytes, size_t at)
{
    unsigned char *to = out;
    while (bytes > 0) {
        ssize_t got = pread(fd, to, bytes, (off_t)at);
        if (got < 0 && errno == EINTR)
            continue;
        if (got <= 0)
            return false;
        to += got;
        at += (size_t)got;
        bytes -= (size_t)got;
    }
    return true;
}

static void read_block(void *arg, size_t block)
{
    struct reading *r = arg;
    unsigned char *to = r->body + block * BLOCK_BYTES;
    size_t bytes = block_bytes(r->body_bytes, block);
    if (!read_at(r->fd, to, bytes, body_at(r->body_bytes) + block * BLOCK_BYTES) ||
        checksum64(to, bytes) != r->sums[block])
        atomic_store(&r->changed, true);
}

/* The head and the table; ERR_CORRUPT when they are not what was written. */
static enum err read_table(struct reading *r, uint64_t file_bytes)
{
    struct head head;
    if (file_bytes < sizeof head || !read_at(r->fd, &head, sizeof head, 0) ||
        memcmp(head.magic, magic, sizeof magic) != 0 || head.body_bytes == 0 ||
        head.body_bytes >= file_bytes || body_at(head.body_bytes) + head.body_bytes != file_bytes)
        return ERR_CORRUPT;
    size_t table_bytes = block_count(head.body_bytes) * sizeof *r->sums;
    r->body_bytes = head.body_bytes;
    r->sums = mem_alloc(table_bytes);
    if (!r->sums)
        return ERR_NOMEM;
    bool same = read_at(r->fd, r->sums, table_bytes, sizeof head) &&
                checksum64(r->sums, table_bytes) == head.table_sum;
    return same ? ERR_OK : ERR_CORRUPT;
}

/* The whole body, on all threads. */
static enum err read_body(struct reading *r, const struct accel_runner *runner)
{
    size_t align = r->body_bytes >= MEM_HUGE_PAGE ? MEM_HUGE_PAGE : 64;
    size_t blocks = block_count(r->body_bytes);
    r->body = mem_alloc_aligned(r->body_bytes, align);
    if (!r->body)
        return ERR_NOMEM;
    if (runner && blocks > 1)
        runner->run(runner->ctx, blocks, read_block, r);
    for (size_t i = 0; (!runner || blocks == 1) && i < blocks; i++)
        read_block(r, i);
    return atomic_load(&r->changed) ? ERR_CORRUPT : ERR_OK;
}

static enum err read_file(struct tree_cache *c, const char *path, const struct accel_runner *runner,
                          struct reading *r)
{
    struct stat st;
    r->fd = open(path, O_RDONLY | O_CLOEXEC);
    if (r->fd < 0)
        return err_from_errno(errno);
    if (fstat(r->fd, &st) != 0 || !S_ISREG(st.st_mode))
        return ERR_IO;
    /* A larger one was never put here: it is not read. */
    if ((uint64_t)st.st_size > c->bytes_max)
        return ERR_CORRUPT;
    TL_TRY(read_table(r, (uint64_t)st.st_size));
    return read_body(r, runner);
}

/* --- In and out ---------------------------------------------------------- */

enum err tree_cache_get(struct tree_cache *c, const digest *key, const struct accel_runner *runner,
                        void **data, size_t *bytes)
{
    char *path = path_of(c, key, suffix);
    struct reading r = {.fd = -1};
    if (!path)
        return ERR_NOMEM;
    enum err e = read_file(c, path, runner, &r);
    if (r.fd >= 0)
        (void)close(r.fd);
    mem_free(r.sums);
    if (e == ERR_CORRUPT) {
        log_warn("cache",
                 "tree dropped: the disk has changed it, or it is of another version "
                 "file=%s",
                 path);
        (void)unlink(path);
        e = ERR_NOT_FOUND;
    }
    if (e == ERR_OK) {
        (void)utimensat(AT_FDCWD, path, NULL, 0); /* used now, for every process */
        *data = r.body;
        *bytes = r.body_bytes;
    } else {
        mem_free(r.body);
    }
    mem_free(path);
    return e;
}

/* --- Writing -------------------------------------------------------------- */

static enum err write_at(int fd, const void *data, size_t bytes, size_t at)
{
    const unsigned char *from = data;
    while (bytes > 0) {
        ssize_t wrote = pwrite(fd, from, bytes, (off_t)at);
        if (wrote < 0 && errno == EINTR)
            continue;
        if (wrote < 0)
            return err_from_errno(errno);
        from += wrote;
        at += (size_t)wrote;
        bytes -= (size_t)wrote;
    }
    return ERR_OK;
}

/* The body through `room`, a block at a time, then the table and the head in front of it. */
static enum err write_file(int fd, size_t bytes, tree_source *source, void *ctx,
                           unsigned char *room, uint64_t *sums)
{
    struct head head = {.body_bytes = bytes};
    size_t blocks = block_count(bytes), at = body_at(bytes);
    for (size_t i = 0; i < blocks; i++) {
        size_t some = block_bytes(bytes, i);
        source(ctx, i * BLOCK_BYTES, some, room);
        sums[i] = checksum64(room, some);
        TL_TRY(write_at(fd, room, some, at + i * BLOCK_BYTES));
    }
    memcpy(head.magic, magic, sizeof magic);
    head.table_sum = checksum64(sums, blocks * sizeof *sums);
    TL_TRY(write_at(fd, sums, blocks * sizeof *sums, sizeof head));
    return write_at(fd, &head, sizeof head, 0);
}

/* A file of that size leaves most of the free room to others: the folder may be that of all
 * temporary files. */
static bool has_room(const struct tree_cache *c, uint64_t bytes)
{
    struct statvfs disk;
    return statvfs(c->folder, &disk) == 0 &&
           bytes <= (uint64_t)disk.f_bavail * disk.f_frsize / ROOM_SHARE_MAX;
}

/* Written aside and renamed; not synced: what a crash of the machine makes of it, the checksums
 * find. */
static enum err write_aside(const char *path, size_t bytes, tree_source *source, void *ctx)
{
    char *aside;
    int fd;
    unsigned char *room = mem_alloc(BLOCK_BYTES);
    uint64_t *sums = mem_alloc_array(block_count(bytes), sizeof *sums);
    enum err e = room && sums ? file_open_aside(path, &aside, &fd) : ERR_NOMEM;
    if (e == ERR_OK) {
        e = write_file(fd, bytes, source, ctx, room, sums);
        e = file_close_aside(path, aside, fd, e);
    }
    mem_free(room);
    mem_free(sums);
    return e;
}

static enum err make_folder(const struct tree_cache *c)
{
    return mkdir(c->folder, 0777) == 0 || errno == EEXIST ? ERR_OK : err_from_errno(errno);
}

enum err tree_cache_put(struct tree_cache *c, const digest *key, size_t bytes, tree_source *source,
                        void *ctx)
{
    TL_ASSERT(bytes > 0);
    uint64_t file_bytes = body_at(bytes) + bytes;
    if (file_bytes > c->bytes_max)
        return ERR_OK;
    TL_TRY(make_folder(c));
    if (!has_room(c, file_bytes))
        return ERR_NOSPACE;
    char *path = path_of(c, key, suffix);
    enum err e = path ? write_aside(path, bytes, source, ctx) : ERR_NOMEM;
    mem_free(path);
    trim(c);
    return e;
}

/* --- Who builds ------------------------------------------------------------ */

struct tree_claim {
    char *path; /* of the lock's file */
    int fd;     /* locked while the claim lives: a kill ends both */
};

void tree_cache_release(struct tree_claim *claim)
{
    if (!claim)
        return;
    /* Who waits on the file finds the tree there, or builds one. */
    (void)unlink(claim->path);
    (void)close(claim->fd);
    mem_free(claim->path);
    mem_free(claim);
}

static bool is_there(const char *path)
{
    return access(path, R_OK) == 0;
}

/* Waits until the lock is ours (then *locked), or the tree is there; false: neither, in time. */
static bool await(int fd, const char *tree, uint32_t patience_ms, bool *locked)
{
    static const struct timespec step = {.tv_nsec = WAIT_STEP_MS * 1000000L};
    for (uint32_t waited = 0;; waited += WAIT_STEP_MS) {
        *locked = flock(fd, LOCK_EX | LOCK_NB) == 0;
        bool held = !*locked && (errno == EWOULDBLOCK || errno == EINTR);
        if (*locked || is_there(tree))
            return true;
        if (!held || waited >= patience_ms)
            return false;
        (void)nanosleep(&step, NULL);
    }
}

static bool claim(const char *tree, struct tree_claim *mine, uint32_t patience_ms, bool *locked)
{
    mine->fd = open(mine->path, O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    return mine->fd >= 0 && await(mine->fd, tree, patience_ms, locked) && is_there(tree);
}

bool tree_cache_claim(struct tree_cache *c, const digest *key, uint32_t patience_ms,
                      struct tree_claim **out)
{
    struct tree_claim *mine = mem_calloc(1, sizeof *mine);
    char *tree = path_of(c, key, suffix);
    bool locked = false, there = false;
    *out = NULL;
    if (mine && tree && make_folder(c) == ERR_OK) {
        mine->path = path_of(c, key, lock_suffix);
        mine->fd = -1;
        there = mine->path && claim(tree, mine, patience_ms, &locked);
    }
    mem_free(tree);
    if (locked && !there) {
        *out = mine;
        return false;
    }
    if (locked) {
        tree_cache_release(mine);
        return true;
    }
    if (mine && mine->path && mine->fd >= 0)
        (void)close(mine->fd);
    if (mine)
        mem_free(mine->path);
    mem_free(mine);
    return there;
}
