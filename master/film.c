#include "master/film_impl.h"

#include <math.h>
#include <string.h>

#include "common/mem.h"

static uint32_t half_of(uint32_t block)
{
    return block & 1;
}

uint32_t film_half_blocks(const struct film *f, uint32_t half)
{
    return (f->blocks.count + 1 - half) / 2;
}

uint64_t film_bytes_of(const struct job_spec *spec)
{
    uint64_t pixels = (uint64_t)spec->crop.width * spec->crop.height;
    return pixels * FILM_HALVES * job_plane_count(spec) * sizeof(double);
}

/* Before there is a plan, every cell gets the pilot. */
static bool pilot_limits(struct film *f)
{
    f->limit = mem_alloc_array(f->grid->cell_count, sizeof *f->limit);
    f->limit_total = (uint64_t)f->grid->cell_count * f->blocks.pilot;
    for (uint32_t cell = 0; f->limit && cell < f->grid->cell_count; cell++)
        f->limit[cell] = (uint16_t)f->blocks.pilot;
    return f->limit != NULL;
}

enum err film_new(const struct grid *grid, const struct job_blocks *blocks, struct film **out)
{
    TL_ASSERT(blocks->count >= 1 && blocks->count <= JOB_BLOCKS_MAX);
    struct film *f = mem_calloc(1, sizeof *f);
    if (!f)
        return ERR_NOMEM;
    f->grid = grid;
    f->blocks = *blocks;
    f->held_end = &f->held;
    f->limit_total = (uint64_t)grid->cell_count * blocks->count;
    f->cell_offset = mem_alloc_array((size_t)grid->cell_count + 1, sizeof *f->cell_offset);
    uint64_t bits = (uint64_t)grid->cell_count * blocks->count;
    f->present = mem_calloc((bits + 63) / 64, sizeof *f->present);
    if (!f->cell_offset || !f->present)
        goto fail;
    for (uint32_t cell = 0; cell < grid->cell_count; cell++) {
        f->cell_offset[cell] = f->pixels;
        f->pixels += grid_pixels(grid, cell, 1);
    }
    f->cell_offset[grid->cell_count] = f->pixels;
    for (int half = 0; half < FILM_HALVES; half++) {
        f->sum[half] = mem_calloc(f->pixels, grid->plane_count * sizeof(double));
        f->next[half] = mem_calloc(grid->cell_count, sizeof *f->next[half]);
        if (!f->sum[half] || !f->next[half])
            goto fail;
    }
    if (blocks->pilot > 0 && !pilot_limits(f))
        goto fail;
    *out = f;
    return ERR_OK;

fail:
    film_free(f);
    return ERR_NOMEM;
}

static void free_list(struct film_wait *w)
{
    while (w) {
        struct film_wait *next = w->next;
        mem_free(w->values);
        mem_free(w);
        w = next;
    }
}

void film_free(struct film *f)
{
    if (!f)
        return;
    for (uint32_t block = 0; block < JOB_BLOCKS_MAX; block++)
        free_list(f->waiting[block]);
    free_list(f->held);
    for (int half = 0; half < FILM_HALVES; half++) {
        mem_free(f->sum[half]);
        mem_free(f->next[half]);
    }
    mem_free(f->cell_offset);
    mem_free(f->present);
    mem_free(f->limit);
    mem_free(f);
}

/* --- Presence ----------------------------------------------------------- */

static bool is_present(const struct film *f, uint32_t block, uint32_t cell)
{
    uint64_t bit = (uint64_t)block * f->grid->cell_count + cell;
    return f->present[bit / 64] >> (bit % 64) & 1;
}

void film_set_present(struct film *f, struct unit u)
{
    uint64_t bit = (uint64_t)u.block * f->grid->cell_count + u.cell_begin;
    for (uint32_t i = 0; i < u.cell_count; i++, bit++)
        f->present[bit / 64] |= UINT64_C(1) << (bit % 64);
    f->present_count += u.cell_count;
}

