/* The simulated disk, and the book of what must hold whatever happens. */
#include "tests/sim/sim.h"

#include <string.h>

uint64_t spot_index(const struct sim_job *j, uint32_t cell, uint32_t block)
{
    return (uint64_t)block * j->cells + cell;
}

struct sim_job *book_job(struct sim *sim, uint64_t id)
{
    SIM_CHECK(sim, id >= 1 && id <= sim->c.jobs, "no job %" PRIu64, id);
    return &sim->jobs[id - 1];
}

void book_init(struct sim *sim)
{
    buf_init(&sim->disk.bytes);
    sim->disk.epoch_limit = 1;
    for (uint32_t i = 0; i < sim->c.jobs; i++) {
        struct sim_job *j = &sim->jobs[i];
        *j = (struct sim_job){.id = i + 1, .cells = sim->c.cells[i], .blocks = sim->c.blocks[i]};
        size_t spots = (size_t)j->cells * j->blocks;
        j->flags = mem_calloc(spots, sizeof *j->flags);
        j->hash = mem_calloc(spots, sizeof *j->hash);
        j->worker = mem_calloc(spots, sizeof *j->worker);
        j->memory = mem_alloc_aligned(sched_job_bytes(j->cells, j->blocks), 64);
        TL_ASSERT(j->flags && j->hash && j->worker && j->memory);
    }
}

void book_free(struct sim *sim)
{
    buf_release(&sim->disk.bytes);
    mem_free(sim->disk.pending);
    mem_free(sim->liars);
    for (uint32_t i = 0; i < sim->c.jobs; i++) {
        mem_free(sim->jobs[i].flags);
        mem_free(sim->jobs[i].hash);
        mem_free(sim->jobs[i].worker);
        mem_free(sim->jobs[i].memory);
        mem_free(sim->jobs[i].checks);
        mem_free(sim->jobs[i].blame);
    }
}

bool body_hashes(const struct sim *sim, const void *body, size_t bytes, uint32_t cells,
                 uint32_t *out)
{
    size_t values = (size_t)cells * SIM_CELL_FLOATS;
    const float *planes = body;
    float *decoded = NULL;
    if (sim->c.codec) {
        decoded = mem_alloc_array(values, sizeof *decoded);
        TL_ASSERT(decoded);
        if (tile_codec_decode(body, bytes, decoded, values) != ERR_OK) {
            mem_free(decoded);
            return false;
        }
        planes = decoded;
    } else if (bytes != values * sizeof *planes) {
        return false;
    }
    for (uint32_t i = 0; i < cells; i++) {
        float p[SIM_CELL_FLOATS];
        for (uint32_t k = 0; k < SIM_CELL_FLOATS; k++)
            memcpy(&p[k], (const char *)planes + ((size_t)k * cells + i) * sizeof *p, sizeof *p);
        out[i] = pixels_hash(p);
    }
    mem_free(decoded);
    return true;
}

/* --- What must hold ---------------------------------------------------------------------- */

void book_lease(struct sim *sim, const struct sched_action *a)
{
    const struct sim_job *j = book_job(sim, a->job);
    SIM_CHECK(sim, a->epoch > sim->epoch_highest, "epoch %" PRIu64 " is used twice", a->epoch);
    SIM_CHECK(sim, a->epoch < sim->disk.epoch_limit, "epoch %" PRIu64 " was not reserved",
              a->epoch);
    sim->epoch_highest = a->epoch;
    SIM_CHECK(sim,
              a->unit.cell_count > 0 && a->unit.cell_begin < j->cells &&
                  a->unit.cell_count <= j->cells - a->unit.cell_begin && a->unit.block < j->blocks,
              "a lease outside of job %" PRIu64, a->job);
    sim->stats.leases++;
    sim->stats.copies += a->kind == SCHED_KIND_COPY;
    sim->stats.checks += a->kind == SCHED_KIND_CHECK;
    for (uint32_t i = 0; i < a->unit.cell_count; i++) {
        uint32_t cell = a->unit.cell_begin + i;
        uint8_t flags = j->flags[spot_index(j, cell, a->unit.block)];
        if (a->kind == SCHED_KIND_FIRST || a->kind == SCHED_KIND_RETRY) {
            SIM_CHECK(sim, !(flags & SPOT_ACKED),
                      "job %" PRIu64 " cell %u block %u is leased again", a->job, cell,
                      a->unit.block);
            SIM_CHECK(sim, !(flags & SPOT_ACCEPTED),
                      "job %" PRIu64 " cell %u block %u is accepted and leased", a->job, cell,
                      a->unit.block);
            SIM_CHECK(sim,
                      a->unit.block < SCHED_WINDOW ||
                          j->flags[spot_index(j, cell, a->unit.block - SCHED_WINDOW)] &
                              SPOT_ACCEPTED,
                      "job %" PRIu64 " cell %u block %u is beyond the window", a->job, cell,
                      a->unit.block);
        } else if (a->kind == SCHED_KIND_CHECK) {
            SIM_CHECK(sim, flags & SPOT_ACCEPTED, "a check of what was not accepted");
        }
    }
}

