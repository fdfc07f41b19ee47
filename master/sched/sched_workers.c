/* The life of a worker: joined, loading, at work, faulty, drained, gone. */
#include "master/sched/sched_impl.h"

enum {
    GOOD_RESULTS_FORGIVE = 64, /* so many good results shorten the next pause by half */
    SPARE_MAX = 32, /* leases beyond its threads; a worker refuses more than threads + 66 */
};

bool worker_usable(const struct worker *w)
{
    return w->connected && !w->away && !w->draining && !w->quarantined && !w->set_aside;
}

enum sched_worker_state worker_state(const struct worker *w)
{
    if (w->quarantined)
        return SCHED_WORKER_QUARANTINED;
    if (!w->connected)
        return SCHED_WORKER_GONE;
    if (w->set_aside)
        return SCHED_WORKER_SET_ASIDE;
    if (w->draining)
        return SCHED_WORKER_DRAINING;
    if (w->begun.count > 0)
        return SCHED_WORKER_BUSY;
    return w->queued.count > 0 ? SCHED_WORKER_LOADING : SCHED_WORKER_IDLE;
}

static struct worker_job *latest_job(struct worker *w)
{
    struct worker_job *best = NULL;
    for (int i = 0; i < WORKER_JOBS; i++) {
        struct worker_job *wj = &w->jobs[i];
        if (wj->job != 0 && wj->open && (!best || wj->used_ms > best->used_ms))
            best = wj;
    }
    return best;
}

/* Threads + 2, and as many more as finish within one and a half round trips. */
uint32_t worker_allowance(const struct sched *s, const struct worker *w)
{
    uint64_t spare = 2;
    const struct worker_job *wj = latest_job((struct worker *)w);
    if (wj && wj->target_ms > 0) {
        uint64_t unit_us = (uint64_t)wj->target_ms * 1000;
        uint64_t rtt_us = w->rtt_us < 60000000 ? w->rtt_us : 60000000;
        uint64_t needed = 1 + (w->threads * rtt_us * 3 / 2 + unit_us - 1) / unit_us;
        if (needed > spare)
            spare = needed;
    }
    uint64_t allowance = w->threads + (spare < SPARE_MAX ? spare : SPARE_MAX);
    uint32_t cap = s->limits.leases_per_worker_max;
    return allowance < cap ? (uint32_t)allowance : cap;
}

static struct chain *list_of(struct sched *s, enum worker_list list)
{
    switch (list) {
    case LIST_STARVING:
        return &s->starving;
    case LIST_PREFETCH:
        return &s->prefetch;
    case LIST_GONE:
        return &s->gone;
    case LIST_NONE:
        break;
    }
    return NULL;
}

void worker_unlist(struct sched *s, uint32_t worker)
{
    struct worker *w = &s->workers[worker];
    struct chain *c = list_of(s, w->list);
    if (c)
        chain_remove(c, s->worker_links, worker);
    w->list = LIST_NONE;
}

static enum worker_list list_wanted(const struct sched *s, const struct worker *w)
{
    if (!w->connected)
        return LIST_GONE;
    if (!worker_usable(w) || w->alone || (w->reserved_job != 0 && w->held > 0))
        return LIST_NONE;
    if (w->held < w->threads && w->held < s->limits.leases_per_worker_max)
        return LIST_STARVING;
    return w->held < worker_allowance(s, w) ? LIST_PREFETCH : LIST_NONE;
}

/* Its job may empty another worker instead. */
void worker_unreserve(struct sched *s, uint32_t worker)
{
    struct worker *w = &s->workers[worker];
    uint32_t job = slotmap_find(&s->job_map, w->reserved_job);
    if (job != SLOT_NONE) {
        TL_ASSERT(s->jobs[job].reserved > 0);
        s->jobs[job].reserved--;
    }
    w->reserved_job = 0;
}

uint32_t threads_with(const struct sched *s, uint64_t tags)
{
    uint32_t threads = 0;
    if (tags == 0)
        return s->threads;
    for (uint32_t i = 0; i < s->limits.worker_count_max; i++) {
        const struct worker *w = &s->workers[i];
        if (slotmap_used(&s->worker_map, i) && w->counted && (tags & ~w->tags) == 0)
            threads += w->threads;
    }
    return threads;
}

