#include "master/checkpoint.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "common/mem.h"
#include "master/durable.h"

enum {
    CHECKPOINT_MAGIC = 0x32434c54,   /* "TLC2" */
    CHECKPOINT_MAGIC_1 = 0x31434c54, /* "TLC1" */
    NUMBERS_BYTES_MAX = 4096,
    PIECE_BYTES = 1 << 18, /* of one write: few system calls, little memory */
};

/* A file being written or read, hashed in passing. */
struct stream {
    int fd;
    struct digest_ctx hash;
    unsigned char *piece; /* PIECE_BYTES */
    size_t used, filled;
};

static enum err stream_flush(struct stream *s)
{
    for (size_t at = 0; at < s->used;) {
        ssize_t n = write(s->fd, s->piece + at, s->used - at);
        if (n < 0 && errno == EINTR)
            continue;
        if (n < 0)
            return err_from_errno(errno);
        at += (size_t)n;
    }
    s->used = 0;
    return ERR_OK;
}

static enum err stream_write(void *ctx, const void *data, size_t bytes)
{
    struct stream *s = ctx;
    digest_add(&s->hash, data, bytes);
    for (const unsigned char *at = data; bytes > 0;) {
        size_t n = PIECE_BYTES - s->used < bytes ? PIECE_BYTES - s->used : bytes;
        memcpy(s->piece + s->used, at, n);
        s->used += n;
        at += n;
        bytes -= n;
        if (s->used == PIECE_BYTES)
            TL_TRY(stream_flush(s));
    }
    return ERR_OK;
}

static enum err stream_fill(struct stream *s)
{
    for (;;) {
        ssize_t n = read(s->fd, s->piece, PIECE_BYTES);
        if (n < 0 && errno == EINTR)
            continue;
        if (n < 0)
            return err_from_errno(errno);
        s->used = 0;
        s->filled = (size_t)n;
        return n == 0 ? ERR_CORRUPT : ERR_OK;
    }
}

static enum err stream_read_plain(struct stream *s, void *data, size_t bytes)
{
    for (unsigned char *at = data; bytes > 0;) {
        if (s->used == s->filled)
            TL_TRY(stream_fill(s));
        size_t n = s->filled - s->used < bytes ? s->filled - s->used : bytes;
        memcpy(at, s->piece + s->used, n);
        s->used += n;
        at += n;
        bytes -= n;
    }
    return ERR_OK;
}

static enum err stream_read(void *ctx, void *data, size_t bytes)
{
    struct stream *s = ctx;
    TL_TRY(stream_read_plain(s, data, bytes));
    digest_add(&s->hash, data, bytes);
    return ERR_OK;
}

/* A hash and a buffer; the file is opened by the caller. */
static enum err stream_init(struct stream *s)
{
    *s = (struct stream){.fd = -1};
    s->piece = mem_alloc(PIECE_BYTES);
    if (!s->piece)
        return ERR_NOMEM;
    enum err e = digest_begin(&s->hash);
    if (e != ERR_OK)
        mem_free(s->piece);
    return e;
}

/* Ends the hash, closes the file. */
static void stream_release(struct stream *s, bool hashing)
{
    if (hashing)
        (void)digest_end(&s->hash);
    if (s->fd >= 0)
        (void)close(s->fd);
    mem_free(s->piece);
}

static enum err write_header(struct stream *s, const struct checkpoint *c)
{
    struct buf numbers, head;
    buf_init(&numbers);
    buf_init(&head);
    job_numbers_put(&numbers, &c->totals, &c->stats);
    buf_put_u32(&head, CHECKPOINT_MAGIC);
    buf_put_u32(&head, (uint32_t)numbers.bytes);
    buf_put_u64(&head, c->job);
    buf_put_u64(&head, c->covered_sequence);
    buf_put(&head, numbers.data, numbers.bytes);
    enum err e = buf_status(&numbers) == ERR_OK ? buf_status(&head) : ERR_NOMEM;
    if (e == ERR_OK)
        e = stream_write(s, head.data, head.bytes);
    buf_release(&numbers);
    buf_release(&head);
    return e;
}

