/* What people see of jobs, workers and the farm. */
#include "master/sched/sched_impl.h"

const char *sched_why_text(enum sched_why why)
{
    static const char *const texts[SCHED_WHY_COUNT] = {
        [SCHED_WHY_NONE] = "no reason",
        [SCHED_WHY_NO_JOB] = "the job is not being rendered",
        [SCHED_WHY_NO_UNIT] = "not a unit that was leased",
        [SCHED_WHY_SHUT] = "too far ahead of the cell's first open block",
        [SCHED_WHY_UNCHECKED] = "part of a unit that is to be verified as a whole",
        [SCHED_WHY_QUARANTINED] = "the worker is quarantined",
        [SCHED_WHY_UNIT_KILLS] = "one unit lost too many workers",
        [SCHED_WHY_JOB_UNFIT] = "no worker can render it",
        [SCHED_WHY_NO_AGREEMENT] = "workers do not agree on its pixels",
    };
    return (unsigned)why < SCHED_WHY_COUNT ? texts[why] : "unknown";
}

const char *sched_worker_state_name(enum sched_worker_state st)
{
    switch (st) {
    case SCHED_WORKER_IDLE:
        return "idle";
    case SCHED_WORKER_LOADING:
        return "loading";
    case SCHED_WORKER_BUSY:
        return "busy";
    case SCHED_WORKER_DRAINING:
        return "draining";
    case SCHED_WORKER_SET_ASIDE:
    case SCHED_WORKER_QUARANTINED:
        return "set-aside";
    case SCHED_WORKER_GONE:
        return "lost";
    }
    return "unknown";
}

const char *sched_job_state_name(enum sched_job_state st)
{
    static const char *const names[] = {
        [SCHED_ACTIVE] = "rendering", [SCHED_PAUSED] = "paused", [SCHED_CANCELLED] = "cancelled",
        [SCHED_FAILED] = "failed",    [SCHED_DONE] = "done",
    };
    return (unsigned)st <= SCHED_DONE ? names[st] : "unknown";
}

/* Workers with a lease of the job, the begun leases' longest expected rest. */
static void count_leases(const struct sched *s, const struct job *j, uint32_t *workers,
                         double *longest_s)
{
    *workers = 0;
    *longest_s = 0.0;
    for (uint32_t i = 0; i < s->limits.worker_count_max; i++) {
        struct worker *w = &s->workers[i];
        const struct worker_job *wj =
            slotmap_used(&s->worker_map, i) && w->held > 0 ? worker_job_find(w, j->id) : NULL;
        if (!wj || wj->leases == 0)
            continue;
        ++*workers;
        uint32_t l = w->begun.head;
        if (l == SLOT_NONE)
            continue;
        uint64_t end_ms = s->leases[l].begun_ms + s->leases[l].expected_ms;
        double left_s = end_ms > s->now_ms ? 1e-3 * (double)(end_ms - s->now_ms) : 0.0;
        if (left_s > *longest_s)
            *longest_s = left_s;
    }
}

static enum sched_wait wait_reason(const struct sched *s, const struct job *j)
{
    if (j->state != SCHED_ACTIVE || j->held || j->solo.count + j->others.count > 0)
        return SCHED_WAIT_NOTHING;
    bool any = false;
    for (uint32_t i = 0; i < s->limits.worker_count_max && !any; i++) {
        struct worker *w = &s->workers[i];
        any = slotmap_used(&s->worker_map, i) && worker_usable(w) && !worker_barred(s, w, j);
    }
    if (!any)
        return SCHED_WAIT_WORKER;
    if (j->checks.count > 0 && j->spots.waiting == 0)
        return s->checks[j->checks.head].vote_count > 1 ? SCHED_WAIT_THIRD_WORKER
                                                        : SCHED_WAIT_SECOND_WORKER;
    return SCHED_WAIT_BEHIND;
}

static void left_fill(const struct sched *s, const struct job *j, double longest_s,
                      struct sched_job_info *out)
{
    double unknown_s, left_s = job_left_seconds(j, &unknown_s);
    uint64_t unknown_weight = j->weight_count - j->weight_done - j->known_weight;
    double weight_per_unit = j->units ? (double)j->weight_done / (double)j->units : 1.0;
    struct eta e = {
        .known_s = left_s - unknown_s,
        .unknown_s = unknown_s,
        .unknown_units = (uint64_t)((double)unknown_weight / weight_per_unit) + 1,
        .spread = j->spread,
        .threads = (double)j->begun,
        .longest_open_s = longest_s,
        .elapsed_s = j->started_ms < s->now_ms ? 1e-3 * (double)(s->now_ms - j->started_ms) : 0.0,
    };
    out->left_known = j->state == SCHED_ACTIVE && eta_left(&e, &out->left_low_s, &out->left_high_s);
}

