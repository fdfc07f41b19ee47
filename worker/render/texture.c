#include "worker/render/texture.h"

#include <emmintrin.h>

#include "common/texel.h"

/* Over which a checkerboard's slope is taken: half of it to either side, in its own space. */
#define SLOPE_STEP (1.0 / 256)

/* floor for every double; the compiler's own is a library call on the baseline. */
static double floor_of(double x)
{
    if (!(fabs(x) < 4503599627370496.0))
        return x;
    double t = (double)(int64_t)x;
    return t > x ? t - 1 : t;
}

/* --- Texels --------------------------------------------------------------- */

void texture_level_init(struct texture_level *l, uint32_t width, uint32_t height)
{
    uint32_t side = 1u << TEXTURE_TILE_SHIFT;
    *l = (struct texture_level){.width = width, .height = height};
    l->tile_shift[0] = width < side ? 0 : TEXTURE_TILE_SHIFT;
    l->tile_shift[1] = height < side ? 0 : TEXTURE_TILE_SHIFT;
    l->tiles_across = ((width - 1) >> l->tile_shift[0]) + 1;
}

size_t texture_level_texels(const struct texture_level *l)
{
    size_t tiles_down = ((l->height - 1) >> l->tile_shift[1]) + 1;
    return l->tiles_across * tiles_down << (l->tile_shift[0] + l->tile_shift[1]);
}

/* Squares of a level that pieces have: log2 of their side. */
static unsigned square_shift(uint32_t level)
{
    return PYRAMID_PIECE_SHIFT - level;
}

/* The sum of a geometric series: each level has a quarter of the texels of the one below. */
size_t texture_piece_texels(uint32_t levels)
{
    unsigned all = 2 * (PYRAMID_PIECE_SHIFT + 1);
    return (((size_t)1 << all) - ((size_t)1 << (all - 2 * levels))) / 3;
}

size_t texture_piece_place(uint32_t level, uint32_t x, uint32_t y)
{
    unsigned shift = square_shift(level);
    uint32_t mask = (1u << shift) - 1, in = (1u << TEXTURE_TILE_SHIFT) - 1;
    x &= mask;
    y &= mask;
    size_t tile = ((size_t)(y >> TEXTURE_TILE_SHIFT) << (shift - TEXTURE_TILE_SHIFT)) +
                  (x >> TEXTURE_TILE_SHIFT);
    return texture_piece_texels(level) + (tile << 2 * TEXTURE_TILE_SHIFT) +
           ((size_t)(y & in) << TEXTURE_TILE_SHIFT) + (x & in);
}

/* Notes what is not there. */
static void lack(struct texture_lacks *lacks, uint32_t number)
{
    if (!lacks)
        return;
    lacks->met++;
    for (uint32_t i = lacks->count; i > 0; i--)
        if (lacks->numbers[i - 1] == number)
            return;
    if (lacks->count < RENDER_LACKS_MAX)
        lacks->numbers[lacks->count++] = number;
}

/* Whether the texels of a level outside pieces can be read. */
static bool is_there(const struct texture_image *image, struct texture_lacks *lacks)
{
    if (!atomic_load_explicit(&image->absent, memory_order_acquire))
        return true;
    lack(lacks, image->number);
    return false;
}

/* Whether the sides of a texture's levels are known: of a whole picture once it is there. */
static bool is_known(const struct texture *t, struct texture_lacks *lacks)
{
    return t->type != SCENE_TEXTURE_IMAGE || t->image->piece_levels > 0 ||
           is_there(t->image, lacks);
}

static void missing(double c[4])
{
    c[0] = c[1] = c[2] = c[3] = 1;
}

static void texel_at(const struct texture_image *image, const struct texture_level *l, size_t place,
                     double c[4])
{
    texel_get(image->format, image->channel_count, l->texels, place, c);
}