/* The worker's threads may take work from now on, or not any more. */
static void count_threads(struct sched *s, struct worker *w, bool counted)
{
    TL_ASSERT(w->counted != counted);
    w->counted = counted;
    s->threads = counted ? s->threads + w->threads : s->threads - w->threads;
    for (uint32_t i = 0; i < s->job_rank_count; i++) {
        struct job *j = &s->jobs[s->job_rank[i]];
        if (worker_has_tags(w, j))
            j->threads = counted ? j->threads + w->threads : j->threads - w->threads;
    }
}

void worker_place(struct sched *s, uint32_t worker)
{
    struct worker *w = &s->workers[worker];
    if (!worker_usable(w))
        worker_unreserve(s, worker);
    enum worker_list wanted = list_wanted(s, w);
    if (wanted != w->list) {
        worker_unlist(s, worker);
        w->list = wanted;
        if (wanted != LIST_NONE)
            chain_push(list_of(s, wanted), s->worker_links, worker);
    }
    if (worker_usable(w) != w->counted)
        count_threads(s, w, !w->counted);
    if (w->draining && w->connected && !w->away && w->held == 0 && !w->drained_told) {
        w->drained_told = true;
        sched_news_push(s, &(struct sched_action){.type = SCHED_DRAINED, .worker = w->handle});
    }
}

struct worker_job *worker_job_find(struct worker *w, uint64_t job)
{
    for (int i = 0; i < WORKER_JOBS; i++) {
        if (w->jobs[i].job == job)
            return &w->jobs[i];
    }
    return NULL;
}

/* Which entry to give up: a free one, else the one unused for longest, barred ones last. */
static struct worker_job *entry_to_reuse(const struct sched *s, struct worker *w)
{
    struct worker_job *best = NULL;
    for (int i = 0; i < WORKER_JOBS; i++) {
        struct worker_job *wj = &w->jobs[i];
        if (wj->job == 0)
            return wj;
        if (wj->leases > 0)
            continue;
        bool barred = wj->barred_until_ms > s->now_ms;
        bool best_barred = best && best->barred_until_ms > s->now_ms;
        if (!best || (best_barred && !barred) ||
            (best_barred == barred && wj->used_ms < best->used_ms))
            best = wj;
    }
    return best;
}

struct worker_job *worker_job_get(struct sched *s, struct worker *w, uint64_t job)
{
    struct worker_job *wj = worker_job_find(w, job);
    if (wj)
        return wj;
    wj = entry_to_reuse(s, w);
    if (!wj)
        return NULL;
    if (wj->job != 0 && wj->open)
        sched_news_push(s, &(struct sched_action){
                               .type = SCHED_CLOSE_JOB, .worker = w->handle, .job = wj->job});
    *wj =
        (struct worker_job){.job = job, .target_ms = s->limits.unit_first_ms, .used_ms = s->now_ms};
    return wj;
}

/* The worker is about to be told of the job. */
void worker_job_open(struct sched *s, uint32_t worker, struct worker_job *wj)
{
    wj->open = true;
    wj->ready = false;
    wj->opened_ms = s->now_ms;
    worker_timer_set(s, worker);
}

bool worker_barred(const struct sched *s, struct worker *w, const struct job *j)
{
    const struct worker_job *wj = worker_job_find(w, j->id);
    return !worker_has_tags(w, j) || (wj && wj->barred_until_ms > s->now_ms);
}

/* The oldest `threads` leases of jobs it is ready for are taken to be begun. */
void worker_begin_leases(struct sched *s, uint32_t worker)
{
    struct worker *w = &s->workers[worker];
    if (!w->connected || w->away || w->quarantined || w->set_aside)
        return;
    uint32_t l = w->queued.head;
    while (l != SLOT_NONE && w->begun.count < w->threads) {
        uint32_t next = s->lease_worker_links[l].next;
        const struct worker_job *wj = worker_job_find(w, s->jobs[s->leases[l].job].id);
        TL_ASSERT(wj);
        if (wj->ready)
            lease_begin(s, l);
        l = next;
    }
}

/* --- Health --------------------------------------------------------------- */

static uint64_t pause_ms(const struct sched *s, uint32_t pauses)
{
    uint64_t ms = (uint64_t)s->limits.pause_ms_min << (pauses < PAUSES_MAX ? pauses : PAUSES_MAX);
    return ms < s->limits.pause_ms_max ? ms : s->limits.pause_ms_max;
}

