/* worker/render/texture.h: colours that vary over a surface.
 *
 * An image is looked up at a point, bilinearly between texel centres or at the nearest one, or
 * over a footprint: the parallelogram about the point that one sample of the picture stands for.
 * A footprint is cut along the longer axis of its ellipse into probes as long as the shorter
 * (Feline: McCormack et al. 1999), each looked up between two levels of a pyramid of averages
 * (Williams 1983). Footprints below a texel give the bilinear value, bit for bit. A checkerboard
 * is averaged over a footprint in closed form.
 *
 * v = 0 is the bottom row of the picture, as in OBJ. Texels lie in tiles of 4 x 4, so that
 * neighbours in both directions share cache lines. A picture, or squares of its finer levels, may
 * not be there yet: a look-up that meets what is missing notes it and means nothing. Everything is
 * borrowed from the render scene's arena. Any thread. Tests: test_texture, test_surface,
 * test_scene_late.
 */
#ifndef WORKER_RENDER_TEXTURE_H
#define WORKER_RENDER_TEXTURE_H

#include <stdatomic.h>

#include "common/pyramid.h"
#include "worker/render/render.h"
#include "worker/render/vec.h"

enum {
    TEXTURE_TILE_SHIFT = 2,  /* log2 of a tile's side in texels */
    TEXTURE_LEVELS_MAX = 16, /* of SCENE_IMAGE_SIDE_MAX, down to one texel */
    TEXTURE_PROBES_MAX = 8,  /* a longer footprint is widened */
};

_Static_assert(SCENE_IMAGE_SIDE_MAX == 1 << (TEXTURE_LEVELS_MAX - 1),
               "the largest picture has as many levels");

struct texture_level {
    const void *texels;
    uint32_t width, height;
    uint32_t tiles_across;
    uint8_t tile_shift[2]; /* log2 of a tile's sides: 0 where the level is narrower than a tile */
};

/* The texels of a square of PYRAMID_PIECE_SIDE texels a side in level 0, and of the same square in
 * the levels that pieces have: one level behind the other, in tiles. NULL: not there yet. */
typedef _Atomic(const void *) texture_piece;

/* Level 0 is the picture; each next has half its sides, rounded down, to 1 x 1. While it is
 * `absent`, nothing of its levels may be read: a late picture comes while units are rendered, and
 * then stays. Of one in pieces the sides of all levels are known from the start, the texels of the
 * first levels are in its pieces, and those of the others may be absent. */
struct texture_image {
    atomic_bool absent;
    enum scene_image_format format;
    uint32_t channel_count;
    bool opaque;           /* no opacity is looked up, or it is 1 everywhere */
    uint32_t level_count;  /* 1: no pyramid */
    uint32_t piece_levels; /* 0: no pieces */
    uint32_t pieces_across;
    uint32_t number;       /* of the image, among what a unit may lack; */
    uint32_t first_number; /* of its first piece */
    texture_piece *pieces; /* row by row */
    struct texture_level levels[TEXTURE_LEVELS_MAX];
};

/* What look-ups have met that is not there: pictures and pieces by their numbers, each once, while
 * there is room. */
struct texture_lacks {
    uint32_t met; /* so often */
    uint32_t count;
    uint32_t numbers[RENDER_LACKS_MAX];
};

struct texture {
    enum scene_texture_type type;
    enum scene_texture_filter filter;
    rgb color[2]; /* constant, checkerboard; image: [0] is a factor */
    double uv_matrix[6];
    enum scene_wrap wrap[2];
    const struct texture_image *image;
};

/* What one sample of the picture stands for, as two sides of a parallelogram. */
struct texture_footprint {
    double u[2], v[2];
};

/* Sets all of a level but its texels. */
void texture_level_init(struct texture_level *l, uint32_t width, uint32_t height);

/* Texels that a level has room for: whole tiles. */
size_t texture_level_texels(const struct texture_level *l);

/* What a column and a row add to the place of a texel. x < width, y < height, row 0 at the top. */
static inline size_t texture_column(const struct texture_level *l, uint32_t x)
{
    unsigned sx = l->tile_shift[0], sy = l->tile_shift[1];
    return ((size_t)(x >> sx) << (sx + sy)) + (x & ((1u << sx) - 1));
}

static inline size_t texture_row(const struct texture_level *l, uint32_t y)
{
    unsigned sx = l->tile_shift[0], sy = l->tile_shift[1];
    return ((size_t)(y >> sy) * l->tiles_across << (sx + sy)) +
           ((size_t)(y & ((1u << sy) - 1)) << sx);
}

static inline size_t texture_place(const struct texture_level *l, uint32_t x, uint32_t y)
{
    return texture_column(l, x) + texture_row(l, y);
}

/* Texels of a piece: of all its levels, whole squares. */
size_t texture_piece_texels(uint32_t levels);

/* Where in a piece the texel (x, y) of a level lies; x and y of the whole level. */
size_t texture_piece_place(uint32_t level, uint32_t x, uint32_t y);

/* One texel of a level that is there and in no piece, decoded to linear: c[0..2] colour (grey three
 * times), c[3] the fourth channel, 1 when there is none. */
void texture_texel(const struct texture_image *image, const struct texture_level *l, uint32_t x,
                   uint32_t y, double c[4]);

/* The texture at a point of the surface, of a picture that is all there; the matrix is applied
 * here.
 */
rgb texture_color(const struct texture *t, double u, double v);

/* The fourth channel there, at the finest level always: 1 when there is none. Of a picture that is
 * all there. */
double texture_alpha(const struct texture *t, double u, double v);

/* The mean over a footprint, if the texture's filter asks for that and there is one (not NULL);
 * else that at the point. Numbers of any kind are fine: a footprint without end has the mean of
 * the whole. What is not there is noted in `lacks`, unless that is NULL: then lacks->met has grown
 * and the colour means nothing. */
rgb texture_filtered(const struct texture *t, double u, double v,
                     const struct texture_footprint *footprint, struct texture_lacks *lacks);

/* By how much its luminance changes with u and v: a difference over a texel of an image, or over
 * the footprint where that is wider and asked for. */
void texture_gradient(const struct texture *t, double u, double v,
                      const struct texture_footprint *footprint, struct texture_lacks *lacks,
                      double gradient[2]);

#endif
