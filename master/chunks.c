#include "master/chunks.h"

#include <dirent.h>
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#define HASH_NONFATAL_OOM 1
#include <uthash.h>

#include "common/file_io.h"
#include "common/log.h"
#include "common/mem.h"
#include "common/package.h"
#include "master/durable.h"

enum { RAW_BYTES_FIELD = 8 };

/* Somebody who waits for a chunk to be read. */
struct waiter {
    struct waiter *next;
    chunk_got *done;
    void *ctx;
};

/* A chunk that is on disk. */
struct chunk {
    digest name;
    struct blob *frame; /* owned reference; NULL: not in memory */
    uint64_t raw_bytes; /* known while frame is */
    uint64_t used_at;
    struct waiter *waiters; /* a read is under way while there are any */
    uint64_t asked_ms;      /* when somebody stored it or asked whether it is there */
    uint64_t sweep;         /* the last one that found it in a package */
    UT_hash_handle hh;
};

struct chunk_store {
    uv_loop_t *loop;
    char *dir; /* owned: DIR/chunks */
    struct chunk *chunks;
    uint64_t cached_bytes, clock;
    uint64_t temporary; /* names of files being written */
    uint64_t sweeps;
};

/* One job of the pool. */
struct work {
    uv_work_t request;
    struct chunk_store *store;
    digest name;
    char *path, *aside; /* owned */
    struct buf frame;   /* to be written */
    struct buf missing;
    struct blob *read;
    uint64_t raw_bytes;
    enum err result;
    chunk_put_done *put_done;
    chunks_checked *check_done;
    void *ctx;
    struct package_index index;
};

static char *path_of(const struct chunk_store *s, const digest *name)
{
    char hex[DIGEST_HEX_BYTES];
    digest_to_hex(name, hex);
    return mem_sprintf("%s/%.2s/%s", s->dir, hex, hex);
}

/* --- What is there ------------------------------------------------------ */

static struct chunk *find(const struct chunk_store *s, const digest *name)
{
    struct chunk *c = NULL;
    HASH_FIND(hh, s->chunks, name->bytes, DIGEST_BYTES, c);
    return c;
}

static enum err note_chunk(struct chunk_store *s, const digest *name)
{
    if (find(s, name))
        return ERR_OK;
    struct chunk *c = mem_calloc(1, sizeof *c);
    if (!c)
        return ERR_NOMEM;
    c->name = *name;
    c->asked_ms = uv_now(s->loop);
    HASH_ADD_KEYPTR(hh, s->chunks, c->name.bytes, DIGEST_BYTES, c);
    if (!find(s, name)) {
        mem_free(c);
        return ERR_NOMEM;
    }
    return ERR_OK;
}

/* Notes the files of one folder "aa"; removes what a crash left half-written. */
static enum err list_folder(struct chunk_store *s, const char *path)
{
    DIR *d = opendir(path);
    if (!d)
        return err_from_errno(errno);
    enum err e = ERR_OK;
    for (struct dirent *entry = readdir(d); entry && e == ERR_OK; entry = readdir(d)) {
        digest name;
        if (digest_from_hex(entry->d_name, &name))
            e = note_chunk(s, &name);
        else if (strstr(entry->d_name, ".new"))
            (void)unlinkat(dirfd(d), entry->d_name, 0);
    }
    (void)closedir(d);
    return e;
}

enum err chunks_open(uv_loop_t *loop, const char *dir, struct chunk_store **out)
{
    struct chunk_store *s = mem_calloc(1, sizeof *s);
    if (!s)
        return ERR_NOMEM;
    s->loop = loop;
    s->dir = mem_sprintf("%s/chunks", dir);
    enum err e = s->dir ? durable_make_folder(s->dir) : ERR_NOMEM;
    for (unsigned i = 0; e == ERR_OK && i < 256; i++) {
        char *folder = mem_sprintf("%s/%02x", s->dir, i);
        e = folder ? list_folder(s, folder) : ERR_NOMEM;
        mem_free(folder);
        if (e == ERR_NOT_FOUND)
            e = ERR_OK; /* made when its first chunk comes: 256 mkdirs would cost a short render
                           most */
    }
    if (e != ERR_OK) {
        chunks_close(s);
        return e;
    }
    *out = s;
    return ERR_OK;
}