/* --- The disk -------------------------------------------------------------------------------- */

static void append(struct sim *sim, const struct journal_result *r, const void *body,
                   uint64_t handle)
{
    unsigned char head[JOURNAL_HEADER_BYTES];
    (void)journal_header(r, body, head);
    struct sim_disk *d = &sim->disk;
    buf_put(&d->bytes, head, sizeof head);
    buf_put(&d->bytes, body, r->body_bytes);
    TL_ASSERT(buf_status(&d->bytes) == ERR_OK);
    d->pending = sim_grow(d->pending, d->pending_count, &d->pending_capacity, sizeof *d->pending);
    d->pending[d->pending_count++] = (struct sim_pending){.end = d->bytes.bytes,
                                                          .handle = handle,
                                                          .job = r->job,
                                                          .epoch = r->epoch,
                                                          .unit = r->unit,
                                                          .note = (int)r->samples};
}

/* A part of a result becomes new pixels: it must not be there yet. The record holds the run alone,
 * as plain floats would be too large to keep; the simulation stores hashes. */
void book_accept(struct sim *sim, const struct sched_action *a)
{
    struct sim_job *j = book_job(sim, a->job);
    const struct sim_result *r = sim->m.answering;
    uint32_t skip = a->unit.cell_begin - r->lease.unit.cell_begin;
    for (uint32_t i = 0; i < a->unit.cell_count; i++) {
        uint64_t spot = spot_index(j, a->unit.cell_begin + i, a->unit.block);
        SIM_CHECK(sim, !(j->flags[spot] & SPOT_ACCEPTED),
                  "job %" PRIu64 " cell %u block %u is accepted twice", a->job,
                  a->unit.cell_begin + i, a->unit.block);
        j->flags[spot] |= SPOT_ACCEPTED;
        j->hash[spot] = sim->m.answering_hash[skip + i];
        j->worker[spot] = (uint32_t)sim->m.answering_handle;
        j->accepted++;
    }
    append(
        sim,
        &(struct journal_result){.job = a->job,
                                 .unit = a->unit,
                                 .worker = (uint32_t)sim->m.answering_handle,
                                 .epoch = a->epoch,
                                 .body_bytes = (uint32_t)(a->unit.cell_count * sizeof(uint32_t))},
        sim->m.answering_hash + skip, 0);
}

static void clear_cells(struct sim_job *j, uint32_t cell_begin, uint32_t cell_count, uint8_t flags)
{
    for (uint32_t b = 0; b < j->blocks; b++) {
        for (uint32_t cell = cell_begin; cell < cell_begin + cell_count; cell++) {
            uint8_t *f = &j->flags[spot_index(j, cell, b)];
            j->accepted -= (*f & flags & SPOT_ACCEPTED) != 0;
            j->durable -= (*f & flags & SPOT_DURABLE) != 0;
            *f &= (uint8_t)~flags;
        }
    }
}

static bool overlaps(struct unit u, uint32_t cell_begin, uint32_t cell_count)
{
    return u.cell_begin < cell_begin + cell_count && cell_begin < u.cell_begin + u.cell_count;
}

static void drop_checks(struct sim_job *j, uint32_t cell_begin, uint32_t cell_count)
{
    size_t kept = 0;
    for (size_t i = 0; i < j->check_count; i++)
        if (!overlaps(j->checks[i], cell_begin, cell_count))
            j->checks[kept++] = j->checks[i];
    j->check_count = kept;
}

