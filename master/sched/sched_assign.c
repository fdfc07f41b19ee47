/* Who gets what next: the job, the unit, its size; and copies for idle workers. */
#include "master/sched/sched_impl.h"

enum {
    RUN_CELLS_MAX = 65536, /* cells looked at for one unit */
    SUSPECTS_LOOKED_AT = 8,
    CHECKS_LOOKED_AT = 8,   /* pending ones that are tried for a worker */
    COPIES_LOOKED_AT = 16,  /* oldest leases among which the slowest is copied */
    TRIES_COPY = 4,         /* idle workers that are tried for a copy per event */
    TRIES = 64,             /* workers for which no job may have work per event */
    CHECK_TAKEN_MS = 1000,  /* a worker keeps a check for at least so long */
    COPY_SUSPECT_MS = 1000, /* and a unit that lost a worker, without a copy */
    CLAIM_MS = 1000,        /* of each thread, that a job may be behind its equals */
    LOAD_GUESS_MS = 10000,  /* a scene that must be loaded first delays a copy by so much */
};

/* Pixel-samples per second and thread before the first result: only the size of the very first
 * units depends on it, and units that are too small cost less than units that are too large. */
static const double SPEED_GUESS = 2.5e5;

/* One worker's speed over the job's mean is believed within this factor. */
static const double RATIO_MAX = 16.0;

/* --- How long, how large --------------------------------------------------- */

double worker_speed_ratio(const struct sched *s, struct worker *w, const struct job *j)
{
    (void)s;
    const struct worker_job *wj = worker_job_find(w, j->id);
    if (!wj || wj->speed <= 0.0 || j->samples_s <= 0.0 || j->samples <= 0.0)
        return 1.0;
    double ratio = wj->speed * j->samples_s / j->samples;
    if (ratio > RATIO_MAX)
        return RATIO_MAX;
    return ratio < 1.0 / RATIO_MAX ? 1.0 / RATIO_MAX : ratio;
}

uint32_t unit_expected_ms(const struct sched *s, struct worker *w, const struct job *j,
                          struct unit unit)
{
    double sum_s = 0.0;
    for (uint32_t i = 0; i < unit.cell_count; i++)
        sum_s += job_cell_seconds(j, unit.cell_begin + i, unit.block);
    double ms = 1e3 * sum_s / worker_speed_ratio(s, w, j);
    if (sum_s <= 0.0)
        return 0;
    if (ms < 1.0)
        return 1;
    return ms < 1e9 ? (uint32_t)ms : 1000000000;
}

/* A quarter of a thread's share of what is not leased yet: the end must not drag. */
static uint32_t cells_allowed(const struct job *j)
{
    uint64_t left = job_spot_count(j) - j->spots.done - j->spots.leased;
    uint64_t threads = j->threads > 0 ? j->threads : 1;
    uint64_t cells = left / (4 * threads);
    if (cells > RUN_CELLS_MAX)
        cells = RUN_CELLS_MAX;
    if (j->unit_cells_max > 0 && cells > j->unit_cells_max)
        cells = j->unit_cells_max;
    return cells > 0 ? (uint32_t)cells : 1;
}

/* Cuts the next unit from the lowest block with waiting cells, to last about as long as the
 * worker's next unit should. */
static bool unit_carve(const struct sched *s, struct worker *w, const struct worker_job *wj,
                       const struct job *j, struct unit *out)
{
    if (job_waiting_run(j, cells_allowed(j), out) == 0)
        return false;
    uint32_t target_ms = wj->target_ms < j->unit_ms ? wj->target_ms : j->unit_ms;
    double target_s = 1e-3 * target_ms * worker_speed_ratio(s, w, j);
    double guess_s = j->cell_cost * (double)job_weight(j, out->block) / SPEED_GUESS;
    double sum_s = 0.0;
    uint32_t count = 0;
    while (count < out->cell_count) {
        double cell_s = job_cell_seconds(j, out->cell_begin + count, out->block);
        sum_s += cell_s > 0.0 ? cell_s : guess_s;
        if (count > 0 && sum_s > target_s)
            break;
        count++;
    }
    out->cell_count = count;
    return true;
}

/* --- What a job has for a worker ------------------------------------------- */

