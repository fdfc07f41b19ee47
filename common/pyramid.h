/* common/pyramid.h: the averages over which textures are filtered.
 *
 * Each level has half the sides of the one above, rounded down, to 1 x 1; a texel is the mean of
 * those that fall into it (Williams 1983), taken from the level above before that was rounded to
 * the picture's format. Workers make the levels of pictures that they have whole, the writer of
 * packages those of pictures that travel in pieces: by this code both, so the bits are the same.
 *
 * Pure apart from memory; any thread. Tests: test_texture, test_scene_pieces.
 */
#ifndef COMMON_PYRAMID_H
#define COMMON_PYRAMID_H

#include "common/scene.h"

/* A picture may be cut into squares of so many texels a side, the last of a row or column perhaps
 * smaller. Whoever has such a piece makes PYRAMID_PIECE_LEVELS levels of it, the picture's own
 * among them, without its neighbours: so the picture's sides are multiples of 2 to the power of
 * that. */
enum {
    PYRAMID_PIECE_SHIFT = 9,
    PYRAMID_PIECE_SIDE = 1 << PYRAMID_PIECE_SHIFT,
    PYRAMID_PIECE_LEVELS = 3,
};

/* True if the sides of a picture (its pixels do not matter) allow pieces. */
bool pyramid_can_be_pieces(const struct scene_image *image);

/* Pieces in a row and in a column. */
uint32_t pyramid_pieces_across(const struct scene_image *image);
uint32_t pyramid_pieces_down(const struct scene_image *image);

/* Where piece (x, y) lies: its corner in *left and *top, its sides in the result, without pixels.
 */
struct scene_image pyramid_piece_at(const struct scene_image *image, uint32_t x, uint32_t y,
                                    uint32_t *left, uint32_t *top);

/* A level in linear light, row by row. You own the samples (mem_free). */
struct pyramid_level {
    uint32_t width, height, channel_count;
    float *samples;
};

/* The next side of a level. */
static inline uint32_t pyramid_half(uint32_t side)
{
    return side > 1 ? side / 2 : 1;
}

/* The first level above a picture of more than one texel. `weighed`: a colour counts as much as can
 * be seen of it; where nothing can, all count the same. ERR_NOMEM. */
TL_NODISCARD enum err pyramid_first(const struct scene_image *picture, bool weighed,
                                    struct pyramid_level *out);

/* The level above one of more than one texel. */
TL_NODISCARD enum err pyramid_next(const struct pyramid_level *below, bool weighed,
                                   struct pyramid_level *out);

/* One texel of a level in the picture's format, at `place` of `texels`. */
void pyramid_round(enum scene_image_format format, uint32_t channel_count, const float *linear,
                   void *texels, size_t place);

#endif
