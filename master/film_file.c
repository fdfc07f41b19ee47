/* A film as bytes and back: see film.h. */
#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "master/film_impl.h"

/* Layout, little-endian: magic, block_count, AOV planes, pixels, spp, cell_count, unit count; then
 * next[] and sums of half 0 and 1; then per waiting unit begin, count, block and its planes. */
enum {
    FILM_MAGIC = 0x314d4c46,      /* "FLM1" */
    FILM_MAGIC_PLAN = 0x324d4c46, /* "FLM2": with u32 planned, u32 pilot kept and the limits behind
                                     the header */
};

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
    while (cell < end && !film_is_left(f, w, cell))
        cell++;
    uint32_t begin = cell;
    while (cell < end && film_is_left(f, w, cell))
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
    return (struct film_header){.magic = f->limit ? FILM_MAGIC_PLAN : FILM_MAGIC,
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
    if (f->limit) {
        uint32_t flags[2] = {f->planned, f->pilot_kept};
        TL_TRY(write(ctx, flags, sizeof flags));
        TL_TRY(write(ctx, f->limit, f->grid->cell_count * sizeof *f->limit));
    }
    for (int half = 0; half < FILM_HALVES; half++) {
        TL_TRY(write(ctx, f->next[half], f->grid->cell_count * sizeof *f->next[half]));
        TL_TRY(write(ctx, f->sum[half], f->pixels * f->grid->plane_count * sizeof(double)));
    }
    for (uint32_t block = 0; block < f->blocks.count; block++)
        for (const struct film_wait *w = f->waiting[block]; w; w = w->next)
            TL_TRY(save_unit(f, w, write, ctx));
    return ERR_OK;
}

static enum err load_limits(struct film *f, enum err (*read)(void *ctx, void *data, size_t bytes),
                            void *ctx)
{
    uint32_t flags[2];
    TL_TRY(read(ctx, flags, sizeof flags));
    TL_TRY(read(ctx, f->limit, f->grid->cell_count * sizeof *f->limit));
    if (flags[0] > 1 || flags[1] > flags[0])
        return ERR_CORRUPT;
    f->planned = flags[0];
    f->pilot_kept = flags[1];
    f->limit_total = 0;
    for (uint32_t cell = 0; cell < f->grid->cell_count; cell++) {
        if (f->limit[cell] == 0 || f->limit[cell] > f->blocks.count)
            return ERR_CORRUPT;
        f->limit_total += f->limit[cell];
    }
    return ERR_OK;
}

static enum err load_sums(struct film *f, enum err (*read)(void *ctx, void *data, size_t bytes),
                          void *ctx)
{
    for (uint32_t half = 0; half < FILM_HALVES; half++) {
        TL_TRY(read(ctx, f->next[half], f->grid->cell_count * sizeof *f->next[half]));
        TL_TRY(read(ctx, f->sum[half], f->pixels * f->grid->plane_count * sizeof(double)));
        for (uint32_t cell = 0; cell < f->grid->cell_count; cell++) {
            if (f->next[half][cell] > film_half_blocks(f, half))
                return ERR_CORRUPT;
            for (uint32_t i = 0; i < f->next[half][cell]; i++)
                film_set_present(f, (struct unit){cell, 1, 2 * i + half});
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
    if (e == ERR_OK && f->limit)
        e = load_limits(f, read, ctx);
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
