/* The life of a job: added, rendered, paused, cancelled, failed, done, forgotten. */
#include "master/sched/sched_impl.h"

/* Keeps slots by falling priority, then by arrival: id order is not arrival order, so an equal
 * goes behind its equals. */
static void rank_add(struct sched *s, uint32_t job)
{
    uint32_t at = s->job_rank_count++;
    while (at > 0 && s->jobs[s->job_rank[at - 1]].priority < s->jobs[job].priority) {
        s->job_rank[at] = s->job_rank[at - 1];
        at--;
    }
    s->job_rank[at] = job;
}

static void rank_remove(struct sched *s, uint32_t job)
{
    uint32_t at = 0;
    while (s->job_rank[at] != job)
        TL_ASSERT(++at < s->job_rank_count);
    s->job_rank_count--;
    for (; at < s->job_rank_count; at++)
        s->job_rank[at] = s->job_rank[at + 1];
}

static bool add_valid(const struct sched_job_add *a)
{
    if (sched_job_bytes(a->cell_count, a->block_count) == 0 || !a->memory)
        return false;
    if (!(a->cell_cost > 0.0) || !(a->verify_share >= 0.0 && a->verify_share <= 1.0))
        return false;
    for (uint32_t i = 0; a->limits && i < a->cell_count; i++)
        if (a->limits[i] == 0 || a->limits[i] > a->block_count)
            return false;
    for (uint32_t b = 0; a->block_weights && b < a->block_count; b++)
        if (a->block_weights[b] == 0 || a->block_weights[b] > JOB_SPP_MAX)
            return false;
    for (size_t i = 0; i < a->done_count; i++) {
        const struct sched_done *d = &a->done[i];
        if (d->cell_begin >= a->cell_count || d->cell_count > a->cell_count - d->cell_begin ||
            d->block_begin > d->block_end || d->block_end > a->block_count)
            return false;
    }
    return true;
}

static bool job_add(struct sched *s, uint64_t id, const struct sched_job_add *a)
{
    if (id == 0 || slotmap_find(&s->job_map, id) != SLOT_NONE || !add_valid(a))
        return false;
    uint32_t job = slotmap_add(&s->job_map, id);
    if (job == SLOT_NONE)
        return false;
    struct job *j = &s->jobs[job];
    *j = (struct job){.id = id,
                      .state = a->paused ? SCHED_PAUSED : SCHED_ACTIVE,
                      .priority = a->priority,
                      .open = a->open,
                      .cell_cost = a->cell_cost,
                      .unit_ms = a->unit_ms > 0 && a->unit_ms < s->limits.unit_ms
                                     ? a->unit_ms
                                     : s->limits.unit_ms,
                      .unit_cells_max = a->unit_cells_max,
                      .verify_share = a->verify_share,
                      .tags = a->tags,
                      .threads = threads_with(s, a->tags),
                      .quiet_until_ms = s->now_ms + a->quiet_ms,
                      .started_ms = UINT64_MAX};
    struct chain *const chains[] = {&j->solo,           &j->others, &j->suspects,
                                    &j->suspects_alone, &j->checks, &j->checks_out};
    for (size_t i = 0; i < sizeof chains / sizeof *chains; i++)
        chain_init(chains[i]);
    job_cells_init(j, a);
    job_cells_restore(s, j, a->done, a->done_count);
    job_progress_update(j);
    rank_add(s, job);
    job_checks_restore(s, job, a->checks, a->check_count);
    job_blame_restore(s, job, a->blame, a->blame_count);
    job_settle(s, job);
    return true;
}

/* Units held back wait again; what is not the job's any more is forgotten. */
static void suspects_dissolve(struct sched *s, struct job *j)
{
    struct chain *const chains[] = {&j->suspects, &j->suspects_alone};
    for (int i = 0; i < 2; i++) {
        while (chains[i]->count > 0)
            suspect_dissolve(s, chains[i]->head);
    }
}

/* Ends all work of a job that is not live any more, and has its workers told. */
static void job_stop(struct sched *s, uint32_t job)
{
    struct job *j = &s->jobs[job];
    job_leases_revoke(s, job); /* checks stay open: a retried job owes them still */
    suspects_dissolve(s, j);
    TL_ASSERT(j->spots.leased == 0 && j->begun == 0);
    j->closing = true;
    j->close_slot = 0;
}

void job_fail(struct sched *s, uint32_t job, enum sched_why why, struct unit unit)
{
    struct job *j = &s->jobs[job];
    if (!job_is_live(j))
        return;
    j->state = SCHED_FAILED;
    job_stop(s, job);
    sched_news_push(s, &(struct sched_action){
                           .type = SCHED_JOB_FAILED, .job = j->id, .why = why, .unit = unit});
}

void job_settle(struct sched *s, uint32_t job)
{
    struct job *j = &s->jobs[job];
    if (j->open)
        return;
    if (!job_is_live(j) || j->spots.done < job_spot_count(j) || j->checks.count > 0 ||
        j->checks_out.count > 0 || s->liars_unsettled > 0)
        return;
    TL_ASSERT(j->solo.count == 0 && j->others.count == 0);
    j->state = SCHED_DONE;
    job_progress_update(j);
    job_stop(s, job);
    sched_news_push(s, &(struct sched_action){.type = SCHED_JOB_DONE, .job = j->id});
}

/* A finished job has work again. */
void job_reopen(struct sched *s, uint32_t job)
{
    struct job *j = &s->jobs[job];
    if (j->state == SCHED_DONE)
        j->state = SCHED_ACTIVE;
}

static bool job_pause(struct job *j)
{
    if (j->state != SCHED_ACTIVE)
        return false;
    j->state = SCHED_PAUSED;
    return true;
}

