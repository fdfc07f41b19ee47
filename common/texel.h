/* common/texel.h: samples of pictures as linear light.
 *
 * What scene_image_format says of a sample, told once: shading looks texels up by it, pyramids of
 * averages are made by it. Pure; any thread. Tests: test_texture, test_surface.
 */
#ifndef COMMON_TEXEL_H
#define COMMON_TEXEL_H

#include "common/scene.h"
#include "common/srgb_table.h"

/* The texel at `place` (in texels): c[0..2] colour (grey three times), c[3] the fourth channel, 1
 * when there is none. */
static inline void texel_get(enum scene_image_format format, uint32_t channel_count,
                             const void *texels, size_t place, double c[4])
{
    size_t at = place * channel_count;
    c[3] = 1;
    if (format == SCENE_IMAGE_F32) {
        const float *p = (const float *)texels + at;
        for (uint32_t k = 0; k < channel_count; k++)
            c[k] = (double)p[k];
    } else {
        const unsigned char *p = (const unsigned char *)texels + at;
        for (uint32_t k = 0; k < channel_count; k++) {
            bool curve = format == SCENE_IMAGE_U8_SRGB && k < 3;
            c[k] = curve ? srgb_table[p[k]] : p[k] / 255.0;
        }
    }
    if (channel_count == 1)
        c[1] = c[2] = c[0];
}

/* Bytes of one texel. */
static inline size_t texel_bytes(enum scene_image_format format, uint32_t channel_count)
{
    return channel_count * (format == SCENE_IMAGE_F32 ? sizeof(float) : 1);
}

#endif
