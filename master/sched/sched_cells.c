/* The spots of one job: which are open, who owns them, what they cost. */
#include "master/sched/sched_impl.h"

#include <string.h>

_Static_assert(SCHED_WINDOW >= 2 && SCHED_WINDOW < 32, "done spots of a window fit a mask");
_Static_assert(JOB_BLOCKS_MAX <= UINT16_MAX, "a frontier fits 16 bits");
_Static_assert(GRID_CELLS_MAX <= 1 << 24, "cellset holds the cells of a grid");
_Static_assert(JOB_BLOCKS_MAX % 64 == 0, "waiting_blocks has whole words");

static size_t align64(size_t bytes)
{
    return (bytes + 63) & ~(size_t)63;
}

size_t sched_job_bytes(uint32_t cell_count, uint32_t block_count)
{
    if (cell_count == 0 || cell_count > GRID_CELLS_MAX || block_count == 0 ||
        block_count > JOB_BLOCKS_MAX)
        return 0;
    struct cellset_shape shape = cellset_shape_of(cell_count);
    return align64((size_t)cell_count * SCHED_WINDOW * sizeof(uint32_t)) +
           align64((size_t)cell_count * sizeof(float)) +
           align64((size_t)cell_count * sizeof(uint16_t)) +
           align64((size_t)block_count * shape.word_count * sizeof(uint64_t)) +
           align64((size_t)block_count * sizeof(uint32_t));
}

static void *carve(uint8_t **at, size_t bytes)
{
    void *p = *at;
    *at += align64(bytes);
    return p;
}

void job_cells_init(struct job *j, const struct sched_job_add *add)
{
    TL_ASSERT(add->memory && ((uintptr_t)add->memory & 63) == 0);
    j->cell_count = add->cell_count;
    j->block_count = add->block_count;
    j->shape = cellset_shape_of(add->cell_count);
    memset(add->memory, 0, sched_job_bytes(add->cell_count, add->block_count));
    uint8_t *at = add->memory;
    size_t cells = add->cell_count, blocks = add->block_count;
    j->owner = carve(&at, cells * SCHED_WINDOW * sizeof *j->owner);
    j->cost_s = carve(&at, cells * sizeof *j->cost_s);
    j->frontier = carve(&at, cells * sizeof *j->frontier);
    j->waiting = carve(&at, blocks * j->shape.word_count * sizeof *j->waiting);
    j->waiting_count = carve(&at, blocks * sizeof *j->waiting_count);

    /* The first blocks of every cell wait, the others are shut. */
    uint32_t open = add->block_count < SCHED_WINDOW ? add->block_count : SCHED_WINDOW;
    for (size_t i = 0; i < cells * SCHED_WINDOW; i++)
        j->owner[i] = i % SCHED_WINDOW < open ? OWNER_NONE : OWNER_DONE;
    for (uint32_t b = 0; b < open; b++) {
        cellset_fill(&j->shape, j->waiting + (size_t)b * j->shape.word_count);
        j->waiting_count[b] = add->cell_count;
        j->waiting_blocks[0] |= UINT64_C(1) << b;
    }
    j->spots = (struct spot_counts){.waiting = (uint64_t)open * cells};
}

uint64_t job_spot_count(const struct job *j)
{
    return (uint64_t)j->cell_count * j->block_count;
}

uint32_t *job_spot_owner(const struct job *j, uint32_t cell, uint32_t block)
{
    TL_DASSERT(cell < j->cell_count && block < j->block_count);
    return &j->owner[(size_t)cell * SCHED_WINDOW + block % SCHED_WINDOW];
}

enum spot_state job_spot_state(const struct job *j, uint32_t cell, uint32_t block)
{
    uint32_t frontier = j->frontier[cell];
    if (block < frontier)
        return SPOT_DONE;
    if (block >= frontier + SCHED_WINDOW)
        return SPOT_SHUT;
    uint32_t owner = *job_spot_owner(j, cell, block);
    if (owner == OWNER_NONE)
        return SPOT_WAITING;
    return owner == OWNER_DONE ? SPOT_DONE : SPOT_LEASED;
}

static uint64_t *waiting_set(const struct job *j, uint32_t block)
{
    return j->waiting + (size_t)block * j->shape.word_count;
}

static void waiting_add(struct job *j, uint32_t cell, uint32_t block)
{
    cellset_add(&j->shape, waiting_set(j, block), cell);
    if (j->waiting_count[block]++ == 0)
        j->waiting_blocks[block / 64] |= UINT64_C(1) << (block % 64);
    j->spots.waiting++;
}

static void waiting_remove(struct job *j, uint32_t cell, uint32_t block)
{
    cellset_remove(&j->shape, waiting_set(j, block), cell);
    if (--j->waiting_count[block] == 0)
        j->waiting_blocks[block / 64] &= ~(UINT64_C(1) << (block % 64));
    j->spots.waiting--;
}

