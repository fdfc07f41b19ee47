#include "common/pyramid.h"

#include "common/mem.h"
#include "common/texel.h"

/* --- Pieces ---------------------------------------------------------------- */

bool pyramid_can_be_pieces(const struct scene_image *image)
{
    uint32_t rest = (1u << PYRAMID_PIECE_LEVELS) - 1;
    return image->width > 0 && image->height > 0 && !(image->width & rest) &&
           !(image->height & rest);
}

uint32_t pyramid_pieces_across(const struct scene_image *image)
{
    return (image->width + PYRAMID_PIECE_SIDE - 1) >> PYRAMID_PIECE_SHIFT;
}

uint32_t pyramid_pieces_down(const struct scene_image *image)
{
    return (image->height + PYRAMID_PIECE_SIDE - 1) >> PYRAMID_PIECE_SHIFT;
}

struct scene_image pyramid_piece_at(const struct scene_image *image, uint32_t x, uint32_t y,
                                    uint32_t *left, uint32_t *top)
{
    struct scene_image piece = *image;
    *left = x << PYRAMID_PIECE_SHIFT;
    *top = y << PYRAMID_PIECE_SHIFT;
    piece.pixels = NULL;
    piece.width =
        image->width - *left < PYRAMID_PIECE_SIDE ? image->width - *left : PYRAMID_PIECE_SIDE;
    piece.height =
        image->height - *top < PYRAMID_PIECE_SIDE ? image->height - *top : PYRAMID_PIECE_SIDE;
    return piece;
}

/* --- Rounding -------------------------------------------------------------- */

/* The code whose light is nearest, the lower of two. */
static unsigned char srgb_code(double light)
{
    unsigned low = 0, high = 255;
    while (low < high) {
        unsigned middle = (low + high) / 2;
        if (light - srgb_table[middle] <= srgb_table[middle + 1] - light)
            high = middle;
        else
            low = middle + 1;
    }
    return (unsigned char)low;
}

void pyramid_round(enum scene_image_format format, uint32_t channel_count, const float *linear,
                   void *texels, size_t place)
{
    for (uint32_t k = 0; k < channel_count; k++) {
        double v = (double)linear[k];
        unsigned char *byte = (unsigned char *)texels + place * channel_count + k;
        if (format == SCENE_IMAGE_F32)
            ((float *)texels)[place * channel_count + k] = linear[k];
        else if (format == SCENE_IMAGE_U8_SRGB && k < 3)
            *byte = srgb_code(v);
        else
            *byte = (unsigned char)(v * 255 + 0.5);
    }
}

/* --- Averages -------------------------------------------------------------- */

/* What of a row or column of `from` falls into place i of `to` < from: at most three neighbours,
 * by the share of each that lies in it. Every sample is shared out whole, so means stay. */
struct share {
    uint32_t first, count;
    double weight[3];
};

static struct share share_of(uint32_t i, uint32_t from, uint32_t to)
{
    if (from == to)
        return (struct share){i, 1, {1}};
    struct share s = {.first = 2 * i, .count = 2, .weight = {0.5, 0.5}};
    if (from % 2 == 0)
        return s;
    s.count = 3;
    s.weight[0] = (double)(to - i) / from;
    s.weight[1] = (double)to / from;
    s.weight[2] = (double)(i + 1) / from;
    return s;
}

/* Where a level comes from: the picture itself, or floats. */
struct source {
    uint32_t width, height, channel_count;
    const struct scene_image *picture; /* NULL: floats */
    const float *samples;
};

static void source_sample(const struct source *s, uint32_t x, uint32_t y, double c[4])
{
    size_t place = (size_t)y * s->width + x;
    texel_get(s->picture ? s->picture->format : SCENE_IMAGE_F32, s->channel_count,
              s->picture ? s->picture->pixels : s->samples, place, c);
}

