/* client/import_sky.c: the soft sky that lights a model without lights of its own.
 *
 * Adds one image and one light to the scene of the import. One thread.
 */
#include <math.h>

#include "client/import_model.h"
#include "common/mem.h"

/* A soft overcast sky: brightest overhead, a lighter band at the horizon, a darker ground. Smooth,
 * so that few rows do and nothing shines through as a hot spot. */
enum { SKY_WIDTH = 4, SKY_HEIGHT = 64 };

static const double zenith[3] = {0.95, 1.05, 1.25};
static const double horizon[3] = {0.85, 0.87, 0.90};
static const double ground[3] = {0.30, 0.29, 0.28};

static double smooth(double t)
{
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    return t * t * (3 - 2 * t);
}

static void fill_row(float *row, uint32_t y)
{
    double up = 1 - 2 * (y + 0.5) / SKY_HEIGHT; /* 1 overhead, -1 below; linear in the angle */
    for (uint32_t x = 0; x < SKY_WIDTH; x++)
        for (uint32_t c = 0; c < 3; c++) {
            double above = horizon[c] + (zenith[c] - horizon[c]) * smooth(up);
            double below = horizon[c] + (ground[c] - horizon[c]) * smooth(-up * 5);
            row[3 * x + c] = (float)(up >= 0 ? above : below);
        }
}

enum err import_sky(struct import *im)
{
    struct scene_image image = {
        .width = SKY_WIDTH, .height = SKY_HEIGHT, .channel_count = 3, .format = SCENE_IMAGE_F32};
    float *pixels = mem_alloc_array((size_t)SKY_WIDTH * SKY_HEIGHT * 3, sizeof *pixels);
    if (!pixels)
        return ERR_NOMEM;
    for (uint32_t y = 0; y < SKY_HEIGHT; y++)
        fill_row(pixels + (size_t)y * SKY_WIDTH * 3, y);
    image.pixels = pixels;
    struct scene_texture texture;
    scene_image_texture_init(&texture);
    texture.wrap[1] = SCENE_WRAP_CLAMP;
    TL_TRY(import_add_image(im, &image, &texture.image));
    return import_add_texture(im, &texture, "sky", &im->scene.envmap.texture);
}
