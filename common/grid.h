/* common/grid.h: the cells of a picture, in the order in which they are leased.
 *
 * Cells are squares of tile x tile pixels aligned to the full picture and cut to
 * the crop. Their order is a Hilbert curve over the cells that meet the crop, so
 * that a run of cells is a compact patch. A unit's payload holds its cells in this
 * order, each row by row, plane after plane: R, G, B, then the AOVs' (aov.h). Pure; any
 * thread.
 */
#ifndef COMMON_GRID_H
#define COMMON_GRID_H

#include "common/job_spec.h"

struct grid_rect {
    uint32_t x, y, width, height; /* pixels of the full picture; never empty */
};

struct grid {
    struct job_crop crop;
    uint32_t tile;
    uint32_t column0, row0, columns, rows; /* cells that meet the crop */
    uint32_t cell_count;
    uint32_t plane_count;   /* of floats in a unit's payload: job_plane_count */
    uint32_t centre_planes; /* of them, behind the colour's, AOVs of kind CENTRE */
    uint32_t *order;        /* cell position on the curve -> row * columns + column; owned */
};

enum {
    GRID_CELLS_MAX = 1 << 24,
    GRID_SQUARE = 16, /* side in pixels of the squares by which error is measured and samples are
                         allocated, whatever --tile says */
};

/* ERR_LIMIT: more than GRID_CELLS_MAX cells; ERR_NOMEM. */
TL_NODISCARD enum err grid_init(struct grid *g, const struct job_spec *spec);
void grid_release(struct grid *g);

/* The pixels of the cell at a position of the order, < cell_count. */
struct grid_rect grid_cell(const struct grid *g, uint32_t cell);

/* Pixels of a run of cells. */
uint64_t grid_pixels(const struct grid *g, uint32_t cell_begin, uint32_t cell_count);

/* A unit of work: a run of cells times one sample block. */
struct unit {
    uint32_t cell_begin, cell_count;
    uint32_t block;
};

/* True if the unit lies within the grid and the block within the job. */
bool grid_has_unit(const struct grid *g, const struct job_blocks *blocks, struct unit u);

#endif
