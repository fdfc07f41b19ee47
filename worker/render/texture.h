/* worker/render/texture.h: colours that vary over a surface.
 *
 * Images are looked up bilinearly between texel centres; v = 0 is the bottom row of
 * the picture, as in OBJ. Pixels are borrowed from the render scene's arena. Any
 * thread. Tests: test_surface.
 */
#ifndef WORKER_RENDER_TEXTURE_H
#define WORKER_RENDER_TEXTURE_H

#include "common/scene.h"
#include "worker/render/vec.h"

struct texture {
    enum scene_texture_type type;
    rgb color[2];
    double uv_matrix[6];
    enum scene_wrap wrap[2];
    uint32_t width, height, channel_count;
    enum scene_image_format format;
    const void *pixels;
};

/* The texture at surface coordinates; the matrix is applied here. */
rgb texture_color(const struct texture *t, double u, double v);

/* Colour and, in *alpha, the fourth channel (1 when there is none). */
rgb texture_color_alpha(const struct texture *t, double u, double v, double *alpha);

/* One texel, decoded to linear. x < width, y < height, row 0 at the top. */
rgb texture_texel(const struct texture *t, uint32_t x, uint32_t y, double *alpha);

#endif
