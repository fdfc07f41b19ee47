#include "client/flip.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"

/* Constants of the papers. */
#define PIXELS_PER_DEGREE 67.02064
#define COLOR_EXPONENT    0.7
#define COLOR_KNEE        0.4  /* share of the largest colour difference ... */
#define COLOR_KNEE_ERROR  0.95 /* ... that is mapped here */
#define FEATURE_WIDTH     0.082
#define FEATURE_EXPONENT  0.5
#define ACES_TARGET       0.85 /* brightest and median value after tone mapping */

enum { RADIUS_MAX = 16, TAPS_MAX = 2 * RADIUS_MAX + 1, EXPOSURES_MAX = 60 };

static const double aces[6] = {0.6 * 0.6 * 2.51, 0.6 * 0.03, 0, 0.6 * 0.6 * 2.43, 0.6 * 0.59, 0.14};
static const double white[3] = {0.950428545, 1.0, 1.088900371};

struct kernel {
    int radius;
    float taps[TAPS_MAX];
};

/* Kernels and scratch planes of one comparison. */
struct work {
    uint32_t width, height;
    size_t pixels;
    struct kernel csf[4];              /* luminance, red-green, blue-yellow twice */
    double mix[2];                     /* of the two blue-yellow ones */
    struct kernel smooth, slope, bend; /* feature detectors: Gaussian and its derivatives */
    double color_max;                  /* green against blue */
    float *memory;
    float *color[2];      /* 3 planes each: Lab after Hunt */
    float *luma[2];       /* normalised Y */
    float *planes[3];     /* YCxCz of one picture */
    float *feature[2][2]; /* edges and points of each picture */
    float *scratch[3];
    float *largest; /* error over all exposures */
};

/* --- Colour spaces ------------------------------------------------------ */

static void xyz_of_rgb(const double rgb[3], double xyz[3])
{
    static const double m[9] = {10135552.0 / 24577794, 8788810.0 / 24577794, 4435075.0 / 24577794,
                                2613072.0 / 12288897,  8788810.0 / 12288897, 887015.0 / 12288897,
                                1425312.0 / 73733382,  8788810.0 / 73733382, 70074185.0 / 73733382};
    for (int i = 0; i < 3; i++)
        xyz[i] = m[3 * i] * rgb[0] + m[3 * i + 1] * rgb[1] + m[3 * i + 2] * rgb[2];
}

static void rgb_of_xyz(const double xyz[3], double rgb[3])
{
    static const double m[9] = {3.241003275, -1.537398934, -0.498615861, -0.969224334, 1.875930071,
                                0.041554224, 0.055639423,  -0.204011202, 1.057148933};
    for (int i = 0; i < 3; i++)
        rgb[i] = m[3 * i] * xyz[0] + m[3 * i + 1] * xyz[1] + m[3 * i + 2] * xyz[2];
}

static void opponent_of_rgb(const double rgb[3], double out[3])
{
    double xyz[3];
    xyz_of_rgb(rgb, xyz);
    for (int i = 0; i < 3; i++)
        xyz[i] /= white[i];
    out[0] = 116 * xyz[1] - 16;
    out[1] = 500 * (xyz[0] - xyz[1]);
    out[2] = 200 * (xyz[1] - xyz[2]);
}

static double clamp01(double v)
{
    return v < 0 ? 0 : v > 1 ? 1 : v;
}

static double lab_curve(double t)
{
    static const double delta = 6.0 / 29;
    return t > delta * delta * delta ? cbrt(t) : t / (3 * delta * delta) + 4.0 / 29;
}

/* Linear RGB to CIELab with chroma scaled by lightness (Hunt effect). */
static void hunt_lab_of_rgb(const double rgb[3], double lab[3])
{
    double xyz[3], f[3];
    xyz_of_rgb(rgb, xyz);
    for (int i = 0; i < 3; i++)
        f[i] = lab_curve(xyz[i] / white[i]);
    lab[0] = 116 * f[1] - 16;
    lab[1] = 500 * (f[0] - f[1]) * 0.01 * lab[0];
    lab[2] = 200 * (f[1] - f[2]) * 0.01 * lab[0];
}

/* After the eye's blur: back to RGB, into its gamut, to Lab. */
static void hunt_lab_of_opponent(const double opponent[3], double lab[3])
{
    double xyz[3], rgb[3];
    double y = (opponent[0] + 16) / 116;
    xyz[0] = (y + opponent[1] / 500) * white[0];
    xyz[1] = y * white[1];
    xyz[2] = (y - opponent[2] / 200) * white[2];
    rgb_of_xyz(xyz, rgb);
    for (int i = 0; i < 3; i++)
        rgb[i] = clamp01(rgb[i]);
    hunt_lab_of_rgb(rgb, lab);
}