static void clear_present(struct film *f, struct unit u)
{
    uint64_t bit = (uint64_t)u.block * f->grid->cell_count + u.cell_begin;
    for (uint32_t i = 0; i < u.cell_count; i++, bit++) {
        f->present_count -= f->present[bit / 64] >> (bit % 64) & 1;
        f->present[bit / 64] &= ~(UINT64_C(1) << (bit % 64));
    }
}

bool film_has_any(const struct film *f, struct unit unit)
{
    TL_ASSERT(grid_has_unit(f->grid, &f->blocks, unit));
    for (uint32_t i = 0; i < unit.cell_count; i++)
        if (is_present(f, unit.block, unit.cell_begin + i))
            return true;
    return false;
}

bool film_complete(const struct film *f)
{
    return f->added_count == film_total_count(f);
}

uint64_t film_present_count(const struct film *f)
{
    return f->present_count;
}

uint64_t film_total_count(const struct film *f)
{
    return f->limit_total;
}

uint64_t film_waiting_bytes(const struct film *f)
{
    return f->waiting_bytes;
}

void film_each_present(const struct film *f, void (*visit)(void *ctx, struct unit run), void *ctx)
{
    for (uint32_t block = 0; block < f->blocks.count; block++) {
        uint32_t begin = 0;
        for (uint32_t cell = 0; cell <= f->grid->cell_count; cell++) {
            if (cell < f->grid->cell_count && is_present(f, block, cell))
                continue;
            if (cell > begin)
                visit(ctx, (struct unit){begin, cell - begin, block});
            begin = cell + 1;
        }
    }
}

/* --- Adding ------------------------------------------------------------- */

/* Adds cells [begin, end) of the waiting unit to the sums: their turn has come. */
static void add_cells(struct film *f, struct film_wait *w, uint32_t begin, uint32_t end)
{
    uint32_t half = half_of(w->unit.block);
    uint64_t first = f->cell_offset[begin], pixels = f->cell_offset[end] - first;
    uint64_t from = first - f->cell_offset[w->unit.cell_begin];
    bool counts = !f->planned || f->pilot_kept || w->unit.block >= f->blocks.pilot;
    /* With a pilot that is kept, the pixels' centres are there already. */
    bool centred = f->planned && f->pilot_kept && w->unit.block == f->blocks.pilot;
    for (uint32_t plane = 0; counts && plane < f->grid->plane_count; plane++) {
        if (centred && plane >= FILM_CHANNELS && plane - FILM_CHANNELS < f->grid->centre_planes)
            continue;
        double *sum = f->sum[half] + (uint64_t)plane * f->pixels + first;
        const float *values = w->values + (uint64_t)plane * w->pixels + from;
        for (uint64_t i = 0; i < pixels; i++)
            sum[i] += (double)values[i];
    }
    for (uint32_t cell = begin; cell < end; cell++)
        f->next[half][cell]++;
    w->cells_left -= end - begin;
    f->added_count += end - begin;
}

static float *first_value(const struct film *f, const struct film_wait *w, uint32_t cell)
{
    return w->values + (f->cell_offset[cell] - f->cell_offset[w->unit.cell_begin]);
}

bool film_is_left(const struct film *f, const struct film_wait *w, uint32_t cell)
{
    return f->next[half_of(w->unit.block)][cell] <= w->unit.block / 2 &&
           !isnan(*first_value(f, w, cell));
}

static bool is_due(const struct film *f, const struct film_wait *w, uint32_t cell)
{
    return f->next[half_of(w->unit.block)][cell] == w->unit.block / 2 &&
           !isnan(*first_value(f, w, cell));
}

/* Adds what can be added of one waiting unit within [begin, end); true if anything was. */
static bool add_due(struct film *f, struct film_wait *w, uint32_t begin, uint32_t end)
{
    uint32_t unit_end = w->unit.cell_begin + w->unit.cell_count;
    begin = begin > w->unit.cell_begin ? begin : w->unit.cell_begin;
    end = end < unit_end ? end : unit_end;
    bool any = false;
    for (uint32_t cell = begin; cell < end; cell++) {
        if (!is_due(f, w, cell))
            continue;
        uint32_t run = cell;
        while (cell < end && is_due(f, w, cell))
            cell++;
        add_cells(f, w, run, cell);
        any = true;
    }
    return any;
}

