#include "worker/chunk_cache.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/queue.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "common/file_io.h"
#include "common/log.h"
#include "common/mem.h"
#include "common/package.h"

enum {
    BUCKETS = 4096,
    SHARDS = 256,        /* folders "00" to "ff" */
    STALE_SECONDS = 600, /* no writer takes so long: what it left is rubbish */
    NAME_BYTES = DIGEST_HEX_BYTES - 1,
};
static const char suffix[] = ".zst";

struct entry {
    digest name;
    uint64_t bytes;
    uint64_t generation;  /* of its last use */
    unsigned char *frame; /* in memory; NULL: in its file */
    uint32_t readers;     /* of frame, outside the lock */
    time_t used;          /* while taking stock: the file's time */
    TAILQ_ENTRY(entry) by_age;
    LIST_ENTRY(entry) in_bucket;
};

struct chunk_cache {
    pthread_mutex_t lock;
    char *folder; /* NULL: in memory */
    struct tree_cache *trees;
    uint64_t bytes, bytes_max, generation;
    TAILQ_HEAD(, entry) ages; /* oldest use first */
    LIST_HEAD(, entry) buckets[BUCKETS];
};

static void lock(struct chunk_cache *c)
{
    TL_ASSERT(pthread_mutex_lock(&c->lock) == 0);
}

static void unlock(struct chunk_cache *c)
{
    TL_ASSERT(pthread_mutex_unlock(&c->lock) == 0);
}

/* --- The table, under the lock ---------------------------------------------------- */

/* A name is a hash already. */
static size_t bucket_of(const digest *name)
{
    return ((size_t)name->bytes[0] | (size_t)name->bytes[1] << 8) % BUCKETS;
}

static struct entry *find(struct chunk_cache *c, const digest *name)
{
    struct entry *e;
    LIST_FOREACH(e, &c->buckets[bucket_of(name)], in_bucket)
    if (digest_equal(&e->name, name))
        return e;
    return NULL;
}

static void touch(struct chunk_cache *c, struct entry *e)
{
    e->generation = c->generation;
    TAILQ_REMOVE(&c->ages, e, by_age);
    TAILQ_INSERT_TAIL(&c->ages, e, by_age);
}

static void insert(struct chunk_cache *c, struct entry *e)
{
    c->bytes += e->bytes;
    TAILQ_INSERT_TAIL(&c->ages, e, by_age);
    LIST_INSERT_HEAD(&c->buckets[bucket_of(&e->name)], e, in_bucket);
}

static void discard(struct chunk_cache *c, struct entry *e)
{
    TL_ASSERT(c->bytes >= e->bytes && e->readers == 0);
    c->bytes -= e->bytes;
    TAILQ_REMOVE(&c->ages, e, by_age);
    LIST_REMOVE(e, in_bucket);
    mem_free(e->frame);
    mem_free(e);
}

/* DIR/ab/abcd....zst, or DIR/ab when `shard` is set; NULL: out of memory. */
static char *path_of(const struct chunk_cache *c, const digest *name, bool shard)
{
    char hex[DIGEST_HEX_BYTES];
    digest_to_hex(name, hex);
    return shard ? mem_sprintf("%s/%.2s", c->folder, hex)
                 : mem_sprintf("%s/%.2s/%s%s", c->folder, hex, hex, suffix);
}

static void unlink_chunk(const struct chunk_cache *c, const digest *name)
{
    char *path = c->folder ? path_of(c, name, false) : NULL;
    if (path)
        (void)unlink(path);
    mem_free(path);
}

/* Makes room: oldest first, never what the present scene has used. */
static void trim(struct chunk_cache *c)
{
    struct entry *e, *next;
    for (e = TAILQ_FIRST(&c->ages); e && c->bytes > c->bytes_max; e = next) {
        next = TAILQ_NEXT(e, by_age);
        if (e->generation == c->generation || e->readers > 0)
            continue;
        if (!e->frame)
            unlink_chunk(c, &e->name);
        discard(c, e);
    }
}

/* --- Taking stock of a folder ----------------------------------------------------- */

/* Puts one file on record, or removes what a killed writer left. */
static enum err take_file(struct chunk_cache *c, const char *shard, const char *file)
{
    char hex[DIGEST_HEX_BYTES];
    struct stat st;
    digest name;
    size_t bytes = strlen(file);
    char *path = mem_sprintf("%s/%s", shard, file);
    if (!path)
        return ERR_NOMEM;
    bool known = stat(path, &st) == 0 && S_ISREG(st.st_mode) && bytes >= NAME_BYTES;
    if (known) {
        (void)snprintf(hex, sizeof hex, "%.*s", (int)NAME_BYTES, file);
        known = digest_from_hex(hex, &name) &&
                strncmp(file + NAME_BYTES, suffix, sizeof suffix - 1) == 0;
    }
    bool whole = known && bytes == NAME_BYTES + sizeof suffix - 1;
    if (known && !whole && time(NULL) - st.st_mtime > STALE_SECONDS)
        (void)unlink(path);
    mem_free(path);
    if (!whole || find(c, &name))
        return ERR_OK;

