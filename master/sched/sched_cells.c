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
           align64((size_t)cell_count * sizeof(uint64_t)) +
           align64((size_t)cell_count * sizeof(double)) +
           align64((size_t)cell_count * sizeof(float)) +
           2 * align64((size_t)cell_count * sizeof(uint16_t)) +
           align64((size_t)block_count * shape.word_count * sizeof(uint64_t)) +
           align64((size_t)block_count * sizeof(uint32_t));
}

static void *carve(uint8_t **at, size_t bytes)
{
    void *p = *at;
    *at += align64(bytes);
    return p;
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

static void weights_init(struct job *j, const uint64_t *weights)
{
    j->weight_below[0] = 0;
    for (uint32_t b = 0; b < j->block_count; b++)
        j->weight_below[b + 1] = j->weight_below[b] + (weights ? weights[b] : 1);
}

/* The first blocks of every cell wait, the others are shut. */
static void spots_init(struct job *j, const uint16_t *limits)
{
    for (uint32_t cell = 0; cell < j->cell_count; cell++) {
        uint32_t limit = limits ? limits[cell] : j->block_count;
        j->limit[cell] = (uint16_t)limit;
        j->spot_count += limit;
        j->weight_count += j->weight_below[limit];
        for (uint32_t b = 0; b < SCHED_WINDOW; b++)
            j->owner[(size_t)cell * SCHED_WINDOW + b] = b < limit ? OWNER_NONE : OWNER_DONE;
        for (uint32_t b = 0; limits && b < SCHED_WINDOW && b < limit; b++)
            waiting_add(j, cell, b);
    }
    uint32_t open = j->block_count < SCHED_WINDOW ? j->block_count : SCHED_WINDOW;
    for (uint32_t b = 0; !limits && b < open; b++) {
        cellset_fill(&j->shape, waiting_set(j, b));
        j->waiting_count[b] = j->cell_count;
        j->waiting_blocks[0] |= UINT64_C(1) << b;
        j->spots.waiting += j->cell_count;
    }
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
    j->measured = carve(&at, cells * sizeof *j->measured);
    j->spent_s = carve(&at, cells * sizeof *j->spent_s);
    j->cost_s = carve(&at, cells * sizeof *j->cost_s);
    j->frontier = carve(&at, cells * sizeof *j->frontier);
    j->limit = carve(&at, cells * sizeof *j->limit);
    j->waiting = carve(&at, blocks * j->shape.word_count * sizeof *j->waiting);
    j->waiting_count = carve(&at, blocks * sizeof *j->waiting_count);
    weights_init(j, add->block_weights);
    spots_init(j, add->limits);
}

uint64_t job_spot_count(const struct job *j)
{
    return j->spot_count;
}

uint64_t job_weight(const struct job *j, uint32_t block)
{
    return j->weight_below[block + 1] - j->weight_below[block];
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
    if (block >= frontier + SCHED_WINDOW || block >= j->limit[cell])
        return SPOT_SHUT;
    uint32_t owner = *job_spot_owner(j, cell, block);
    if (owner == OWNER_NONE)
        return SPOT_WAITING;
    return owner == OWNER_DONE ? SPOT_DONE : SPOT_LEASED;
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

static uint32_t window_end(const struct job *j, uint32_t cell, uint32_t frontier)
{
    uint32_t end = frontier + SCHED_WINDOW;
    return end < j->limit[cell] ? end : j->limit[cell];
}

/* Bit i: block frontier + i is done. */
static uint32_t done_ahead(const struct job *j, uint32_t cell)
{
    uint32_t frontier = j->frontier[cell], mask = 0;
    for (uint32_t b = frontier; b < window_end(j, cell, frontier); b++) {
        if (*job_spot_owner(j, cell, b) == OWNER_DONE)
            mask |= UINT32_C(1) << (b - frontier);
    }
    return mask;
}

/* Weight of the blocks of a cell that are done, given those of its window. */
static uint64_t done_weight(const struct job *j, uint32_t frontier, uint32_t mask)
{
    uint64_t weight = j->weight_below[frontier];
    for (; mask; mask &= mask - 1)
        weight += job_weight(j, frontier + (uint32_t)__builtin_ctz(mask));
    return weight;
}

/* Adds (sign 1) or takes off (sign -1) a measured cell's share of what is left. */
void job_known_update(struct job *j, uint32_t cell, int sign)
{
    double cost_s = (double)j->cost_s[cell];
    if (cost_s <= 0.0)
        return;
    uint64_t left =
        j->weight_below[j->limit[cell]] - done_weight(j, j->frontier[cell], done_ahead(j, cell));
    if (sign > 0) {
        j->known_weight += left;
        j->known_s += (double)left * cost_s;
        return;
    }
    TL_ASSERT(j->known_weight >= left);
    j->known_weight -= left;
    j->known_s -= (double)left * cost_s;
    /* Sums of floats drift: forget the rest where there is none. */
    if (j->known_weight == 0 || j->known_s < 0.0)
        j->known_s = 0.0;
}

static double weight_mean_s(const struct job *j)
{
    return j->measured_weight ? j->committed_s / (double)j->measured_weight : 0.0;
}

double job_cell_seconds(const struct job *j, uint32_t cell, uint32_t block)
{
    double cost_s = (double)j->cost_s[cell];
    return (cost_s > 0.0 ? cost_s : weight_mean_s(j)) * (double)job_weight(j, block);
}

double job_left_seconds(const struct job *j, double *unknown_s)
{
    uint64_t unknown = j->weight_count - j->weight_done - j->known_weight;
    *unknown_s = (double)unknown * weight_mean_s(j);
    return j->known_s + *unknown_s;
}

double job_done_share(const struct job *j)
{
    if (j->weight_done == j->weight_count)
        return 1.0;
    double mean_s = weight_mean_s(j);
    if (mean_s <= 0.0)
        return (double)j->weight_done / (double)j->weight_count;
    /* Spots restored from an earlier life have no measure and count as average. */
    double restored = (double)j->weight_done - (double)j->measured_weight;
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

static void measure(struct job *j, uint32_t cell, uint32_t block, double cost_s)
{
    uint64_t weight = job_weight(j, block);
    double old_s = (double)j->cost_s[cell], new_s = cost_s / (double)weight;
    j->cost_s[cell] = (float)(old_s > 0.0 ? 0.5 * (old_s + new_s) : new_s);
    j->measured[cell] += weight;
    j->measured_weight += weight;
    j->spent_s[cell] += cost_s;
    j->committed_s += cost_s;
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
    j->weight_done += job_weight(j, block);

    /* Each block that closes at the frontier opens one at the far end of the window. */
    while (j->frontier[cell] < j->limit[cell] &&
           *job_spot_owner(j, cell, j->frontier[cell]) == OWNER_DONE) {
        uint32_t opened = (uint32_t)j->frontier[cell]++ + SCHED_WINDOW;
        if (opened < j->limit[cell]) {
            *job_spot_owner(j, cell, opened) = OWNER_NONE;
            waiting_add(j, cell, opened);
        }
    }
    if (cost_s > 0.0)
        measure(j, cell, block, cost_s);
    job_known_update(j, cell, 1);
}

/* Takes a cell's open spots from whoever has them; gives the mask of those done. */
static uint32_t cell_close(struct sched *s, struct job *j, uint32_t cell)
{
    uint32_t frontier = j->frontier[cell], mask = done_ahead(j, cell);
    job_known_update(j, cell, -1);
    for (uint32_t b = frontier; b < window_end(j, cell, frontier); b++) {
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
    j->weight_done -= done_weight(j, frontier, mask);
    return mask;
}

static void cell_open(struct job *j, uint32_t cell, uint32_t frontier, uint32_t mask)
{
    while (mask & 1) {
        mask >>= 1;
        frontier++;
    }
    j->frontier[cell] = (uint16_t)frontier;
    for (uint32_t b = frontier; b < window_end(j, cell, frontier); b++) {
        bool done = mask >> (b - frontier) & 1;
        *job_spot_owner(j, cell, b) = done ? OWNER_DONE : OWNER_NONE;
        if (!done)
            waiting_add(j, cell, b);
    }
    j->spots.done += frontier + (uint32_t)__builtin_popcount(mask);
    j->weight_done += done_weight(j, frontier, mask);
    job_known_update(j, cell, 1);
}

void job_cells_restore(struct sched *s, struct job *j, const struct sched_done *done, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        const struct sched_done *d = &done[i];
        for (uint32_t cell = d->cell_begin; cell < d->cell_begin + d->cell_count; cell++) {
            uint32_t frontier = j->frontier[cell];
            uint32_t block_end = d->block_end < j->limit[cell] ? d->block_end : j->limit[cell];
            if (d->block_begin >= block_end || block_end <= frontier)
                continue;
            uint32_t mask = cell_close(s, j, cell);
            if (d->block_begin <= frontier) {
                uint32_t ahead = block_end - frontier;
                frontier = block_end;
                mask = ahead < 32 ? mask >> ahead : 0;
            } else {
                for (uint32_t b = d->block_begin; b < block_end && b < frontier + SCHED_WINDOW; b++)
                    mask |= UINT32_C(1) << (b - frontier);
            }
            cell_open(j, cell, frontier, mask);
        }
    }
}

/* The limit that a cell can have: what is done or leased stays below it. */
static uint32_t limit_possible(const struct job *j, uint32_t cell, uint32_t wanted)
{
    uint32_t lowest = j->frontier[cell];
    for (uint32_t b = lowest; b < window_end(j, cell, j->frontier[cell]); b++)
        if (*job_spot_owner(j, cell, b) != OWNER_NONE)
            lowest = b + 1;
    return wanted > lowest ? wanted : lowest;
}

void job_cells_limit(struct job *j, const uint16_t *limits)
{
    for (uint32_t cell = 0; cell < j->cell_count; cell++) {
        uint32_t frontier = j->frontier[cell], before = j->limit[cell];
        uint32_t open_before = window_end(j, cell, frontier);
        uint32_t limit = limit_possible(j, cell, limits[cell]);
        job_known_update(j, cell, -1);
        j->limit[cell] = (uint16_t)limit;
        uint32_t open_now = window_end(j, cell, frontier);
        for (uint32_t b = open_now; b < open_before; b++) {
            waiting_remove(j, cell, b);
            *job_spot_owner(j, cell, b) = OWNER_DONE;
        }
        for (uint32_t b = open_before; b < open_now; b++) {
            *job_spot_owner(j, cell, b) = OWNER_NONE;
            waiting_add(j, cell, b);
        }
        j->spot_count += limit;
        j->spot_count -= before;
        j->weight_count += j->weight_below[limit];
        j->weight_count -= j->weight_below[before];
        job_known_update(j, cell, 1);
    }
}

/* The cost of what was forgotten was spent, but is not part of the picture any more. Of a cell of
 * which a part is kept, the measured spots count as spread over all. */
static void forget_cost(struct job *j, uint32_t cell, uint64_t before, uint64_t kept)
{
    double share = before > kept ? 1.0 - (double)kept / (double)before : 0.0;
    uint64_t measured = (uint64_t)(share * (double)j->measured[cell]);
    double spent_s = share * j->spent_s[cell];
    j->measured[cell] -= measured;
    j->measured_weight -= measured;
    j->spent_s[cell] -= spent_s;
    j->committed_s -= spent_s;
    /* As in job_known_update. */
    if (j->measured_weight == 0 || j->committed_s < 0.0)
        j->committed_s = 0.0;
}

void job_cells_reset(struct sched *s, struct job *j, struct unit unit)
{
    for (uint32_t cell = unit.cell_begin; cell < unit.cell_begin + unit.cell_count; cell++) {
        uint32_t frontier = j->frontier[cell];
        uint32_t mask = cell_close(s, j, cell);
        uint64_t before = done_weight(j, frontier, mask);
        if (unit.block < frontier) {
            frontier = unit.block;
            mask = 0;
        } else if (unit.block < frontier + SCHED_WINDOW) {
            mask &= (UINT32_C(1) << (unit.block - frontier)) - 1;
        }
        forget_cost(j, cell, before, done_weight(j, frontier, mask));
        cell_open(j, cell, frontier, mask);
    }
    j->cells_reset += unit.cell_count;
    job_progress_update(j);
}
