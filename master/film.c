#include "master/film.h"

#include <math.h>
#include <string.h>

#include "common/mem.h"

/* A unit whose payload is not wholly in the sums. */
struct film_wait {
    struct film_wait *next;
    struct unit unit;
    uint32_t cells_left; /* neither added nor dropped yet */
    uint64_t pixels;
    /* Owned; planes of `pixels` finite floats. A cell that was dropped by a reset has a NaN for its
     * first value. NULL: the entry is a held-back reset of the unit's cells. */
    float *values;
};

struct film {
    const struct grid *grid; /* borrowed */
    struct job_blocks blocks;
    uint64_t pixels;
    uint64_t *cell_offset;       /* cell_count + 1: first pixel of a cell in grid order */
    double *sum[FILM_HALVES];    /* grid->plane_count planes of `pixels` */
    uint16_t *next[FILM_HALVES]; /* per cell: blocks of the half that are added */
    uint64_t *present;           /* bit block * cell_count + cell */
    struct film_wait *waiting[JOB_BLOCKS_MAX];
    struct film_wait *held, **held_end; /* arrived while somebody reads, oldest first */
    uint32_t readers;
    uint64_t added_count, present_count; /* cell-blocks */
    uint64_t waiting_bytes;
};

_Static_assert(JOB_BLOCKS_MAX / 2 <= UINT16_MAX, "next[] counts blocks of a half");

static uint32_t half_of(uint32_t block)
{
    return block & 1;
}

/* Blocks of a half. */
static uint32_t half_blocks(const struct film *f, uint32_t half)
{
    return (f->blocks.count + 1 - half) / 2;
}

uint64_t film_bytes_of(const struct job_spec *spec)
{
    uint64_t pixels = (uint64_t)spec->crop.width * spec->crop.height;
    return pixels * FILM_HALVES * job_plane_count(spec) * sizeof(double);
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
    f->cell_offset = mem_alloc_array((size_t)grid->cell_count + 1, sizeof *f->cell_offset);
    uint64_t bits = film_total_count(f);
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
    mem_free(f);
}

/* --- Presence ----------------------------------------------------------- */

static bool is_present(const struct film *f, uint32_t block, uint32_t cell)
{
    uint64_t bit = (uint64_t)block * f->grid->cell_count + cell;
    return f->present[bit / 64] >> (bit % 64) & 1;
}

