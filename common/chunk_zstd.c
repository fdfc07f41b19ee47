/* Chunks as zstd frames with a bounded window, and back, checked against their size and digest.
 * Owns the only use of zstd for packages; no state, any thread. */
#include <zstd.h>
#include <zstd_errors.h>

#include "common/mem.h"
#include "common/package.h"

/* A frame may ask its reader for a window of at most this; level 1 uses 512 KiB. */
enum { LEVEL = 1, WINDOW_LOG_MAX = 23, STEP_BYTES = 256 * 1024 };

static enum err zstd_error(size_t code)
{
    return ZSTD_getErrorCode(code) == ZSTD_error_memory_allocation ? ERR_NOMEM : ERR_CORRUPT;
}

/* --- Compression --------------------------------------------------------- */

static enum err compress(ZSTD_CCtx *ctx, const void *data, size_t bytes, struct buf *out)
{
    size_t before = out->bytes, bound = ZSTD_compressBound(bytes);
    unsigned char *to = buf_extend(out, bound);
    if (!to)
        return ERR_NOMEM;
    (void)ZSTD_CCtx_setParameter(ctx, ZSTD_c_compressionLevel, LEVEL);
    (void)ZSTD_CCtx_setParameter(ctx, ZSTD_c_checksumFlag, 1);
    size_t done = ZSTD_compress2(ctx, to, bound, data, bytes);
    if (ZSTD_isError(done)) {
        out->bytes = before;
        return ERR_NOMEM; /* the room suffices and the parameters are valid */
    }
    out->bytes = before + done;
    return ERR_OK;
}

enum err chunk_compress(const void *data, size_t bytes, struct buf *out)
{
    ZSTD_CCtx *ctx = ZSTD_createCCtx();
    if (!ctx)
        return ERR_NOMEM;
    enum err e = compress(ctx, data, bytes, out);
    (void)ZSTD_freeCCtx(ctx);
    return e;
}

/* --- Decompression ------------------------------------------------------- */

/* Room is taken at once for so many times the bytes of a frame, which it must say it fills; what
 * claims more has to grow to it. */
enum { ROOM_RATIO_MAX = 64 };

/* A frame's head (RFC 8878, 3.1.1.1): true if it asks for a window that we give. zstd looks at that
 * itself, but not where it has room for all of the contents. */
static bool window_fits(const unsigned char *frame, size_t frame_bytes)
{
    enum { DESCRIPTOR_AT = 4, WINDOW_AT = 5, SINGLE_SEGMENT = 1 << 5 };
    if (frame_bytes <= WINDOW_AT)
        return false;
    if (frame[DESCRIPTOR_AT] & SINGLE_SEGMENT)
        return ZSTD_getFrameContentSize(frame, frame_bytes) <= UINT64_C(1) << WINDOW_LOG_MAX;
    unsigned exponent = frame[WINDOW_AT] >> 3, mantissa = frame[WINDOW_AT] & 7;
    return 10 + exponent + (mantissa > 0) <= WINDOW_LOG_MAX;
}

/* The size that a frame says it has, if it can be decompressed into room of that size; else 0. */
static size_t room_for(const void *frame, size_t frame_bytes, uint64_t bytes_max)
{
    unsigned long long says = ZSTD_getFrameContentSize(frame, frame_bytes);
    bool known = says != ZSTD_CONTENTSIZE_UNKNOWN && says != ZSTD_CONTENTSIZE_ERROR;
    if (!known || says > bytes_max || says / ROOM_RATIO_MAX > frame_bytes)
        return 0;
    return ZSTD_findFrameCompressedSize(frame, frame_bytes) == frame_bytes ? (size_t)says : 0;
}

/* The whole frame into room of just its size: no window is kept beside it. */
static enum err decompress_at_once(ZSTD_DCtx *ctx, const ZSTD_inBuffer *in, size_t room,
                                   struct buf *out)
{
    unsigned char *to = buf_extend(out, room);
    if (!to)
        return ERR_NOMEM;
    size_t done = ZSTD_decompressDCtx(ctx, to, room, in->src, in->size);
    if (ZSTD_isError(done))
        return zstd_error(done);
    return done == room ? ERR_OK : ERR_CORRUPT;
}

