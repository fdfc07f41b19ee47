#include "master/provenance.h"

#include <string.h>

#include "common/mem.h"

/* Open checks are at most the scheduler's; more in a file is damage. */
enum { CHECKS_MAX = 1 << 22 };

static size_t spot_count(const struct provenance *p)
{
    return (size_t)p->cell_count * p->block_count;
}

static bool unit_equal(struct unit a, struct unit b)
{
    return a.cell_begin == b.cell_begin && a.cell_count == b.cell_count && a.block == b.block;
}

static bool has_unit(const struct provenance *p, struct unit u)
{
    return u.cell_count > 0 && u.cell_begin < p->cell_count &&
           u.cell_count <= p->cell_count - u.cell_begin && u.block < p->block_count;
}

enum err provenance_init(struct provenance *p, uint32_t cell_count, uint32_t block_count)
{
    *p = (struct provenance){.cell_count = cell_count, .block_count = block_count};
    p->hash = mem_calloc(spot_count(p), sizeof *p->hash);
    p->worker = mem_calloc(spot_count(p), sizeof *p->worker);
    if (p->hash && p->worker)
        return ERR_OK;
    provenance_release(p);
    return ERR_NOMEM;
}

void provenance_release(struct provenance *p)
{
    mem_free(p->hash);
    mem_free(p->worker);
    mem_free(p->checks);
    *p = (struct provenance){0};
}

enum err provenance_copy(const struct provenance *p, struct provenance *out)
{
    TL_TRY(provenance_init(out, p->cell_count, p->block_count));
    memcpy(out->hash, p->hash, spot_count(p) * sizeof *p->hash);
    memcpy(out->worker, p->worker, spot_count(p) * sizeof *p->worker);
    for (size_t i = 0; i < p->check_count; i++) {
        enum err e = provenance_open_check(out, p->checks[i]);
        if (e != ERR_OK) {
            provenance_release(out);
            return e;
        }
    }
    return ERR_OK;
}

void provenance_note(struct provenance *p, struct unit run, uint32_t worker,
                     const uint64_t *cell_hash)
{
    TL_ASSERT(has_unit(p, run));
    size_t first = (size_t)run.block * p->cell_count + run.cell_begin;
    for (uint32_t i = 0; i < run.cell_count; i++) {
        p->hash[first + i] = cell_hash[i];
        p->worker[first + i] = worker;
    }
}

void provenance_reset(struct provenance *p, uint32_t cell_begin, uint32_t cell_count)
{
    TL_ASSERT(has_unit(p, (struct unit){cell_begin, cell_count, 0}));
    for (size_t block = 0; block < p->block_count; block++) {
        size_t first = block * p->cell_count + cell_begin;
        memset(p->hash + first, 0, cell_count * sizeof *p->hash);
        memset(p->worker + first, 0, cell_count * sizeof *p->worker);
    }
    size_t kept = 0;
    for (size_t i = 0; i < p->check_count; i++) {
        struct unit u = p->checks[i];
        bool touches =
            u.cell_begin < cell_begin + cell_count && cell_begin < u.cell_begin + u.cell_count;
        if (!touches)
            p->checks[kept++] = u;
    }
    p->check_count = kept;
}

void provenance_widen(const struct provenance *p, uint32_t *cell_begin, uint32_t *cell_count)
{
    uint32_t begin = *cell_begin, end = begin + *cell_count;
    for (bool wider = true; wider;) {
        wider = false;
        for (size_t i = 0; i < p->check_count; i++) {
            uint32_t from = p->checks[i].cell_begin, to = from + p->checks[i].cell_count;
            if (from >= end || to <= begin || (from >= begin && to <= end))
                continue;
            begin = from < begin ? from : begin;
            end = to > end ? to : end;
            wider = true;
        }
    }
    *cell_begin = begin;
    *cell_count = end - begin;
}

