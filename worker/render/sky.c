#include "worker/render/sky.h"

#include "worker/render/sky_parts.h"

static const double below_one = 1.0 - 1.0 / 9007199254740992.0;

uint32_t sky_table(vec3 n)
{
    return (uint32_t)sky_table_at(n);
}

vec3 sky_unfolded(double x, double y)
{
    double z = 1 - fabs(x) - fabs(y);
    vec3 n = v3(x, y, z);
    if (z < 0) {
        n.x = copysign(1 - fabs(y), x);
        n.y = copysign(1 - fabs(x), y);
    }
    return v3_unit(n);
}

/* The last element of the ascending sums[0..count) that is not above t, or the first; *rest in
 * [0,1) is where t falls between it and the next. */
static uint32_t find(const double *sums, uint32_t count, double t, double *rest)
{
    const double *at = sums;
    while (count > 1) {
        uint32_t half = count / 2;
        at += at[half] <= t ? half : 0;
        count -= half;
    }
    double r = (t - at[0]) / (at[1] - at[0]);
    *rest = r < below_one ? r : below_one;
    return (uint32_t)(at - sums);
}

/* The same between two of the sums: t in [0,1) from sums[begin] to sums[end]. */
static uint32_t find_between(const double *sums, uint32_t begin, uint32_t end, double t,
                             double *rest)
{
    double low = sums[begin], high = sums[end];
    return begin + find(sums + begin, end - begin, low + t * (high - low), rest);
}

double sky_draw(const struct sky_map *m, uint32_t table, double u, double v, double *x, double *y)
{
    const struct sky_choice *c = &m->choices[table];
    uint32_t down = find(c->row, SKY_BLOCKS_DOWN, v, &v);
    const double *columns = c->column[down];
    uint32_t across = find(columns, SKY_BLOCKS_ACROSS, u, &u);
    double block = (c->row[down + 1] - c->row[down]) * (columns[across + 1] - columns[across]);

    const double *rows = m->down + (size_t)across * (m->height + 1);
    uint32_t top = down * m->block_height, bottom = top + m->block_height;
    uint32_t row = find_between(rows, top, bottom, v, &v);
    const double *cells = m->along + (size_t)row * (m->width + 1);
    uint32_t left = across * m->block_width;
    uint32_t column = find_between(cells, left, left + m->block_width, u, &u);

    *x = (column + u) / m->width;
    *y = (row + v) / m->height;
    return block * (cells[column + 1] - cells[column]) / (rows[bottom] - rows[top]) *
           ((double)m->width * m->height);
}

double sky_density(const struct sky_map *m, uint32_t table, double x, double y)
{
    return sky_cell_density(m, table, (uint32_t)sky_cell_at(x, m->width),
                            (uint32_t)sky_cell_at(y, m->height));
}