static double hyab(const double a[3], const double b[3])
{
    double d1 = a[1] - b[1], d2 = a[2] - b[2];
    return fabs(a[0] - b[0]) + sqrt(d1 * d1 + d2 * d2);
}

/* --- Kernels ------------------------------------------------------------ */

static double gaussian_sum(struct kernel *k, double exponent_of_square)
{
    double sum = 0;
    for (int i = -k->radius; i <= k->radius; i++) {
        double v = exp(-exponent_of_square * i * i);
        k->taps[i + k->radius] = (float)v;
        sum += v;
    }
    return sum;
}

static void normalise(struct kernel *k, double sum)
{
    for (int i = 0; i <= 2 * k->radius; i++)
        k->taps[i] = (float)((double)k->taps[i] / sum);
}

/* Contrast sensitivity as sums of Gaussians: a * sqrt(pi / b) * exp(-pi^2 x^2 / b), x in degrees.
 */
static void make_csf(struct work *w)
{
    static const double a[4] = {1, 1, 34.1, 13.5}, b[4] = {0.0047, 0.0053, 0.04, 0.025};
    double weights[4];
    int radius = (int)ceil(3 * sqrt(0.04 / (2 * M_PI * M_PI)) * PIXELS_PER_DEGREE);
    for (int i = 0; i < 4; i++) {
        w->csf[i].radius = radius;
        double sum =
            gaussian_sum(&w->csf[i], M_PI * M_PI / (b[i] * PIXELS_PER_DEGREE * PIXELS_PER_DEGREE));
        normalise(&w->csf[i], sum);
        weights[i] = a[i] * sqrt(M_PI / b[i]) * sum * sum;
    }
    w->mix[0] = weights[2] / (weights[2] + weights[3]);
    w->mix[1] = 1 - w->mix[0];
}

/* Positive taps sum to 1 and negative ones to -1. */
static void normalise_signed(struct kernel *k)
{
    double positive = 0, negative = 0;
    for (int i = 0; i <= 2 * k->radius; i++) {
        positive += k->taps[i] > 0 ? (double)k->taps[i] : 0;
        negative -= k->taps[i] < 0 ? (double)k->taps[i] : 0;
    }
    for (int i = 0; i <= 2 * k->radius; i++)
        k->taps[i] = (float)((double)k->taps[i] / (k->taps[i] > 0 ? positive : negative));
}

static void make_features(struct work *w)
{
    double sigma = 0.5 * FEATURE_WIDTH * PIXELS_PER_DEGREE;
    int radius = (int)ceil(3 * sigma);
    w->smooth.radius = w->slope.radius = w->bend.radius = radius;
    double sum = gaussian_sum(&w->smooth, 1 / (2 * sigma * sigma));
    for (int i = -radius; i <= radius; i++) {
        double g = (double)w->smooth.taps[i + radius];
        w->slope.taps[i + radius] = (float)(-i * g);
        w->bend.taps[i + radius] = (float)((i * i / (sigma * sigma) - 1) * g);
    }
    normalise(&w->smooth, sum);
    normalise_signed(&w->slope);
    normalise_signed(&w->bend);
}

/* --- Convolution, borders repeated --------------------------------------- */

static size_t at_border(int64_t i, size_t count)
{
    return i < 0 ? 0 : (size_t)i >= count ? count - 1 : (size_t)i;
}

static void convolve_rows(const struct work *w, const float *in, const struct kernel *k, float *out)
{
    for (size_t y = 0; y < w->height; y++) {
        const float *row = in + y * w->width;
        for (size_t x = 0; x < w->width; x++) {
            float sum = 0;
            for (int i = -k->radius; i <= k->radius; i++)
                sum += k->taps[i + k->radius] * row[at_border((int64_t)x + i, w->width)];
            out[y * w->width + x] = sum;
        }
    }
}

/* Row by row, so that memory is read in order. */
static void convolve_columns(const struct work *w, const float *in, const struct kernel *k,
                             float *out)
{
    for (size_t y = 0; y < w->height; y++) {
        float *to = out + y * w->width;
        memset(to, 0, w->width * sizeof *to);
        for (int i = -k->radius; i <= k->radius; i++) {
            const float *row = in + at_border((int64_t)y + i, w->height) * w->width;
            float tap = k->taps[i + k->radius];
            for (size_t x = 0; x < w->width; x++)
                to[x] += tap * row[x];
        }
    }
}