/* One timer a worker: the end of its absence, its pause, a bar, or its patience with loading. */
void worker_timer_set(struct sched *s, uint32_t worker)
{
    const struct worker *w = &s->workers[worker];
    uint64_t due = UINT64_MAX;
    if (w->connected && w->set_aside && !w->quarantined)
        due = w->until_ms;
    if (w->away && w->away_until_ms < due)
        due = w->away_until_ms;
    for (int i = 0; i < WORKER_JOBS && w->connected; i++) {
        const struct worker_job *wj = &w->jobs[i];
        if (wj->job == 0)
            continue;
        if (wj->barred_until_ms > 0 && wj->barred_until_ms < due)
            due = wj->barred_until_ms;
        uint64_t load_due = wj->opened_ms + s->limits.load_ms;
        if (wj->open && !wj->ready && load_due < due)
            due = load_due;
    }
    timers_set(&s->timers, s->limits.lease_count_max + worker, due);
}

void worker_job_unfit(struct sched *s, uint32_t worker, struct worker_job *wj, uint32_t points)
{
    struct worker *w = &s->workers[worker];
    uint64_t id = wj->job;
    wj->open = wj->ready = false;
    wj->barred_until_ms = s->now_ms + pause_ms(s, wj->unfit++);
    worker_leases_end(s, worker, id, END_FAILED, false);
    worker_timer_set(s, worker);
    worker_place(s, worker);
    uint32_t job = slotmap_find(&s->job_map, id);
    TL_ASSERT(w->connected || wj->leases == 0);
    if (job == SLOT_NONE || !job_is_live(&s->jobs[job]))
        return;
    s->jobs[job].unfit_points += points;
    if (s->jobs[job].unfit_points >= UNFIT_POINTS_FAIL)
        job_fail(s, job, SCHED_WHY_JOB_UNFIT, (struct unit){0});
}

static void worker_gone(struct sched *s, uint32_t worker, bool lost);

void worker_timer_fired(struct sched *s, uint32_t worker)
{
    struct worker *w = &s->workers[worker];
    if (w->away && s->now_ms >= w->away_until_ms) {
        worker_gone(s, worker, true);
        return;
    }
    if (w->set_aside && s->now_ms >= w->until_ms) {
        w->set_aside = false;
        w->fault_points = FAULT_POINTS_ASIDE / 2;
        sched_news_push(s, &(struct sched_action){.type = SCHED_WORKER_NEWS,
                                                  .worker = w->handle,
                                                  .state = worker_state(w)});
    }
    for (int i = 0; i < WORKER_JOBS; i++) {
        struct worker_job *wj = &w->jobs[i];
        if (wj->barred_until_ms > 0 && wj->barred_until_ms <= s->now_ms)
            wj->barred_until_ms = 0;
        if (wj->job != 0 && wj->open && !wj->ready &&
            wj->opened_ms + s->limits.load_ms <= s->now_ms) {
            if (!w->away)
                sched_news_push(s, &(struct sched_action){.type = SCHED_CLOSE_JOB,
                                                          .worker = w->handle,
                                                          .job = wj->job});
            worker_job_unfit(s, worker, wj, UNFIT_POINTS);
        }
    }
    worker_timer_set(s, worker);
    worker_place(s, worker);
}

void worker_fault(struct sched *s, uint32_t worker)
{
    struct worker *w = &s->workers[worker];
    w->good_results = 0;
    if (w->set_aside)
        return;
    w->fault_points += FAULT_POINTS;
    if (w->fault_points < FAULT_POINTS_ASIDE)
        return;
    w->set_aside = true;
    w->until_ms = s->now_ms + pause_ms(s, w->pauses);
    if (w->pauses < PAUSES_MAX)
        w->pauses++;
    uint32_t held = w->held;
    worker_leases_end(s, worker, 0, END_TAKEN, false);
    worker_timer_set(s, worker);
    worker_place(s, worker);
    sched_news_push(s, &(struct sched_action){.type = SCHED_WORKER_NEWS,
                                              .worker = w->handle,
                                              .state = SCHED_WORKER_SET_ASIDE,
                                              .losses = held,
                                              .until_ms = w->until_ms});
}

void worker_good(struct sched *s, uint32_t worker)
{
    struct worker *w = &s->workers[worker];
    if (w->fault_points > 0)
        w->fault_points--;
    if (++w->good_results >= GOOD_RESULTS_FORGIVE) {
        w->good_results = 0;
        if (w->pauses > 0)
            w->pauses--;
    }
}

