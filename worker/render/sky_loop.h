/* The body of sky_sse2.c, sky_avx2.c and sky_avx512.c: the sky for the lanes of a batch, in loops
 * of which those over numbers become vectors. The including file defines SKY_DRAW and SKY_LOOK, the
 * functions' names; the instruction set is the compiler's business. The steps are those of sky.c
 * and light.c. */
#include "worker/render/sky_batch.h"
#include "worker/render/sky_parts.h"
#include "worker/render/warp.h"

/* sky_table() for all normals. */
static inline void find_tables(struct sky_batch *b)
{
    for (int i = 0; i < SKY_BATCH; i++)
        b->table[i] = (uint32_t)sky_table_at(v3(b->n[0][i], b->n[1][i], b->n[2][i]));
}

/* find() of sky.c: moves each at[i] from the first of `count` ascending sums to the last that is
 * not above t[i]. */
static inline void search(const double *at[], uint32_t count, const double t[])
{
    while (count > 1) {
        uint32_t half = count / 2;
        for (int i = 0; i < SKY_BATCH; i++)
            at[i] += at[i][half] <= t[i] ? half : 0;
        count -= half;
    }
}

/* A pair of sums for each lane. */
struct sums {
    double low[SKY_BATCH], high[SKY_BATCH];
};

/* at[i][0] and at[i][step]. */
static inline void load(const double *const at[], uint32_t step, struct sums *s)
{
    for (int i = 0; i < SKY_BATCH; i++) {
        s->low[i] = at[i][0];
        s->high[i] = at[i][step];
    }
}

/* Where t[i] falls between two sums, in [0,1). */
static inline void find_rest(const struct sums *s, double t[])
{
    const double below_one = 1.0 - 1.0 / 9007199254740992.0;
    for (int i = 0; i < SKY_BATCH; i++) {
        double r = (t[i] - s->low[i]) / (s->high[i] - s->low[i]);
        t[i] = r < below_one ? r : below_one;
    }
}

/* From a share of the way between two sums to the sum there. */
static inline void find_sum(const struct sums *s, double t[])
{
    for (int i = 0; i < SKY_BATCH; i++)
        t[i] = s->low[i] + t[i] * (s->high[i] - s->low[i]);
}

/* sky_draw(), u in x and v in y: the blocks, what is left of u and v in them, and their shares. */
static inline void draw_blocks(const struct sky_map *m, struct sky_batch *b, uint32_t across[],
                               uint32_t down[])
{
    const double *rows[SKY_BATCH], *columns[SKY_BATCH];
    struct sums row_sums, column_sums;
    for (int i = 0; i < SKY_BATCH; i++)
        rows[i] = m->choices[b->table[i]].row;
    search(rows, SKY_BLOCKS_DOWN, b->y);
    for (int i = 0; i < SKY_BATCH; i++) {
        const struct sky_choice *c = &m->choices[b->table[i]];
        down[i] = (uint32_t)(rows[i] - c->row);
        columns[i] = c->column[down[i]];
    }
    search(columns, SKY_BLOCKS_ACROSS, b->x);
    for (int i = 0; i < SKY_BATCH; i++)
        across[i] = (uint32_t)(columns[i] - m->choices[b->table[i]].column[down[i]]);
    load(rows, 1, &row_sums);
    load(columns, 1, &column_sums);
    find_rest(&row_sums, b->y);
    find_rest(&column_sums, b->x);
    for (int i = 0; i < SKY_BATCH; i++)
        b->density[i] =
            (row_sums.high[i] - row_sums.low[i]) * (column_sums.high[i] - column_sums.low[i]);
}

/* Its cells: x and y from within the blocks to within the map. */
static inline void draw_cells(const struct sky_map *m, struct sky_batch *b, const uint32_t across[],
                              const uint32_t down[])
{
    const double *rows[SKY_BATCH], *cells[SKY_BATCH];
    struct sums whole, row, cell;
    double row_numbers[SKY_BATCH], cell_numbers[SKY_BATCH];
    const double width = m->width, height = m->height;
    for (int i = 0; i < SKY_BATCH; i++)
        rows[i] = m->down + (size_t)across[i] * (m->height + 1) + down[i] * m->block_height;
    load(rows, m->block_height, &whole);
    find_sum(&whole, b->y);
    search(rows, m->block_height, b->y);
    load(rows, 1, &row);
    find_rest(&row, b->y);
    for (int i = 0; i < SKY_BATCH; i++) {
        size_t number = (size_t)(rows[i] - (m->down + (size_t)across[i] * (m->height + 1)));
        row_numbers[i] = (double)(int32_t)number;
        cells[i] = m->along + number * (m->width + 1) + across[i] * m->block_width;
    }
    load(cells, m->block_width, &cell);
    find_sum(&cell, b->x);
    search(cells, m->block_width, b->x);
    load(cells, 1, &cell);
    find_rest(&cell, b->x);
    for (int i = 0; i < SKY_BATCH; i++) {
        const double *line = m->along + (size_t)(int32_t)row_numbers[i] * (m->width + 1);
        cell_numbers[i] = (double)(int32_t)(cells[i] - line);
    }
    for (int i = 0; i < SKY_BATCH; i++) {
        b->x[i] = (cell_numbers[i] + b->x[i]) / width;
        b->y[i] = (row_numbers[i] + b->y[i]) / height;
        b->density[i] = b->density[i] * (cell.high[i] - cell.low[i]) /
                        (whole.high[i] - whole.low[i]) * (width * height);
    }
}

