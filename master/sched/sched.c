#include "master/sched/sched_impl.h"

/* --- Start -------------------------------------------------------------------- */

void sched_limits_init(struct sched_limits *limits)
{
    *limits = (struct sched_limits){
        .worker_count_max = 16384,
        .job_count_max = 1024,
        .lease_count_max = 65536,
        .leases_per_worker_max = 256,
        .suspect_count_max = 4096,
        .unit_ms = 1000,
        .unit_first_ms = 100,
        .lease_factor = 8,
        .lease_ms_min = 20000,
        .load_ms = 600000,
        .pause_ms_min = 2000,
        .pause_ms_max = 120000,
        .away_ms = 600,
        .seed = 1,
    };
}

static bool limits_valid(const struct sched_limits *l)
{
    const uint32_t table_max = UINT32_C(1) << 22;
    return l->worker_count_max > 0 && l->worker_count_max <= table_max && l->job_count_max > 0 &&
           l->job_count_max <= table_max && l->lease_count_max > 0 &&
           l->lease_count_max <= table_max && l->leases_per_worker_max > 0 &&
           l->leases_per_worker_max <= 65536 && l->suspect_count_max > 0 &&
           l->suspect_count_max <= table_max && l->unit_ms > 0 && l->unit_first_ms > 0 &&
           l->lease_factor > 0 && l->lease_ms_min > 0 && l->load_ms > 0 && l->pause_ms_min > 0 &&
           l->pause_ms_max >= l->pause_ms_min;
}

static enum err pool_init(struct pool *p, struct arena *arena, uint32_t capacity)
{
    p->links = arena_alloc(arena, capacity, sizeof *p->links);
    if (!p->links)
        return ERR_NOMEM;
    chain_init(&p->free);
    for (uint32_t i = 0; i < capacity; i++)
        chain_push(&p->free, p->links, i);
    return ERR_OK;
}

static enum err tables_init(struct sched *s, struct arena *arena)
{
    const struct sched_limits *l = &s->limits;
    /* One step of sched_next ends at most a worker's leases or one unit's; each may make news. */
    s->news_capacity = 2 * l->leases_per_worker_max + 256;
    s->jobs = arena_alloc(arena, l->job_count_max, sizeof *s->jobs);
    s->job_rank = arena_alloc(arena, l->job_count_max, sizeof *s->job_rank);
    s->workers = arena_alloc(arena, l->worker_count_max, sizeof *s->workers);
    s->worker_links = arena_alloc(arena, l->worker_count_max, sizeof *s->worker_links);
    s->leases = arena_alloc(arena, l->lease_count_max, sizeof *s->leases);
    s->lease_worker_links = arena_alloc(arena, l->lease_count_max, sizeof *s->lease_worker_links);
    s->lease_job_links = arena_alloc(arena, l->lease_count_max, sizeof *s->lease_job_links);
    s->suspects = arena_alloc(arena, l->suspect_count_max, sizeof *s->suspects);
    s->checks = arena_alloc(arena, l->lease_count_max, sizeof *s->checks);
    s->news = arena_alloc(arena, s->news_capacity, sizeof *s->news);
    if (!s->jobs || !s->job_rank || !s->workers || !s->worker_links || !s->leases ||
        !s->lease_worker_links || !s->lease_job_links || !s->suspects || !s->checks || !s->news)
        return ERR_NOMEM;
    TL_TRY(slotmap_init(&s->job_map, arena, l->job_count_max));
    TL_TRY(slotmap_init(&s->worker_map, arena, l->worker_count_max));
    TL_TRY(slotmap_init(&s->lease_map, arena, l->lease_count_max));
    TL_TRY(timers_init(&s->timers, arena, l->lease_count_max + l->worker_count_max));
    TL_TRY(pool_init(&s->suspect_pool, arena, l->suspect_count_max));
    return pool_init(&s->check_pool, arena, l->lease_count_max);
}

enum err sched_new(struct arena *arena, const struct sched_limits *limits, uint64_t epoch_first,
                   struct sched **out)
{
    if (!limits_valid(limits) || epoch_first == 0)
        return ERR_LIMIT;
    struct sched *s = arena_alloc(arena, 1, sizeof *s);
    if (!s)
        return ERR_NOMEM;
    s->limits = *limits;
    s->epoch_next = epoch_first;
    TL_TRY(tables_init(s, arena));
    chain_init(&s->starving);
    chain_init(&s->prefetch);
    chain_init(&s->gone);
    chain_init(&s->revoked);
    for (uint32_t i = 0; i < limits->suspect_count_max; i++)
        s->suspects[i] = (struct suspect){.job = SLOT_NONE, .lease = SLOT_NONE};
    for (uint32_t i = 0; i < limits->lease_count_max; i++)
        s->checks[i] = (struct check){.job = SLOT_NONE, .lease = SLOT_NONE};
    *out = s;
    return ERR_OK;
}