void worker_quarantine(struct sched *s, uint32_t worker)
{
    struct worker *w = &s->workers[worker];
    if (w->quarantined)
        return;
    w->quarantined = true;
    worker_leases_end(s, worker, 0, END_TAKEN, false);
    worker_timer_set(s, worker);
    worker_place(s, worker);
}

/* --- Coming and going ------------------------------------------------------ */

/* Its connection is gone: leases return, a new connection starts from nothing. */
static void worker_gone(struct sched *s, uint32_t worker, bool lost)
{
    struct worker *w = &s->workers[worker];
    uint32_t held = w->held;
    w->connected = w->away = false;
    w->draining = false;
    w->alone = false;
    worker_leases_end(s, worker, 0, END_DROPPED, lost);
    for (int i = 0; i < WORKER_JOBS; i++) {
        struct worker_job *wj = &w->jobs[i];
        if (wj->job == 0)
            continue;
        bool loading = wj->open && !wj->ready;
        wj->open = wj->ready = false;
        if (loading && lost)
            worker_job_unfit(s, worker, wj, UNFIT_POINTS_LOST);
    }
    if (lost)
        worker_fault(s, worker);
    worker_timer_set(s, worker);
    worker_place(s, worker);
    sched_news_push(s, &(struct sched_action){.type = SCHED_WORKER_NEWS,
                                              .worker = w->handle,
                                              .state = SCHED_WORKER_GONE,
                                              .losses = held});
}

/* Its connection is gone, perhaps not for long: it keeps what it has, and gets nothing. */
static bool worker_leave(struct sched *s, uint32_t worker)
{
    struct worker *w = &s->workers[worker];
    if (w->away)
        return false;
    w->away = true;
    w->away_until_ms = s->now_ms + s->limits.away_ms;
    worker_timer_set(s, worker);
    worker_place(s, worker);
    return true;
}

/* A lease of a worker that it has not told of, or SLOT_NONE. */
static uint32_t untold_lease(const struct sched *s, const struct worker *w)
{
    const struct chain *chains[] = {&w->begun, &w->queued};
    for (int i = 0; i < 2; i++)
        for (uint32_t l = chains[i]->head; l != SLOT_NONE; l = s->lease_worker_links[l].next)
            if (!s->leases[l].told)
                return l;
    return SLOT_NONE;
}

/* The same process is back before it was lost: what it still has stays as it is, deadlines too. It
 * is told of its jobs once more, and has no longer to load them than it had. */
static void worker_back(struct sched *s, uint32_t worker, const struct sched_join *join)
{
    struct worker *w = &s->workers[worker];
    worker_told(s, worker, join->held, join->held_count);
    uint32_t lease;
    while ((lease = untold_lease(s, w)) != SLOT_NONE) {
        w->lost++;
        lease_end(s, lease, END_DROPPED, false);
    }
    for (int i = 0; i < WORKER_JOBS; i++) {
        struct worker_job *wj = &w->jobs[i];
        bool loading = wj->open && !wj->ready;
        uint64_t opened_ms = wj->opened_ms;
        wj->open = wj->ready = false;
        if (wj->leases == 0)
            continue;
        worker_job_open(s, worker, wj);
        if (loading)
            wj->opened_ms = opened_ms;
        sched_news_push(
            s, &(struct sched_action){.type = SCHED_OPEN_JOB, .worker = w->handle, .job = wj->job});
    }
    w->draining = w->away = false;
}

uint32_t worker_add(struct sched *s, uint64_t handle)
{
    uint32_t worker = slotmap_add(&s->worker_map, handle);
    if (worker == SLOT_NONE) {
        if (s->gone.count == 0)
            return SLOT_NONE;
        uint32_t oldest = s->gone.head;
        worker_unlist(s, oldest);
        timers_stop(&s->timers, s->limits.lease_count_max + oldest);
        slotmap_remove(&s->worker_map, oldest);
        worker = slotmap_add(&s->worker_map, handle);
    }
    struct worker *w = &s->workers[worker];
    *w = (struct worker){.handle = handle};
    chain_init(&w->begun);
    chain_init(&w->queued);
    return worker;
}