/* A pending check for which this worker has not voted, or SLOT_NONE. */
static uint32_t check_for(const struct sched *s, const struct job *j, const struct worker *w)
{
    uint32_t c = j->checks.head;
    for (int i = 0; i < CHECKS_LOOKED_AT && c != SLOT_NONE; i++) {
        if (!check_voted(&s->checks[c], w->handle))
            return c;
        c = s->check_pool.links[c].next;
    }
    return SLOT_NONE;
}

/* A pending suspect that did not take this worker down just now, or SLOT_NONE. */
static uint32_t suspect_for(const struct sched *s, const struct chain *pending,
                            const struct worker *w)
{
    uint32_t p = pending->head;
    for (int i = 0; i < SUSPECTS_LOOKED_AT && p != SLOT_NONE; i++) {
        const struct suspect *suspect = &s->suspects[p];
        bool lost = false;
        for (int k = 0; k < SUSPECT_LOSERS; k++)
            lost |= suspect->losers[k] == w->handle;
        if (!lost || s->now_ms - suspect->lost_ms >= SUSPECT_PATIENCE_MS)
            return p;
        p = s->suspect_pool.links[p].next;
    }
    return SLOT_NONE;
}

static bool job_offers(const struct sched *s, const struct job *j, const struct worker *w)
{
    return j->spots.waiting > 0 || suspect_for(s, &j->suspects, w) != SLOT_NONE ||
           (w->held == 0 && suspect_for(s, &j->suspects_alone, w) != SLOT_NONE) ||
           check_for(s, j, w) != SLOT_NONE;
}

static bool job_has_work(const struct sched *s, const struct job *j)
{
    return j->state == SCHED_ACTIVE && !j->held && s->now_ms >= j->quiet_until_ms &&
           (j->suspects.count > 0 || j->spots.waiting > 0 || j->suspects_alone.count > 0 ||
            j->checks.count > 0);
}

/* A suspect that may only be rendered alone needs a worker that holds nothing: have one emptied. */
static bool reserve(struct sched *s, struct job *j, uint32_t worker)
{
    struct worker *w = &s->workers[worker];
    if (j->suspects_alone.count <= j->reserved || w->held == 0 ||
        suspect_for(s, &j->suspects_alone, w) == SLOT_NONE)
        return false;
    j->reserved++;
    w->reserved_job = j->id;
    worker_place(s, worker);
    return true;
}

/* Among equals the job that was given the least thread-time so far goes first. Who comes anew, or
 * had nothing to do, begins where the one is that was given most, and nobody is ever further
 * behind it than a second of the whole farm: waiting gives no claim to everything later. So a new
 * master needs no record of what an old one gave: that all begin level takes no more than this
 * second from anybody. `begin` is the first of these equals in job_rank; gives the one behind the
 * last. */
static uint32_t settle_equals(struct sched *s, uint32_t begin, bool *work)
{
    uint32_t end = begin;
    uint64_t most_ms = 0;
    int32_t priority = s->jobs[s->job_rank[begin]].priority;
    for (; end < s->job_rank_count && s->jobs[s->job_rank[end]].priority == priority; end++) {
        const struct job *j = &s->jobs[s->job_rank[end]];
        if (j->contends && j->leased_ms > most_ms)
            most_ms = j->leased_ms;
    }
    for (uint32_t i = begin; i < end; i++) {
        struct job *j = &s->jobs[s->job_rank[i]];
        uint64_t claim_ms = j->contends ? (uint64_t)CLAIM_MS * (s->threads + 1) : 0;
        j->contends = job_has_work(s, j);
        *work |= j->contends;
        if (j->contends && j->leased_ms + claim_ms < most_ms)
            j->leased_ms = most_ms - claim_ms;
    }
    return end;
}

/* Once before workers are tried, not for each of them: true if any job has work. */
static bool settle_claims(struct sched *s)
{
    bool work = false;
    for (uint32_t i = 0; i < s->job_rank_count;)
        i = settle_equals(s, i, &work);
    return work;
}

/* A scene that the worker does not hold counts like a unit on half its threads. */
static uint64_t job_load(const struct sched *s, const struct job *j, struct worker *w)
{
    const struct worker_job *wj = worker_job_find(w, j->id);
    uint64_t units = wj && wj->open ? 0 : w->threads > 1 ? w->threads / 2 : 1;
    return j->leased_ms + units * s->limits.unit_ms;
}