void chunks_close(struct chunk_store *s)
{
    if (!s)
        return;
    struct chunk *c, *next;
    HASH_ITER(hh, s->chunks, c, next)
    {
        HASH_DEL(s->chunks, c);
        blob_unref(c->frame);
        mem_free(c);
    }
    mem_free(s->dir);
    mem_free(s);
}

bool chunks_has(struct chunk_store *s, const digest *name)
{
    struct chunk *c = find(s, name);
    if (c)
        c->asked_ms = uv_now(s->loop);
    return c != NULL;
}

size_t chunks_count(const struct chunk_store *s)
{
    return HASH_COUNT(s->chunks);
}

/* On the loop, so that no upload of the same name can come between table and file. */
static void remove_chunk(struct chunk_store *s, struct chunk *c)
{
    char *path = path_of(s, &c->name);
    if (!path)
        return;
    if (unlink(path) != 0 && errno != ENOENT)
        log_warn("chunks", "cannot remove file=%s error=\"%s\"", path, strerror(errno));
    mem_free(path);
    if (c->frame)
        s->cached_bytes -= blob_bytes(c->frame);
    blob_unref(c->frame);
    HASH_DEL(s->chunks, c);
    mem_free(c);
}

/* Its file is not there: somebody took it away. It may be sent again. */
static void forget_missing(struct chunk_store *s, const digest *name)
{
    struct chunk *c = find(s, name);
    if (!c || c->waiters)
        return;
    char hex[DIGEST_HEX_BYTES];
    digest_to_hex(name, hex);
    log_warn("chunks", "its file is gone name=%s", hex);
    remove_chunk(s, c);
}

/* --- Work of the pool --------------------------------------------------- */

static void work_free(struct work *w)
{
    mem_free(w->path);
    mem_free(w->aside);
    buf_release(&w->frame);
    buf_release(&w->missing);
    package_index_release(&w->index);
    mem_free(w);
}

static struct work *work_new(struct chunk_store *s, const digest *name)
{
    struct work *w = mem_calloc(1, sizeof *w);
    if (!w)
        return NULL;
    w->request.data = w;
    w->store = s;
    w->name = *name;
    buf_init(&w->frame);
    buf_init(&w->missing);
    w->path = path_of(s, name);
    if (!w->path) {
        work_free(w);
        return NULL;
    }
    return w;
}

static enum err queue(struct work *w, uv_work_cb run, uv_after_work_cb after)
{
    return uv_queue_work(w->store->loop, &w->request, run, after) == 0 ? ERR_OK : ERR_NOMEM;
}

/* --- Putting ------------------------------------------------------------ */

static enum err write_parts(int fd, const struct work *w)
{
    unsigned char head[RAW_BYTES_FIELD];
    memcpy(head, &w->raw_bytes, sizeof head);
    const unsigned char *parts[2] = {head, w->frame.data};
    size_t bytes[2] = {sizeof head, w->frame.bytes};
    for (int i = 0; i < 2; i++) {
        while (bytes[i] > 0) {
            ssize_t n = write(fd, parts[i], bytes[i]);
            if (n < 0 && errno == EINTR)
                continue;
            if (n < 0)
                return err_from_errno(errno);
            parts[i] += n;
            bytes[i] -= (size_t)n;
        }
    }
    return durable_sync(fd);
}

static enum err write_aside(struct work *w)
{
    FILE *file = fopen(w->aside, "wxe");
    if (!file)
        return err_from_errno(errno);
    enum err e = write_parts(fileno(file), w);
    if (fclose(file) != 0 && e == ERR_OK)
        e = err_from_errno(errno);
    if (e == ERR_OK && rename(w->aside, w->path) != 0)
        e = err_from_errno(errno);
    if (e != ERR_OK) {
        (void)unlink(w->aside);
        return e;
    }
    return durable_sync_name(w->path);
}

