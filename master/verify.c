/* What is compared, and what follows from a lie: see farm.h and provenance.h.
 *
 * A liar's name is on disk before the cells that it touched are reset, and those before the check
 * that found it is closed: a master that dies in between resets them when it starts again. */
#include <inttypes.h>

#include "common/log.h"
#include "common/mem.h"
#include "master/farm.h"

enum { PASTS_MAX = 100000 };

/* --- Comparing ---------------------------------------------------------- */

void verify_compare(struct farm *f, const struct sched_action *a)
{
    struct job *job = farm_job(f, a->job);
    uint64_t worker;
    const uint64_t *given = results_answering(f, a->unit, &worker);
    if (!job || job->provenance.cell_count == 0)
        return;
    size_t spot = (size_t)a->unit.block * job->grid.cell_count + a->unit.cell_begin;
    const uint64_t *known = job->provenance.hash + spot;
    const uint32_t *who = job->provenance.worker + spot;
    for (uint32_t i = 0; i < a->unit.cell_count;) {
        if (known[i] == 0 || known[i] == given[i]) {
            i++;
            continue;
        }
        struct sched_event event = {.type = SCHED_MISMATCH,
                                    .worker = worker,
                                    .job = a->job,
                                    .mismatch = {.unit = {a->unit.cell_begin + i, 0, a->unit.block},
                                                 .worker_accepted = who[i]}};
        struct sched_mismatch *m = &event.mismatch;
        for (; i < a->unit.cell_count && who[i] == m->worker_accepted && known[i] != 0 &&
               known[i] != given[i];
             i++) {
            m->unit.cell_count++;
            m->digest_accepted = provenance_fold(m->digest_accepted, known[i]);
            m->digest = provenance_fold(m->digest, given[i]);
        }
        jobs_log(f, job,
                 "w%" PRIu64 " and w%" PRIu64 " differ in %" PRIu32 " cells of block %" PRIu32,
                 worker, m->worker_accepted, m->unit.cell_count, m->unit.block);
        farm_feed(f, &event);
    }
}

/* --- Steps of the journal that are no result ------------------------------ */

/* On its way to the disk: the film forgets in the order of the journal. */
struct noting {
    struct farm *farm;
    uint64_t job, sequence;
    uint32_t cell_begin, cell_count; /* of a reset; count 0: a check */
};

static void on_noted(void *ctx, enum err e)
{
    struct noting *s = ctx;
    struct farm *f = s->farm;
    struct job *job = farm_job(f, s->job);
    TL_ASSERT(job && job->in_store > 0);
    job->in_store--;
    job->settled = s->sequence;
    bool reset = s->cell_count > 0;
    if (e == ERR_OK && reset && job->film)
        e = film_reset(job->film, s->cell_begin, s->cell_count);
    /* A lie that stays in the film must not become a picture. */
    if (e != ERR_OK && reset)
        jobs_fail(f, job, err_text(e));
    else if (e != ERR_OK)
        jobs_disk_trouble(f, job, e);
    mem_free(s);
    if (f->stopping)
        return;
    job_film_changed(f, job);
    f->admit_due |= !job->in_sched;
}

static struct noting *noting_new(struct farm *f, struct job *job)
{
    struct noting *s = mem_calloc(1, sizeof *s);
    if (!s) {
        jobs_fail(f, job, err_text(ERR_NOMEM));
        return NULL;
    }
    *s = (struct noting){.farm = f, .job = job->rec.id, .sequence = ++job->sequence};
    job->in_store++;
    return s;
}

static void noting_failed(struct job *job, struct noting *s)
{
    job->in_store--;
    jobs_fail(s->farm, job, err_text(ERR_NOMEM));
    mem_free(s);
}

void verify_check(struct farm *f, const struct sched_action *a)
{
    struct job *job = farm_job(f, a->job);
    bool open = a->type == SCHED_CHECK_OPENED;
    if (!job || !job->in_sched || job->provenance.cell_count == 0)
        return;
    if (!open)
        provenance_close_check(&job->provenance, a->unit);
    else if (provenance_open_check(&job->provenance, a->unit) != ERR_OK)
        log_warn("verify", "out of memory: a restart would forget a check job=j%" PRIu64, a->job);
    struct noting *s = noting_new(f, job);
    if (s && store_put_check(f->store, a->job, s->sequence, a->unit, open, on_noted, s) != ERR_OK)
        noting_failed(job, s);
}

static void reset_run(struct farm *f, struct job *job, uint32_t begin, uint32_t count)
{
    struct noting *s = noting_new(f, job);
    if (!s)
        return;
    s->cell_begin = begin;
    s->cell_count = count;
    if (store_put_reset(f->store, job->rec.id, s->sequence, begin, count, on_noted, s) != ERR_OK) {
        noting_failed(job, s);
        return;
    }
    provenance_reset(&job->provenance, begin, count);
    struct sched_event event = {
        .type = SCHED_CELLS_RESET, .job = job->rec.id, .unit = {begin, count, 0}};
    farm_feed(f, &event);
}