/* The most urgent job with work for this worker; SLOT_NONE. */
static uint32_t job_for(struct sched *s, uint32_t worker)
{
    struct worker *w = &s->workers[worker];
    uint32_t best = SLOT_NONE;
    uint64_t best_load = 0;
    for (uint32_t i = 0; i < s->job_rank_count; i++) {
        uint32_t job = s->job_rank[i];
        struct job *j = &s->jobs[job];
        if (best != SLOT_NONE && j->priority < s->jobs[best].priority)
            break;
        if (!job_has_work(s, j) || worker_barred(s, w, j))
            continue;
        if (reserve(s, j, worker))
            return SLOT_NONE;
        if (!job_offers(s, j, w))
            continue;
        uint64_t load = job_load(s, j, w);
        if (best == SLOT_NONE || load < best_load) {
            best = job;
            best_load = load;
        }
    }
    return best;
}

/* --- Leasing ---------------------------------------------------------------- */

/* What is not measured yet is taken to last as long as first units are to. */
static void job_charge(struct sched *s, uint32_t job, uint32_t lease)
{
    uint32_t ms = s->leases[lease].expected_ms;
    s->jobs[job].leased_ms += ms > 0 ? ms : s->limits.unit_first_ms;
}

static uint32_t lease_suspect(struct sched *s, uint32_t worker, uint32_t job, uint32_t suspect,
                              bool alone)
{
    const struct suspect *p = &s->suspects[suspect];
    if (p->open < p->unit.cell_count) {
        /* A late result brought part of it: it does not kill. Carve it anew. */
        suspect_dissolve(s, suspect);
        return SLOT_NONE;
    }
    uint32_t lease = lease_new(s, worker, job, p->unit, SCHED_KIND_RETRY);
    if (lease == SLOT_NONE)
        return SLOT_NONE;
    s->leases[lease].alone = alone;
    s->workers[worker].alone = alone;
    lease_own_suspect(s, lease, suspect);
    return lease;
}

static uint32_t lease_check(struct sched *s, uint32_t worker, uint32_t job, uint32_t check)
{
    uint32_t lease = lease_new(s, worker, job, s->checks[check].unit, SCHED_KIND_CHECK);
    if (lease != SLOT_NONE)
        lease_own_check(s, lease, check);
    return lease;
}

static uint32_t lease_waiting(struct sched *s, uint32_t worker, uint32_t job,
                              const struct worker_job *wj)
{
    struct job *j = &s->jobs[job];
    /* A result to be verified must find room for its check. */
    if (j->verify_share > 0.0 && s->lease_map.count >= s->check_pool.free.count)
        return SLOT_NONE;
    struct unit unit;
    if (!unit_carve(s, &s->workers[worker], wj, j, &unit))
        return SLOT_NONE;
    uint32_t lease = lease_new(s, worker, job, unit, SCHED_KIND_FIRST);
    if (lease != SLOT_NONE)
        lease_own(s, lease);
    return lease;
}

/* The most pressing thing that the job has for the worker. */
static uint32_t lease_from(struct sched *s, uint32_t worker, uint32_t job)
{
    struct worker *w = &s->workers[worker];
    struct job *j = &s->jobs[job];
    const struct worker_job *wj = worker_job_get(s, w, j->id);
    if (!wj)
        return SLOT_NONE;
    uint32_t p;
    while (w->held == 0 && (p = suspect_for(s, &j->suspects_alone, w)) != SLOT_NONE) {
        uint32_t lease = lease_suspect(s, worker, job, p, true);
        if (lease != SLOT_NONE || s->lease_map.count == s->lease_map.capacity)
            return lease;
    }
    uint32_t check = check_for(s, j, w);
    if (check != SLOT_NONE)
        return lease_check(s, worker, job, check);
    while ((p = suspect_for(s, &j->suspects, w)) != SLOT_NONE) {
        uint32_t lease = lease_suspect(s, worker, job, p, false);
        if (lease != SLOT_NONE || s->lease_map.count == s->lease_map.capacity)
            return lease;
    }
    return lease_waiting(s, worker, job, wj);
}