static void put_run(uv_work_t *request)
{
    struct work *w = request->data;
    w->result =
        chunk_check(w->frame.data, w->frame.bytes, &w->name, CHUNKS_RAW_BYTES_MAX, &w->raw_bytes);
    char *folder = file_folder(w->path);
    if (w->result == ERR_OK)
        w->result = folder ? durable_make_folder(folder) : ERR_NOMEM;
    if (w->result == ERR_OK)
        w->result = write_aside(w);
    mem_free(folder);
}

/* Drops what was not used for longest until the cache fits. */
static void trim_cache(struct chunk_store *s, const struct chunk *keep)
{
    while (s->cached_bytes > CHUNKS_CACHE_BYTES) {
        struct chunk *oldest = NULL, *c, *next;
        HASH_ITER(hh, s->chunks, c, next)
        {
            if (c->frame && c != keep && (!oldest || c->used_at < oldest->used_at))
                oldest = c;
        }
        if (!oldest)
            return;
        s->cached_bytes -= blob_bytes(oldest->frame);
        blob_unref(oldest->frame);
        oldest->frame = NULL;
    }
}

/* The frame that was just written stays in memory: workers will ask for it next. */
static void cache_put(struct work *w)
{
    struct chunk_store *s = w->store;
    struct chunk *c = find(s, &w->name);
    if (!c || c->frame || c->waiters)
        return;
    unsigned char *fitting = mem_realloc_array(w->frame.data, w->frame.bytes, 1);
    w->frame.data = fitting ? fitting : w->frame.data;
    c->frame = blob_new(w->frame.data, w->frame.bytes);
    if (!c->frame)
        return;
    buf_init(&w->frame); /* the blob's now */
    c->raw_bytes = w->raw_bytes;
    c->used_at = ++s->clock;
    s->cached_bytes += blob_bytes(c->frame);
    trim_cache(s, c);
}

static void put_after(uv_work_t *request, int status)
{
    struct work *w = request->data;
    enum err e = status == 0 ? w->result : ERR_CANCELLED;
    if (e == ERR_OK)
        e = note_chunk(w->store, &w->name);
    if (e == ERR_OK)
        cache_put(w);
    w->put_done(w->ctx, e);
    work_free(w);
}

enum err chunks_put(struct chunk_store *s, const digest *name, struct buf *frame,
                    chunk_put_done *done, void *ctx)
{
    struct work *w = work_new(s, name);
    if (!w)
        return ERR_NOMEM;
    w->aside = mem_sprintf("%s.%llu.new", w->path, (unsigned long long)++s->temporary);
    w->put_done = done;
    w->ctx = ctx;
    struct buf moved = *frame;
    w->frame = moved;
    enum err e = w->aside ? queue(w, put_run, put_after) : ERR_NOMEM;
    if (e != ERR_OK) {
        buf_init(&w->frame); /* stays the caller's */
        work_free(w);
        return e;
    }
    buf_init(frame);
    return ERR_OK;
}

/* --- Getting ------------------------------------------------------------ */

/* The stored frame of a chunk file; its size unpacked in *raw_bytes. */
static enum err read_chunk(const char *path, unsigned char **frame, size_t *bytes,
                           uint64_t *raw_bytes)
{
    char *data = NULL;
    size_t have = 0;
    TL_TRY(file_read(path, UINT32_MAX, &data, &have));
    if (have <= RAW_BYTES_FIELD) {
        mem_free(data);
        return ERR_CORRUPT;
    }
    memcpy(raw_bytes, data, RAW_BYTES_FIELD);
    memmove(data, data + RAW_BYTES_FIELD, have - RAW_BYTES_FIELD);
    *frame = (unsigned char *)data;
    *bytes = have - RAW_BYTES_FIELD;
    return ERR_OK;
}

