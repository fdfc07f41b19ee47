/* worker/render/sky_parts.h: the steps of looking up a sky that is a picture, for one direction and
 * for sixteen, the same bits.
 *
 * Written so that a loop over them becomes vectors: nothing branches on numbers. The loops are
 * compiled for each instruction set (sky_loop.h). Any thread. Tests: test_light.
 */
#ifndef WORKER_RENDER_SKY_PARTS_H
#define WORKER_RENDER_SKY_PARTS_H

#include "worker/render/sky.h"

/* sky_table(). */
static inline int32_t sky_table_at(vec3 n)
{
    double sum = v3_abs_sum(n);
    bool there = sum > 0, below = n.z < 0;
    double x = n.x / (there ? sum : 1), y = n.y / (there ? sum : 1);
    double folded_x = copysign(1 - fabs(y), x), folded_y = copysign(1 - fabs(x), y);
    x = below ? folded_x : x;
    y = below ? folded_y : y;
    double half = (SKY_GRID - 1) / 2;
    int32_t column = (int32_t)(x * half + (half + 0.5)), row = (int32_t)(y * half + (half + 0.5));
    return there ? row * SKY_GRID + column : (int32_t)SKY_ANYWHERE;
}

/* Which of `count` cells along an edge of the map lies at x; the last one or the first where x is
 * outside or no number. */
static inline int32_t sky_cell_at(double x, double count)
{
    double at = x * count, last = count - 1;
    at = at > 0 ? at : 0;
    return (int32_t)(at < last ? at : last);
}

/* The density over the unit square with which a cell is drawn. */
static inline double sky_cell_density(const struct sky_map *m, uint32_t table, uint32_t column,
                                      uint32_t row)
{
    uint32_t across = column / m->block_width, down = row / m->block_height;
    const struct sky_choice *c = &m->choices[table];
    double block =
        (c->row[down + 1] - c->row[down]) * (c->column[down][across + 1] - c->column[down][across]);
    const double *rows = m->down + (size_t)across * (m->height + 1);
    const double *cells = m->along + (size_t)row * (m->width + 1);
    return block * (cells[column + 1] - cells[column]) /
           (rows[(down + 1) * m->block_height] - rows[down * m->block_height]) *
           ((double)m->width * m->height);
}

#endif