static bool worker_join(struct sched *s, uint64_t handle, const struct sched_join *join)
{
    if (handle == 0 || join->threads == 0)
        return false;
    uint32_t worker = slotmap_find(&s->worker_map, handle);
    if (worker == SLOT_NONE)
        worker = worker_add(s, handle);
    if (worker == SLOT_NONE)
        return false;
    struct worker *w = &s->workers[worker];
    if (w->connected)
        (void)worker_leave(s, worker);
    if (w->away && w->begun.count > join->threads)
        worker_gone(s, worker, false);
    w->tags = join->tags; /* its threads are not counted now */
    if (w->away)
        worker_back(s, worker, join);
    w->connected = true;
    w->drained_told = false;
    w->threads = join->threads < SCHED_THREADS_MAX ? join->threads : SCHED_THREADS_MAX;
    if (w->set_aside && w->until_ms <= s->now_ms)
        w->until_ms = s->now_ms;
    worker_timer_set(s, worker);
    worker_place(s, worker);
    worker_adopt(s, worker, join->held, join->held_count);
    worker_place(s, worker);
    return true;
}

static bool worker_retag(struct sched *s, struct worker *w, uint64_t tags)
{
    bool counted = w->counted;
    if (counted)
        count_threads(s, w, false);
    w->tags = tags;
    if (counted)
        count_threads(s, w, true);
    return true;
}

static bool worker_ready(struct sched *s, uint32_t worker, uint64_t job)
{
    struct worker *w = &s->workers[worker];
    struct worker_job *wj = job ? worker_job_find(w, job) : NULL;
    if (!wj || !wj->open)
        return false;
    worker_leases_go_on(s, worker, job);
    if (wj->ready)
        return true;
    wj->ready = true;
    wj->unfit = 0;
    uint32_t slot = slotmap_find(&s->job_map, job);
    if (slot != SLOT_NONE)
        s->jobs[slot].unfit_points = 0;
    worker_timer_set(s, worker);
    worker_begin_leases(s, worker);
    worker_place(s, worker);
    return true;
}

static bool worker_unfit(struct sched *s, uint32_t worker, uint64_t job)
{
    struct worker_job *wj = job ? worker_job_find(&s->workers[worker], job) : NULL;
    if (!wj || !wj->open)
        return false;
    worker_job_unfit(s, worker, wj, UNFIT_POINTS);
    return true;
}

static bool worker_drain(struct sched *s, uint32_t worker)
{
    struct worker *w = &s->workers[worker];
    if (w->draining)
        return false;
    w->draining = true;
    worker_place(s, worker);
    return true;
}

static bool worker_unit_failed(struct sched *s, uint32_t worker, uint64_t epoch)
{
    uint32_t lease = slotmap_find(&s->lease_map, epoch);
    if (lease == SLOT_NONE || s->leases[lease].worker != worker)
        return false;
    struct worker *w = &s->workers[worker];
    w->failed++;
    w->lost++;
    lease_end(s, lease, END_FAILED, true);
    worker_fault(s, worker);
    return true;
}

bool workers_feed(struct sched *s, const struct sched_event *e)
{
    if (e->type == SCHED_WORKER_PAST)
        return worker_past(s, e->worker, &e->past);
    if (e->type == SCHED_WORKER_JOIN)
        return worker_join(s, e->worker, &e->join);
    uint32_t worker = slotmap_find(&s->worker_map, e->worker);
    if (worker == SLOT_NONE || !s->workers[worker].connected)
        return false;
    switch (e->type) {
    case SCHED_WORKER_AWAY:
        return worker_leave(s, worker);
    case SCHED_WORKER_LOST:
    case SCHED_WORKER_LEFT:
        worker_gone(s, worker, e->type == SCHED_WORKER_LOST);
        return true;
    case SCHED_WORKER_DRAIN:
        return worker_drain(s, worker);
    case SCHED_WORKER_RTT:
        s->workers[worker].rtt_us = e->rtt_us;
        worker_place(s, worker);
        return true;
    case SCHED_WORKER_TAGS:
        return worker_retag(s, &s->workers[worker], e->tags);
    case SCHED_JOB_READY:
        return worker_ready(s, worker, e->job);
    case SCHED_WORKER_ASKS:
        worker_leases_wait(s, worker);
        return true;
    case SCHED_JOB_UNFIT:
        return worker_unfit(s, worker, e->job);
    case SCHED_UNIT_FAILED:
        return worker_unit_failed(s, worker, e->epoch);
    default:
        return false;
    }
}