uint32_t job_waiting_run(const struct job *j, uint32_t cells_max, struct unit *out)
{
    for (uint32_t i = 0; i < JOB_BLOCKS_MAX / 64; i++) {
        if (j->waiting_blocks[i] == 0)
            continue;
        uint32_t block = i * 64 + (uint32_t)__builtin_ctzll(j->waiting_blocks[i]);
        const uint64_t *set = waiting_set(j, block);
        uint32_t cell = cellset_next(&j->shape, set, 0);
        TL_ASSERT(cell < j->cell_count);
        *out = (struct unit){.cell_begin = cell,
                             .cell_count = cellset_run(&j->shape, set, cell, cells_max),
                             .block = block};
        return out->cell_count;
    }
    return 0;
}

void job_spot_take(struct job *j, uint32_t cell, uint32_t block, uint32_t owner)
{
    TL_DASSERT(job_spot_state(j, cell, block) == SPOT_WAITING);
    waiting_remove(j, cell, block);
    j->spots.leased++;
    *job_spot_owner(j, cell, block) = owner;
}

void job_spot_give_back(struct job *j, uint32_t cell, uint32_t block)
{
    TL_DASSERT(job_spot_state(j, cell, block) == SPOT_LEASED);
    j->spots.leased--;
    *job_spot_owner(j, cell, block) = OWNER_NONE;
    waiting_add(j, cell, block);
}

/* --- What is left, by measured cost -------------------------------------- */

static uint32_t window_end(const struct job *j, uint32_t frontier)
{
    uint32_t end = frontier + SCHED_WINDOW;
    return end < j->block_count ? end : j->block_count;
}

/* Bit i: block frontier + i is done. */
static uint32_t done_ahead(const struct job *j, uint32_t cell)
{
    uint32_t frontier = j->frontier[cell], mask = 0;
    for (uint32_t b = frontier; b < window_end(j, frontier); b++) {
        if (*job_spot_owner(j, cell, b) == OWNER_DONE)
            mask |= UINT32_C(1) << (b - frontier);
    }
    return mask;
}

/* Adds (sign 1) or takes off (sign -1) a measured cell's share of what is left. */
void job_known_update(struct job *j, uint32_t cell, int sign)
{
    double cost_s = (double)j->cost_s[cell];
    if (cost_s <= 0.0)
        return;
    uint32_t left =
        j->block_count - j->frontier[cell] - (uint32_t)__builtin_popcount(done_ahead(j, cell));
    if (sign > 0) {
        j->known_spots += left;
        j->known_s += left * cost_s;
        return;
    }
    TL_ASSERT(j->known_spots >= left);
    j->known_spots -= left;
    j->known_s -= left * cost_s;
    /* Sums of floats drift: forget the rest where there is none. */
    if (j->known_spots == 0 || j->known_s < 0.0)
        j->known_s = 0.0;
}

static double spot_mean_s(const struct job *j)
{
    return j->measured_spots ? j->committed_s / (double)j->measured_spots : 0.0;
}

double job_cell_seconds(const struct job *j, uint32_t cell)
{
    double cost_s = (double)j->cost_s[cell];
    return cost_s > 0.0 ? cost_s : spot_mean_s(j);
}

double job_left_seconds(const struct job *j, double *unknown_s)
{
    uint64_t unknown = job_spot_count(j) - j->spots.done - j->known_spots;
    *unknown_s = (double)unknown * spot_mean_s(j);
    return j->known_s + *unknown_s;
}

double job_done_share(const struct job *j)
{
    uint64_t total = job_spot_count(j);
    if (j->spots.done == total)
        return 1.0;
    double mean_s = spot_mean_s(j);
    if (mean_s <= 0.0)
        return (double)j->spots.done / (double)total;
    /* Spots restored from an earlier life have no measure and count as average. */
    double restored = (double)j->spots.done - (double)j->measured_spots;
    double done_s = j->committed_s + (restored > 0.0 ? restored * mean_s : 0.0);
    double unknown_s, left_s = job_left_seconds(j, &unknown_s);
    return done_s / (done_s + left_s);
}

void job_progress_update(struct job *j)
{
    double share = job_done_share(j);
    if (share > j->done_shown)
        j->done_shown = share;
}

static void measure(struct job *j, uint32_t cell, double cost_s)
{
    double old_s = (double)j->cost_s[cell];
    j->cost_s[cell] = (float)(old_s > 0.0 ? 0.5 * (old_s + cost_s) : cost_s);
    j->committed_s += cost_s;
    j->measured_spots++;
}

/* --- Done and undone ------------------------------------------------------ */