bool sched_job_info(const struct sched *s, uint64_t job, struct sched_job_info *out)
{
    uint32_t slot = slotmap_find(&s->job_map, job);
    if (slot == SLOT_NONE)
        return false;
    const struct job *j = &s->jobs[slot];
    *out = (struct sched_job_info){
        .state = j->state,
        .wait = wait_reason(s, j),
        .priority = j->priority,
        .spots = job_spot_count(j),
        .spots_done = j->spots.done,
        .spots_leased = j->spots.leased,
        .leases = j->solo.count + j->others.count,
        .units = j->units,
        .retried = j->retried,
        .speculated = j->speculated,
        .rejected = j->rejected,
        .compared = j->compared,
        .verified = j->verified,
        .mismatched = j->mismatched,
        .checks_open = j->checks.count + j->checks_out.count,
        .cells_reset = j->cells_reset,
        .thread_seconds = j->samples_s,
        .done = j->done_shown,
    };
    double longest_s;
    count_leases(s, j, &out->workers, &longest_s);
    left_fill(s, j, longest_s, out);
    return true;
}

bool sched_worker_info(const struct sched *s, uint64_t worker, struct sched_worker_info *out)
{
    uint32_t slot = slotmap_find(&s->worker_map, worker);
    if (slot == SLOT_NONE)
        return false;
    const struct worker *w = &s->workers[slot];
    uint32_t oldest = w->begun.head != SLOT_NONE ? w->begun.head : w->queued.head;
    *out = (struct sched_worker_info){
        .state = worker_state(w),
        .job = oldest != SLOT_NONE ? s->jobs[s->leases[oldest].job].id : 0,
        .threads = w->threads,
        .leases = w->held,
        .units = w->units,
        .lost = w->lost,
        .failed = w->failed,
        .timeouts = w->timeouts,
        .differed = w->differed,
        .until_ms = w->set_aside ? w->until_ms : 0,
        .pauses = w->pauses,
        .speed = w->speed_shown,
    };
    return true;
}

void sched_farm_info(const struct sched *s, struct sched_farm_info *out)
{
    *out = (struct sched_farm_info){.leases = s->lease_map.count, .epoch_next = s->epoch_next};
    for (uint32_t i = 0; i < s->limits.worker_count_max; i++) {
        if (!slotmap_used(&s->worker_map, i) || !s->workers[i].connected)
            continue;
        out->workers++;
        out->threads += s->workers[i].threads;
    }
    for (uint32_t i = 0; i < s->job_rank_count; i++)
        out->jobs[s->jobs[s->job_rank[i]].state]++;
}

void sched_each_lease(const struct sched *s, uint64_t job,
                      void (*visit)(void *context, uint64_t worker, uint64_t job, struct unit unit,
                                    enum sched_lease_kind kind),
                      void *context)
{
    for (uint32_t i = 0; i < s->job_rank_count; i++) {
        const struct job *j = &s->jobs[s->job_rank[i]];
        if (job != 0 && j->id != job)
            continue;
        const uint32_t heads[] = {j->solo.head, j->others.head};
        for (int k = 0; k < 2; k++) {
            for (uint32_t l = heads[k]; l != SLOT_NONE; l = s->lease_job_links[l].next)
                visit(context, s->workers[s->leases[l].worker].handle, j->id, s->leases[l].unit,
                      s->leases[l].kind);
        }
    }
}

bool sched_spot_done(const struct sched *s, uint64_t job, uint32_t cell, uint32_t block)
{
    uint32_t slot = slotmap_find(&s->job_map, job);
    if (slot == SLOT_NONE || cell >= s->jobs[slot].cell_count || block >= s->jobs[slot].block_count)
        return false;
    return job_spot_state(&s->jobs[slot], cell, block) == SPOT_DONE;
}

uint32_t sched_frontier(const struct sched *s, uint64_t job, uint32_t cell)
{
    uint32_t slot = slotmap_find(&s->job_map, job);
    if (slot == SLOT_NONE || cell >= s->jobs[slot].cell_count)
        return 0;
    return s->jobs[slot].frontier[cell];
}

uint64_t sched_waiting(const struct sched *s, uint64_t job)
{
    uint32_t slot = slotmap_find(&s->job_map, job);
    return slot == SLOT_NONE ? 0 : s->jobs[slot].spots.waiting;
}

bool sched_limits_get(const struct sched *s, uint64_t job, uint16_t *limits)
{
    uint32_t slot = slotmap_find(&s->job_map, job);
    for (uint32_t cell = 0; slot != SLOT_NONE && cell < s->jobs[slot].cell_count; cell++)
        limits[cell] = s->jobs[slot].limit[cell];
    return slot != SLOT_NONE;
}

double sched_left_seconds(const struct sched *s, uint64_t job)
{
    uint32_t slot = slotmap_find(&s->job_map, job);
    double unknown_s = 0.0;
    return slot == SLOT_NONE ? 0.0 : job_left_seconds(&s->jobs[slot], &unknown_s);
}
