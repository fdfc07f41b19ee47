/* worker/render/distribution.h: drawing from a tabulated density.
 *
 * Inversion of the cumulated weights, so that strata of u survive. Memory comes from
 * an arena. Building: one thread; drawing: any.
 * Tests: test_light.
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

#endif