/* --- The end of a job: the slowest leases once more -------------------------- */

static uint32_t twins(const struct sched *s, uint32_t lease, uint32_t worker, bool *here)
{
    uint32_t count = 0, l = lease;
    do {
        *here = *here || s->leases[l].worker == worker;
        count++;
        l = s->leases[l].twin;
    } while (l != lease);
    return count;
}

/* How much longer a lease may be expected to take. What is overdue is expected to stay so for as
 * long as it already is. */
static uint64_t lease_left_ms(const struct sched *s, const struct lease *l)
{
    struct worker *w = &s->workers[l->worker];
    const struct worker_job *wj = worker_job_find(w, s->jobs[l->job].id);
    uint64_t expected_ms = l->expected_ms;
    if (w->away)
        return expected_ms + LOAD_GUESS_MS;
    if (!l->begun) {
        uint64_t ahead = w->begun.count > 0 ? expected_ms : 0;
        return expected_ms + ahead + (wj->ready ? 0 : LOAD_GUESS_MS);
    }
    uint64_t elapsed_ms = s->now_ms - l->begun_ms;
    if (elapsed_ms <= expected_ms)
        return expected_ms - elapsed_ms;
    return elapsed_ms - expected_ms;
}

/* What may kill whoever renders it is not copied in haste, and one that is rendered alone only to a
 * worker that holds nothing. But it must not wait for the end of a hung worker's patience either.
 */
static bool copy_allowed(const struct sched *s, const struct lease *l, const struct worker *w)
{
    if (!l->owner)
        return false;
    if (l->suspect == SLOT_NONE)
        return true;
    uint64_t held_ms = s->now_ms - l->leased_ms;
    return held_ms >= COPY_SUSPECT_MS && held_ms / (l->alone ? 4 : 2) > l->expected_ms &&
           (!l->alone || w->held == 0);
}

/* The lease of the job that is worth copying to this worker; SLOT_NONE. */
static uint32_t copy_candidate(struct sched *s, uint32_t worker, const struct job *j)
{
    struct worker *w = &s->workers[worker];
    const struct worker_job *wj = worker_job_find(w, j->id);
    uint32_t best = SLOT_NONE;
    uint64_t best_left_ms = 0;
    const uint32_t heads[] = {j->solo.head, j->others.head};
    for (int k = 0; k < 2; k++) {
        uint32_t l = heads[k];
        for (int i = 0; i < COPIES_LOOKED_AT && l != SLOT_NONE;
             i++, l = s->lease_job_links[l].next) {
            const struct lease *lease = &s->leases[l];
            bool here = false;
            if (!copy_allowed(s, lease, w) || twins(s, l, worker, &here) > COPIES_MAX || here)
                continue;
            uint64_t left_ms = lease_left_ms(s, lease);
            uint64_t here_ms = unit_expected_ms(s, w, j, lease->unit);
            if (!wj || !wj->ready)
                here_ms += LOAD_GUESS_MS;
            if (left_ms > here_ms && left_ms > best_left_ms) {
                best = l;
                best_left_ms = left_ms;
            }
        }
    }
    return best;
}

/* A check that another worker has for too long, taken from it: its vote would still count. */
static uint32_t check_to_take(struct sched *s, uint32_t worker, const struct job *j)
{
    struct worker *w = &s->workers[worker];
    uint32_t c = j->checks_out.head;
    for (int i = 0; i < CHECKS_LOOKED_AT && c != SLOT_NONE; i++, c = s->check_pool.links[c].next) {
        const struct check *check = &s->checks[c];
        if (check_voted(check, w->handle) || s->leases[check->lease].worker == worker)
            continue;
        const struct lease *l = &s->leases[check->lease];
        uint64_t held_ms = s->now_ms - l->leased_ms;
        if (held_ms >= CHECK_TAKEN_MS && held_ms / 2 >= l->expected_ms &&
            lease_left_ms(s, l) > unit_expected_ms(s, w, j, check->unit))
            return c;
    }
    return SLOT_NONE;
}

