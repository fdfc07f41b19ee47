#include "client/metrics.h"

#include <math.h>
#include <string.h>

#include "common/dmath.h"
#include "common/mem.h"

enum { SSIM_RADIUS = 5 };

#define SSIM_SIGMA   1.5
#define TRIM_SHARE   0.001
#define RELMSE_FLOOR 0.01

static double mean_of_reference(const float *r, size_t count)
{
    double sum = 0;
    size_t finite = 0;
    for (size_t i = 0; i < count; i++) {
        if (isfinite(r[i])) {
            sum += (double)r[i];
            finite++;
        }
    }
    return finite ? sum / (double)finite : 0;
}

/* 0 for equal values even where both are black. */
static double relative_square(double x, double r, double mean)
{
    double d = x - r;
    return d == 0 ? 0 : d * d / (r * r + RELMSE_FLOOR * mean * mean);
}

void metrics_error_map(const float *x, const float *r, uint32_t width, uint32_t height, double *out)
{
    size_t pixels = (size_t)width * height;
    double mean = mean_of_reference(r, 3 * pixels);
    for (size_t i = 0; i < pixels; i++) {
        double sum = 0;
        for (size_t k = 3 * i; k < 3 * i + 3; k++)
            sum += isfinite(x[k]) && isfinite(r[k])
                       ? relative_square((double)x[k], (double)r[k], mean)
                       : (double)NAN;
        out[i] = sum / 3;
    }
}

/* The sum of all but the `drop` largest of `v`, whose order changes: quickselect. */
static double sum_without_largest(double *v, size_t count, size_t drop)
{
    size_t low = 0, high = count, keep = count - drop;
    while (high - low > 1 && drop > 0) {
        double pivot = v[low + (high - low) / 2];
        size_t less = low, same = low, more = high;
        while (same < more) {
            double value = v[same];
            if (value < pivot) {
                v[same++] = v[less];
                v[less++] = value;
            } else if (value > pivot) {
                v[same] = v[--more];
                v[more] = value;
            } else {
                same++;
            }
        }
        if (keep < less)
            high = less;
        else if (keep >= more)
            low = more;
        else
            break;
    }
    double sum = 0;
    for (size_t i = 0; i < keep; i++)
        sum += v[i];
    return sum;
}

static enum err trimmed(const float *x, const float *r, uint32_t width, uint32_t height,
                        double *out)
{
    size_t pixels = (size_t)width * height, finite = 0;
    double *errors = mem_alloc_array(pixels, sizeof *errors);
    if (!errors)
        return ERR_NOMEM;
    metrics_error_map(x, r, width, height, errors);
    for (size_t i = 0; i < pixels; i++)
        if (!isnan(errors[i]))
            errors[finite++] = errors[i];
    size_t drop = (size_t)((double)finite * TRIM_SHARE);
    *out = finite > drop ? sum_without_largest(errors, finite, drop) / (double)(finite - drop)
                         : (double)NAN;
    mem_free(errors);
    return ERR_OK;
}

static double display_of(float v)
{
    double clamped = !(v > 0) ? 0 : v > 1 ? 1 : (double)v;
    return dmath_srgb_encode(clamped);
}

static void sums(const float *x, const float *r, uint32_t width, size_t values, struct metrics *out)
{
    double square = 0, relative = 0, percentage = 0, display = 0, sum_x = 0, sum_r = 0;
    double mean = mean_of_reference(r, values);
    out->max_difference = (double)NAN;
    for (size_t i = 0; i < values; i++) {
        out->nonfinite_x += isfinite(x[i]) ? 0 : 1;
        out->nonfinite_r += isfinite(r[i]) ? 0 : 1;
        if (!isfinite(x[i]) || !isfinite(r[i]))
            continue;
        double xi = (double)x[i], ri = (double)r[i], d = xi - ri;
        double shown = display_of(x[i]) - display_of(r[i]);
        square += d * d;
        relative += relative_square(xi, ri, mean);
        percentage += d == 0 ? 0 : fabs(d) / (fabs(ri) + RELMSE_FLOOR * fabs(mean));
        display += shown * shown;
        sum_x += xi;
        sum_r += ri;
        out->values++;
        if (!(fabs(d) <= out->max_difference)) {
            out->max_difference = fabs(d);
            out->max_x = (uint32_t)(i / 3 % width);
            out->max_y = (uint32_t)(i / 3 / width);
        }
    }
    double n = (double)out->values;
    out->rmse = sqrt(square / n);
    out->relmse = relative / n;
    out->mape = percentage / n;
    out->psnr = 10 * log10(1 / (display / n));
    out->mean_x = sum_x / n;
    out->mean_r = sum_r / n;
}

/* --- SSIM --------------------------------------------------------------- */

/* Luma of the display values; values that are not finite count as black. */
static void luma_of(const float *rgb, size_t pixels, float *out)
{
    for (size_t i = 0; i < pixels; i++)
        out[i] = (float)(0.2126 * display_of(rgb[3 * i]) + 0.7152 * display_of(rgb[3 * i + 1]) +
                         0.0722 * display_of(rgb[3 * i + 2]));
}

