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

enum err distribution_2d_init(struct distribution_2d *d, struct arena *arena, const double *weights,
                              size_t width, size_t height)
{
    struct distribution_2d made = {.width = width, .height = height};
    made.columns = arena_alloc(arena, height, sizeof *made.columns);
    double *sums = mem_alloc_array(height, sizeof *sums);
    enum err e = made.columns && sums ? ERR_OK : ERR_NOMEM;
    for (size_t y = 0; e == ERR_OK && y < height; y++) {
        e = distribution_1d_init(&made.columns[y], arena, weights + y * width, width);
        sums[y] = e == ERR_OK ? made.columns[y].sum : 0;
    }
    if (e == ERR_OK)
        e = distribution_1d_init(&made.rows, arena, sums, height);
    mem_free(sums);
    if (e == ERR_OK)
        *d = made;
    return e;
}

double distribution_2d_sample(const struct distribution_2d *d, double u, double v, double *x,
                              double *y)
{
    double fx, fy;
    size_t row = distribution_1d_sample(&d->rows, v, &fy);
    size_t column = distribution_1d_sample(&d->columns[row], u, &fx);
    *x = ((double)column + fx) / (double)d->width;
    *y = ((double)row + fy) / (double)d->height;
    return distribution_1d_probability(&d->rows, row) *
           distribution_1d_probability(&d->columns[row], column) *
           ((double)d->width * (double)d->height);
}

static size_t cell_of(double x, size_t count)
{
    double at = x * (double)count;
    return !(at > 0) ? 0 : at >= (double)(count - 1) ? count - 1 : (size_t)at;
}

double distribution_2d_pdf(const struct distribution_2d *d, double x, double y)
{
    size_t row = cell_of(y, d->height), column = cell_of(x, d->width);
    return distribution_1d_probability(&d->rows, row) *
           distribution_1d_probability(&d->columns[row], column) *
           ((double)d->width * (double)d->height);
}
