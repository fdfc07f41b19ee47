/* Results: accepted, compared or ignored, spot by spot; and checks of who tells the truth. */
#include "master/sched/sched_impl.h"

/* Weight of the newest result in a worker's speed. */
static const double SPEED_WEIGHT = 0.25;

static const double VERIFY_SCALE = 0x1p-64;

/* --- Checks ----------------------------------------------------------------- */

bool check_voted(const struct check *c, uint64_t worker)
{
    for (uint32_t i = 0; i < c->vote_count; i++) {
        if (c->votes[i].worker == worker)
            return true;
    }
    return false;
}

void check_free(struct sched *s, uint32_t check)
{
    struct check *c = &s->checks[check];
    struct job *j = &s->jobs[c->job];
    uint32_t lease = c->lease;
    chain_remove(lease == SLOT_NONE ? &j->checks : &j->checks_out, s->check_pool.links, check);
    *c = (struct check){.job = SLOT_NONE, .lease = SLOT_NONE};
    chain_push(&s->check_pool.free, s->check_pool.links, check);
    if (lease != SLOT_NONE) {
        s->leases[lease].check = SLOT_NONE;
        lease_end(s, lease, END_REVOKED, false);
    }
}

void job_checks_drop(struct sched *s, uint32_t job, uint32_t cell_begin, uint32_t cell_count)
{
    struct job *j = &s->jobs[job];
    const uint32_t heads[] = {j->checks.head, j->checks_out.head};
    for (int i = 0; i < 2; i++) {
        uint32_t c = heads[i];
        while (c != SLOT_NONE) {
            uint32_t next = s->check_pool.links[c].next;
            struct unit u = s->checks[c].unit;
            if (u.cell_begin < cell_begin + cell_count && cell_begin < u.cell_begin + u.cell_count)
                check_free(s, c);
            c = next;
        }
    }
}

uint32_t check_new(struct sched *s, uint32_t job, struct unit unit, struct vote accepted)
{
    uint32_t slot = s->check_pool.free.head;
    if (slot == SLOT_NONE)
        return SLOT_NONE;
    chain_remove(&s->check_pool.free, s->check_pool.links, slot);
    s->checks[slot] = (struct check){
        .job = job, .unit = unit, .votes = {accepted}, .vote_count = 1, .lease = SLOT_NONE};
    chain_push(&s->jobs[job].checks, s->check_pool.links, slot);
    return slot;
}

static void liar_found(struct sched *s, const struct check *c, uint32_t vote)
{
    uint64_t handle = c->votes[vote].worker;
    uint32_t worker = slotmap_find(&s->worker_map, handle);
    if (worker != SLOT_NONE)
        s->workers[worker].differed++;
    s->liars_unsettled++;
    sched_news_push(s, &(struct sched_action){.type = SCHED_LIAR,
                                              .worker = handle,
                                              .job = s->jobs[c->job].id,
                                              .unit = c->unit,
                                              .accepted = vote == 0});
    if (worker != SLOT_NONE)
        worker_quarantine(s, worker);
}

static void check_news(struct sched *s, enum sched_action_type type, const struct job *j,
                       struct unit unit)
{
    sched_news_push(s, &(struct sched_action){.type = type, .job = j->id, .unit = unit});
}

/* Two equal votes decide; whoever voted otherwise lied. Without agreement the check asks another
 * worker, up to SCHED_VOTES_MAX. */
static void check_count_votes(struct sched *s, uint32_t check)
{
    struct check c = s->checks[check];
    struct job *j = &s->jobs[c.job];
    for (uint32_t a = 0; a < c.vote_count; a++) {
        for (uint32_t b = a + 1; b < c.vote_count; b++) {
            if (c.votes[a].digest != c.votes[b].digest)
                continue;
            j->verified++;
            j->mismatched += c.vote_count > 2;
            for (uint32_t v = 0; v < c.vote_count; v++)
                j->rejected += c.votes[v].digest != c.votes[a].digest;
            check_free(s, check);
            for (uint32_t v = 0; v < c.vote_count; v++) {
                if (c.votes[v].digest != c.votes[a].digest)
                    liar_found(s, &c, v);
            }
            /* After the liar: who keeps both must not know of neither. */
            check_news(s, SCHED_CHECK_CLOSED, j, c.unit);
            job_settle(s, c.job);
            return;
        }
    }
    if (c.vote_count < SCHED_VOTES_MAX)
        return;
    /* If the job is retried, others are asked. */
    s->checks[check].vote_count = 1;
    job_fail(s, c.job, SCHED_WHY_NO_AGREEMENT, c.unit);
}

static void check_vote(struct sched *s, uint32_t check, struct vote vote)
{
    struct check *c = &s->checks[check];
    if (check_voted(c, vote.worker))
        return;
    TL_ASSERT(c->vote_count < SCHED_VOTES_MAX);
    /* Its bits came another way (a late copy): it need not render it once more. */
    if (c->lease != SLOT_NONE && s->workers[s->leases[c->lease].worker].handle == vote.worker)
        lease_end(s, c->lease, END_REVOKED, false);
    c->votes[c->vote_count++] = vote;
    check_count_votes(s, check);
}