static uint32_t lease_copy(struct sched *s, uint32_t worker)
{
    struct worker *w = &s->workers[worker];
    for (uint32_t i = 0; i < s->job_rank_count; i++) {
        uint32_t job = s->job_rank[i];
        struct job *j = &s->jobs[job];
        if (j->state != SCHED_ACTIVE || s->now_ms < j->quiet_until_ms || worker_barred(s, w, j))
            continue;
        uint32_t check = check_to_take(s, worker, j), of = copy_candidate(s, worker, j);
        if ((check == SLOT_NONE && of == SLOT_NONE) || !worker_job_get(s, w, j->id))
            continue;
        if (check != SLOT_NONE) {
            s->workers[s->leases[s->checks[check].lease].worker].lost++;
            lease_end(s, s->checks[check].lease, END_REVOKED, false);
            return lease_check(s, worker, job, check);
        }
        uint32_t lease = lease_new(s, worker, job, s->leases[of].unit, SCHED_KIND_COPY);
        if (lease == SLOT_NONE)
            return SLOT_NONE;
        lease_join(s, lease, of);
        s->leases[lease].alone = w->alone = s->leases[of].alone;
        j->speculated++;
        return lease;
    }
    return SLOT_NONE;
}

/* --- The queue of workers with room ------------------------------------------ */

static uint32_t lease_for(struct sched *s, uint32_t worker, bool work)
{
    struct worker *w = &s->workers[worker];
    uint32_t lease = SLOT_NONE;
    if (w->reserved_job != 0)
        worker_unreserve(s, worker);
    if (work) {
        uint32_t job = job_for(s, worker);
        if (job != SLOT_NONE)
            lease = lease_from(s, worker, job);
        if (lease != SLOT_NONE)
            job_charge(s, job, lease);
    }
    if (lease == SLOT_NONE && w->list == LIST_STARVING)
        lease = lease_copy(s, worker);
    return lease;
}

static void rotate(struct sched *s, struct chain *list, uint32_t worker)
{
    chain_remove(list, s->worker_links, worker);
    chain_push(list, s->worker_links, worker);
}

/* The LEASE, or before the first one of a job its OPEN_JOB. */
static void announce(struct sched *s, uint32_t lease, struct sched_action *out)
{
    const struct lease *l = &s->leases[lease];
    struct worker *w = &s->workers[l->worker];
    const struct job *j = &s->jobs[l->job];
    struct worker_job *wj = worker_job_find(w, j->id);
    *out = (struct sched_action){.type = SCHED_LEASE,
                                 .worker = w->handle,
                                 .job = j->id,
                                 .unit = l->unit,
                                 .epoch = l->epoch,
                                 .kind = l->kind};
    if (wj->open)
        return;
    s->stash = *out;
    s->stashed = true;
    *out = (struct sched_action){.type = SCHED_OPEN_JOB, .worker = w->handle, .job = j->id};
    worker_job_open(s, l->worker, wj);
}

void assign_rearm(struct sched *s)
{
    s->went_without[0] = s->went_without[1] = 0;
}

/* The list whose first worker is to be tried: idle threads before prefetch. Each worker is tried
 * about once, and no more than TRIES go without: the others are first at the next event. */
static struct chain *list_to_try(struct sched *s, bool work)
{
    uint32_t tries = work ? TRIES : TRIES_COPY;
    if (s->went_without[0] < (tries < s->starving.count ? tries : s->starving.count))
        return &s->starving;
    if (work && s->went_without[1] < (tries < s->prefetch.count ? tries : s->prefetch.count))
        return &s->prefetch;
    return NULL;
}

bool assign_next(struct sched *s, struct sched_action *out)
{
    /* What a liar touched is about to be reset: nothing is built on it. */
    if (s->liars_unsettled > 0 || s->starving.count + s->prefetch.count == 0)
        return false;
    bool work = settle_claims(s);
    struct chain *list;
    while ((list = list_to_try(s, work)) != NULL) {
        uint32_t worker = list->head;
        enum worker_list was = s->workers[worker].list;
        uint32_t lease = lease_for(s, worker, work);
        worker_begin_leases(s, worker);
        worker_place(s, worker);
        if (s->workers[worker].list == was)
            rotate(s, list, worker);
        if (lease == SLOT_NONE) {
            s->went_without[list == &s->prefetch]++;
            continue;
        }
        assign_rearm(s);
        announce(s, lease, out);
        return true;
    }
    return false;
}
