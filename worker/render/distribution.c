#include "worker/render/distribution.h"

enum err distribution_1d_init(struct distribution_1d *d, struct arena *arena, const double *weights,
                              size_t count)
{
    TL_ASSERT(count > 0);
    double *cdf = arena_alloc(arena, count + 1, sizeof *cdf);
    if (!cdf)
        return ERR_NOMEM;
    double sum = 0;
    for (size_t i = 0; i < count; i++)
        sum += weights[i];
    double running = 0;
    for (size_t i = 0; i < count; i++) {
        cdf[i] = sum > 0 ? running / sum : (double)i / (double)count;
        running += weights[i];
    }
    cdf[count] = 1;
    *d = (struct distribution_1d){.cdf = cdf, .count = count, .sum = sum};
    return ERR_OK;
}

size_t distribution_1d_sample(const struct distribution_1d *d, double u, double *rest)
{
    size_t low = 0, high = d->count;
    while (high - low > 1) {
        size_t middle = (low + high) / 2;
        if (d->cdf[middle] <= u)
            low = middle;
        else
            high = middle;
    }
    double below = 1.0 - 1.0 / 9007199254740992.0;
    double r = (u - d->cdf[low]) / (d->cdf[low + 1] - d->cdf[low]);
    *rest = r < below ? r : below;
    return low;
}