/* Takes one waiting unit out of its list, for good. */
static void unlink_wait(struct film *f, struct film_wait **at)
{
    struct film_wait *w = *at;
    *at = w->next;
    f->waiting_bytes -= w->pixels * f->grid->plane_count * sizeof(float);
    mem_free(w->values);
    mem_free(w);
}

/* Adds what became due in these cells, from `block` on through the later ones of its half. */
static void settle(struct film *f, struct unit changed)
{
    bool any = true;
    for (uint32_t block = changed.block; any && block < f->blocks.count; block += 2) {
        any = false;
        for (struct film_wait **at = &f->waiting[block]; *at;) {
            struct film_wait *w = *at;
            any |= add_due(f, w, changed.cell_begin, changed.cell_begin + changed.cell_count);
            if (w->cells_left > 0)
                at = &w->next;
            else
                unlink_wait(f, at);
        }
    }
}

/* Forgets what waits for one cell, whether it is in the sums already or not. */
static void drop_waiting(struct film *f, uint32_t block, uint32_t cell)
{
    for (struct film_wait **at = &f->waiting[block]; *at;) {
        struct film_wait *w = *at;
        bool inside = cell >= w->unit.cell_begin && cell - w->unit.cell_begin < w->unit.cell_count;
        if (inside) {
            w->cells_left -= film_is_left(f, w, cell);
            *first_value(f, w, cell) = NAN;
        }
        if (w->cells_left > 0)
            at = &w->next;
        else
            unlink_wait(f, at);
    }
}

static void reset_cells(struct film *f, uint32_t begin, uint32_t end)
{
    for (uint32_t cell = begin; cell < end; cell++) {
        for (uint32_t block = 0; block < f->blocks.count; block++)
            drop_waiting(f, block, cell);
        uint64_t first = f->cell_offset[cell], pixels = f->cell_offset[cell + 1] - first;
        for (int half = 0; half < FILM_HALVES; half++) {
            for (uint64_t c = 0; c < f->grid->plane_count; c++)
                memset(f->sum[half] + c * f->pixels + first, 0, pixels * sizeof(double));
            f->added_count -= f->next[half][cell];
            f->next[half][cell] = 0;
        }
    }
}

static void place(struct film *f, struct film_wait *w)
{
    if (!w->values) {
        reset_cells(f, w->unit.cell_begin, w->unit.cell_begin + w->unit.cell_count);
        mem_free(w);
        return;
    }
    w->next = f->waiting[w->unit.block];
    f->waiting[w->unit.block] = w;
    settle(f, w->unit);
}

static void place_or_hold(struct film *f, struct film_wait *w)
{
    if (f->readers == 0) {
        place(f, w);
    } else {
        *f->held_end = w;
        f->held_end = &w->next;
    }
}

enum err film_add(struct film *f, struct unit unit, float *values)
{
    if (film_has_any(f, unit))
        return ERR_STATE;
    struct film_wait *w = mem_calloc(1, sizeof *w);
    if (!w)
        return ERR_NOMEM;
    w->unit = unit;
    w->cells_left = unit.cell_count;
    w->pixels = f->cell_offset[unit.cell_begin + unit.cell_count] - f->cell_offset[unit.cell_begin];
    w->values = values;
    f->waiting_bytes += w->pixels * f->grid->plane_count * sizeof(float);
    film_set_present(f, unit);
    place_or_hold(f, w);
    return ERR_OK;
}

enum err film_reset(struct film *f, uint32_t cell_begin, uint32_t cell_count)
{
    TL_ASSERT(cell_begin < f->grid->cell_count && cell_count <= f->grid->cell_count - cell_begin);
    struct film_wait *w = mem_calloc(1, sizeof *w);
    if (!w)
        return ERR_NOMEM;
    w->unit = (struct unit){cell_begin, cell_count, 0};
    for (uint32_t block = 0; block < f->blocks.count; block++)
        clear_present(f, (struct unit){cell_begin, cell_count, block});
    place_or_hold(f, w);
    return ERR_OK;
}