/* Every cell of the job that the worker touched starts again; how many. */
static uint32_t reset_touched(struct farm *f, struct job *job, uint64_t worker)
{
    uint32_t cells = 0;
    if (job_state_ended(job->rec.state) || job->provenance.cell_count == 0)
        return 0;
    for (uint32_t cell = 0; cell < job->grid.cell_count; cell++) {
        uint32_t begin = cell;
        while (cell < job->grid.cell_count &&
               provenance_touched(&job->provenance, (uint32_t)worker, cell))
            cell++;
        if (cell == begin)
            continue;
        uint32_t count = cell - begin;
        provenance_widen(&job->provenance, &begin, &count);
        reset_run(f, job, begin, count);
        cells += count;
        cell = begin + count - 1;
    }
    if (cells > 0)
        jobs_log(f, job, "w%" PRIu64 " lied and is set aside; %" PRIu32 " cells start again",
                 worker, cells);
    return cells;
}

/* --- Workers that lied or were set aside ----------------------------------- */

static struct worker_past *past_of(const struct farm *f, uint64_t worker)
{
    for (size_t i = 0; i < f->past_count; i++)
        if (f->pasts[i].id == worker)
            return &f->pasts[i];
    return NULL;
}

enum err verify_load_past(void *ctx, const struct worker_past *past)
{
    struct farm *f = ctx;
    if (f->past_count >= PASTS_MAX)
        return ERR_OK;
    if (!mem_grow((void **)&f->pasts, f->past_count, &f->past_capacity, sizeof *f->pasts))
        return ERR_NOMEM;
    f->pasts[f->past_count++] = *past;
    return ERR_OK;
}

void verify_keep_past(struct farm *f, const struct worker_past *past)
{
    struct worker_past *known = past_of(f, past->id);
    struct worker_past now = *past;
    now.lied |= known && known->lied;
    if (known)
        *known = now;
    else if (verify_load_past(f, &now) != ERR_OK)
        log_warn("verify", "out of memory: past not kept worker=w%" PRIu64, past->id);
    if (store_put_past(f->store, &now) != ERR_OK)
        log_warn("verify", "past not stored worker=w%" PRIu64, past->id);
}

void verify_tell_past(struct farm *f, uint64_t worker)
{
    const struct worker_past *past = past_of(f, worker);
    if (!past)
        return;
    int64_t left_ms = (past->until_us - farm_wall_us()) / 1000;
    struct sched_event event = {.type = SCHED_WORKER_PAST,
                                .worker = worker,
                                .past = {.lied = past->lied, .pauses = past->pauses}};
    if (left_ms > 0)
        event.past.until_ms = uv_now(f->loop) + (uint64_t)left_ms;
    farm_feed(f, &event);
}

bool verify_reset_liars(struct farm *f, struct job *job)
{
    uint32_t cells = 0;
    for (size_t i = 0; i < f->past_count; i++)
        if (f->pasts[i].lied)
            cells += reset_touched(f, job, f->pasts[i].id);
    return cells > 0;
}

void verify_liar(struct farm *f, const struct sched_action *a)
{
    /* Fed while actions are drained: comes after every reset below. */
    struct sched_event settled = {.type = SCHED_LIAR_SETTLED};
    if (a->worker != 0) {
        log_error("verify", "worker gave wrong bits worker=w%" PRIu64 " job=j%" PRIu64, a->worker,
                  a->job);
        verify_keep_past(f, &(struct worker_past){.id = a->worker, .lied = true});
        for (size_t i = 0; i < f->job_count; i++)
            (void)reset_touched(f, f->jobs[i], a->worker);
    }
    farm_feed(f, &settled);
    struct worker *w = farm_worker(f, a->worker);
    if (w)
        workers_changed(f, w);
}

/* --- Blame ------------------------------------------------------------------ */

void verify_keep_blame(struct farm *f, struct job *job, const struct sched_action *a)
{
    struct sched_blame blame = {.unit = a->unit, .worker = a->worker, .alone = a->alone};
    if (job->blame_count >= STORE_BLAME_KEPT)
        return;
    if (!mem_grow((void **)&job->blame, job->blame_count, &job->blame_capacity,
                  sizeof *job->blame)) {
        log_warn("verify", "out of memory: blame not kept job=j%" PRIu64, job->rec.id);
        return;
    }
    job->blame[job->blame_count++] = blame;
    if (store_put_blame(f->store, job->rec.id, &blame) != ERR_OK)
        log_warn("verify", "blame not stored job=j%" PRIu64, job->rec.id);
}

void verify_forget_blame(struct farm *f, struct job *job)
{
    if (job->blame_count > 0 && store_forget_blame(f->store, job->rec.id) != ERR_OK)
        log_warn("verify", "blame not forgotten job=j%" PRIu64, job->rec.id);
    job->blame_count = 0;
}

enum err verify_load_blame(void *ctx, uint64_t job_id, const struct sched_blame *blame)
{
    struct job *job = farm_job(ctx, job_id);
    if (!job || job->blame_count >= STORE_BLAME_KEPT)
        return ERR_OK;
    if (!mem_grow((void **)&job->blame, job->blame_count, &job->blame_capacity, sizeof *job->blame))
        return ERR_NOMEM;
    job->blame[job->blame_count++] = *blame;
    return ERR_OK;
}

struct sched_open_check *verify_open_checks(const struct job *job, size_t *count)
{
    const struct provenance *p = &job->provenance;
    struct sched_open_check *checks = mem_alloc_array(p->check_count, sizeof *checks);
    *count = 0;
    for (size_t i = 0; checks && i < p->check_count; i++) {
        uint32_t worker;
        struct sched_open_check c = {.unit = p->checks[i]};
        if (!provenance_of_unit(p, c.unit, &worker, &c.digest))
            continue;
        c.worker = worker;
        checks[(*count)++] = c;
    }
    return checks;
}