static inline void turn(const double *restrict u, double *restrict sine, double *restrict cosine)
{
    for (int i = 0; i < SKY_BATCH; i++) {
        double s, c;
        warp_sincos_turn(u[i], &s, &c);
        sine[i] = s;
        cosine[i] = c;
    }
}

/* environment_direction() and the density there. */
static inline void find_directions(const double m[9], struct sky_batch *b)
{
    double half[SKY_BATCH], sines[SKY_BATCH], cosines[SKY_BATCH], across[SKY_BATCH],
        along[SKY_BATCH];
    const double a0 = m[0], a1 = m[1], a2 = m[2], a3 = m[3], a4 = m[4], a5 = m[5], a6 = m[6],
                 a7 = m[7], a8 = m[8];
    for (int i = 0; i < SKY_BATCH; i++)
        half[i] = b->y[i] * 0.5;
    turn(b->x, across, along);
    turn(half, sines, cosines);
    for (int i = 0; i < SKY_BATCH; i++) {
        vec3 l = v3(sines[i] * across[i], cosines[i], -sines[i] * along[i]);
        b->w[0][i] = a0 * l.x + a3 * l.y + a6 * l.z;
        b->w[1][i] = a1 * l.x + a4 * l.y + a7 * l.z;
        b->w[2][i] = a2 * l.x + a5 * l.y + a8 * l.z;
    }
    for (int i = 0; i < SKY_BATCH; i++) {
        vec3 n = v3(b->n[0][i], b->n[1][i], b->n[2][i]);
        double cosine = v3_dot(n, v3(b->w[0][i], b->w[1][i], b->w[2][i]));
        double reach = v3_abs_max(n) > 0 ? cosine : 1;
        double pdf = b->density[i] / (2 * VEC_PI * VEC_PI * sines[i]);
        pdf = reach > 0 ? pdf : 0;
        b->pdf[i] = sines[i] > 0 ? pdf : 0;
    }
}

void SKY_DRAW(const struct environment *e, struct sky_batch *b)
{
    uint32_t across[SKY_BATCH], down[SKY_BATCH];
    find_tables(b);
    draw_blocks(&e->map, b, across, down);
    draw_cells(&e->map, b, across, down);
    find_directions(e->to_local, b);
}

/* The points of the map in the directions; their sines to the poles. */
static inline void find_points(const double m[9], struct sky_batch *b, double sines[])
{
    double x[SKY_BATCH], y[SKY_BATCH], z[SKY_BATCH];
    const double a0 = m[0], a1 = m[1], a2 = m[2], a3 = m[3], a4 = m[4], a5 = m[5], a6 = m[6],
                 a7 = m[7], a8 = m[8];
    for (int i = 0; i < SKY_BATCH; i++) {
        vec3 w = v3(b->w[0][i], b->w[1][i], b->w[2][i]);
        x[i] = a0 * w.x + a1 * w.y + a2 * w.z;
        y[i] = a3 * w.x + a4 * w.y + a5 * w.z;
        z[i] = a6 * w.x + a7 * w.y + a8 * w.z;
        sines[i] = sqrt(x[i] * x[i] + z[i] * z[i]);
    }
    for (int i = 0; i < SKY_BATCH; i++)
        b->x[i] = warp_turn_of(x[i], -z[i]);
    for (int i = 0; i < SKY_BATCH; i++)
        b->y[i] = 2 * warp_turn_of(sines[i], y[i]);
}

void SKY_LOOK(const struct environment *e, struct sky_batch *b)
{
    const struct sky_map *m = &e->map;
    double sines[SKY_BATCH];
    const double width = m->width, height = m->height;
    int32_t columns[SKY_BATCH], rows[SKY_BATCH];
    find_tables(b);
    find_points(e->to_local, b, sines);
    for (int i = 0; i < SKY_BATCH; i++) {
        columns[i] = sky_cell_at(b->x[i], width);
        rows[i] = sky_cell_at(b->y[i], height);
    }
    for (int i = 0; i < SKY_BATCH; i++)
        b->density[i] = sky_cell_density(m, b->table[i], (uint32_t)columns[i], (uint32_t)rows[i]);
    for (int i = 0; i < SKY_BATCH; i++) {
        double pdf = b->density[i] / (2 * VEC_PI * VEC_PI * sines[i]);
        b->pdf[i] = sines[i] > 0 ? pdf : 0;
    }
}