/* Appends what comes next, at most STEP_BYTES; *left is 0 at the end of the frame. */
static enum err step(ZSTD_DCtx *ctx, ZSTD_inBuffer *in, struct buf *out, size_t *left)
{
    size_t before = out->bytes, taken = in->pos;
    unsigned char *to = buf_extend(out, STEP_BYTES);
    if (!to)
        return ERR_NOMEM;
    ZSTD_outBuffer piece = {.dst = to, .size = STEP_BYTES};
    *left = ZSTD_decompressStream(ctx, &piece, in);
    out->bytes = before + piece.pos;
    if (ZSTD_isError(*left))
        return zstd_error(*left);
    bool stuck = piece.pos == 0 && in->pos == taken;
    return *left != 0 && stuck ? ERR_CORRUPT : ERR_OK; /* the frame is cut short */
}

/* One frame, exactly; `out` grows by what comes out, up to bytes_max. */
static enum err decompress(ZSTD_DCtx *ctx, ZSTD_inBuffer *in, uint64_t bytes_max, struct buf *out)
{
    size_t start = out->bytes, left = 1;
    if (ZSTD_isError(ZSTD_DCtx_setParameter(ctx, ZSTD_d_windowLogMax, WINDOW_LOG_MAX)))
        return ERR_NOMEM;
    while (left != 0) {
        TL_TRY(step(ctx, in, out, &left));
        if (out->bytes - start > bytes_max)
            return ERR_LIMIT;
    }
    return in->pos == in->size ? ERR_OK : ERR_CORRUPT;
}

enum err chunk_decompress_any(const void *frame, size_t frame_bytes, const digest *name,
                              uint64_t bytes_max, struct buf *out)
{
    size_t before = out->bytes;
    ZSTD_DCtx *ctx = ZSTD_createDCtx();
    if (!ctx)
        return ERR_NOMEM;
    ZSTD_inBuffer in = {.src = frame, .size = frame_bytes};
    bool fits = window_fits(frame, frame_bytes);
    size_t room = fits ? room_for(frame, frame_bytes, bytes_max) : 0;
    enum err e = ERR_CORRUPT;
    if (room > 0)
        e = decompress_at_once(ctx, &in, room, out);
    else if (fits)
        e = decompress(ctx, &in, bytes_max, out);
    (void)ZSTD_freeDCtx(ctx);
    if (e == ERR_OK) {
        digest found = digest_of(out->data + before, out->bytes - before);
        if (!digest_equal(&found, name))
            e = ERR_CORRUPT;
    }
    if (e != ERR_OK) {
        out->bytes = before;
        out->failed = false;
    }
    return e;
}

enum err chunk_decompress(const void *frame, size_t frame_bytes, const digest *name,
                          uint64_t bytes_expected, struct buf *out)
{
    size_t before = out->bytes;
    TL_TRY(chunk_decompress_any(frame, frame_bytes, name, bytes_expected, out));
    if (out->bytes - before == bytes_expected)
        return ERR_OK;
    out->bytes = before;
    return ERR_CORRUPT;
}

/* Hashes what comes out, piece by piece. */
static enum err hash_frame(ZSTD_DCtx *ctx, ZSTD_inBuffer *in, uint64_t bytes_max,
                           struct digest_ctx *hash, uint64_t *bytes)
{
    struct buf piece;
    size_t left = 1;
    enum err e = ERR_OK;
    buf_init(&piece);
    if (ZSTD_isError(ZSTD_DCtx_setParameter(ctx, ZSTD_d_windowLogMax, WINDOW_LOG_MAX)))
        e = ERR_NOMEM;
    while (e == ERR_OK && left != 0) {
        e = step(ctx, in, &piece, &left);
        if (e == ERR_OK && piece.bytes > bytes_max - *bytes)
            e = ERR_LIMIT;
        if (e == ERR_OK)
            digest_add(hash, piece.data, piece.bytes);
        *bytes += piece.bytes;
        buf_clear(&piece);
    }
    buf_release(&piece);
    return e == ERR_OK && in->pos != in->size ? ERR_CORRUPT : e;
}

enum err chunk_check(const void *frame, size_t frame_bytes, const digest *name, uint64_t bytes_max,
                     uint64_t *bytes)
{
    struct digest_ctx hash;
    uint64_t done = 0;
    TL_TRY(digest_begin(&hash));
    ZSTD_DCtx *ctx = ZSTD_createDCtx();
    ZSTD_inBuffer in = {.src = frame, .size = frame_bytes};
    enum err e = ctx ? ERR_CORRUPT : ERR_NOMEM;
    if (ctx && window_fits(frame, frame_bytes))
        e = hash_frame(ctx, &in, bytes_max, &hash, &done);
    (void)ZSTD_freeDCtx(ctx);
    digest found = digest_end(&hash);
    if (e == ERR_OK && !digest_equal(&found, name))
        e = ERR_CORRUPT;
    if (e == ERR_OK)
        *bytes = done;
    return e;
}