void texture_texel(const struct texture_image *image, const struct texture_level *l, uint32_t x,
                   uint32_t y, double c[4])
{
    texel_at(image, l, texture_place(l, x, y), c);
}

/* A texel of a level that is in pieces. */
static void piece_texel(const struct texture_image *image, uint32_t level, uint32_t x, uint32_t y,
                        struct texture_lacks *lacks, double c[4])
{
    unsigned shift = square_shift(level);
    uint32_t piece = (y >> shift) * image->pieces_across + (x >> shift);
    const void *texels = atomic_load_explicit(&image->pieces[piece], memory_order_acquire);
    if (texels) {
        texel_get(image->format, image->channel_count, texels, texture_piece_place(level, x, y), c);
        return;
    }
    missing(c);
    lack(lacks, image->first_number + piece);
}

static bool is_in_pieces(const struct texture_image *image, const struct texture_level *l)
{
    return l < image->levels + image->piece_levels;
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

/* --- At a point ----------------------------------------------------------- */

static void nearest(const struct texture *t, const struct texture_level *l, double s, double r,
                    struct texture_lacks *lacks, double c[4])
{
    uint32_t x = wrap_index(floor_of(s * l->width), l->width, t->wrap[0]);
    uint32_t y = wrap_index(floor_of((1 - r) * l->height), l->height, t->wrap[1]);
    if (is_in_pieces(t->image, l))
        piece_texel(t->image, (uint32_t)(l - t->image->levels), x, y, lacks, c);
    else if (is_there(t->image, lacks))
        texture_texel(t->image, l, x, y, c);
    else
        missing(c);
}

/* The two texel indices about x, in texels from the first's middle, and how far it lies between
 * them. */
static double neighbours(double x, uint32_t size, enum scene_wrap wrap, uint32_t at[2])
{
    /* Within the level nothing wraps; most of what does repeats. */
    if (x >= 0 && x < size - 1.0) {
        at[0] = (uint32_t)x;
        at[1] = at[0] + 1;
        return x - at[0];
    }
    double below = floor_of(x);
    if (wrap == SCENE_WRAP_REPEAT && fabs(x) < 1e9) {
        int32_t i = (int32_t)below, n = (int32_t)size, r = i % n;
        at[0] = (uint32_t)(r < 0 ? r + n : r);
        at[1] = at[0] + 1 < size ? at[0] + 1 : 0;
    } else {
        at[0] = wrap_index(below, size, wrap);
        at[1] = wrap_index(below + 1, size, wrap);
    }
    return x - below;
}

/* The weighted sum of four texels of three floats, two channels in one vector. */
static void sum_f32x3(const float *texels, const size_t places[4], const double weights[4],
                      double c[4])
{
    __m128d first = _mm_setzero_pd();
    double third = 0;
    for (int k = 0; k < 4; k++) {
        const float *texel = texels + 3 * places[k];
        __m128 two = _mm_castsi128_ps(_mm_loadl_epi64((const void *)texel));
        first = _mm_add_pd(first, _mm_mul_pd(_mm_cvtps_pd(two), _mm_set1_pd(weights[k])));
        third += (double)texel[2] * weights[k];
    }
    _mm_storeu_pd(c, first);
    c[2] = third;
    c[3] = 1;
}

/* The weighted sum of four texels of pieces, as bilinear() has it. */
static void sum_pieces(const struct texture_image *image, uint32_t level, const uint32_t xs[2],
                       const uint32_t ys[2], const double weights[4], struct texture_lacks *lacks,
                       double c[4])
{
    c[0] = c[1] = c[2] = c[3] = 0;
    for (int k = 0; k < 4; k++) {
        double texel[4] = {0};
        piece_texel(image, level, xs[k & 1], ys[k >> 1], lacks, texel);
        for (int j = 0; j < 4; j++)
            c[j] += texel[j] * weights[k];
    }
}

static void bilinear(const struct texture *t, const struct texture_level *l, double s, double r,
                     struct texture_lacks *lacks, double c[4])
{
    const struct texture_image *image = t->image;
    uint32_t xs[2], ys[2];
    double fx = neighbours(s * l->width - 0.5, l->width, t->wrap[0], xs);
    double fy = neighbours((1 - r) * l->height - 0.5, l->height, t->wrap[1], ys);
    const double weights[4] = {(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy};
    if (is_in_pieces(image, l)) {
        sum_pieces(image, (uint32_t)(l - image->levels), xs, ys, weights, lacks, c);
        return;
    }
    if (!is_there(image, lacks)) {
        missing(c);
        return;
    }
    size_t columns[2] = {texture_column(l, xs[0]), texture_column(l, xs[1])};
    size_t rows[2] = {texture_row(l, ys[0]), texture_row(l, ys[1])};
    const size_t places[4] = {columns[0] + rows[0], columns[1] + rows[0], columns[0] + rows[1],
                              columns[1] + rows[1]};
    if (image->format == SCENE_IMAGE_F32 && image->channel_count == 3) {
        sum_f32x3(l->texels, places, weights, c);
        return;
    }
    c[0] = c[1] = c[2] = c[3] = 0;
    for (int k = 0; k < 4; k++) {
        double texel[4] = {0};
        texel_at(image, l, places[k], texel);
        for (int j = 0; j < 4; j++)
            c[j] += texel[j] * weights[k];
    }
}

static void at_point(const struct texture *t, double s, double r, struct texture_lacks *lacks,
                     double c[4])
{
    const struct texture_level *l = &t->image->levels[0];
    if (t->filter == SCENE_FILTER_NEAREST)
        nearest(t, l, s, r, lacks, c);
    else
        bilinear(t, l, s, r, lacks, c);
}

static rgb factored(const struct texture *t, const double c[4])
{
    return rgb_mul((rgb){c[0], c[1], c[2]}, t->color[0]);
}

static void map_uv(const struct texture *t, double u, double v, double *s, double *r)
{
    const double *m = t->uv_matrix;
    *s = m[0] * u + m[1] * v + m[2];
    *r = m[3] * u + m[4] * v + m[5];
}

static rgb checker_color(const struct texture *t, double s, double r)
{
    /* Same parity of floor(2 s) and floor(2 t): their sum is even. */
    double sum = floor_of(2 * s) + floor_of(2 * r);
    return t->color[sum - 2 * floor_of(sum / 2) != 0];
}

static rgb color_at(const struct texture *t, double u, double v, struct texture_lacks *lacks)
{
    if (t->type == SCENE_TEXTURE_CONSTANT)
        return t->color[0];
    double s, r, c[4];
    map_uv(t, u, v, &s, &r);
    if (t->type == SCENE_TEXTURE_IMAGE) {
        at_point(t, s, r, lacks, c);
        return factored(t, c);
    }
    return checker_color(t, s, r);
}

rgb texture_color(const struct texture *t, double u, double v)
{
    return color_at(t, u, v, NULL);
}

double texture_alpha(const struct texture *t, double u, double v)
{
    if (t->type != SCENE_TEXTURE_IMAGE || t->image->channel_count < 4)
        return 1;
    double s, r, c[4];
    map_uv(t, u, v, &s, &r);
    at_point(t, s, r, NULL, c);
    return c[3];
}

/* --- Over a footprint ------------------------------------------------------ */

/* The ellipse that touches the sides of a parallelogram from inside, scaled to its width: half axes
 * are those of {a cos + b sin}. The longer axis as a vector, and both lengths. */
struct ellipse {
    double x, y;
    double longer, shorter;
};

static struct ellipse ellipse_of(const double a[2], const double b[2])
{
    /* The symmetric matrix a a' + b b' has the squares of the lengths as eigenvalues. */
    double xx = a[0] * a[0] + b[0] * b[0], yy = a[1] * a[1] + b[1] * b[1];
    double xy = a[0] * a[1] + b[0] * b[1];
    double mean = (xx + yy) / 2, half = (xx - yy) / 2;
    double root = sqrt(half * half + xy * xy);
    double longer = sqrt(mean + root);
    struct ellipse e = {.longer = longer};
    e.shorter = longer > 0 ? fabs(a[0] * b[1] - a[1] * b[0]) / longer : 0;
    /* Its eigenvector, from the row that does not cancel. */
    double x = half > 0 ? half + root : xy, y = half > 0 ? xy : root - half;
    double length = sqrt(x * x + y * y);
    e.x = length > 0 ? x / length * longer : longer;
    e.y = length > 0 ? y / length * longer : 0;
    return e;
}

/* Between the two levels whose texels are just narrower and just wider than `width` texels of the
 * finest, linearly in the width. */
static void trilinear(const struct texture *t, double s, double r, double width,
                      struct texture_lacks *lacks, double c[4])
{
    uint32_t level = 0, last = t->image->level_count - 1;
    while (width >= 2 && level < last) {
        width *= 0.5;
        level++;
    }
    bilinear(t, &t->image->levels[level], s, r, lacks, c);
    if (!(width > 1) || level == last)
        return;
    double coarse[4];
    bilinear(t, &t->image->levels[level + 1], s, r, lacks, coarse);
    for (int j = 0; j < 4; j++)
        c[j] += (coarse[j] - c[j]) * (width - 1);
}

static void image_mean(const struct texture *t, double s, double r, const double side[2][2],
                       struct texture_lacks *lacks, double c[4])
{
    const struct texture_image *image = t->image;
    double texels[2] = {image->levels[0].width, image->levels[0].height};
    double a[2] = {side[0][0] * texels[0], side[0][1] * texels[1]};
    double b[2] = {side[1][0] * texels[0], side[1][1] * texels[1]};
    struct ellipse e = ellipse_of(a, b);
    /* Also where it is no number: nothing is known of the place then. */
    if (!(e.longer < 4.0 * SCENE_IMAGE_SIDE_MAX)) {
        bilinear(t, &image->levels[image->level_count - 1], s, r, lacks, c);
        return;
    }
    double width =
        e.shorter > e.longer / TEXTURE_PROBES_MAX ? e.shorter : e.longer / TEXTURE_PROBES_MAX;
    width = width > 1 ? width : 1;
    uint32_t probes = (uint32_t)(e.longer / width);
    probes += probes < e.longer / width;
    if (probes <= 1) {
        trilinear(t, s, r, width, lacks, c);
        return;
    }
    /* From end to end of the ellipse, each as wide as `width`: one that is hardly longer than that
     * is hardly spread. */
    double spread = 1 - width / e.longer;
    c[0] = c[1] = c[2] = c[3] = 0;
    for (uint32_t i = 0; i < probes; i++) {
        double probe[4], along = (i / (probes - 1.0) - 0.5) * spread;
        trilinear(t, s + along * e.x / texels[0], r + along * e.y / texels[1], width, lacks, probe);
        for (int j = 0; j < 4; j++)
            c[j] += probe[j];
    }
    for (int j = 0; j < 4; j++)
        c[j] /= probes;
}

/* The wave that is 1 over [0, 1), -1 over [1, 2), and so on, averaged over `width` about x. */
static double wave_mean(double x, double width)
{
    double from = x - width / 2, to = x + width / 2;
    double first = floor_of(from);
    if (first == floor_of(to))
        return first - 2 * floor_of(first / 2) != 0 ? -1 : 1;
    if (!(width < 1e9))
        return 0;
    /* Its integral is a triangle: 0 at even, 1 at odd numbers. */
    double end[2] = {from, to};
    for (int k = 0; k < 2; k++)
        end[k] = 1 - fabs(1 - (end[k] - 2 * floor_of(end[k] / 2)));
    return (end[1] - end[0]) / width;
}

/* Over the upright rectangle about the footprint. */
static rgb checker_mean(const struct texture *t, double s, double r, const double side[2][2])
{
    double across = 2 * (fabs(side[0][0]) + fabs(side[1][0]));
    double down = 2 * (fabs(side[0][1]) + fabs(side[1][1]));
    double second = 0.5 - 0.5 * wave_mean(2 * s, across) * wave_mean(2 * r, down);
    return rgb_add(rgb_scale(t->color[0], 1 - second), rgb_scale(t->color[1], second));
}

static bool is_averaged(const struct texture *t, const struct texture_footprint *footprint)
{
    return footprint && t->filter == SCENE_FILTER_MIPMAP && t->type != SCENE_TEXTURE_CONSTANT;
}

static void map_footprint(const struct texture *t, const struct texture_footprint *footprint,
                          double side[2][2])
{
    const double *m = t->uv_matrix;
    for (int k = 0; k < 2; k++) {
        side[k][0] = m[0] * footprint->u[k] + m[1] * footprint->v[k];
        side[k][1] = m[3] * footprint->u[k] + m[4] * footprint->v[k];
    }
}

rgb texture_filtered(const struct texture *t, double u, double v,
                     const struct texture_footprint *footprint, struct texture_lacks *lacks)
{
    if (!is_known(t, lacks))
        return rgb_grey(1);
    if (!is_averaged(t, footprint))
        return color_at(t, u, v, lacks);
    double s, r, c[4], side[2][2];
    map_uv(t, u, v, &s, &r);
    map_footprint(t, footprint, side);
    if (t->type == SCENE_TEXTURE_CHECKERBOARD)
        return checker_mean(t, s, r, side);
    image_mean(t, s, r, side, lacks, c);
    return factored(t, c);
}

/* --- Slopes ---------------------------------------------------------------- */

/* Luminance at a point of the texture's own space; `side` NULL: no footprint. */
static double luminance_at(const struct texture *t, double s, double r, const double side[2][2],
                           struct texture_lacks *lacks)
{
    double c[4];
    if (t->type == SCENE_TEXTURE_CHECKERBOARD)
        return rgb_luminance(side ? checker_mean(t, s, r, side) : checker_color(t, s, r));
    if (side)
        image_mean(t, s, r, side, lacks, c);
    else
        at_point(t, s, r, lacks, c);
    return rgb_luminance(factored(t, c));
}

void texture_gradient(const struct texture *t, double u, double v,
                      const struct texture_footprint *footprint, struct texture_lacks *lacks,
                      double gradient[2])
{
    gradient[0] = gradient[1] = 0;
    if (t->type == SCENE_TEXTURE_CONSTANT || !is_known(t, lacks))
        return;
    double s, r, side[2][2], step[2] = {SLOPE_STEP, SLOPE_STEP};
    const double(*wide)[2] = NULL;
    map_uv(t, u, v, &s, &r);
    if (t->type == SCENE_TEXTURE_IMAGE) {
        step[0] = 1.0 / t->image->levels[0].width;
        step[1] = 1.0 / t->image->levels[0].height;
    }
    if (is_averaged(t, footprint)) {
        map_footprint(t, footprint, side);
        wide = (const double(*)[2])side;
        for (int k = 0; k < 2; k++) {
            double across = fabs(side[0][k]) + fabs(side[1][k]);
            step[k] = across > step[k] ? across : step[k];
        }
    }
    double right = luminance_at(t, s + step[0] / 2, r, wide, lacks);
    double left = luminance_at(t, s - step[0] / 2, r, wide, lacks);
    double above = luminance_at(t, s, r + step[1] / 2, wide, lacks);
    double below = luminance_at(t, s, r - step[1] / 2, wide, lacks);
    double ds = (right - left) / step[0], dr = (above - below) / step[1];
    const double *m = t->uv_matrix;
    gradient[0] = m[0] * ds + m[3] * dr;
    gradient[1] = m[1] * ds + m[4] * dr;
}
