/* proto/tile_codec.h: the pixels of a unit as bytes, smaller and exact.
 *
 * The floats (planes R, G, B and those of AOVs, of a unit's pixels in grid order) are cut into four
 * byte planes (all lowest bytes, ..., all highest bytes), each byte is replaced by
 * its difference from the one before it in its plane, and the whole is one zstd
 * frame of level 1 with content size and checksum. Any 32 bits pass unchanged:
 * NaN payloads, infinities, -0.
 *
 * Pure functions, any thread. A decoder's memory is the exact output and one
 * scratch of the same size; the input's own claims allocate nothing. Tests:
 * test_tile_codec, fuzz_tile_codec.
 */
#ifndef PROTO_TILE_CODEC_H
#define PROTO_TILE_CODEC_H

#include "common/err.h"
#include "proto/limits.h"

/* Values of one call at most: all planes of the largest unit. */
enum { TILE_CODEC_VALUES_MAX = LIMIT_UNIT_VALUES };

/* The most bytes an encoding of that many values can have. */
size_t tile_codec_bound(size_t value_count);

/* Encodes 1..TILE_CODEC_VALUES_MAX values (asserted). On success *out is a new buffer of *out_bytes
 * that you own (mem_free). ERR_NOMEM. */
TL_NODISCARD enum err tile_codec_encode(const float *values, size_t value_count,
                                        unsigned char **out, size_t *out_bytes);

/* Decodes into exactly value_count values. ERR_CORRUPT: not one zstd frame of that very size with a
 * checksum that holds; ERR_LIMIT: a window over LIMIT_ZSTD_WINDOW_LOG; ERR_NOMEM. `values` is
 * unspecified after an error. */
TL_NODISCARD enum err tile_codec_decode(const void *data, size_t bytes, float *values,
                                        size_t value_count);

#endif