static void get_run(uv_work_t *request)
{
    struct work *w = request->data;
    unsigned char *frame = NULL;
    size_t bytes = 0;
    w->result = read_chunk(w->path, &frame, &bytes, &w->raw_bytes);
    if (w->result != ERR_OK)
        return;
    w->read = blob_new(frame, bytes);
    if (!w->read) {
        mem_free(frame);
        w->result = ERR_NOMEM;
    }
}

static void get_after(uv_work_t *request, int status)
{
    struct work *w = request->data;
    struct chunk_store *s = w->store;
    struct chunk *c = find(s, &w->name);
    enum err e = status == 0 ? w->result : ERR_CANCELLED;
    TL_ASSERT(c && c->waiters);
    struct waiter *waiter = c->waiters;
    c->waiters = NULL;
    if (e == ERR_OK) {
        c->frame = w->read;
        c->raw_bytes = w->raw_bytes;
        c->used_at = ++s->clock;
        s->cached_bytes += blob_bytes(c->frame);
    } else {
        log_error("chunks", "cannot read file=%s error=\"%s\"", w->path, err_text(e));
    }
    struct blob *frame = e == ERR_OK ? blob_ref(c->frame) : NULL;
    while (waiter) {
        struct waiter *next = waiter->next;
        waiter->done(waiter->ctx, e, &w->name, frame, w->raw_bytes);
        mem_free(waiter);
        waiter = next;
    }
    blob_unref(frame);
    if (e == ERR_NOT_FOUND)
        forget_missing(s, &w->name);
    else
        trim_cache(s, c);
    work_free(w);
}

void chunks_get(struct chunk_store *s, const digest *name, chunk_got *done, void *ctx)
{
    struct chunk *c = find(s, name);
    if (!c) {
        done(ctx, ERR_NOT_FOUND, name, NULL, 0);
        return;
    }
    if (c->frame) {
        c->used_at = ++s->clock;
        done(ctx, ERR_OK, name, c->frame, c->raw_bytes);
        return;
    }
    bool reading = c->waiters != NULL;
    struct waiter *waiter = mem_calloc(1, sizeof *waiter);
    struct work *w = waiter && !reading ? work_new(s, name) : NULL;
    if (!waiter || (!reading && (!w || queue(w, get_run, get_after) != ERR_OK))) {
        mem_free(waiter);
        if (w)
            work_free(w);
        done(ctx, ERR_NOMEM, name, NULL, 0);
        return;
    }
    *waiter = (struct waiter){.next = c->waiters, .done = done, .ctx = ctx};
    c->waiters = waiter;
}

/* --- Checking a package -------------------------------------------------- */

static void check_run(uv_work_t *request)
{
    struct work *w = request->data;
    unsigned char *frame = NULL;
    size_t bytes = 0;
    struct buf root;
    buf_init(&root);
    w->result = read_chunk(w->path, &frame, &bytes, &w->raw_bytes);
    if (w->result == ERR_OK)
        w->result = chunk_decompress_any(frame, bytes, &w->name, PACKAGE_ROOT_BYTES_MAX, &root);
    if (w->result == ERR_OK)
        w->result = package_root_read(root.data, root.bytes, &w->index);
    mem_free(frame);
    buf_release(&root);
}

static void check_after(uv_work_t *request, int status)
{
    struct work *w = request->data;
    enum err e = status == 0 ? w->result : ERR_CANCELLED;
    if (e == ERR_NOT_FOUND) {
        forget_missing(w->store, &w->name);
        buf_put(&w->missing, &w->name, sizeof w->name);
        e = ERR_OK;
    }
    for (size_t i = 0; e == ERR_OK && i < w->index.count; i++)
        if (!chunks_has(w->store, &w->index.entries[i].name))
            buf_put(&w->missing, &w->index.entries[i].name, sizeof(digest));
    if (e == ERR_OK)
        e = buf_status(&w->missing);
    w->check_done(w->ctx, e, &w->missing);
    work_free(w);
}