static void blur_line(const float *in, ptrdiff_t stride, uint32_t count, const float *kernel,
                      float *out)
{
    for (uint32_t i = 0; i < count; i++) {
        float sum = 0;
        for (int k = -SSIM_RADIUS; k <= SSIM_RADIUS; k++) {
            int64_t at = (int64_t)i + k;
            at = at < 0 ? 0 : at >= (int64_t)count ? (int64_t)count - 1 : at;
            sum += kernel[k + SSIM_RADIUS] * in[at * stride];
        }
        out[i] = sum;
    }
}

/* In place; `line` holds one row or column. */
static void blur(float *plane, uint32_t width, uint32_t height, const float *kernel, float *line)
{
    for (uint32_t y = 0; y < height; y++) {
        blur_line(plane + (size_t)y * width, 1, width, kernel, line);
        memcpy(plane + (size_t)y * width, line, width * sizeof *line);
    }
    for (uint32_t x = 0; x < width; x++) {
        blur_line(plane + x, (ptrdiff_t)width, height, kernel, line);
        for (uint32_t y = 0; y < height; y++)
            plane[(size_t)y * width + x] = line[y];
    }
}

static void gaussian(float kernel[2 * SSIM_RADIUS + 1])
{
    double sum = 0;
    for (int k = -SSIM_RADIUS; k <= SSIM_RADIUS; k++)
        sum += exp(-k * k / (2 * SSIM_SIGMA * SSIM_SIGMA));
    for (int k = -SSIM_RADIUS; k <= SSIM_RADIUS; k++)
        kernel[k + SSIM_RADIUS] = (float)(exp(-k * k / (2 * SSIM_SIGMA * SSIM_SIGMA)) / sum);
}

static double ssim_mean(float *const planes[5], size_t pixels)
{
    static const double c1 = 0.01 * 0.01, c2 = 0.03 * 0.03;
    double sum = 0;
    for (size_t i = 0; i < pixels; i++) {
        double mx = (double)planes[0][i], mr = (double)planes[1][i];
        double vx = (double)planes[2][i] - mx * mx, vr = (double)planes[3][i] - mr * mr;
        double cov = (double)planes[4][i] - mx * mr;
        sum += (2 * mx * mr + c1) * (2 * cov + c2) / ((mx * mx + mr * mr + c1) * (vx + vr + c2));
    }
    return sum / (double)pixels;
}

static enum err ssim(const float *x, const float *r, uint32_t width, uint32_t height, double *out)
{
    size_t pixels = (size_t)width * height, side = width > height ? width : height;
    float kernel[2 * SSIM_RADIUS + 1];
    float *memory = mem_alloc_array(5 * pixels + side, sizeof *memory);
    if (!memory)
        return ERR_NOMEM;
    float *planes[5];
    for (size_t p = 0; p < 5; p++)
        planes[p] = memory + p * pixels;
    luma_of(x, pixels, planes[0]);
    luma_of(r, pixels, planes[1]);
    for (size_t i = 0; i < pixels; i++) {
        planes[2][i] = planes[0][i] * planes[0][i];
        planes[3][i] = planes[1][i] * planes[1][i];
        planes[4][i] = planes[0][i] * planes[1][i];
    }
    gaussian(kernel);
    for (size_t p = 0; p < 5; p++)
        blur(planes[p], width, height, kernel, memory + 5 * pixels);
    *out = ssim_mean(planes, pixels);
    mem_free(memory);
    return ERR_OK;
}

enum err metrics_compare(const float *x, const float *r, uint32_t width, uint32_t height,
                         struct metrics *out)
{
    size_t values = 3 * (size_t)width * height;
    struct metrics m = {0};
    m.identical = memcmp(x, r, values * sizeof *x) == 0;
    sums(x, r, width, values, &m);
    TL_TRY(trimmed(x, r, width, height, &m.relmse_trimmed));
    TL_TRY(ssim(x, r, width, height, &m.ssim));
    *out = m;
    return ERR_OK;
}

void metrics_heat(double error, unsigned char rgb[3])
{
    /* Stops of a scale whose brightness rises evenly: dark blue, violet, red, orange, yellow. */
    static const double stops[5][3] = {
        {10, 10, 60}, {100, 20, 130}, {200, 50, 70}, {245, 140, 20}, {255, 250, 120}};
    if (isnan(error)) {
        memset(rgb, 255, 3);
        return;
    }
    double t = error <= 0.001 ? 0 : error >= 1 ? 1 : (log10(error) + 3) / 3;
    int i = t >= 1 ? 3 : (int)(t * 4);
    double f = t * 4 - i;
    for (int c = 0; c < 3; c++)
        rgb[c] = (unsigned char)(stops[i][c] + f * (stops[i + 1][c] - stops[i][c]) + 0.5);
}