bool film_holds(const struct film *f)
{
    return f->held != NULL;
}

/* Marks the pilot's blocks as there, though nobody rendered them. */
static void skip_pilot(struct film *f)
{
    TL_ASSERT(f->present_count == 0 && f->added_count == 0);
    for (uint32_t block = 0; block < f->blocks.pilot; block++)
        film_set_present(f, (struct unit){0, f->grid->cell_count, block});
    for (uint32_t cell = 0; cell < f->grid->cell_count; cell++)
        f->next[0][cell] = f->next[1][cell] = (uint16_t)(f->blocks.pilot / 2);
    f->added_count = f->present_count;
}

bool film_plan(struct film *f, const uint16_t *limits, enum film_pilot pilot)
{
    TL_ASSERT(f->blocks.pilot > 0);
    if (f->readers > 0)
        return false;
    if (!f->planned && pilot != FILM_PILOT_KEPT)
        for (int half = 0; half < FILM_HALVES; half++)
            memset(f->sum[half], 0, f->pixels * f->grid->plane_count * sizeof(double));
    if (!f->planned && pilot == FILM_PILOT_SKIPPED && f->present_count == 0)
        skip_pilot(f);
    if (!f->planned)
        f->pilot_kept = pilot == FILM_PILOT_KEPT;
    f->planned = true;
    f->limit_total = 0;
    for (uint32_t cell = 0; cell < f->grid->cell_count; cell++) {
        TL_ASSERT(limits[cell] >= 1 && limits[cell] <= f->blocks.count);
        f->limit[cell] = limits[cell];
        f->limit_total += limits[cell];
    }
    return true;
}

bool film_planned(const struct film *f)
{
    return f->planned;
}

const uint16_t *film_limits(const struct film *f)
{
    return f->limit;
}

void film_read_begin(struct film *f)
{
    f->readers++;
}

void film_read_end(struct film *f)
{
    TL_ASSERT(f->readers > 0);
    if (--f->readers > 0)
        return;
    struct film_wait *w = f->held;
    f->held = NULL;
    f->held_end = &f->held;
    while (w) {
        struct film_wait *next = w->next;
        place(f, w);
        w = next;
    }
}

/* --- Reading ------------------------------------------------------------ */

uint64_t film_half_samples(const struct film *f, uint32_t half, uint32_t cell)
{
    uint32_t blocks = f->next[half][cell], pilot = f->blocks.pilot / 2;
    if (blocks == 0)
        return 0;
    if (f->blocks.pilot == 0) {
        struct job_block last = job_block_at(&f->blocks, 2 * (blocks - 1) + half);
        return last.begin + last.count;
    }
    uint64_t samples = blocks > pilot ? job_ladder(blocks - pilot) : 0;
    if (!f->planned || f->pilot_kept) {
        uint32_t of_pilot = blocks < pilot ? blocks : pilot;
        struct job_block last = job_block_at(&f->blocks, 2 * (of_pilot - 1) + half);
        samples += last.begin + last.count;
    }
    return samples;
}

void film_picture(const struct film *f, float *rgb)
{
    const struct job_crop *crop = &f->grid->crop;
    for (uint32_t cell = 0; cell < f->grid->cell_count; cell++) {
        struct grid_rect r = grid_cell(f->grid, cell);
        uint64_t samples = film_half_samples(f, 0, cell) + film_half_samples(f, 1, cell);
        double count = samples ? (double)samples : 1.0;
        uint64_t from = f->cell_offset[cell];
        for (uint32_t y = 0; y < r.height; y++) {
            uint64_t row = (uint64_t)(r.y - crop->y + y) * crop->width + (r.x - crop->x);
            for (uint32_t x = 0; x < r.width; x++, from++)
                for (uint64_t c = 0; c < FILM_CHANNELS; c++)
                    rgb[(row + x) * FILM_CHANNELS + c] = (float)((f->sum[0][c * f->pixels + from] +
                                                                  f->sum[1][c * f->pixels + from]) /
                                                                 count);
        }
    }
}