    struct entry *e = mem_calloc(1, sizeof *e);
    if (!e)
        return ERR_NOMEM;
    e->name = name;
    e->bytes = (uint64_t)st.st_size;
    e->used = st.st_mtime;
    insert(c, e);
    return ERR_OK;
}

static enum err take_shard(struct chunk_cache *c, int number)
{
    char *shard = mem_sprintf("%s/%02x", c->folder, number);
    if (!shard)
        return ERR_NOMEM;
    enum err e = ERR_OK;
    DIR *dir = opendir(shard);
    if (dir) {
        for (struct dirent *f = readdir(dir); f && e == ERR_OK; f = readdir(dir))
            if (f->d_name[0] != '.')
                e = take_file(c, shard, f->d_name);
        (void)closedir(dir);
    }
    mem_free(shard);
    return e;
}

/* The list as an array of entries sorted by their files' times: insertion would be quadratic. */
static int by_used(const void *a, const void *b)
{
    const struct entry *x = *(struct entry *const *)a, *y = *(struct entry *const *)b;
    return (x->used > y->used) - (x->used < y->used);
}

static enum err sort_by_age(struct chunk_cache *c)
{
    size_t count = 0;
    struct entry *e;
    TAILQ_FOREACH(e, &c->ages, by_age)
    count++;
    struct entry **all = mem_alloc_array(count, sizeof(struct entry *));
    if (!all)
        return ERR_NOMEM;
    for (size_t i = 0; i < count; i++) {
        all[i] = TAILQ_FIRST(&c->ages);
        TAILQ_REMOVE(&c->ages, all[i], by_age);
    }
    qsort(all, count, sizeof(struct entry *), by_used);
    for (size_t i = 0; i < count; i++)
        TAILQ_INSERT_TAIL(&c->ages, all[i], by_age);
    mem_free(all);
    return ERR_OK;
}

static enum err take_stock(struct chunk_cache *c)
{
    if (mkdir(c->folder, 0777) != 0 && errno != EEXIST)
        return err_from_errno(errno);
    if (access(c->folder, W_OK | X_OK) != 0)
        return err_from_errno(errno);
    for (int number = 0; number < SHARDS; number++)
        TL_TRY(take_shard(c, number));
    TL_TRY(sort_by_age(c));
    trim(c);
    return ERR_OK;
}

static enum err record(struct chunk_cache *c, const digest *name, unsigned char *frame,
                       size_t frame_bytes);

/* --- Life ------------------------------------------------------------------------- */

enum err chunk_cache_new(const char *folder, uint64_t bytes_max, struct chunk_cache **out)
{
    struct chunk_cache *c = mem_calloc(1, sizeof *c);
    if (!c)
        return ERR_NOMEM;
    TL_ASSERT(pthread_mutex_init(&c->lock, NULL) == 0);
    TAILQ_INIT(&c->ages);
    c->bytes_max = bytes_max;
    c->generation = 1;
    if (folder) {
        c->folder = mem_strdup(folder);
        enum err e = c->folder ? take_stock(c) : ERR_NOMEM;
        if (e == ERR_OK)
            e = tree_cache_new(folder, bytes_max, &c->trees);
        if (e != ERR_OK) {
            chunk_cache_free(c);
            return e;
        }
    }
    *out = c;
    return ERR_OK;
}

void chunk_cache_free(struct chunk_cache *c)
{
    if (!c)
        return;
    while (!TAILQ_EMPTY(&c->ages))
        discard(c, TAILQ_FIRST(&c->ages));
    (void)pthread_mutex_destroy(&c->lock);
    tree_cache_free(c->trees);
    mem_free(c->folder);
    mem_free(c);
}

enum err chunk_cache_keep_trees(struct chunk_cache *c, const char *folder, uint64_t bytes_max)
{
    struct tree_cache *trees;
    TL_TRY(tree_cache_new(folder, bytes_max, &trees));
    tree_cache_free(c->trees);
    c->trees = trees;
    return ERR_OK;
}

struct tree_cache *chunk_cache_trees(struct chunk_cache *c)
{
    return c->trees;
}

void chunk_cache_begin(struct chunk_cache *c)
{
    lock(c);
    c->generation++;
    unlock(c);
}

uint64_t chunk_cache_bytes(struct chunk_cache *c)
{
    lock(c);
    uint64_t bytes = c->bytes;
    unlock(c);
    return bytes;
}