/* An open check of exactly this unit, or SLOT_NONE. */
static uint32_t check_of_unit(const struct sched *s, const struct job *j, struct unit unit)
{
    const uint32_t heads[] = {j->checks.head, j->checks_out.head};
    for (int i = 0; i < 2; i++) {
        for (uint32_t c = heads[i]; c != SLOT_NONE; c = s->check_pool.links[c].next) {
            struct unit u = s->checks[c].unit;
            if (u.cell_begin == unit.cell_begin && u.cell_count == unit.cell_count &&
                u.block == unit.block)
                return c;
        }
    }
    return SLOT_NONE;
}

bool mismatch_feed(struct sched *s, const struct sched_event *e)
{
    const struct sched_mismatch *m = &e->mismatch;
    uint32_t job = slotmap_find(&s->job_map, e->job);
    if (job == SLOT_NONE || !unit_within(&s->jobs[job], m->unit) ||
        m->digest == m->digest_accepted || m->worker_accepted == e->worker)
        return false;
    struct job *j = &s->jobs[job];
    if (!job_is_live(j) && j->state != SCHED_DONE)
        return false;
    uint32_t check = check_of_unit(s, j, m->unit);
    if (check == SLOT_NONE) {
        job_reopen(s, job);
        check =
            check_new(s, job, m->unit,
                      (struct vote){.worker = m->worker_accepted, .digest = m->digest_accepted});
    }
    if (check == SLOT_NONE)
        return false;
    check_news(s, SCHED_CHECK_OPENED, j, m->unit);
    check_vote(s, check, (struct vote){.worker = e->worker, .digest = m->digest});
    return true;
}

/* --- Results ---------------------------------------------------------------- */

static void learn_speed(struct sched *s, uint32_t worker, uint64_t job,
                        const struct sched_result *r)
{
    struct worker *w = &s->workers[worker];
    struct worker_job *wj = worker_job_find(w, job);
    if (!wj || r->samples == 0)
        return;
    double seconds = 1e-6 * (double)(r->render_us > 0 ? r->render_us : 1);
    double speed = (double)r->samples / seconds;
    wj->speed = wj->speed > 0.0 ? wj->speed + SPEED_WEIGHT * (speed - wj->speed) : speed;
    w->speed_shown = wj->speed;
    uint32_t target_ms = wj->target_ms * 2;
    wj->target_ms = target_ms < s->limits.unit_ms ? target_ms : s->limits.unit_ms;
}

/* The worker answered one of its leases, or (SLOT_NONE) one that was taken from it: from that too
 * its speed is learnt, or a slow worker would be late for ever; and it is a vote all the same. */
static void answered(struct sched *s, uint32_t worker, uint32_t lease, uint32_t job,
                     const struct sched_event *e)
{
    const struct sched_result *r = &e->result;
    uint32_t check = SLOT_NONE;
    learn_speed(s, worker, e->job, r);
    if (lease != SLOT_NONE) {
        check = s->leases[lease].check;
        worker_good(s, worker);
        struct worker_job *wj = worker_job_find(&s->workers[worker], e->job);
        wj->late = 0;
        lease_end(s, lease, END_RESULT, false);
    } else if (s->jobs[job].checks.count + s->jobs[job].checks_out.count > 0) {
        check = check_of_unit(s, &s->jobs[job], r->unit);
    }
    if (check == SLOT_NONE || check_voted(&s->checks[check], e->worker))
        return;
    s->scan.vote = true;
    check_vote(s, check, (struct vote){.worker = e->worker, .digest = r->digest});
}

void result_feed(struct sched *s, const struct sched_event *e)
{
    const struct sched_result *r = &e->result;
    uint32_t worker = slotmap_find(&s->worker_map, e->worker);
    uint32_t job = slotmap_find(&s->job_map, e->job);
    uint32_t lease = slotmap_find(&s->lease_map, r->epoch);
    s->scan = (struct scan){
        .active = true, .job = SLOT_NONE, .job_id = e->job, .worker = e->worker, .result = *r};
    struct scan *scan = &s->scan;

    if (worker != SLOT_NONE && s->workers[worker].quarantined) {
        scan->why = SCHED_WHY_QUARANTINED;
        if (job != SLOT_NONE)
            s->jobs[job].rejected++;
        return;
    }
    if (job == SLOT_NONE || !job_is_live(&s->jobs[job])) {
        scan->why = SCHED_WHY_NO_JOB;
        return;
    }
    struct job *j = &s->jobs[job];
    bool known = lease != SLOT_NONE;
    bool fits = !known || (s->leases[lease].worker == worker && s->leases[lease].job == job &&
                           unit_equal(s->leases[lease].unit, r->unit));
    if (!unit_within(j, r->unit) || !fits) {
        scan->why = SCHED_WHY_NO_UNIT;
        j->rejected++;
        if (worker != SLOT_NONE && s->workers[worker].connected)
            worker_fault(s, worker);
        return;
    }
    /* The ratio belongs to the speed that the unit was cut for: take it before it changes. */
    double ratio = worker != SLOT_NONE ? worker_speed_ratio(s, &s->workers[worker], j) : 1.0;
    scan->cell_s = 1e-6 * (double)r->render_us * ratio / r->unit.cell_count;
    scan->job = job;
    if (worker != SLOT_NONE)
        answered(s, worker, lease, job, e);
}

