/* master/chunks.h: scene chunks on disk, by the SHA-256 of what they unpack to.
 *
 *   DIR/chunks/aa/HEX    u64 size unpacked, little-endian, then the zstd frame as it came
 *
 * What is there is known in memory; files are read and written on libuv's pool, written
 * aside, synced and renamed, and the folder synced. What was read lately stays in memory, and
 * requests for the same chunk share one read. Loop thread only; callbacks come from it. Tests:
 * tests/unit/test_chunks.c, tests/e2e/test_master_http.py.
 */
#ifndef MASTER_CHUNKS_H
#define MASTER_CHUNKS_H

#include <uv.h>

#include "common/buf.h"
#include "common/digest.h"
#include "proto/transport.h"

enum { CHUNKS_CACHE_BYTES = 128 << 20 };
#define CHUNKS_RAW_BYTES_MAX (UINT64_C(4) << 30) /* of one chunk unpacked */

struct chunk_store; /* opaque */

/* Lists the folder (blocking). ERR_IO, ERR_NOMEM. */
TL_NODISCARD enum err chunks_open(uv_loop_t *loop, const char *dir, struct chunk_store **out);
/* No operation may be under way. */
void chunks_close(struct chunk_store *s);

/* Asking keeps it from the next sweeps: whoever asks is about to use it. */
bool chunks_has(struct chunk_store *s, const digest *name);
size_t chunks_count(const struct chunk_store *s);

/* Checks that `frame` (taken) unpacks to `name` and stores it. ERR_CORRUPT: it does not;
 * ERR_LIMIT: too large; ERR_NOSPACE, ERR_IO, ERR_NOMEM. */
typedef void chunk_put_done(void *ctx, enum err e);
TL_NODISCARD enum err chunks_put(struct chunk_store *s, const digest *name, struct buf *frame,
                                 chunk_put_done *done, void *ctx);

/* Gives the frame, or an error: ERR_NOT_FOUND (then it is not known any more), ERR_IO, ERR_NOMEM.
 * `frame` is borrowed for the call; blob_ref keeps it. May call back before it returns. */
typedef void chunk_got(void *ctx, enum err e, const digest *name, struct blob *frame,
                       uint64_t raw_bytes);
void chunks_get(struct chunk_store *s, const digest *name, chunk_got *done, void *ctx);

/* Reads a package's root and tells which of its chunks are missing, itself included: their names,
 * in `missing` (of digest values; taken by the callback). ERR_CORRUPT, ERR_LIMIT, ERR_VERSION: it
 * is no package. ERR_NOT_FOUND, at once: its root is not known. */
typedef void chunks_checked(void *ctx, enum err e, struct buf *missing);
TL_NODISCARD enum err chunks_check_package(struct chunk_store *s, const digest *root,
                                           chunks_checked *done, void *ctx);

/* Removes the chunks that are in none of these packages (`roots`, mem_alloc'ed, taken) and that
 * nobody has stored or asked for since `before_ms` of the loop's clock; at most 1,000 at a time.
 * Nothing when a package cannot be read. ERR_NOMEM: not begun. */
typedef void chunks_swept(void *ctx);
TL_NODISCARD enum err chunks_sweep(struct chunk_store *s, digest *roots, size_t root_count,
                                   uint64_t before_ms, chunks_swept *done, void *ctx);

#endif