static void blur_plane(struct work *w, const float *in, const struct kernel *k, float *out)
{
    convolve_rows(w, in, k, w->scratch[0]);
    convolve_columns(w, w->scratch[0], k, out);
}

/* --- One picture at one exposure ----------------------------------------- */

static double tone_map(float v, double gain)
{
    double x = isfinite(v) && v > 0 ? (double)v * gain : 0;
    return clamp01((aces[0] * x * x + aces[1] * x + aces[2]) /
                   (aces[3] * x * x + aces[4] * x + aces[5]));
}

static void split_planes(struct work *w, const float *rgb, double gain, float *luma)
{
    for (size_t i = 0; i < w->pixels; i++) {
        double mapped[3], opponent[3];
        for (int c = 0; c < 3; c++)
            mapped[c] = tone_map(rgb[3 * i + (size_t)c], gain);
        opponent_of_rgb(mapped, opponent);
        for (int c = 0; c < 3; c++)
            w->planes[c][i] = (float)opponent[c];
        luma[i] = (float)((opponent[0] + 16) / 116);
    }
}

static void see_color(struct work *w, float *color)
{
    blur_plane(w, w->planes[2], &w->csf[3], w->scratch[1]);
    blur_plane(w, w->planes[2], &w->csf[2], w->scratch[2]);
    for (size_t i = 0; i < w->pixels; i++)
        w->planes[2][i] =
            (float)(w->mix[0] * (double)w->scratch[2][i] + w->mix[1] * (double)w->scratch[1][i]);
    for (int c = 0; c < 2; c++) {
        blur_plane(w, w->planes[c], &w->csf[c], w->scratch[1]);
        memcpy(w->planes[c], w->scratch[1], w->pixels * sizeof(float));
    }
    for (size_t i = 0; i < w->pixels; i++) {
        double lab[3], opponent[3];
        for (int c = 0; c < 3; c++)
            opponent[c] = (double)w->planes[c][i];
        hunt_lab_of_opponent(opponent, lab);
        for (size_t c = 0; c < 3; c++)
            color[c * w->pixels + i] = (float)lab[c];
    }
}

/* Length of a detector's answer across and along. */
static void see_feature(struct work *w, const float *luma, const struct kernel *detector,
                        float *out)
{
    convolve_rows(w, luma, detector, w->scratch[0]);
    convolve_columns(w, w->scratch[0], &w->smooth, w->scratch[1]);
    convolve_rows(w, luma, &w->smooth, w->scratch[0]);
    convolve_columns(w, w->scratch[0], detector, w->scratch[2]);
    for (size_t i = 0; i < w->pixels; i++)
        out[i] = sqrtf(w->scratch[1][i] * w->scratch[1][i] + w->scratch[2][i] * w->scratch[2][i]);
}

static void see(struct work *w, const float *rgb, double gain, int picture)
{
    split_planes(w, rgb, gain, w->luma[picture]);
    see_color(w, w->color[picture]);
    see_feature(w, w->luma[picture], &w->slope, w->feature[picture][0]);
    see_feature(w, w->luma[picture], &w->bend, w->feature[picture][1]);
}

/* --- The difference ------------------------------------------------------ */

static double color_error(const struct work *w, size_t i)
{
    double lab[2][3];
    for (int p = 0; p < 2; p++)
        for (size_t c = 0; c < 3; c++)
            lab[p][c] = (double)w->color[p][c * w->pixels + i];
    double d = pow(hyab(lab[0], lab[1]), COLOR_EXPONENT), knee = COLOR_KNEE * w->color_max;
    if (d < knee)
        return d * COLOR_KNEE_ERROR / knee;
    return COLOR_KNEE_ERROR + (d - knee) / (w->color_max - knee) * (1 - COLOR_KNEE_ERROR);
}

static double feature_error(const struct work *w, size_t i)
{
    double edge = fabs((double)w->feature[0][0][i] - (double)w->feature[1][0][i]);
    double point = fabs((double)w->feature[0][1][i] - (double)w->feature[1][1][i]);
    return pow((edge > point ? edge : point) / sqrt(2), FEATURE_EXPONENT);
}

