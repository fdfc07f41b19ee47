#include "client/study_error.h"

#include <math.h>

#include "common/mem.h"

enum { SQUARE = 8 };

#define RELMSE_FLOOR 0.01

static size_t values_of(const struct study_truth *t)
{
    return 3 * (size_t)t->width * t->height;
}

static bool comparable(const struct study_truth *t, const float *rgb, size_t i)
{
    return isfinite(rgb[i]) && t->weight[i] > 0;
}

/* The mean of both; a weight of 0 marks a value that no reference knows. */
static double mean_of_truth(const struct study_truth *t)
{
    double sum = 0;
    size_t finite = 0;
    for (size_t i = 0; i < values_of(t); i++) {
        if (!isfinite(t->a[i]) || !isfinite(t->b[i]))
            continue;
        sum += ((double)t->a[i] + (double)t->b[i]) / 2;
        finite++;
    }
    return finite ? sum / (double)finite : 0;
}

static void weigh(struct study_truth *t)
{
    double mean = mean_of_truth(t), sum = 0;
    size_t used = 0;
    for (size_t i = 0; i < values_of(t); i++) {
        double r = ((double)t->a[i] + (double)t->b[i]) / 2, d = (double)t->a[i] - (double)t->b[i];
        double floor = r * r + RELMSE_FLOOR * mean * mean;
        t->weight[i] = isfinite(r) && floor > 0 ? (float)(1 / floor) : 0;
        if (t->weight[i] > 0) {
            sum += (double)t->weight[i] * d * d / 4;
            used++;
        }
    }
    t->relmse = used ? sum / (double)used : (double)NAN;
}

enum err study_truth_init(struct study_truth *t, uint32_t width, uint32_t height, float *a,
                          float *b)
{
    *t = (struct study_truth){.width = width, .height = height, .a = a, .b = b};
    t->weight = mem_alloc_array(values_of(t), sizeof *t->weight);
    if (!t->weight) {
        study_truth_release(t);
        return ERR_NOMEM;
    }
    weigh(t);
    return ERR_OK;
}

void study_truth_release(struct study_truth *t)
{
    mem_free(t->a);
    mem_free(t->b);
    mem_free(t->weight);
    *t = (struct study_truth){0};
}

double study_truth_relmse(const struct study_truth *t, const float *rgb)
{
    double sum = 0;
    size_t used = 0;
    for (size_t i = 0; i < values_of(t); i++) {
        if (!comparable(t, rgb, i))
            continue;
        double x = (double)rgb[i];
        sum += (double)t->weight[i] * (x - (double)t->a[i]) * (x - (double)t->b[i]);
        used++;
    }
    return used ? sum / (double)used : (double)NAN;
}

static enum err sums_make(struct study_sums *s, size_t values)
{
    if (s->first)
        return ERR_OK;
    s->first = mem_calloc(2 * values, sizeof *s->first);
    if (!s->first)
        return ERR_NOMEM;
    s->second = s->first + values;
    return ERR_OK;
}

enum err study_sums_add(struct study_sums *s, const struct study_truth *t, const float *rgb,
                        double *relmse)
{
    size_t values = values_of(t);
    TL_TRY(sums_make(s, values));
    for (size_t i = 0; i < values; i++) {
        if (!isfinite(rgb[i]))
            s->nonfinite++;
        if (!comparable(t, rgb, i))
            continue;
        /* Around the reference, so that small variances survive the subtraction. */
        double d = (double)rgb[i] - ((double)t->a[i] + (double)t->b[i]) / 2;
        s->first[i] += d;
        s->second[i] += d * d;
    }
    s->count++;
    *relmse = study_truth_relmse(t, rgb);
    return ERR_OK;
}

void study_sums_release(struct study_sums *s)
{
    mem_free(s->first);
    *s = (struct study_sums){0};
}

/* Sums of one value's variance and bias^2, both weighed. */
struct terms {
    double variance, bias2;
    size_t used;
};

static void add_value(const struct study_sums *s, const struct study_truth *t, size_t i,
                      struct terms *out)
{
    if (!(t->weight[i] > 0))
        return;
    double n = s->count, mean = s->first[i] / n;
    double variance = (s->second[i] - n * mean * mean) / (n - 1);
    variance = variance > 0 ? variance : 0;
    double half = ((double)t->a[i] - (double)t->b[i]) / 2, w = (double)t->weight[i];
    /* (x - a)(x - b) around their mean is mean^2 - half^2. */
    out->variance += w * variance;
    out->bias2 += w * (mean * mean - half * half - variance / n);
    out->used++;
}

static struct terms square_terms(const struct study_sums *s, const struct study_truth *t,
                                 uint32_t x0, uint32_t y0)
{
    struct terms sum = {0};
    for (uint32_t y = y0; y < t->height && y < y0 + SQUARE; y++)
        for (uint32_t x = x0; x < t->width && x < x0 + SQUARE; x++)
            for (size_t c = 0; c < 3; c++)
                add_value(s, t, 3 * ((size_t)y * t->width + x) + c, &sum);
    return sum;
}

void study_sums_parts(const struct study_sums *s, const struct study_truth *t,
                      struct study_parts *out)
{
    *out = (struct study_parts){(double)NAN, (double)NAN, (double)NAN};
    if (s->count < 2)
        return;
    struct terms all = {0};
    double squares = 0;
    size_t count = 0;
    for (uint32_t y = 0; y < t->height; y += SQUARE) {
        for (uint32_t x = 0; x < t->width; x += SQUARE) {
            struct terms one = square_terms(s, t, x, y);
            all.variance += one.variance;
            all.bias2 += one.bias2;
            all.used += one.used;
            squares += one.bias2 * one.bias2;
            count++;
        }
    }
    if (all.used == 0)
        return;
    double n = (double)all.used, cells = (double)count;
    out->variance = all.variance / n;
    out->bias2 = all.bias2 / n;
    if (count >= 2)
        out->bias2_se =
            sqrt(cells / (cells - 1) * fmax(0, squares - all.bias2 * all.bias2 / cells)) / n;
}