uint64_t sched_epoch_next(const struct sched *s)
{
    return s->epoch_next;
}

/* --- Events in ------------------------------------------------------------------ */

static bool liar_settled(struct sched *s)
{
    if (s->liars_unsettled == 0)
        return false;
    if (--s->liars_unsettled == 0) {
        for (uint32_t i = 0; i < s->job_rank_count; i++)
            job_settle(s, s->job_rank[i]);
    }
    return true;
}

bool sched_feed(struct sched *s, uint64_t now_ms, const struct sched_event *e)
{
    TL_ASSERT(now_ms >= s->now_ms);
    TL_ASSERT(!s->scan.active && !s->stashed && s->news_count == 0 && s->revoked.count == 0);
    s->now_ms = now_ms;
    assign_rearm(s);
    switch (e->type) {
    case SCHED_TICK:
        return true;
    case SCHED_JOB_ADD:
    case SCHED_JOB_PAUSE:
    case SCHED_JOB_RESUME:
    case SCHED_JOB_CANCEL:
    case SCHED_JOB_RETRY:
    case SCHED_JOB_PRIORITY:
    case SCHED_JOB_HOLD:
    case SCHED_JOB_REMOVE:
    case SCHED_JOB_LIMITS:
    case SCHED_CELLS_RESET:
        return jobs_feed(s, e);
    case SCHED_WORKER_PAST:
    case SCHED_WORKER_JOIN:
    case SCHED_WORKER_AWAY:
    case SCHED_WORKER_LOST:
    case SCHED_WORKER_DRAIN:
    case SCHED_WORKER_LEFT:
    case SCHED_WORKER_RTT:
    case SCHED_WORKER_TAGS:
    case SCHED_JOB_READY:
    case SCHED_WORKER_ASKS:
    case SCHED_JOB_UNFIT:
    case SCHED_UNIT_FAILED:
        return workers_feed(s, e);
    case SCHED_RESULT:
        result_feed(s, e);
        return true;
    case SCHED_MISMATCH:
        return mismatch_feed(s, e);
    case SCHED_LIAR_SETTLED:
        return liar_settled(s);
    }
    TL_ASSERT(false); /* an event type that sched.h does not know */
    return false;
}

/* --- Actions out ------------------------------------------------------------------ */

void sched_news_push(struct sched *s, const struct sched_action *a)
{
    TL_ASSERT(s->news_count < s->news_capacity);
    s->news[(s->news_begin + s->news_count++) % s->news_capacity] = *a;
}

static bool news_next(struct sched *s, struct sched_action *out)
{
    if (s->news_count == 0)
        return false;
    *out = s->news[s->news_begin];
    s->news_begin = (s->news_begin + 1) % s->news_capacity;
    s->news_count--;
    return true;
}

static bool revoke_next(struct sched *s, struct sched_action *out)
{
    uint32_t slot = s->revoked.head;
    if (slot == SLOT_NONE)
        return false;
    const struct lease *l = &s->leases[slot];
    *out = (struct sched_action){.type = SCHED_REVOKE,
                                 .worker = s->workers[l->worker].handle,
                                 .job = s->jobs[l->job].id,
                                 .unit = l->unit,
                                 .epoch = l->epoch,
                                 .kind = l->kind};
    chain_remove(&s->revoked, s->lease_worker_links, slot);
    slotmap_remove(&s->lease_map, slot);
    return true;
}

/* Deadlines are met one at a time, each when the actions of the one before were taken, so that
 * the news of thousands of leases that end at once need no room. */
static bool timer_fire(struct sched *s)
{
    uint32_t id = timers_pop(&s->timers, s->now_ms);
    if (id == UINT32_MAX)
        return false;
    if (id < s->limits.lease_count_max)
        lease_timer_fired(s, id);
    else
        worker_timer_fired(s, id - s->limits.lease_count_max);
    return true;
}

bool sched_next(struct sched *s, struct sched_action *out)
{
    if (s->stashed) {
        *out = s->stash;
        s->stashed = false;
        return true;
    }
    do {
        if (scan_next(s, out) || revoke_next(s, out) || news_next(s, out) ||
            jobs_close_next(s, out))
            return true;
    } while (timer_fire(s));
    return assign_next(s, out) || news_next(s, out);
}

uint64_t sched_deadline_ms(const struct sched *s)
{
    uint64_t due_ms = timers_due_ms(&s->timers);
    uint64_t tick_ms = s->now_ms + TICK_MS;
    if (s->starving.count == 0 || due_ms <= tick_ms)
        return due_ms;
    /* Idle workers may copy a lease that gets late, or were not tried yet. */
    for (uint32_t i = 0; i < s->job_rank_count; i++) {
        const struct job *j = &s->jobs[s->job_rank[i]];
        if (j->state == SCHED_ACTIVE && j->spots.done < job_spot_count(j))
            return tick_ms;
    }
    return due_ms;
}
