#include "master/journal.h"

#include <string.h>

#include "common/buf.h"

enum { JOURNAL_MAGIC = 0x31524c54 /* "TLR1" */, DIGEST_AT = JOURNAL_HEADER_BYTES - DIGEST_BYTES };

static unsigned char *put_u32(unsigned char *at, uint32_t v)
{
    memcpy(at, &v, sizeof v);
    return at + sizeof v;
}

static unsigned char *put_u64(unsigned char *at, uint64_t v)
{
    memcpy(at, &v, sizeof v);
    return at + sizeof v;
}

/* A digest of two digests: the header's and the body's. */
static digest record_digest_of(const unsigned char *header, const void *body, size_t body_bytes)
{
    digest parts[2] = {digest_of(header, DIGEST_AT), digest_of(body, body_bytes)};
    return digest_of(parts, sizeof parts);
}

digest journal_header(const struct journal_result *r, const void *body,
                      unsigned char out[JOURNAL_HEADER_BYTES])
{
    TL_ASSERT(r->body_bytes <= JOURNAL_BODY_BYTES_MAX);
    unsigned char *at = put_u32(out, JOURNAL_MAGIC);
    at = put_u32(at, r->body_bytes);
    at = put_u64(at, r->job);
    at = put_u64(at, r->sequence);
    at = put_u32(at, r->unit.cell_begin);
    at = put_u32(at, r->unit.cell_count);
    at = put_u32(at, r->unit.block);
    at = put_u32(at, r->worker);
    at = put_u64(at, r->epoch);
    at = put_u64(at, r->samples);
    at = put_u64(at, r->rays);
    at = put_u64(at, r->nonfinite);
    at = put_u64(at, r->nonfinite_pixel);
    at = put_u64(at, r->nonfinite_sample);
    at = put_u64(at, r->render_us);
    at = put_u32(at, r->raw_bytes);
    at = put_u32(at, 0); /* reserved, keeps the digest aligned */
    TL_ASSERT(at - out == DIGEST_AT);
    digest d = record_digest_of(out, body, r->body_bytes);
    memcpy(at, d.bytes, DIGEST_BYTES);
    return d;
}

enum err journal_read(const void *data, size_t bytes, struct journal_result *out,
                      digest *record_digest, const unsigned char **body)
{
    struct buf_reader r = buf_reader_of(data, bytes);
    uint32_t magic = buf_get_u32(&r);
    struct journal_result read = {.body_bytes = buf_get_u32(&r)};
    if (r.failed || magic != JOURNAL_MAGIC || bytes < JOURNAL_HEADER_BYTES ||
        read.body_bytes > bytes - JOURNAL_HEADER_BYTES)
        return ERR_CORRUPT;
    const unsigned char *at = data;
    digest d = record_digest_of(at, at + JOURNAL_HEADER_BYTES, read.body_bytes);
    if (memcmp(d.bytes, at + DIGEST_AT, DIGEST_BYTES) != 0)
        return ERR_CORRUPT;
    read.job = buf_get_u64(&r);
    read.sequence = buf_get_u64(&r);
    read.unit.cell_begin = buf_get_u32(&r);
    read.unit.cell_count = buf_get_u32(&r);
    read.unit.block = buf_get_u32(&r);
    read.worker = buf_get_u32(&r);
    read.epoch = buf_get_u64(&r);
    read.samples = buf_get_u64(&r);
    read.rays = buf_get_u64(&r);
    read.nonfinite = buf_get_u64(&r);
    read.nonfinite_pixel = buf_get_u64(&r);
    read.nonfinite_sample = buf_get_u64(&r);
    read.render_us = buf_get_u64(&r);
    read.raw_bytes = buf_get_u32(&r);
    *out = read;
    *record_digest = d;
    *body = at + JOURNAL_HEADER_BYTES;
    return ERR_OK;
}
