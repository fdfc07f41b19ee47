/* worker/render/distribution.h: drawing from tabulated densities, in one and two dimensions.
 *
 * Inversion of the cumulated weights, so that strata of u survive. Memory comes from
 * an arena. Building: one thread; drawing: any.
 * Tests: test_light, by the sky.
 */
#ifndef WORKER_RENDER_DISTRIBUTION_H
#define WORKER_RENDER_DISTRIBUTION_H

#include "common/mem.h"

struct distribution_1d {
    double *cdf; /* count + 1, from 0 to 1 */
    size_t count;
    double sum; /* of the weights */
};

/* `weights` >= 0 and finite, copied. All zero: uniform, with sum 0. ERR_NOMEM. */
TL_NODISCARD enum err distribution_1d_init(struct distribution_1d *d, struct arena *arena,
                                           const double *weights, size_t count);

/* Index of an element drawn by u in [0,1); *rest in [0,1) is where u fell within it. Elements of
 * weight zero are not drawn. */
size_t distribution_1d_sample(const struct distribution_1d *d, double u, double *rest);

static inline double distribution_1d_probability(const struct distribution_1d *d, size_t index)
{
    return d->cdf[index + 1] - d->cdf[index];
}

/* Piecewise constant over the unit square; rows are along y. */
struct distribution_2d {
    struct distribution_1d rows;     /* which row */
    struct distribution_1d *columns; /* in each row */
    size_t width, height;
};

TL_NODISCARD enum err distribution_2d_init(struct distribution_2d *d, struct arena *arena,
                                           const double *weights, size_t width, size_t height);

/* A point (x, y) of the unit square; returns its density. */
double distribution_2d_sample(const struct distribution_2d *d, double u, double v, double *x,
                              double *y);
double distribution_2d_pdf(const struct distribution_2d *d, double x, double y);

#endif
