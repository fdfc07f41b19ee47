/* common/package_split.h: a large picture as a base and pieces, and back.
 *
 * Internal to the writer and the reader of packages. A piece is a square of the picture, an image
 * chunk of its own; the base has the levels of the picture's pyramid from PYRAMID_PIECE_LEVELS on
 * (package.h). Cutting is spread over the machine's cores. No state; any thread.
 * Tests: test_package, prop_package, test_scene_pieces.
 */
#ifndef COMMON_PACKAGE_SPLIT_H
#define COMMON_PACKAGE_SPLIT_H

#include "common/package.h"

/* A picture of fewer plain bytes is not worth it: it comes whole in the time of a few requests. */
enum { PACKAGE_SPLIT_BYTES_MIN = 1 << 20 };

/* Whether a picture with these stored channels travels in pieces, if it may come late. */
bool package_is_split(const struct scene_image *image, unsigned stored, uint64_t bytes_min);

struct split_piece {
    struct buf bytes;
    digest name;
};

struct split {
    struct scene_image picture; /* without pixels */
    struct buf base;
    digest name; /* of the base */
    struct split_piece *pieces;
    size_t count;
};

/* ERR_NOMEM; release *out in any case. */
TL_NODISCARD enum err package_split(const struct scene_image *image, unsigned stored,
                                    struct split *out);
void package_split_release(struct split *s);

#endif