/* Standard error of a pixel's mean over R, G and B, from the difference of its halves; 0 while one
 * of them has no sample. */
static double pixel_error(const struct film *f, uint64_t i, double na, double nb)
{
    double a = 0, b = 0;
    for (uint64_t c = 0; c < FILM_CHANNELS; c++) {
        a += f->sum[0][c * f->pixels + i];
        b += f->sum[1][c * f->pixels + i];
    }
    if (na == 0 || nb == 0)
        return 0;
    return sqrt(na * nb) / (na + nb) * fabs(a / na - b / nb) / FILM_CHANNELS;
}

static double aov_value(const struct film *f, enum film_aov kind, uint32_t plane, uint64_t i,
                        double na, double nb)
{
    double sum = 0;
    if (kind == FILM_AOV_SUM || kind == FILM_AOV_MEAN)
        sum = f->sum[0][plane * f->pixels + i] + f->sum[1][plane * f->pixels + i];
    switch (kind) {
    case FILM_AOV_SUM:
        return sum;
    case FILM_AOV_MEAN:
        return na + nb > 0 ? sum / (na + nb) : 0;
    case FILM_AOV_SAMPLES:
        return na + nb;
    case FILM_AOV_ERROR:
        return pixel_error(f, i, na, nb);
    }
    return 0;
}

void film_aov(const struct film *f, enum film_aov kind, uint32_t plane, float *out)
{
    TL_ASSERT(plane < f->grid->plane_count);
    const struct job_crop *crop = &f->grid->crop;
    for (uint32_t cell = 0; cell < f->grid->cell_count; cell++) {
        struct grid_rect r = grid_cell(f->grid, cell);
        double na = (double)film_half_samples(f, 0, cell),
               nb = (double)film_half_samples(f, 1, cell);
        uint64_t from = f->cell_offset[cell];
        for (uint32_t y = 0; y < r.height; y++) {
            uint64_t to = (uint64_t)(r.y - crop->y + y) * crop->width + (r.x - crop->x);
            for (uint32_t x = 0; x < r.width; x++)
                out[to++] = (float)aov_value(f, kind, plane, from++, na, nb);
        }
    }
}

void film_samples(const struct film *f, uint64_t *spp_min, double *spp_mean, uint64_t *spp_max)
{
    uint64_t lowest = UINT64_MAX, highest = 0;
    double total = 0;
    for (uint32_t cell = 0; cell < f->grid->cell_count; cell++) {
        uint64_t samples = film_half_samples(f, 0, cell) + film_half_samples(f, 1, cell);
        lowest = samples < lowest ? samples : lowest;
        highest = samples > highest ? samples : highest;
        total += (double)samples * (double)(f->cell_offset[cell + 1] - f->cell_offset[cell]);
    }
    *spp_min = lowest;
    *spp_max = highest;
    *spp_mean = total / (double)f->pixels;
}

void film_check(const struct film *f)
{
    uint64_t added = 0, present = 0, waiting_cells = 0;
    for (uint32_t half = 0; half < FILM_HALVES; half++)
        for (uint32_t cell = 0; cell < f->grid->cell_count; cell++) {
            TL_ASSERT(f->next[half][cell] <= film_half_blocks(f, half));
            added += f->next[half][cell];
            for (uint32_t i = 0; !f->held && i < f->next[half][cell]; i++)
                TL_ASSERT(is_present(f, 2 * i + half, cell));
        }
    for (uint32_t block = 0; block < f->blocks.count; block++) {
        for (const struct film_wait *w = f->waiting[block]; w; w = w->next) {
            TL_ASSERT(w->unit.block == block && w->cells_left > 0);
            waiting_cells += w->cells_left;
        }
        for (uint32_t cell = 0; cell < f->grid->cell_count; cell++)
            present += is_present(f, block, cell);
    }
    TL_ASSERT(added == f->added_count && present == f->present_count);
    TL_ASSERT(f->held || added + waiting_cells == present);
}