enum err chunks_check_package(struct chunk_store *s, const digest *root, chunks_checked *done,
                              void *ctx)
{
    if (!chunks_has(s, root))
        return ERR_NOT_FOUND;
    struct work *w = work_new(s, root);
    if (!w)
        return ERR_NOMEM;
    w->check_done = done;
    w->ctx = ctx;
    enum err e = queue(w, check_run, check_after);
    if (e != ERR_OK)
        work_free(w);
    return e;
}

/* --- Sweeping ------------------------------------------------------------- */

struct sweep {
    uv_work_t request;
    struct chunk_store *store;
    digest *roots; /* owned */
    size_t root_count;
    struct buf names; /* of what their packages consist of */
    uint64_t before_ms;
    chunks_swept *done;
    void *ctx;
    enum err result;
};

static void sweep_free(struct sweep *w)
{
    mem_free(w->roots);
    buf_release(&w->names);
    mem_free(w);
}

/* The names in one package. One that is not there or damaged names nothing: no worker can use it.
 */
static enum err list_package(struct sweep *w, const digest *name)
{
    struct work one = {.store = w->store, .name = *name, .path = path_of(w->store, name)};
    if (!one.path)
        return ERR_NOMEM;
    one.request.data = &one;
    check_run(&one.request);
    for (size_t i = 0; one.result == ERR_OK && i < one.index.count; i++)
        buf_put(&w->names, &one.index.entries[i].name, sizeof(digest));
    package_index_release(&one.index);
    mem_free(one.path);
    if (one.result == ERR_NOMEM || one.result == ERR_IO)
        return one.result;
    return buf_status(&w->names);
}

static void sweep_run(uv_work_t *request)
{
    struct sweep *w = request->data;
    for (size_t i = 0; i < w->root_count && w->result == ERR_OK; i++)
        w->result = list_package(w, &w->roots[i]);
}

static void mark(struct chunk_store *s, const void *names, size_t bytes)
{
    for (size_t at = 0; at + sizeof(digest) <= bytes; at += sizeof(digest)) {
        digest name;
        memcpy(&name, (const unsigned char *)names + at, sizeof name);
        struct chunk *c = find(s, &name);
        if (c)
            c->sweep = s->sweeps;
    }
}

static void sweep_after(uv_work_t *request, int status)
{
    enum { REMOVED_MAX = 1000 }; /* of one sweep: the loop has other things to do */
    struct sweep *w = request->data;
    struct chunk_store *s = w->store;
    size_t removed = 0;
    if (status == 0 && w->result == ERR_OK) {
        s->sweeps++;
        mark(s, w->roots, w->root_count * sizeof(digest));
        mark(s, w->names.data, w->names.bytes);
        struct chunk *c, *next;
        HASH_ITER(hh, s->chunks, c, next)
        {
            if (c->sweep == s->sweeps || c->asked_ms >= w->before_ms || c->waiters ||
                removed >= REMOVED_MAX)
                continue;
            remove_chunk(s, c);
            removed++;
        }
    }
    if (removed > 0)
        log_info("chunks", "of no job, removed count=%zu left=%zu", removed, chunks_count(s));
    w->done(w->ctx);
    sweep_free(w);
}

enum err chunks_sweep(struct chunk_store *s, digest *roots, size_t root_count, uint64_t before_ms,
                      chunks_swept *done, void *ctx)
{
    struct sweep *w = mem_calloc(1, sizeof *w);
    if (!w) {
        mem_free(roots);
        return ERR_NOMEM;
    }
    w->request.data = w;
    w->store = s;
    w->roots = roots;
    w->root_count = root_count;
    w->before_ms = before_ms;
    w->done = done;
    w->ctx = ctx;
    buf_init(&w->names);
    if (uv_queue_work(s->loop, &w->request, sweep_run, sweep_after) == 0)
        return ERR_OK;
    sweep_free(w);
    return ERR_NOMEM;
}
