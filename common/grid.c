#include "common/grid.h"

#include "common/mem.h"

/* Hilbert curve index -> cell of a 2^k square (Warren, Hacker's Delight, 2nd ed., 16-2). */
static void hilbert_cell(uint32_t side, uint64_t index, uint32_t *x, uint32_t *y)
{
    uint32_t px = 0, py = 0;
    for (uint32_t s = 1; s < side; s *= 2) {
        uint32_t rx = (uint32_t)(index / 2) & 1;
        uint32_t ry = (uint32_t)(index ^ rx) & 1;
        if (ry == 0) {
            if (rx == 1) {
                px = s - 1 - px;
                py = s - 1 - py;
            }
            uint32_t swap = px;
            px = py;
            py = swap;
        }
        px += s * rx;
        py += s * ry;
        index /= 4;
    }
    *x = px;
    *y = py;
}

/* Long pictures are covered by a row of squares, so that the walk stays linear in the cells. */
static void fill_order(struct grid *g)
{
    uint32_t shorter = g->columns < g->rows ? g->columns : g->rows;
    uint32_t longer = g->columns < g->rows ? g->rows : g->columns;
    uint32_t side = 1;
    while (side < shorter)
        side *= 2;
    uint32_t count = 0;
    for (uint32_t base = 0; base < longer; base += side) {
        for (uint64_t i = 0; i < (uint64_t)side * side; i++) {
            uint32_t x, y;
            hilbert_cell(side, i, &x, &y);
            uint32_t column = g->columns < g->rows ? x : base + x;
            uint32_t row = g->columns < g->rows ? base + y : y;
            if (column < g->columns && row < g->rows)
                g->order[count++] = row * g->columns + column;
        }
    }
    TL_ASSERT(count == g->cell_count);
}

enum err grid_init(struct grid *g, const struct job_spec *spec)
{
    /* Where samples differ from square to square, the cells are those squares. */
    uint32_t tile = spec->stop == JOB_STOP_SPP ? spec->tile : GRID_SQUARE;
    struct grid made = {.crop = spec->crop, .tile = tile};
    made.plane_count = job_plane_count(spec);
    made.centre_planes = aov_planes(spec->aov, AOV_CENTRE);
    made.column0 = spec->crop.x / tile;
    made.row0 = spec->crop.y / tile;
    made.columns = (spec->crop.x + spec->crop.width - 1) / tile - made.column0 + 1;
    made.rows = (spec->crop.y + spec->crop.height - 1) / tile - made.row0 + 1;
    uint64_t cells = (uint64_t)made.columns * made.rows;
    if (cells > GRID_CELLS_MAX)
        return ERR_LIMIT;
    made.cell_count = (uint32_t)cells;
    made.order = mem_alloc_array(cells, sizeof *made.order);
    if (!made.order)
        return ERR_NOMEM;
    fill_order(&made);
    *g = made;
    return ERR_OK;
}

void grid_release(struct grid *g)
{
    mem_free(g->order);
    *g = (struct grid){0};
}

/* The part of [cell, cell + tile) inside [begin, begin + extent). */
static void cut(uint64_t cell, uint32_t tile, uint32_t begin, uint32_t extent, uint32_t *at,
                uint32_t *length)
{
    uint64_t low = cell > begin ? cell : begin;
    uint64_t high = cell + tile, end = (uint64_t)begin + extent;
    high = high < end ? high : end;
    *at = (uint32_t)low;
    *length = (uint32_t)(high - low);
}

struct grid_rect grid_cell(const struct grid *g, uint32_t cell)
{
    TL_ASSERT(cell < g->cell_count);
    uint64_t column = g->column0 + g->order[cell] % g->columns;
    uint64_t row = g->row0 + g->order[cell] / g->columns;
    struct grid_rect r;
    cut(column * g->tile, g->tile, g->crop.x, g->crop.width, &r.x, &r.width);
    cut(row * g->tile, g->tile, g->crop.y, g->crop.height, &r.y, &r.height);
    return r;
}

uint64_t grid_pixels(const struct grid *g, uint32_t cell_begin, uint32_t cell_count)
{
    uint64_t pixels = 0;
    for (uint32_t i = 0; i < cell_count; i++) {
        struct grid_rect r = grid_cell(g, cell_begin + i);
        pixels += (uint64_t)r.width * r.height;
    }
    return pixels;
}

bool grid_has_unit(const struct grid *g, const struct job_blocks *blocks, struct unit u)
{
    return u.cell_count > 0 && u.cell_begin < g->cell_count &&
           u.cell_count <= g->cell_count - u.cell_begin && u.block < blocks->count;
}