void job_spot_finish(struct sched *s, struct job *j, uint32_t cell, uint32_t block, double cost_s)
{
    job_known_update(j, cell, -1);
    uint32_t *owner = job_spot_owner(j, cell, block);
    switch (job_spot_state(j, cell, block)) {
    case SPOT_WAITING:
        waiting_remove(j, cell, block);
        break;
    case SPOT_LEASED:
        j->spots.leased--;
        lease_spot_lost(s, *owner);
        break;
    case SPOT_SHUT:
    case SPOT_DONE:
        TL_ASSERT(false); /* only an open spot can be finished */
    }
    *owner = OWNER_DONE;
    j->spots.done++;

    /* Each block that closes at the frontier opens one at the far end of the window. */
    while (j->frontier[cell] < j->block_count &&
           *job_spot_owner(j, cell, j->frontier[cell]) == OWNER_DONE) {
        uint32_t opened = (uint32_t)j->frontier[cell]++ + SCHED_WINDOW;
        if (opened < j->block_count) {
            *job_spot_owner(j, cell, opened) = OWNER_NONE;
            waiting_add(j, cell, opened);
        }
    }
    if (cost_s > 0.0)
        measure(j, cell, cost_s);
    job_known_update(j, cell, 1);
}

/* Takes a cell's open spots from whoever has them; gives the mask of those done. */
static uint32_t cell_close(struct sched *s, struct job *j, uint32_t cell)
{
    uint32_t frontier = j->frontier[cell], mask = done_ahead(j, cell);
    job_known_update(j, cell, -1);
    for (uint32_t b = frontier; b < window_end(j, frontier); b++) {
        uint32_t *owner = job_spot_owner(j, cell, b);
        if (*owner == OWNER_NONE) {
            waiting_remove(j, cell, b);
        } else if (*owner != OWNER_DONE) {
            j->spots.leased--;
            lease_spot_lost(s, *owner);
        }
        *owner = OWNER_DONE;
    }
    j->spots.done -= frontier + (uint32_t)__builtin_popcount(mask);
    return mask;
}

static void cell_open(struct job *j, uint32_t cell, uint32_t frontier, uint32_t mask)
{
    while (mask & 1) {
        mask >>= 1;
        frontier++;
    }
    j->frontier[cell] = (uint16_t)frontier;
    for (uint32_t b = frontier; b < window_end(j, frontier); b++) {
        bool done = mask >> (b - frontier) & 1;
        *job_spot_owner(j, cell, b) = done ? OWNER_DONE : OWNER_NONE;
        if (!done)
            waiting_add(j, cell, b);
    }
    j->spots.done += frontier + (uint32_t)__builtin_popcount(mask);
    job_known_update(j, cell, 1);
}

void job_cells_restore(struct sched *s, struct job *j, const struct sched_done *done, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        const struct sched_done *d = &done[i];
        for (uint32_t cell = d->cell_begin; cell < d->cell_begin + d->cell_count; cell++) {
            uint32_t frontier = j->frontier[cell];
            if (d->block_begin >= d->block_end || d->block_end <= frontier)
                continue;
            uint32_t mask = cell_close(s, j, cell);
            if (d->block_begin <= frontier) {
                uint32_t ahead = d->block_end - frontier;
                frontier = d->block_end;
                mask = ahead < 32 ? mask >> ahead : 0;
            } else {
                for (uint32_t b = d->block_begin; b < d->block_end && b < frontier + SCHED_WINDOW;
                     b++)
                    mask |= UINT32_C(1) << (b - frontier);
            }
            cell_open(j, cell, frontier, mask);
        }
    }
}

void job_cells_reset(struct sched *s, struct job *j, struct unit unit)
{
    for (uint32_t cell = unit.cell_begin; cell < unit.cell_begin + unit.cell_count; cell++) {
        uint32_t frontier = j->frontier[cell];
        uint32_t mask = cell_close(s, j, cell);
        uint32_t forgotten = (uint32_t)__builtin_popcount(mask);
        if (unit.block < frontier) {
            forgotten += frontier - unit.block;
            frontier = unit.block;
            mask = 0;
        } else if (unit.block < frontier + SCHED_WINDOW) {
            mask &= (UINT32_C(1) << (unit.block - frontier)) - 1;
            forgotten -= (uint32_t)__builtin_popcount(mask);
        } else {
            forgotten = 0;
        }
        /* Their cost was spent, but is not part of the picture any more. */
        double cost_s = (double)j->cost_s[cell];
        if (cost_s > 0.0) {
            uint64_t measured = forgotten < j->measured_spots ? forgotten : j->measured_spots;
            double spent_s = (double)measured * cost_s;
            j->measured_spots -= measured;
            j->committed_s -= spent_s < j->committed_s ? spent_s : j->committed_s;
        }
        cell_open(j, cell, frontier, mask);
    }
    j->cells_reset += unit.cell_count;
}