bool provenance_touched(const struct provenance *p, uint32_t worker, uint32_t cell)
{
    for (size_t block = 0; block < p->block_count; block++)
        if (p->worker[block * p->cell_count + cell] == worker)
            return true;
    return false;
}

enum err provenance_open_check(struct provenance *p, struct unit unit)
{
    TL_ASSERT(has_unit(p, unit));
    for (size_t i = 0; i < p->check_count; i++)
        if (unit_equal(p->checks[i], unit))
            return ERR_OK;
    if (!mem_grow((void **)&p->checks, p->check_count, &p->check_capacity, sizeof *p->checks))
        return ERR_NOMEM;
    p->checks[p->check_count++] = unit;
    return ERR_OK;
}

void provenance_close_check(struct provenance *p, struct unit unit)
{
    size_t kept = 0;
    for (size_t i = 0; i < p->check_count; i++)
        if (!unit_equal(p->checks[i], unit))
            p->checks[kept++] = p->checks[i];
    p->check_count = kept;
}

bool provenance_of_unit(const struct provenance *p, struct unit unit, uint32_t *worker,
                        uint64_t *hash)
{
    if (!has_unit(p, unit))
        return false;
    size_t first = (size_t)unit.block * p->cell_count + unit.cell_begin;
    *worker = p->worker[first];
    *hash = 0;
    for (uint32_t i = 0; i < unit.cell_count; i++) {
        if (p->worker[first + i] != *worker || p->hash[first + i] == 0)
            return false;
        *hash = provenance_fold(*hash, p->hash[first + i]);
    }
    return *worker != 0;
}

uint64_t provenance_fold(uint64_t so_far, uint64_t cell_hash)
{
    uint64_t mixed = (so_far ^ cell_hash) * UINT64_C(0x9e3779b97f4a7c15);
    return mixed ^ (mixed >> 29);
}

enum err provenance_save(const struct provenance *p,
                         enum err (*write)(void *ctx, const void *data, size_t bytes), void *ctx)
{
    uint32_t head[4] = {0};
    if (p && p->cell_count > 0) {
        head[0] = p->cell_count;
        head[1] = p->block_count;
        head[2] = (uint32_t)p->check_count;
    }
    TL_TRY(write(ctx, head, sizeof head));
    if (head[0] == 0)
        return ERR_OK;
    TL_TRY(write(ctx, p->hash, spot_count(p) * sizeof *p->hash));
    TL_TRY(write(ctx, p->worker, spot_count(p) * sizeof *p->worker));
    return write(ctx, p->checks, p->check_count * sizeof *p->checks);
}

static enum err load_checks(struct provenance *p, uint32_t count,
                            enum err (*read)(void *ctx, void *data, size_t bytes), void *ctx)
{
    for (uint32_t i = 0; i < count; i++) {
        struct unit unit;
        TL_TRY(read(ctx, &unit, sizeof unit));
        if (!has_unit(p, unit))
            return ERR_CORRUPT;
        TL_TRY(provenance_open_check(p, unit));
    }
    return ERR_OK;
}

enum err provenance_load(uint32_t cell_count, uint32_t block_count,
                         enum err (*read)(void *ctx, void *data, size_t bytes), void *ctx,
                         struct provenance *out)
{
    uint32_t head[4];
    struct provenance p = {0};
    TL_TRY(read(ctx, head, sizeof head));
    if (head[0] == 0) {
        *out = p;
        return ERR_OK;
    }
    if (head[0] != cell_count || head[1] != block_count || head[2] > CHECKS_MAX)
        return ERR_CORRUPT;
    TL_TRY(provenance_init(&p, cell_count, block_count));
    enum err e = read(ctx, p.hash, spot_count(&p) * sizeof *p.hash);
    if (e == ERR_OK)
        e = read(ctx, p.worker, spot_count(&p) * sizeof *p.worker);
    if (e == ERR_OK)
        e = load_checks(&p, head[2], read, ctx);
    if (e != ERR_OK) {
        provenance_release(&p);
        return e;
    }
    *out = p;
    return ERR_OK;
}
