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

/* One frame, exactly; `out` grows by what comes out, up to bytes_max. */
static enum err decompress(ZSTD_DCtx *ctx, ZSTD_inBuffer *in, uint64_t bytes_max, struct buf *out)
{
    size_t start = out->bytes, left = 1;
    if (ZSTD_isError(ZSTD_DCtx_setParameter(ctx, ZSTD_d_windowLogMax, WINDOW_LOG_MAX)))
        return ERR_NOMEM;
    while (left != 0) {
        size_t before = out->bytes;
        unsigned char *to = buf_extend(out, STEP_BYTES);
        if (!to)
            return ERR_NOMEM;
        ZSTD_outBuffer piece = {.dst = to, .size = STEP_BYTES};
        size_t taken = in->pos;
        left = ZSTD_decompressStream(ctx, &piece, in);
        out->bytes = before + piece.pos;
        if (ZSTD_isError(left))
            return zstd_error(left);
        if (out->bytes - start > bytes_max)
            return ERR_LIMIT;
        bool stuck = piece.pos == 0 && in->pos == taken;
        if (left != 0 && stuck)
            return ERR_CORRUPT; /* the frame is cut short */
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
    enum err e = frame_bytes ? decompress(ctx, &in, bytes_max, out) : ERR_CORRUPT;
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