/* A chunk that another worker has put into the folder since we took stock. */
static bool adopt(struct chunk_cache *c, const digest *name)
{
    struct stat st;
    char *path = c->folder ? path_of(c, name, false) : NULL;
    bool there = path && stat(path, &st) == 0 && S_ISREG(st.st_mode);
    mem_free(path);
    return there && record(c, name, NULL, (size_t)st.st_size) == ERR_OK;
}

bool chunk_cache_has(struct chunk_cache *c, const digest *name)
{
    lock(c);
    struct entry *e = find(c, name);
    if (e)
        touch(c, e);
    unlock(c);
    return e != NULL || adopt(c, name);
}

/* --- In --------------------------------------------------------------------------- */

static enum err write_file(struct chunk_cache *c, const digest *name, const unsigned char *frame,
                           size_t frame_bytes)
{
    char *shard = path_of(c, name, true), *path = path_of(c, name, false);
    enum err e = shard && path ? ERR_OK : ERR_NOMEM;
    if (e == ERR_OK && mkdir(shard, 0777) != 0 && errno != EEXIST)
        e = err_from_errno(errno);
    if (e == ERR_OK)
        e = file_write(path, frame, frame_bytes);
    mem_free(shard);
    mem_free(path);
    return e;
}

/* Records a checked chunk; its file is there already when `frame` is NULL. Takes it on success. */
static enum err record(struct chunk_cache *c, const digest *name, unsigned char *frame,
                       size_t frame_bytes)
{
    struct entry *e = mem_calloc(1, sizeof *e);
    if (!e)
        return ERR_NOMEM;
    *e = (struct entry){.name = *name, .bytes = frame_bytes, .frame = frame};
    lock(c);
    struct entry *old = find(c, name);
    if (old) {
        touch(c, old);
    } else {
        e->generation = c->generation;
        insert(c, e);
        trim(c);
    }
    unlock(c);
    if (old) {
        mem_free(frame);
        mem_free(e);
    }
    return ERR_OK;
}

enum err chunk_cache_put(struct chunk_cache *c, const digest *name, unsigned char *frame,
                         size_t frame_bytes, uint64_t raw_bytes_max, struct buf *plain)
{
    enum err e = chunk_decompress_any(frame, frame_bytes, name, raw_bytes_max, plain);
    if (e == ERR_OK && c->folder) {
        enum err written = write_file(c, name, frame, frame_bytes);
        if (written == ERR_OK) {
            mem_free(frame);
            frame = NULL;
        } else {
            log_warn("cache",
                     "chunk kept in memory: the folder cannot take it folder=%s error=\"%s\"",
                     c->folder, err_text(written));
        }
    }
    if (e == ERR_OK)
        e = record(c, name, frame, frame_bytes);
    if (e != ERR_OK)
        mem_free(frame);
    return e;
}

/* --- Out -------------------------------------------------------------------------- */

/* Drops a chunk that is gone or no longer itself. */
static void forget(struct chunk_cache *c, const digest *name)
{
    lock(c);
    struct entry *e = find(c, name);
    if (e && e->readers == 0)
        discard(c, e);
    unlock(c);
    unlink_chunk(c, name);
}

static enum err get_from_folder(struct chunk_cache *c, const digest *name, uint64_t raw_bytes_max,
                                struct buf *out)
{
    char *path = path_of(c, name, false), *frame = NULL;
    size_t frame_bytes = 0;
    if (!path)
        return ERR_NOMEM;
    enum err e = file_read(path, UINT32_MAX, &frame, &frame_bytes);
    if (e == ERR_OK)
        e = chunk_decompress_any(frame, frame_bytes, name, raw_bytes_max, out);
    if (e == ERR_OK)
        (void)utimensat(AT_FDCWD, path, NULL, 0); /* used now, for the next process too */
    mem_free(frame);
    mem_free(path);
    return e;
}

enum err chunk_cache_get(struct chunk_cache *c, const digest *name, uint64_t raw_bytes_max,
                         struct buf *out)
{
    lock(c);
    struct entry *entry = find(c, name);
    if (entry) {
        touch(c, entry);
        entry->readers++;
    }
    unlock(c);
    if (!entry)
        return ERR_NOT_FOUND;

    enum err e = entry->frame
                     ? chunk_decompress_any(entry->frame, entry->bytes, name, raw_bytes_max, out)
                     : get_from_folder(c, name, raw_bytes_max, out);
    lock(c);
    entry->readers--;
    unlock(c);
    if (e == ERR_CORRUPT || e == ERR_LIMIT || e == ERR_NOT_FOUND) {
        log_warn("cache", "chunk dropped: the disk has changed or lost it error=\"%s\"",
                 err_text(e));
        forget(c, name);
        return ERR_NOT_FOUND;
    }
    return e;
}
