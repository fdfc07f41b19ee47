#include "worker/render/film_filter.h"

#include <math.h>

#include "common/dmath.h"

static double mitchell(double b, double c, double x)
{
    double x2 = x * x, x3 = x2 * x;
    if (x < 1)
        return ((12 - 9 * b - 6 * c) * x3 + (-18 + 12 * b + 6 * c) * x2 + (6 - 2 * b)) / 6;
    return ((-b - 6 * c) * x3 + (6 * b + 30 * c) * x2 + (-12 * b - 48 * c) * x + (8 * b + 24 * c)) /
           6;
}

double film_filter_value(const struct film_filter *f, double x)
{
    x = fabs(x);
    if (x > f->radius)
        return 0;
    switch (f->type) {
    case JOB_FILTER_TENT:
        return 1 - x / f->radius;
    case JOB_FILTER_GAUSSIAN: {
        double v = dmath_exp(-f->alpha * x * x) - dmath_exp(-f->alpha * f->radius * f->radius);
        return v > 0 ? v : 0;
    }
    case JOB_FILTER_MITCHELL:
        return mitchell(f->b, f->c, 2 * x / f->radius);
    case JOB_FILTER_BLACKMAN_HARRIS: {
        double t = 0.5 + 0.5 * x / f->radius;
        return 0.35875 - 0.48829 * dmath_cospi(2 * t) + 0.14128 * dmath_cospi(4 * t) -
               0.01168 * dmath_cospi(6 * t);
    }
    default:
        return 1;
    }
}

/* The tabulated filters are drawn from a step function of this many steps over their width. */
static double bin_edge(const struct film_filter *f, int bin)
{
    return f->radius * (2.0 * bin / FILM_FILTER_BINS - 1);
}

void film_filter_init(struct film_filter *f, const struct job_spec *spec)
{
    enum { FINE = 16 };
    *f = (struct film_filter){.type = spec->filter,
                              .radius = spec->filter_radius,
                              .alpha = spec->filter_alpha,
                              .b = spec->filter_b,
                              .c = spec->filter_c};
    double width = 2 * f->radius / FILM_FILTER_BINS;
    double magnitude_sum = 0, integral = 0;
    for (int i = 0; i < FILM_FILTER_BINS; i++) {
        double magnitude = 0;
        for (int k = 0; k < FINE; k++) {
            double v = film_filter_value(f, bin_edge(f, i) + width * ((k + 0.5) / FINE));
            magnitude += fabs(v) / FINE;
            integral += v * (width / FINE);
        }
        f->cdf[i] = magnitude_sum;
        magnitude_sum += magnitude;
    }
    /* A filter that is zero everywhere, or nothing on the whole, has no shape to draw from. */
    if (!(magnitude_sum > 0) || !(fabs(integral) > 0)) {
        f->type = JOB_FILTER_BOX;
        return;
    }
    for (int i = 0; i < FILM_FILTER_BINS; i++)
        f->cdf[i] /= magnitude_sum;
    f->cdf[FILM_FILTER_BINS] = 1;
    f->integral = integral;
}

static double sample_table(const struct film_filter *f, double u, double *weight)
{
    int low = 0, high = FILM_FILTER_BINS;
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (f->cdf[middle] <= u)
            low = middle;
        else
            high = middle;
    }
    double mass = f->cdf[low + 1] - f->cdf[low];
    double width = 2 * f->radius / FILM_FILTER_BINS;
    double x = bin_edge(f, low) + width * ((u - f->cdf[low]) / mass);
    *weight = film_filter_value(f, x) * width / (mass * f->integral);
    return x;
}

double film_filter_sample(const struct film_filter *f, double u, double *weight)
{
    *weight = 1;
    switch (f->type) {
    case JOB_FILTER_BOX:
        return f->radius * (2 * u - 1);
    case JOB_FILTER_TENT:
        return u < 0.5 ? f->radius * (sqrt(2 * u) - 1) : f->radius * (1 - sqrt(2 * (1 - u)));
    default:
        return sample_table(f, u, weight);
    }
}