static void average(const struct source *from, struct share across, struct share down, bool weighed,
                    float *out)
{
    double plain[4] = {0}, seen[3] = {0}, opacity = 0, whole = 0;
    for (uint32_t j = 0; j < down.count; j++) {
        for (uint32_t i = 0; i < across.count; i++) {
            double c[4] = {0}, w = across.weight[i] * down.weight[j];
            source_sample(from, across.first + i, down.first + j, c);
            for (int k = 0; k < 4; k++)
                plain[k] += c[k] * w;
            for (int k = 0; k < 3; k++)
                seen[k] += c[k] * w * c[3];
            opacity += w * c[3];
            whole += w;
        }
    }
    /* All opaque is the plain mean, bit for bit. */
    bool by_opacity = weighed && opacity > 0 && opacity < whole;
    for (uint32_t k = 0; k < from->channel_count; k++)
        out[k] = (float)(by_opacity && k < 3 ? seen[k] / opacity : plain[k]);
}

/* The plain mean of two by two, the sum in the order of average(). */
static double mean_of(double a, double b, double c, double d)
{
    return (((0 + a * 0.25) + b * 0.25) + c * 0.25) + d * 0.25;
}

/* A row where both sides are even and nothing is weighed: the same numbers by shorter ways. */
static void quarter_floats(const struct source *from, uint32_t y, uint32_t width, float *out)
{
    size_t n = from->channel_count, row = from->width * n;
    const float *p = from->samples + 2 * y * row;
    for (uint32_t x = 0; x < width; x++, p += 2 * n)
        for (size_t k = 0; k < n; k++)
            *out++ = (float)mean_of((double)p[k], (double)p[k + n], (double)p[k + row],
                                    (double)p[k + row + n]);
}

static void quarter_bytes(const struct source *from, const double *const light[4], uint32_t y,
                          uint32_t width, float *out)
{
    size_t n = from->channel_count, row = from->width * n;
    const unsigned char *p = (const unsigned char *)from->picture->pixels + 2 * y * row;
    for (uint32_t x = 0; x < width; x++, p += 2 * n)
        for (size_t k = 0; k < n; k++)
            *out++ = (float)mean_of(light[k][p[k]], light[k][p[k + n]], light[k][p[k + row]],
                                    light[k][p[k + row + n]]);
}

static void quarter(const struct source *from, uint32_t width, uint32_t height, float *out)
{
    double plain[256];
    const double *light[4];
    bool curved = from->picture && from->picture->format == SCENE_IMAGE_U8_SRGB;
    bool bytes = from->picture && from->picture->format != SCENE_IMAGE_F32;
    struct source floats = *from;
    if (from->picture && !bytes)
        floats.samples = from->picture->pixels;
    for (int i = 0; i < 256; i++)
        plain[i] = i / 255.0;
    for (int k = 0; k < 4; k++)
        light[k] = curved && k < 3 ? srgb_table : plain;
    for (uint32_t y = 0; y < height; y++, out += (size_t)width * from->channel_count) {
        if (bytes)
            quarter_bytes(from, light, y, width, out);
        else
            quarter_floats(&floats, y, width, out);
    }
}

static enum err level_above(const struct source *from, bool weighed, struct pyramid_level *out)
{
    uint32_t width = pyramid_half(from->width), height = pyramid_half(from->height);
    uint32_t channels = from->channel_count;
    *out = (struct pyramid_level){width, height, channels, NULL};
    out->samples = mem_alloc_array((size_t)width * height * channels, sizeof(float));
    if (!out->samples)
        return ERR_NOMEM;
    if (from->width % 2 == 0 && from->height % 2 == 0 && (!weighed || channels < 4)) {
        quarter(from, width, height, out->samples);
        return ERR_OK;
    }
    float *at = out->samples;
    for (uint32_t y = 0; y < height; y++) {
        struct share down = share_of(y, from->height, height);
        for (uint32_t x = 0; x < width; x++, at += channels)
            average(from, share_of(x, from->width, width), down, weighed, at);
    }
    return ERR_OK;
}

enum err pyramid_first(const struct scene_image *picture, bool weighed, struct pyramid_level *out)
{
    struct source from = {.width = picture->width,
                          .height = picture->height,
                          .channel_count = picture->channel_count,
                          .picture = picture};
    return level_above(&from, weighed, out);
}

enum err pyramid_next(const struct pyramid_level *below, bool weighed, struct pyramid_level *out)
{
    struct source from = {.width = below->width,
                          .height = below->height,
                          .channel_count = below->channel_count,
                          .samples = below->samples};
    return level_above(&from, weighed, out);
}
