#include "common/sample_plan.h"

#include <inttypes.h>
#include <string.h>

#include "common/mem.h"

static const char *const pilot_names[] = {"dropped", "kept"};

void sample_plan_release(struct sample_plan *p)
{
    mem_free(p->spp);
    *p = (struct sample_plan){0};
}

/* --- Reading ------------------------------------------------------------ */

static enum err read_spp(struct json_get *g, const struct json *object, struct sample_plan *p)
{
    const struct json *list = json_get_required(g, object, "spp");
    uint64_t squares = (uint64_t)p->columns * p->rows;
    if (!json_get_is(g, list, JSON_ARRAY))
        return ERR_INPUT;
    if (list->count != squares) {
        json_get_problem(g, DIAG_ERROR, list, "bad-plan", NULL,
                         "has %" PRIu32 " numbers, expected columns x rows = %" PRIu64, list->count,
                         squares);
        return ERR_INPUT;
    }
    p->spp = mem_alloc_array(squares, sizeof *p->spp);
    if (!p->spp)
        return ERR_NOMEM;
    uint64_t at = 0;
    for (const struct json *v = list->first; v; v = v->next)
        if (!json_value_uint(g, v, 1, JOB_ADAPTIVE_SPP_MAX, &p->spp[at++]))
            return ERR_INPUT;
    return ERR_OK;
}

static enum err read_members(struct json_get *g, const struct json *object, struct sample_plan *p)
{
    static const char *const keys[] = {"square", "column",  "row",   "columns",
                                       "rows",   "max_spp", "pilot", "spp"};
    static const char *const needed[] = {"columns", "rows", "max_spp", "pilot"};
    const uint32_t side_max = JOB_SIDE_MAX / GRID_SQUARE + 1;
    uint32_t square = GRID_SQUARE;
    int pilot = 0;
    size_t before = g->problems->error_count;
    json_get_keys(g, object, keys, sizeof keys / sizeof *keys);
    bool good = g->problems->error_count == before;
    for (size_t i = 0; i < sizeof needed / sizeof *needed; i++)
        good &= json_get_required(g, object, needed[i]) != NULL;
    good &= json_get_u32(g, object, "square", GRID_SQUARE, GRID_SQUARE, &square);
    good &= json_get_u32(g, object, "column", 0, side_max, &p->column);
    good &= json_get_u32(g, object, "row", 0, side_max, &p->row);
    good &= json_get_u32(g, object, "columns", 1, side_max, &p->columns);
    good &= json_get_u32(g, object, "rows", 1, side_max, &p->rows);
    good &=
        json_get_u64(g, object, "max_spp", JOB_ADAPTIVE_SPP_MIN, JOB_ADAPTIVE_SPP_MAX, &p->max_spp);
    good &= json_get_choice(g, object, "pilot", pilot_names, 2, &pilot);
    p->pilot_kept = pilot == 1;
    return good ? read_spp(g, object, p) : ERR_INPUT;
}

enum err sample_plan_read(struct json_get *g, const struct json *object, struct sample_plan *out)
{
    *out = (struct sample_plan){0};
    if (!json_get_is(g, object, JSON_OBJECT))
        return ERR_INPUT;
    const struct json *inside = json_get_member(object, "plan");
    if (inside ? inside->type == JSON_NULL : json_get_member(object, "job") != NULL) {
        json_get_problem(g, DIAG_ERROR, object, "bad-plan",
                         "plans are written by --target-error and --time-limit",
                         "a report without a plan: every pixel got the same");
        return ERR_INPUT;
    }
    if (inside && !json_get_is(g, inside, JSON_OBJECT))
        return ERR_INPUT;
    struct sample_plan p = {0};
    enum err e = read_members(g, inside ? inside : object, &p);
    if (e != ERR_OK) {
        sample_plan_release(&p);
        return e;
    }
    *out = p;
    return ERR_OK;
}

/* --- Blocks ------------------------------------------------------------- */

uint64_t sample_plan_spp(const struct job_blocks *blocks, uint32_t limit, bool pilot_kept)
{
    uint64_t spp = job_blocks_samples(blocks, limit);
    for (uint32_t b = 0; pilot_kept && b < limit && b < blocks->pilot; b++)
        spp += job_block_at(blocks, b).count;
    return spp;
}

/* The number of blocks that gives so many samples; 0: none does. */
static uint32_t limit_of(const struct job_blocks *blocks, uint64_t spp, bool pilot_kept)
{
    uint32_t low = pilot_kept ? 1 : blocks->pilot + 1, high = blocks->count;
    while (low < high) {
        uint32_t middle = (low + high) / 2;
        if (sample_plan_spp(blocks, middle, pilot_kept) < spp)
            low = middle + 1;
        else
            high = middle;
    }
    return sample_plan_spp(blocks, low, pilot_kept) == spp ? low : 0;
}

bool sample_plan_limits(const struct sample_plan *p, const struct grid *grid,
                        const struct job_blocks *blocks, uint16_t *limits, uint32_t *x, uint32_t *y)
{
    TL_ASSERT(grid->tile == GRID_SQUARE && blocks->pilot > 0);
    for (uint32_t cell = 0; cell < grid->cell_count; cell++) {
        struct grid_rect r = grid_cell(grid, cell);
        uint32_t column = r.x / GRID_SQUARE, row = r.y / GRID_SQUARE;
        *x = r.x;
        *y = r.y;
        if (column < p->column || row < p->row || column - p->column >= p->columns ||
            row - p->row >= p->rows)
            return false;
        uint64_t at = (uint64_t)(row - p->row) * p->columns + (column - p->column);
        uint32_t limit = limit_of(blocks, p->spp[at], p->pilot_kept);
        if (limit == 0)
            return false;
        limits[cell] = (uint16_t)limit;
    }
    return true;
}

void sample_plan_put(struct buf *b, const struct grid *grid, const struct job_blocks *blocks,
                     const uint16_t *limits, bool pilot_kept)
{
    uint64_t *spp = mem_calloc((size_t)grid->columns * grid->rows, sizeof *spp);
    if (!spp) {
        b->failed = true;
        return;
    }
    for (uint32_t cell = 0; cell < grid->cell_count; cell++)
        spp[grid->order[cell]] = sample_plan_spp(blocks, limits[cell], pilot_kept);
    buf_printf(b,
               "{\"square\":%d,\"column\":%" PRIu32 ",\"row\":%" PRIu32 ",\"columns\":%" PRIu32
               ",\"rows\":%" PRIu32 ",\"max_spp\":%" PRIu64 ",\"pilot\":\"%s\",\"spp\":[",
               GRID_SQUARE, grid->column0, grid->row0, grid->columns, grid->rows, blocks->spp,
               pilot_names[pilot_kept]);
    for (uint32_t i = 0; i < grid->cell_count; i++)
        buf_printf(b, i ? ",%" PRIu64 : "%" PRIu64, spp[i]);
    buf_printf(b, "]}");
    mem_free(spp);
}