static void take_exposure(struct work *w, const float *test, const float *reference, double stops)
{
    double gain = exp2(stops);
    see(w, reference, gain, 0);
    see(w, test, gain, 1);
    for (size_t i = 0; i < w->pixels; i++) {
        float error = (float)clamp01(pow(color_error(w, i), 1 - clamp01(feature_error(w, i))));
        if (error > w->largest[i])
            w->largest[i] = error;
    }
}

static int by_value(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

/* Of sorted values, between the two nearest. */
static double percentile(const float *sorted, size_t count, double share)
{
    double at = share * (double)(count - 1);
    size_t low = (size_t)at, high = low + 1 < count ? low + 1 : low;
    return (double)sorted[low] + (at - (double)low) * (double)(sorted[high] - sorted[low]);
}

/* From where the brightest value of the reference to where its median reaches the target. */
static void choose_exposures(struct work *w, const float *reference, struct flip *out)
{
    float *luminance = w->scratch[0];
    for (size_t i = 0; i < w->pixels; i++) {
        double rgb[3], xyz[3];
        for (size_t c = 0; c < 3; c++) {
            float v = reference[3 * i + c];
            rgb[c] = isfinite(v) && v > 0 ? (double)v : 0;
        }
        xyz_of_rgb(rgb, xyz);
        luminance[i] = (float)xyz[1];
    }
    qsort(luminance, w->pixels, sizeof *luminance, by_value);
    double a = aces[0] - ACES_TARGET * aces[3], b = aces[1] - ACES_TARGET * aces[4];
    double c = aces[2] - ACES_TARGET * aces[5];
    double target = (-b + sqrt(b * b - 4 * a * c)) / (2 * a);
    double top = (double)luminance[w->pixels - 1];
    /* Of an even number the upper one, as the authors' program has it: in a picture of two tones
     * the other choice asks for another exposure. */
    double median = (double)luminance[w->pixels / 2];
    out->exposure_start = log2(target / (top > 1e-4 ? top : 1e-4));
    out->exposure_stop = log2(target / (median > 1e-4 ? median : 1e-4));
    double span = ceil(out->exposure_stop - out->exposure_start);
    out->exposure_count = span < 2 ? 2 : span > EXPOSURES_MAX ? EXPOSURES_MAX : (uint32_t)span;
}

static enum err work_init(struct work *w, uint32_t width, uint32_t height)
{
    static const double green[3] = {0, 1, 0}, blue[3] = {0, 0, 1};
    enum { PLANES = 6 + 2 + 3 + 4 + 3 + 1 };
    double lab[2][3];
    *w = (struct work){.width = width, .height = height, .pixels = (size_t)width * height};
    w->memory = mem_calloc(w->pixels, PLANES * sizeof *w->memory);
    if (!w->memory)
        return ERR_NOMEM;
    float *next = w->memory;
    float **targets[] = {&w->luma[0],       &w->luma[1],       &w->planes[0],     &w->planes[1],
                         &w->planes[2],     &w->feature[0][0], &w->feature[0][1], &w->feature[1][0],
                         &w->feature[1][1], &w->scratch[0],    &w->scratch[1],    &w->scratch[2],
                         &w->largest};
    for (size_t i = 0; i < sizeof targets / sizeof *targets; i++, next += w->pixels)
        *targets[i] = next;
    w->color[0] = next;
    w->color[1] = next + 3 * w->pixels;
    make_csf(w);
    make_features(w);
    hunt_lab_of_rgb(green, lab[0]);
    hunt_lab_of_rgb(blue, lab[1]);
    w->color_max = pow(hyab(lab[0], lab[1]), COLOR_EXPONENT);
    return ERR_OK;
}

enum err flip_compare(const float *test, const float *reference, uint32_t width, uint32_t height,
                      struct flip *out)
{
    struct work w;
    TL_TRY(work_init(&w, width, height));
    struct flip f = {0};
    choose_exposures(&w, reference, &f);
    for (uint32_t i = 0; i < f.exposure_count; i++)
        take_exposure(&w, test, reference,
                      f.exposure_start + (f.exposure_stop - f.exposure_start) * i /
                                             (double)(f.exposure_count - 1));
    double sum = 0;
    for (size_t i = 0; i < w.pixels; i++)
        sum += (double)w.largest[i];
    f.mean = sum / (double)w.pixels;
    qsort(w.largest, w.pixels, sizeof *w.largest, by_value);
    f.p95 = percentile(w.largest, w.pixels, 0.95);
    mem_free(w.memory);
    *out = f;
    return ERR_OK;
}