static void set_present(struct film *f, struct unit u)
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
    return (uint64_t)f->grid->cell_count * f->blocks.count;
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
    for (uint32_t plane = 0; plane < f->grid->plane_count; plane++) {
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

/* True while the cell of a waiting unit is neither in the sums nor dropped. */
static bool is_left(const struct film *f, const struct film_wait *w, uint32_t cell)
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
            w->cells_left -= is_left(f, w, cell);
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
    set_present(f, unit);
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

/* Samples of one half that are in the sums of a cell. */
static uint64_t half_samples(const struct film *f, uint32_t half, uint32_t cell)
{
    uint32_t blocks = f->next[half][cell];
    if (blocks == 0)
        return 0;
    struct job_block last = job_block_at(&f->blocks, 2 * (blocks - 1) + half);
    return last.begin + last.count;
}

void film_picture(const struct film *f, float *rgb)
{
    const struct job_crop *crop = &f->grid->crop;
    for (uint32_t cell = 0; cell < f->grid->cell_count; cell++) {
        struct grid_rect r = grid_cell(f->grid, cell);
        uint64_t samples = half_samples(f, 0, cell) + half_samples(f, 1, cell);
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
        double na = (double)half_samples(f, 0, cell), nb = (double)half_samples(f, 1, cell);
        uint64_t from = f->cell_offset[cell];
        for (uint32_t y = 0; y < r.height; y++) {
            uint64_t to = (uint64_t)(r.y - crop->y + y) * crop->width + (r.x - crop->x);
            for (uint32_t x = 0; x < r.width; x++)
                out[to++] = (float)aov_value(f, kind, plane, from++, na, nb);
        }
    }
}

/* Mean over all pixels and channels of the picture so far. */
static double picture_mean(const struct film *f)
{
    double total = 0;
    for (uint32_t cell = 0; cell < f->grid->cell_count; cell++) {
        double count = (double)(half_samples(f, 0, cell) + half_samples(f, 1, cell));
        for (uint64_t i = f->cell_offset[cell]; i < f->cell_offset[cell + 1]; i++)
            for (uint64_t c = 0; c < FILM_CHANNELS; c++)
                total += (f->sum[0][c * f->pixels + i] + f->sum[1][c * f->pixels + i]) / count;
    }
    return total / ((double)f->pixels * FILM_CHANNELS);
}

/* What the pixels of one square of the full picture, ERROR_SQUARE pixels a side, add up to. Pixels
 * of a square may share paths, so their errors go together; squares are independent. */
struct error_square {
    double term;       /* of relMSE */
    double difference; /* of the halves' means, signed, weighted so that its square is a variance */
};
enum { ERROR_SQUARE = 16 };

static void add_pixel_error(const struct film *f, uint64_t i, double na, double nb, double floor_m,
                            struct error_square *square)
{
    double weight = na * nb / ((na + nb) * (na + nb));
    double term = 0, mean_difference = 0;
    for (uint64_t c = 0; c < FILM_CHANNELS; c++) {
        double a = f->sum[0][c * f->pixels + i], b = f->sum[1][c * f->pixels + i];
        double x = (a + b) / (na + nb), difference = a / na - b / nb;
        double below = x * x + floor_m;
        if (below > 0)
            term += weight * difference * difference / below / FILM_CHANNELS;
        mean_difference += difference / FILM_CHANNELS;
    }
    square->term += term;
    square->difference += sqrt(weight) * mean_difference;
}

/* Which squares the crop meets. */
struct error_grid {
    uint32_t column0, row0, columns;
    size_t count;
};

static struct error_grid error_grid_of(const struct job_crop *crop)
{
    struct error_grid g = {.column0 = crop->x / ERROR_SQUARE, .row0 = crop->y / ERROR_SQUARE};
    g.columns = (crop->x + crop->width - 1) / ERROR_SQUARE - g.column0 + 1;
    uint32_t rows = (crop->y + crop->height - 1) / ERROR_SQUARE - g.row0 + 1;
    g.count = (size_t)g.columns * rows;
    return g;
}

static void add_cell_error(const struct film *f, uint32_t cell, double floor_m,
                           const struct error_grid *squares, struct error_square *sums)
{
    double na = (double)half_samples(f, 0, cell), nb = (double)half_samples(f, 1, cell);
    struct grid_rect r = grid_cell(f->grid, cell);
    uint64_t i = f->cell_offset[cell];
    for (uint32_t y = r.y; y < r.y + r.height; y++) {
        for (uint32_t x = r.x; x < r.x + r.width; x++) {
            size_t column = x / ERROR_SQUARE - squares->column0;
            size_t row = y / ERROR_SQUARE - squares->row0;
            add_pixel_error(f, i++, na, nb, floor_m, &sums[row * squares->columns + column]);
        }
    }
}

/* Student's 97.5 % quantile (Abramowitz and Stegun 26.7.5, two terms); few squares know little. */
static double student_quantile(double degrees)
{
    const double z = 1.959964, z3 = z * z * z, z5 = z3 * z * z;
    return z + (z3 + z) / (4 * degrees) + (5 * z5 + 16 * z3 + 3 * z) / (96 * degrees * degrees);
}

/* The picture's error and interval from the sums of its squares. */
static struct film_error error_of_squares(const struct error_square *sums, size_t count,
                                          double pixels, double mean)
{
    double term = 0, spread = 0, mean_variance = 0;
    for (size_t i = 0; i < count; i++)
        term += sums[i].term;
    for (size_t i = 0; i < count; i++) {
        double apart = sums[i].term - term / (double)count;
        spread += apart * apart;
        mean_variance += sums[i].difference * sums[i].difference;
    }
    /* One square knows nothing of its spread: as large as itself. */
    double variance = count > 1 ? spread * (double)count / (double)(count - 1) : term * term;
    double degrees = count > 1 ? (double)(count - 1) : 1;
    double relmse = term / pixels;
    double relmse_error = student_quantile(degrees) * sqrt(variance) / pixels;
    double mean_error = student_quantile((double)count) * sqrt(mean_variance) / pixels;
    return (struct film_error){
        .known = isfinite(relmse) && isfinite(mean),
        .relmse = relmse,
        .relmse_low = relmse > relmse_error ? relmse - relmse_error : 0,
        .relmse_high = relmse + relmse_error,
        .mean = mean,
        .mean_low = mean - mean_error,
        .mean_high = mean + mean_error,
    };
}

void film_error_estimate(const struct film *f, struct film_error *out)
{
    *out = (struct film_error){0};
    for (uint32_t cell = 0; cell < f->grid->cell_count; cell++)
        if (f->next[0][cell] == 0 || f->next[1][cell] == 0)
            return;
    struct error_grid squares = error_grid_of(&f->grid->crop);
    struct error_square *sums = mem_calloc(squares.count, sizeof *sums);
    if (!sums)
        return;
    double mean = picture_mean(f);
    for (uint32_t cell = 0; cell < f->grid->cell_count; cell++)
        add_cell_error(f, cell, 0.01 * mean * mean, &squares, sums);
    *out = error_of_squares(sums, squares.count, (double)f->pixels, mean);
    mem_free(sums);
}

void film_samples(const struct film *f, uint64_t *spp_min, double *spp_mean, uint64_t *spp_max)
{
    uint64_t lowest = UINT64_MAX, highest = 0;
    double total = 0;
    for (uint32_t cell = 0; cell < f->grid->cell_count; cell++) {
        uint64_t samples = half_samples(f, 0, cell) + half_samples(f, 1, cell);
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
            TL_ASSERT(f->next[half][cell] <= half_blocks(f, half));
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

/* --- Saving ------------------------------------------------------------- */

/* Layout, little-endian: magic, block_count, AOV planes, pixels, spp, cell_count, unit count; then
 * next[] and sums of half 0 and 1; then per waiting unit begin, count, block and its planes. */
enum { FILM_MAGIC = 0x314d4c46 /* "FLM1" */ };

struct film_header {
    uint32_t magic;
    uint16_t block_count, aov_planes;
    uint64_t pixels, spp;
    uint32_t cell_count, unit_count;
};
_Static_assert(sizeof(struct film_header) == 32, "written as it lies");
_Static_assert(JOB_BLOCKS_MAX <= UINT16_MAX, "block_count");

/* The next run of cells of a waiting unit, from `cell` on, that are not in the sums. */
static bool left_run(const struct film *f, const struct film_wait *w, uint32_t cell,
                     struct unit *run)
{
    uint32_t end = w->unit.cell_begin + w->unit.cell_count;
    while (cell < end && !is_left(f, w, cell))
        cell++;
    uint32_t begin = cell;
    while (cell < end && is_left(f, w, cell))
        cell++;
    *run = (struct unit){begin, cell - begin, w->unit.block};
    return cell > begin;
}

static uint32_t waiting_runs(const struct film *f)
{
    uint32_t count = 0;
    struct unit run;
    for (uint32_t block = 0; block < f->blocks.count; block++)
        for (const struct film_wait *w = f->waiting[block]; w; w = w->next)
            for (uint32_t cell = w->unit.cell_begin; left_run(f, w, cell, &run);
                 cell = run.cell_begin + run.cell_count)
                count++;
    return count;
}

static enum err save_unit(const struct film *f, const struct film_wait *w,
                          enum err (*write)(void *ctx, const void *data, size_t bytes), void *ctx)
{
    struct unit run;
    for (uint32_t cell = w->unit.cell_begin; left_run(f, w, cell, &run);
         cell = run.cell_begin + run.cell_count) {
        uint64_t first = f->cell_offset[run.cell_begin];
        uint64_t pixels = f->cell_offset[run.cell_begin + run.cell_count] - first;
        uint64_t from = first - f->cell_offset[w->unit.cell_begin];
        TL_TRY(write(ctx, &run, sizeof run));
        for (uint64_t c = 0; c < f->grid->plane_count; c++)
            TL_TRY(write(ctx, w->values + c * w->pixels + from, pixels * sizeof(float)));
    }
    return ERR_OK;
}

static struct film_header header_of(const struct film *f)
{
    return (struct film_header){.magic = FILM_MAGIC,
                                .block_count = (uint16_t)f->blocks.count,
                                .aov_planes = (uint16_t)(f->grid->plane_count - FILM_CHANNELS),
                                .pixels = f->pixels,
                                .spp = f->blocks.spp,
                                .cell_count = f->grid->cell_count};
}

enum err film_save(const struct film *f,
                   enum err (*write)(void *ctx, const void *data, size_t bytes), void *ctx)
{
    struct film_header header = header_of(f);
    header.unit_count = waiting_runs(f);
    TL_TRY(write(ctx, &header, sizeof header));
    for (int half = 0; half < FILM_HALVES; half++) {
        TL_TRY(write(ctx, f->next[half], f->grid->cell_count * sizeof *f->next[half]));
        TL_TRY(write(ctx, f->sum[half], f->pixels * f->grid->plane_count * sizeof(double)));
    }
    for (uint32_t block = 0; block < f->blocks.count; block++)
        for (const struct film_wait *w = f->waiting[block]; w; w = w->next)
            TL_TRY(save_unit(f, w, write, ctx));
    return ERR_OK;
}

static enum err load_sums(struct film *f, enum err (*read)(void *ctx, void *data, size_t bytes),
                          void *ctx)
{
    for (uint32_t half = 0; half < FILM_HALVES; half++) {
        TL_TRY(read(ctx, f->next[half], f->grid->cell_count * sizeof *f->next[half]));
        TL_TRY(read(ctx, f->sum[half], f->pixels * f->grid->plane_count * sizeof(double)));
        for (uint32_t cell = 0; cell < f->grid->cell_count; cell++) {
            if (f->next[half][cell] > half_blocks(f, half))
                return ERR_CORRUPT;
            for (uint32_t i = 0; i < f->next[half][cell]; i++)
                set_present(f, (struct unit){cell, 1, 2 * i + half});
            f->added_count += f->next[half][cell];
        }
        for (uint64_t i = 0; i < f->pixels * f->grid->plane_count; i++)
            if (!isfinite(f->sum[half][i]))
                return ERR_CORRUPT;
    }
    return ERR_OK;
}

static enum err load_unit(struct film *f, enum err (*read)(void *ctx, void *data, size_t bytes),
                          void *ctx)
{
    struct unit unit;
    TL_TRY(read(ctx, &unit, sizeof unit));
    if (!grid_has_unit(f->grid, &f->blocks, unit))
        return ERR_CORRUPT;
    uint64_t pixels =
        f->cell_offset[unit.cell_begin + unit.cell_count] - f->cell_offset[unit.cell_begin];
    float *values = mem_alloc_array(pixels, f->grid->plane_count * sizeof(float));
    if (!values)
        return ERR_NOMEM;
    enum err e = read(ctx, values, pixels * f->grid->plane_count * sizeof(float));
    for (uint64_t i = 0; e == ERR_OK && i < pixels * f->grid->plane_count; i++)
        if (!isfinite(values[i]))
            e = ERR_CORRUPT;
    if (e == ERR_OK)
        e = film_add(f, unit, values);
    if (e == ERR_STATE)
        e = ERR_CORRUPT;
    if (e != ERR_OK)
        mem_free(values);
    return e;
}

enum err film_load(const struct grid *grid, const struct job_blocks *blocks,
                   enum err (*read)(void *ctx, void *data, size_t bytes), void *ctx,
                   struct film **out)
{
    struct film_header header;
    TL_TRY(read(ctx, &header, sizeof header));
    struct film *f = NULL;
    TL_TRY(film_new(grid, blocks, &f));
    struct film_header expected = header_of(f);
    expected.unit_count = header.unit_count;
    enum err e = memcmp(&header, &expected, sizeof header) == 0 ? ERR_OK : ERR_CORRUPT;
    if (e == ERR_OK)
        e = load_sums(f, read, ctx);
    for (uint32_t i = 0; e == ERR_OK && i < header.unit_count; i++)
        e = load_unit(f, read, ctx);
    if (e != ERR_OK) {
        film_free(f);
        return e;
    }
    *out = f;
    return ERR_OK;
}