/* What a note means for the book, told now or read again. */
static void take_note(struct sim *sim, const struct journal_result *r)
{
    struct sim_job *j = book_job(sim, r->job);
    size_t kept = 0;
    switch ((enum sim_note)r->samples) {
    case NOTE_CHECK_OPENED:
        for (size_t i = 0; i < j->check_count; i++)
            if (memcmp(&j->checks[i], &r->unit, sizeof r->unit) == 0)
                return;
        j->checks = sim_grow(j->checks, j->check_count, &j->check_capacity, sizeof *j->checks);
        j->checks[j->check_count++] = r->unit;
        break;
    case NOTE_CHECK_CLOSED:
        for (size_t i = 0; i < j->check_count; i++)
            if (memcmp(&j->checks[i], &r->unit, sizeof r->unit) != 0)
                j->checks[kept++] = j->checks[i];
        j->check_count = kept;
        break;
    case NOTE_BLAME:
        j->blame = sim_grow(j->blame, j->blame_count, &j->blame_capacity, sizeof *j->blame);
        j->blame[j->blame_count++] = (struct sched_blame){r->unit, r->worker, r->rays != 0};
        break;
    case NOTE_FORGIVEN:
        j->blame_count = 0;
        break;
    case NOTE_LIAR:
        sim->liars = sim_grow(sim->liars, sim->liar_count, &sim->liar_capacity, sizeof *sim->liars);
        sim->liars[sim->liar_count++] = r->worker;
        break;
    case NOTE_RESET:
        drop_checks(j, r->unit.cell_begin, r->unit.cell_count);
        break;
    }
}

void book_note(struct sim *sim, const struct sched_action *a, enum sim_note note)
{
    struct journal_result r = {.job = a->job,
                               .unit = a->unit,
                               .worker = (uint32_t)a->worker,
                               .samples = note,
                               .rays = a->alone};
    append(sim, &r, NULL, 0);
    take_note(sim, &r);
}

bool book_lied(const struct sim *sim, uint64_t handle)
{
    for (size_t i = 0; i < sim->liar_count; i++)
        if (sim->liars[i] == handle)
            return true;
    return false;
}

void book_widen(const struct sim_job *j, uint32_t *cell_begin, uint32_t *cell_count)
{
    uint32_t begin = *cell_begin, end = begin + *cell_count;
    for (size_t i = 0; i < j->check_count; i++) {
        uint32_t from = j->checks[i].cell_begin, to = from + j->checks[i].cell_count;
        if (from >= end || to <= begin || (from >= begin && to <= end))
            continue;
        begin = from < begin ? from : begin;
        end = to > end ? to : end;
        i = SIZE_MAX; /* what was wide enough before may touch it now: from the first again */
    }
    *cell_begin = begin;
    *cell_count = end - begin;
}

bool book_touched(const struct sim_job *j, uint32_t cell, uint64_t handle)
{
    for (uint32_t b = 0; b < j->blocks; b++) {
        uint64_t spot = spot_index(j, cell, b);
        if (j->flags[spot] & SPOT_ACCEPTED && j->worker[spot] == handle)
            return true;
    }
    return false;
}

void book_reset(struct sim *sim, uint32_t job, uint32_t cell_begin, uint32_t cell_count)
{
    struct sim_job *j = &sim->jobs[job];
    struct sim_disk *d = &sim->disk;
    clear_cells(j, cell_begin, cell_count, SPOT_ACCEPTED | SPOT_ACKED);
    drop_checks(j, cell_begin, cell_count);
    for (size_t i = 0; i < d->pending_count; i++) {
        struct sim_pending *p = &d->pending[i];
        if (p->job == j->id && overlaps(p->unit, cell_begin, cell_count))
            p->stale = true;
    }
    append(sim,
           &(struct journal_result){.job = j->id,
                                    .unit = {.cell_begin = cell_begin, .cell_count = cell_count}},
           NULL, 0);
}

/* What a durable record says; a record without an epoch resets cells. */
static void replay(struct sim *sim, const struct journal_result *r, uint8_t flags)
{
    struct sim_job *j = book_job(sim, r->job);
    if (r->epoch == 0) {
        if (r->samples == NOTE_RESET)
            clear_cells(j, r->unit.cell_begin, r->unit.cell_count, SPOT_DURABLE);
        return;
    }
    for (uint32_t i = 0; i < r->unit.cell_count; i++) {
        uint8_t *f = &j->flags[spot_index(j, r->unit.cell_begin + i, r->unit.block)];
        SIM_CHECK(sim, !(*f & SPOT_DURABLE), "job %" PRIu64 " cell %u block %u is on disk twice",
                  j->id, r->unit.cell_begin + i, r->unit.block);
        *f |= flags;
        j->durable++;
    }
}

/* Everything before `end` is on disk: say so to those who wait. */
void book_committed(struct sim *sim, size_t end)
{
    struct sim_disk *d = &sim->disk;
    size_t done = 0;
    d->durable = end;
    for (; done < d->pending_count && d->pending[done].end <= end; done++) {
        const struct sim_pending *p = &d->pending[done];
        struct journal_result r = {
            .job = p->job, .unit = p->unit, .epoch = p->epoch, .samples = (uint64_t)p->note};
        bool acked = p->handle != 0 && !p->stale;
        replay(sim, &r, acked ? SPOT_DURABLE | SPOT_ACKED : SPOT_DURABLE);
    }
    memmove(d->pending, d->pending + done, (d->pending_count - done) * sizeof *d->pending);
    d->pending_count -= done;
}