/* Everything but the rename; the stream is released in any case. */
static enum err write_contents(const char *path, const struct checkpoint *c,
                               const struct film *film)
{
    struct stream s;
    TL_TRY(stream_init(&s));
    bool hashing = true;
    s.fd = open(path, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    enum err e = s.fd < 0 ? err_from_errno(errno) : write_header(&s, c);
    if (e == ERR_OK)
        e = film_save(film, stream_write, &s);
    if (e == ERR_OK)
        e = provenance_save(&c->provenance, stream_write, &s);
    if (e == ERR_OK)
        e = stream_flush(&s);
    if (e == ERR_OK) {
        digest d = digest_end(&s.hash);
        hashing = false;
        memcpy(s.piece, d.bytes, DIGEST_BYTES);
        s.used = DIGEST_BYTES;
        e = stream_flush(&s);
    }
    if (e == ERR_OK)
        e = durable_sync(s.fd);
    stream_release(&s, hashing);
    return e;
}

enum err checkpoint_write(const char *path, const struct checkpoint *c, const struct film *film)
{
    char *aside = mem_sprintf("%s.new", path);
    if (!aside)
        return ERR_NOMEM;
    enum err e = write_contents(aside, c, film);
    if (e == ERR_OK && rename(aside, path) != 0)
        e = err_from_errno(errno);
    if (e == ERR_OK)
        e = durable_sync_name(path);
    else
        (void)unlink(aside);
    mem_free(aside);
    return e;
}

static enum err read_header(struct stream *s, uint64_t job, struct checkpoint *out, bool *plain)
{
    unsigned char head[24], numbers[NUMBERS_BYTES_MAX];
    TL_TRY(stream_read(s, head, sizeof head));
    struct buf_reader r = buf_reader_of(head, sizeof head);
    uint32_t magic = buf_get_u32(&r), numbers_bytes = buf_get_u32(&r);
    *out = (struct checkpoint){.job = buf_get_u64(&r), .covered_sequence = buf_get_u64(&r)};
    *plain = magic == CHECKPOINT_MAGIC_1;
    if ((magic != CHECKPOINT_MAGIC && !*plain) || out->job != job || numbers_bytes > sizeof numbers)
        return ERR_CORRUPT;
    TL_TRY(stream_read(s, numbers, numbers_bytes));
    return job_numbers_get(numbers, numbers_bytes, &out->totals, &out->stats);
}

enum err checkpoint_read(const char *path, uint64_t job, const struct grid *grid,
                         const struct job_blocks *blocks, struct checkpoint *out,
                         struct film **film)
{
    struct stream s;
    TL_TRY(stream_init(&s));
    bool hashing = true;
    struct checkpoint read = {0};
    bool plain = false;
    struct film *loaded = NULL;
    s.fd = open(path, O_RDONLY | O_CLOEXEC);
    enum err e = s.fd < 0 ? err_from_errno(errno) : read_header(&s, job, &read, &plain);
    if (e == ERR_OK)
        e = film_load(grid, blocks, stream_read, &s, &loaded);
    if (e == ERR_OK && !plain)
        e = provenance_load(grid->cell_count, blocks->count, stream_read, &s, &read.provenance);
    if (e == ERR_OK) {
        digest found = digest_end(&s.hash), stored;
        hashing = false;
        e = stream_read_plain(&s, stored.bytes, sizeof stored.bytes);
        if (e == ERR_OK && !digest_equal(&found, &stored))
            e = ERR_CORRUPT;
    }
    stream_release(&s, hashing);
    if (e != ERR_OK) {
        film_free(loaded);
        provenance_release(&read.provenance);
        return e;
    }
    *out = read;
    *film = loaded;
    return ERR_OK;
}
