#include "proto/tile_codec.h"

#include <string.h>
#include <zstd.h>

#include "common/mem.h"

enum {
    PLANES = sizeof(float), /* bytes of a value */
    LEVEL = 1,              /* higher ones gain under 7 % for 5 times the time */
};
_Static_assert(sizeof(float) == 4, "binary32");
_Static_assert((int64_t)TILE_CODEC_VALUES_MAX * 4 == LIMIT_UNIT_RAW_BYTES, "the largest unit");

size_t tile_codec_bound(size_t value_count)
{
    return ZSTD_compressBound(value_count * PLANES);
}

/* Byte planes, each byte as its difference from the one before it in its plane. */
static void shuffle(const unsigned char *values, size_t value_count, unsigned char *out)
{
    for (size_t plane = 0; plane < PLANES; plane++) {
        const unsigned char *from = values + plane;
        unsigned char *to = out + plane * value_count;
        unsigned char last = 0;
        for (size_t i = 0; i < value_count; i++) {
            unsigned char byte = from[i * PLANES];
            to[i] = (unsigned char)(byte - last);
            last = byte;
        }
    }
}

static void unshuffle(const unsigned char *in, size_t value_count, unsigned char *values)
{
    for (size_t plane = 0; plane < PLANES; plane++) {
        const unsigned char *from = in + plane * value_count;
        unsigned char *to = values + plane;
        unsigned char last = 0;
        for (size_t i = 0; i < value_count; i++) {
            last = (unsigned char)(last + from[i]);
            to[i * PLANES] = last;
        }
    }
}

static enum err compress(const unsigned char *raw, size_t raw_bytes, unsigned char *out,
                         size_t capacity, size_t *out_bytes)
{
    ZSTD_CCtx *ctx = ZSTD_createCCtx();
    if (!ctx)
        return ERR_NOMEM;
    (void)ZSTD_CCtx_setParameter(ctx, ZSTD_c_compressionLevel, LEVEL);
    (void)ZSTD_CCtx_setParameter(ctx, ZSTD_c_checksumFlag, 1);
    (void)ZSTD_CCtx_setParameter(ctx, ZSTD_c_contentSizeFlag, 1);
    (void)ZSTD_CCtx_setParameter(ctx, ZSTD_c_windowLog, LIMIT_ZSTD_WINDOW_LOG);
    size_t n = ZSTD_compress2(ctx, out, capacity, raw, raw_bytes);
    ZSTD_freeCCtx(ctx);
    if (ZSTD_isError(n))
        return ERR_NOMEM; /* the only failure left: the output is as large as the bound */
    *out_bytes = n;
    return ERR_OK;
}

enum err tile_codec_encode(const float *values, size_t value_count, unsigned char **out,
                           size_t *out_bytes)
{
    TL_ASSERT(value_count > 0 && value_count <= TILE_CODEC_VALUES_MAX);
    size_t raw_bytes = value_count * PLANES, capacity = tile_codec_bound(value_count);
    enum err e = ERR_NOMEM;
    unsigned char *planes = mem_alloc(raw_bytes), *encoded = mem_alloc(capacity);
    size_t encoded_bytes = 0;
    if (!planes || !encoded)
        goto fail;
    shuffle((const unsigned char *)values, value_count, planes);
    e = compress(planes, raw_bytes, encoded, capacity, &encoded_bytes);
    if (e != ERR_OK)
        goto fail;
    mem_free(planes);

    /* Results wait for their acknowledgement: give back what the bound was too large. */
    unsigned char *fitted = mem_realloc_array(encoded, encoded_bytes, 1);
    *out = fitted ? fitted : encoded;
    *out_bytes = encoded_bytes;
    return ERR_OK;

fail:
    mem_free(planes);
    mem_free(encoded);
    return e;
}

/* The window a frame asks for, from its header (RFC 8878, 3.1.1.1): decoding in one pass needs none
 * of it, but other implementations would. */
static enum err check_frame(const unsigned char *data, size_t bytes, size_t raw_bytes)
{
    enum { DESCRIPTOR_AT = 4, SINGLE_SEGMENT = 0x20, CHECKSUM = 0x04, DICTIONARY = 0x03 };
    if (bytes < 9 || ZSTD_getFrameContentSize(data, bytes) != raw_bytes)
        return ERR_CORRUPT;
    unsigned descriptor = data[DESCRIPTOR_AT];
    if ((descriptor & CHECKSUM) == 0 || (descriptor & DICTIONARY) != 0)
        return ERR_CORRUPT;
    uint64_t window = raw_bytes;
    if ((descriptor & SINGLE_SEGMENT) == 0) {
        uint64_t base = UINT64_C(1) << (10 + (data[DESCRIPTOR_AT + 1] >> 3));
        window = base + base / 8 * (data[DESCRIPTOR_AT + 1] & 7);
    }
    if (window > UINT64_C(1) << LIMIT_ZSTD_WINDOW_LOG)
        return ERR_LIMIT;
    return ZSTD_findFrameCompressedSize(data, bytes) == bytes ? ERR_OK : ERR_CORRUPT;
}

enum err tile_codec_decode(const void *data, size_t bytes, float *values, size_t value_count)
{
    TL_ASSERT(value_count > 0 && value_count <= TILE_CODEC_VALUES_MAX);
    size_t raw_bytes = value_count * PLANES;
    TL_TRY(check_frame(data, bytes, raw_bytes));

    unsigned char *planes = mem_alloc(raw_bytes);
    ZSTD_DCtx *ctx = ZSTD_createDCtx();
    enum err e = ERR_NOMEM;
    if (planes && ctx) {
        size_t n = ZSTD_decompressDCtx(ctx, planes, raw_bytes, data, bytes);
        e = ZSTD_isError(n) || n != raw_bytes ? ERR_CORRUPT : ERR_OK;
    }
    if (e == ERR_OK)
        unshuffle(planes, value_count, (unsigned char *)values);
    ZSTD_freeDCtx(ctx);
    mem_free(planes);
    return e;
}