/* Power goes: of what was not synced a part is there, the end of it torn or garbage. */
void book_crash(struct sim *sim)
{
    struct sim_disk *d = &sim->disk;
    size_t loose = d->bytes.bytes - d->durable;
    size_t kept = sim_below(sim, loose + 1);
    d->bytes.bytes = d->durable + kept;
    for (int i = 0; i < 3 && kept > 0 && sim_chance(sim, 0.5); i++)
        d->bytes.data[d->durable + sim_below(sim, kept)] ^=
            (unsigned char)(1 + sim_below(sim, 255));
    d->pending_count = 0;
    d->committing = false;
}

static void recover_record(struct sim *sim, const struct journal_result *r,
                           const unsigned char *body)
{
    struct sim_job *j = book_job(sim, r->job);
    replay(sim, r, SPOT_DURABLE);
    if (r->epoch == 0) {
        take_note(sim, r);
        if (r->samples == NOTE_RESET)
            clear_cells(j, r->unit.cell_begin, r->unit.cell_count, SPOT_ACCEPTED);
        return;
    }
    SIM_CHECK(sim, r->body_bytes == r->unit.cell_count * sizeof(uint32_t), "a record's size");
    for (uint32_t i = 0; i < r->unit.cell_count; i++) {
        uint64_t spot = spot_index(j, r->unit.cell_begin + i, r->unit.block);
        memcpy(&j->hash[spot], body + i * sizeof(uint32_t), sizeof(uint32_t));
        j->worker[spot] = r->worker;
        j->flags[spot] |= SPOT_ACCEPTED;
        j->accepted++;
    }
}

/* The longest valid prefix of the disk is what a new master knows. */
void book_recover(struct sim *sim)
{
    struct sim_disk *d = &sim->disk;
    for (uint32_t i = 0; i < sim->c.jobs; i++) {
        struct sim_job *j = &sim->jobs[i];
        clear_cells(j, 0, j->cells, SPOT_ACCEPTED | SPOT_DURABLE);
        TL_ASSERT(j->accepted == 0 && j->durable == 0);
        j->check_count = j->blame_count = 0;
    }
    sim->liar_count = 0;
    size_t at = 0;
    while (at < d->bytes.bytes) {
        struct journal_result r;
        digest name;
        const unsigned char *body;
        if (journal_read(d->bytes.data + at, d->bytes.bytes - at, &r, &name, &body) != ERR_OK)
            break;
        recover_record(sim, &r, body);
        at += JOURNAL_HEADER_BYTES + r.body_bytes;
    }
    SIM_CHECK(sim, at >= d->durable, "the disk lost what was synced: %zu of %zu bytes", at,
              d->durable);
    d->bytes.bytes = d->durable = at;
    for (uint32_t i = 0; i < sim->c.jobs; i++) {
        const struct sim_job *j = &sim->jobs[i];
        for (size_t spot = 0; spot < (size_t)j->cells * j->blocks; spot++)
            SIM_CHECK(sim, !(j->flags[spot] & SPOT_ACKED) || j->flags[spot] & SPOT_DURABLE,
                      "job %u spot %zu was acknowledged and is lost", i + 1, spot);
    }
}

/* At the end: every spot is on disk, once, and honest. */
void book_final(struct sim *sim)
{
    book_recover(sim);
    for (uint32_t i = 0; i < sim->c.jobs; i++) {
        const struct sim_job *j = &sim->jobs[i];
        if (i == 0 && sim->c.poison_cell >= 0)
            continue;
        SIM_CHECK(sim, j->durable == (uint64_t)j->cells * j->blocks,
                  "job %u: %" PRIu64 " of %" PRIu64 " spots are on disk", i + 1, j->durable,
                  (uint64_t)j->cells * j->blocks);
        for (uint32_t b = 0; b < j->blocks; b++) {
            for (uint32_t cell = 0; cell < j->cells; cell++) {
                float p[SIM_CELL_FLOATS];
                spot_pixels(j->id, cell, b, p);
                SIM_CHECK(sim, j->hash[spot_index(j, cell, b)] == pixels_hash(p),
                          "job %u cell %u block %u is not what an honest worker renders", i + 1,
                          cell, b);
            }
        }
        sim->stats.spots += j->durable;
    }
}