/* Chooses units to verify by the seed and the lease's number: workers cannot foresee it. */
static bool verify_chosen(const struct sched *s, uint64_t epoch, double share)
{
    uint64_t x = s->limits.seed + epoch * UINT64_C(0x9E3779B97F4A7C15);
    x = (x ^ (x >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    x = (x ^ (x >> 27)) * UINT64_C(0x94D049BB133111EB);
    x ^= x >> 31;
    return (double)x * VERIFY_SCALE < share;
}

static void scan_finish(struct sched *s)
{
    struct scan *scan = &s->scan;
    scan->active = false;
    struct job *j = &s->jobs[scan->job];
    if (scan->accepted == 0)
        return;
    uint32_t worker = slotmap_find(&s->worker_map, scan->worker);
    j->units++;
    if (worker != SLOT_NONE)
        s->workers[worker].units++;
    j->samples += (double)scan->result.samples;
    j->samples_s += 1e-6 * (double)(scan->result.render_us > 0 ? scan->result.render_us : 1);
    eta_spread_add(&j->spread, scan->cell_s / (double)job_weight(j, scan->result.unit.block));
    job_progress_update(j);
    if (scan->checked && scan->accepted == scan->result.unit.cell_count)
        (void)check_new(s, scan->job, scan->result.unit,
                        (struct vote){.worker = scan->worker, .digest = scan->result.digest});
    job_settle(s, scan->job);
}

/* An answer that is not given spot by spot. */
static bool scan_whole(struct sched *s, struct sched_action *out)
{
    out->type = s->scan.vote ? SCHED_VOTE : SCHED_IGNORE;
    out->why = s->scan.why;
    out->unit = s->scan.result.unit;
    s->scan.active = false;
    return true;
}

static bool spot_is_open(const struct job *j, uint32_t cell, uint32_t block)
{
    enum spot_state state = job_spot_state(j, cell, block);
    return state == SPOT_WAITING || state == SPOT_LEASED;
}

/* Before the first answer: is this result to be verified? Said before it is accepted, so that
 * whoever keeps both never has the result without its check. A check is of a whole unit: where only
 * a part is new, that part is left to another lease. */
static bool scan_announce(struct sched *s, struct sched_action *out)
{
    struct scan *scan = &s->scan;
    const struct job *j = &s->jobs[scan->job];
    const struct unit unit = scan->result.unit;
    if (scan->at > 0 || scan->checked || scan->worker == 0 ||
        !verify_chosen(s, scan->result.epoch, j->verify_share))
        return false;
    for (uint32_t i = 0; i < unit.cell_count; i++)
        scan->unchecked |= !spot_is_open(j, unit.cell_begin + i, unit.block);
    if (scan->unchecked)
        return false;
    scan->checked = true;
    *out = (struct sched_action){
        .type = SCHED_CHECK_OPENED, .worker = scan->worker, .job = j->id, .unit = unit};
    return true;
}

/* The next run of cells of one kind. */
bool scan_next(struct sched *s, struct sched_action *out)
{
    struct scan *scan = &s->scan;
    if (!scan->active)
        return false;
    const struct unit unit = scan->result.unit;
    *out = (struct sched_action){
        .worker = scan->worker, .job = scan->job_id, .epoch = scan->result.epoch};
    if (scan->job == SLOT_NONE || scan->vote)
        return scan_whole(s, out);
    if (scan_announce(s, out))
        return true;

    struct job *j = &s->jobs[scan->job];
    uint32_t begin = unit.cell_begin + scan->at;
    enum spot_state first = job_spot_state(j, begin, unit.block);
    bool accept = first == SPOT_WAITING || first == SPOT_LEASED;
    uint32_t count = 0;
    while (scan->at < unit.cell_count) {
        uint32_t cell = begin + count;
        enum spot_state state = job_spot_state(j, cell, unit.block);
        if (accept ? state != SPOT_WAITING && state != SPOT_LEASED : state != first)
            break;
        if (accept && !scan->unchecked)
            job_spot_finish(s, j, cell, unit.block, scan->cell_s);
        count++;
        scan->at++;
    }
    out->unit = (struct unit){.cell_begin = begin, .cell_count = count, .block = unit.block};
    if (accept && !scan->unchecked) {
        out->type = SCHED_ACCEPT;
        scan->accepted += count;
    } else if (first == SPOT_DONE) {
        out->type = SCHED_COMPARE;
        j->compared++;
    } else {
        out->type = SCHED_IGNORE;
        out->why = accept ? SCHED_WHY_UNCHECKED : SCHED_WHY_SHUT;
        j->rejected++;
    }
    if (scan->at == unit.cell_count)
        scan_finish(s);
    return true;
}
