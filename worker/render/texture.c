#include "worker/render/texture.h"

#include "worker/render/srgb_table.h"

/* floor for every double; the compiler's own is a library call on the baseline. */
static double floor_of(double x)
{
    if (!(fabs(x) < 4503599627370496.0))
        return x;
    double t = (double)(int64_t)x;
    return t > x ? t - 1 : t;
}

/* A texel index for any whole number, by the wrap mode. */
static uint32_t wrap_index(double i, uint32_t size, enum scene_wrap wrap)
{
    double n = size;
    if (wrap == SCENE_WRAP_CLAMP)
        return !(i > 0) ? 0 : i >= n - 1 ? size - 1 : (uint32_t)i;
    double period = wrap == SCENE_WRAP_MIRROR ? 2 * n : n;
    double r = i - floor_of(i / period) * period;
    if (r >= n && wrap == SCENE_WRAP_MIRROR)
        r = period - 1 - r;
    /* Rounding of i / period may leave r just outside, and i may not be finite. */
    return !(r > 0) ? 0 : r >= n - 1 ? size - 1 : (uint32_t)r;
}

rgb texture_texel(const struct texture *t, uint32_t x, uint32_t y, double *alpha)
{
    size_t at = ((size_t)y * t->width + x) * t->channel_count;
    double c[4] = {0, 0, 0, 1};
    if (t->format == SCENE_IMAGE_F32) {
        const float *p = (const float *)t->pixels + at;
        for (uint32_t k = 0; k < t->channel_count; k++)
            c[k] = (double)p[k];
    } else {
        const unsigned char *p = (const unsigned char *)t->pixels + at;
        for (uint32_t k = 0; k < t->channel_count; k++) {
            bool curve = t->format == SCENE_IMAGE_U8_SRGB && k < 3;
            c[k] = curve ? srgb_table[p[k]] : p[k] / 255.0;
        }
    }
    *alpha = c[3];
    return t->channel_count == 1 ? rgb_grey(c[0]) : (rgb){c[0], c[1], c[2]};
}

static rgb image_color(const struct texture *t, double s, double r, double *alpha)
{
    double x = s * t->width - 0.5, y = (1 - r) * t->height - 0.5;
    double x0 = floor_of(x), y0 = floor_of(y);
    double fx = x - x0, fy = y - y0;
    uint32_t xs[2], ys[2];
    for (int k = 0; k < 2; k++) {
        xs[k] = wrap_index(x0 + k, t->width, t->wrap[0]);
        ys[k] = wrap_index(y0 + k, t->height, t->wrap[1]);
    }
    rgb sum = {0, 0, 0};
    double alpha_sum = 0;
    for (int k = 0; k < 4; k++) {
        double a, w = (k & 1 ? fx : 1 - fx) * (k & 2 ? fy : 1 - fy);
        sum = rgb_mad(sum, texture_texel(t, xs[k & 1], ys[k >> 1], &a), w);
        alpha_sum += a * w;
    }
    *alpha = alpha_sum;
    return sum;
}

rgb texture_color_alpha(const struct texture *t, double u, double v, double *alpha)
{
    *alpha = 1;
    if (t->type == SCENE_TEXTURE_CONSTANT)
        return t->color[0];
    const double *m = t->uv_matrix;
    double s = m[0] * u + m[1] * v + m[2];
    double r = m[3] * u + m[4] * v + m[5];
    if (t->type == SCENE_TEXTURE_IMAGE)
        return image_color(t, s, r, alpha);
    /* Same parity of floor(2 s) and floor(2 t): their sum is even. */
    double sum = floor_of(2 * s) + floor_of(2 * r);
    return t->color[sum - 2 * floor_of(sum / 2) != 0];
}

rgb texture_color(const struct texture *t, double u, double v)
{
    double alpha;
    return texture_color_alpha(t, u, v, &alpha);
}