static bool job_resume(struct job *j)
{
    if (j->state != SCHED_PAUSED)
        return false;
    j->state = SCHED_ACTIVE;
    return true;
}

static bool job_cancel(struct sched *s, uint32_t job)
{
    struct job *j = &s->jobs[job];
    if (!job_is_live(j))
        return false;
    j->state = SCHED_CANCELLED;
    job_stop(s, job);
    return true;
}

static bool job_retry(struct sched *s, uint32_t job)
{
    struct job *j = &s->jobs[job];
    if (j->state != SCHED_FAILED && j->state != SCHED_CANCELLED)
        return false;
    j->state = SCHED_ACTIVE;
    j->unfit_points = 0;
    for (uint32_t i = 0; i < s->limits.worker_count_max; i++) {
        struct worker_job *wj =
            slotmap_used(&s->worker_map, i) ? worker_job_find(&s->workers[i], j->id) : NULL;
        if (!wj)
            continue;
        wj->barred_until_ms = 0;
        wj->unfit = 0;
    }
    job_settle(s, job);
    return true;
}

static bool job_remove(struct sched *s, uint32_t job)
{
    struct job *j = &s->jobs[job];
    if (job_is_live(j)) {
        j->state = SCHED_CANCELLED;
        job_stop(s, job);
    }
    job_checks_drop(s, job, 0, j->cell_count);
    j->removed = true;
    j->closing = true;
    j->close_slot = 0;
    return true;
}

static bool job_set_priority(struct sched *s, uint32_t job, int32_t priority)
{
    rank_remove(s, job);
    s->jobs[job].priority = priority;
    rank_add(s, job);
    return true;
}

static bool job_reset_cells(struct sched *s, uint32_t job, struct unit unit)
{
    struct job *j = &s->jobs[job];
    if (unit.cell_count == 0 || unit.cell_begin >= j->cell_count ||
        unit.cell_count > j->cell_count - unit.cell_begin || unit.block >= j->block_count)
        return false;
    job_checks_drop(s, job, unit.cell_begin, unit.cell_count);
    job_cells_reset(s, j, unit);
    if (j->spots.done < job_spot_count(j))
        job_reopen(s, job);
    return true;
}

/* Takes back what no worker has begun, as far as the master knows. */
static void unbegun_revoke(struct sched *s, uint32_t job)
{
    struct job *j = &s->jobs[job];
    const uint32_t heads[] = {j->solo.head, j->others.head};
    for (int i = 0; i < 2; i++) {
        for (uint32_t l = heads[i]; l != SLOT_NONE;) {
            uint32_t next = s->lease_job_links[l].next;
            if (!s->leases[l].begun && s->leases[l].owner && s->leases[l].solo)
                lease_end(s, l, END_REVOKED, false);
            l = next;
        }
    }
}

static bool job_set_limits(struct sched *s, uint32_t job, const struct sched_job_limits *l)
{
    struct job *j = &s->jobs[job];
    if (!j->open)
        return false;
    for (uint32_t cell = 0; l->limits && cell < j->cell_count; cell++)
        if (l->limits[cell] == 0 || l->limits[cell] > j->block_count)
            return false;
    if (l->cut)
        unbegun_revoke(s, job);
    if (l->limits)
        job_cells_limit(j, l->limits);
    j->open = !l->final;
    job_progress_update(j);
    job_settle(s, job);
    return true;
}

/* One worker at a time: the table may be large. A removed job's slot is free after the last. */
bool jobs_close_next(struct sched *s, struct sched_action *out)
{
    for (uint32_t i = 0; i < s->job_rank_count; i++) {
        uint32_t job = s->job_rank[i];
        struct job *j = &s->jobs[job];
        while (j->closing && j->close_slot < s->limits.worker_count_max) {
            uint32_t slot = j->close_slot++;
            struct worker *w = &s->workers[slot];
            struct worker_job *wj =
                slotmap_used(&s->worker_map, slot) ? worker_job_find(w, j->id) : NULL;
            if (!wj)
                continue;
            bool tell = wj->open && w->connected && !w->away;
            TL_ASSERT(wj->leases == 0);
            wj->open = wj->ready = false; /* its speed is worth keeping */
            if (j->removed)
                *wj = (struct worker_job){0};
            worker_timer_set(s, slot);
            worker_place(s, slot);
            if (tell) {
                *out = (struct sched_action){
                    .type = SCHED_CLOSE_JOB, .worker = w->handle, .job = j->id};
                return true;
            }
        }
        if (j->closing && j->removed) {
            rank_remove(s, job);
            slotmap_remove(&s->job_map, job);
            i--;
        }
        j->closing = false;
    }
    return false;
}

bool jobs_feed(struct sched *s, const struct sched_event *e)
{
    if (e->type == SCHED_JOB_ADD)
        return job_add(s, e->job, &e->add);
    uint32_t job = slotmap_find(&s->job_map, e->job);
    if (job == SLOT_NONE)
        return false;
    switch (e->type) {
    case SCHED_JOB_PAUSE:
        return job_pause(&s->jobs[job]);
    case SCHED_JOB_RESUME:
        return job_resume(&s->jobs[job]);
    case SCHED_JOB_CANCEL:
        return job_cancel(s, job);
    case SCHED_JOB_RETRY:
        return job_retry(s, job);
    case SCHED_JOB_REMOVE:
        return job_remove(s, job);
    case SCHED_JOB_PRIORITY:
        return job_set_priority(s, job, e->priority);
    case SCHED_JOB_HOLD:
        s->jobs[job].held = e->hold;
        return true;
    case SCHED_JOB_LIMITS:
        return job_set_limits(s, job, &e->limits);
    case SCHED_CELLS_RESET:
        return job_reset_cells(s, job, e->unit);
    default:
        return false;
    }
}
