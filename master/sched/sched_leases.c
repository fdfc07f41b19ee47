/* The life of a lease: given, begun, ended; and who is blamed when a worker is lost. */
#include "master/sched/sched_impl.h"

enum { PATIENCE_DOUBLINGS_MAX = 8, LATE_DOUBLINGS_MAX = 3 };

static struct chain *lease_job_chain(struct job *j, const struct lease *l)
{
    return l->solo ? &j->solo : &j->others;
}

static void set_solo(struct sched *s, uint32_t lease, bool solo)
{
    struct lease *l = &s->leases[lease];
    struct job *j = &s->jobs[l->job];
    if (l->solo == solo)
        return;
    chain_remove(lease_job_chain(j, l), s->lease_job_links, lease);
    l->solo = solo;
    chain_push(lease_job_chain(j, l), s->lease_job_links, lease);
}

uint32_t lease_make(struct sched *s, uint32_t worker, uint32_t job, struct unit unit,
                    enum sched_lease_kind kind, uint64_t epoch)
{
    struct worker *w = &s->workers[worker];
    struct job *j = &s->jobs[job];
    struct worker_job *wj = worker_job_find(w, j->id);
    TL_ASSERT(wj && worker_usable(w) && job_is_live(j));
    uint32_t slot = slotmap_add(&s->lease_map, epoch);
    if (slot == SLOT_NONE)
        return SLOT_NONE;
    s->leases[slot] = (struct lease){.epoch = epoch,
                                     .worker = worker,
                                     .job = job,
                                     .unit = unit,
                                     .kind = kind,
                                     .twin = slot,
                                     .suspect = SLOT_NONE,
                                     .check = SLOT_NONE,
                                     .leased_ms = s->now_ms,
                                     .expected_ms = unit_expected_ms(s, w, j, unit)};
    chain_push(&j->others, s->lease_job_links, slot);
    chain_push(&w->queued, s->lease_worker_links, slot);
    w->held++;
    wj->leases++;
    wj->used_ms = s->now_ms;
    if (j->started_ms == UINT64_MAX)
        j->started_ms = s->now_ms;
    return slot;
}

uint32_t lease_new(struct sched *s, uint32_t worker, uint32_t job, struct unit unit,
                   enum sched_lease_kind kind)
{
    TL_ASSERT(s->jobs[job].state == SCHED_ACTIVE);
    uint32_t slot = lease_make(s, worker, job, unit, kind, s->epoch_next);
    s->epoch_next += slot != SLOT_NONE;
    return slot;
}

/* The lease takes the spots of its unit that wait: all of them, unless it is an adopted one. */
void lease_own(struct sched *s, uint32_t lease)
{
    struct lease *l = &s->leases[lease];
    struct job *j = &s->jobs[l->job];
    for (uint32_t i = 0; i < l->unit.cell_count; i++) {
        uint32_t cell = l->unit.cell_begin + i;
        if (job_spot_state(j, cell, l->unit.block) != SPOT_WAITING)
            continue;
        job_spot_take(j, cell, l->unit.block, lease);
        l->open++;
    }
    TL_ASSERT(l->open > 0);
    l->owner = true;
    set_solo(s, lease, true);
}

/* The lease takes all the spots of its unit from a pending suspect. */
void lease_own_suspect(struct sched *s, uint32_t lease, uint32_t suspect)
{
    struct lease *l = &s->leases[lease];
    struct job *j = &s->jobs[l->job];
    struct suspect *p = &s->suspects[suspect];
    TL_ASSERT(p->open == l->unit.cell_count);
    chain_remove(suspect_chain(j, p), s->suspect_pool.links, suspect);
    for (uint32_t i = 0; i < l->unit.cell_count; i++)
        *job_spot_owner(j, l->unit.cell_begin + i, l->unit.block) = lease;
    p->lease = lease;
    p->open = 0;
    l->suspect = suspect;
    l->owner = true;
    l->open = l->unit.cell_count;
    set_solo(s, lease, true);
}

/* The lease answers a pending check. */
void lease_own_check(struct sched *s, uint32_t lease, uint32_t check)
{
    struct job *j = &s->jobs[s->leases[lease].job];
    chain_remove(&j->checks, s->check_pool.links, check);
    chain_push(&j->checks_out, s->check_pool.links, check);
    s->checks[check].lease = lease;
    s->leases[lease].check = check;
}

/* Makes `lease` a copy of the unit of `twin`. */
void lease_join(struct sched *s, uint32_t lease, uint32_t twin)
{
    s->leases[lease].twin = s->leases[twin].twin;
    s->leases[twin].twin = lease;
    set_solo(s, twin, false);
}

/* Takes `lease` out of its ring; gives one that stays, or SLOT_NONE. */
static uint32_t lease_leave(struct sched *s, uint32_t lease)
{
    uint32_t stays = s->leases[lease].twin;
    if (stays == lease)
        return SLOT_NONE;
    uint32_t before = stays;
    while (s->leases[before].twin != lease)
        before = s->leases[before].twin;
    s->leases[before].twin = stays;
    s->leases[lease].twin = lease;
    return stays;
}

/* Moves the spots that `from` owns to `owner`: a lease, a suspect, or nobody. */
static uint32_t spots_hand_over(struct sched *s, uint32_t from, const struct lease *l,
                                uint32_t owner)
{
    struct job *j = &s->jobs[l->job];
    uint32_t count = 0;
    for (uint32_t i = 0; i < l->unit.cell_count; i++) {
        uint32_t cell = l->unit.cell_begin + i;
        if (job_spot_state(j, cell, l->unit.block) != SPOT_LEASED)
            continue;
        uint32_t *at = job_spot_owner(j, cell, l->unit.block);
        if (*at != from)
            continue;
        count++;
        if (owner == OWNER_NONE)
            job_spot_give_back(j, cell, l->unit.block);
        else
            *at = owner;
    }
    return count;
}

struct chain *suspect_chain(struct job *j, const struct suspect *p)
{
    return p->losses >= SCHED_LOSSES_COMPANY ? &j->suspects_alone : &j->suspects;
}

void suspect_free(struct sched *s, uint32_t suspect)
{
    struct suspect *p = &s->suspects[suspect];
    if (p->lease == SLOT_NONE)
        chain_remove(suspect_chain(&s->jobs[p->job], p), s->suspect_pool.links, suspect);
    else
        s->leases[p->lease].suspect = SLOT_NONE;
    *p = (struct suspect){.job = SLOT_NONE, .lease = SLOT_NONE};
    chain_push(&s->suspect_pool.free, s->suspect_pool.links, suspect);
}

void suspect_dissolve(struct sched *s, uint32_t suspect)
{
    struct suspect *p = &s->suspects[suspect];
    TL_ASSERT(p->lease == SLOT_NONE);
    struct job *j = &s->jobs[p->job];
    for (uint32_t i = 0; i < p->unit.cell_count; i++) {
        uint32_t cell = p->unit.cell_begin + i;
        if (job_spot_state(j, cell, p->unit.block) == SPOT_LEASED &&
            *job_spot_owner(j, cell, p->unit.block) == (OWNER_SUSPECT | suspect))
            job_spot_give_back(j, cell, p->unit.block);
    }
    suspect_free(s, suspect);
}

/* The suspect record of a unit, made if there is none; SLOT_NONE when the table is full. */
static uint32_t suspect_of(struct sched *s, uint32_t lease)
{
    struct lease *l = &s->leases[lease];
    if (l->suspect != SLOT_NONE)
        return l->suspect;
    uint32_t slot = s->suspect_pool.free.head;
    if (slot == SLOT_NONE)
        return SLOT_NONE;
    chain_remove(&s->suspect_pool.free, s->suspect_pool.links, slot);
    s->suspects[slot] = (struct suspect){.job = l->job, .unit = l->unit, .lease = lease};
    l->suspect = slot;
    return slot;
}

/* Is there anyone else to ask? */
static bool others_usable(const struct job *j, const struct worker *w)
{
    return j->threads > (w->counted && worker_has_tags(w, j) ? w->threads : 0);
}

/* Counts a loss against the unit of `owner`; true: it is one too many for the job. That one worker
 * fails it again and again tells little of the unit, while there are others; but those may be
 * hung, so it is not forgotten. */
static bool suspect_blame(struct sched *s, uint32_t owner, const struct lease *lost)
{
    uint32_t slot = suspect_of(s, owner);
    if (slot == SLOT_NONE)
        return false;
    struct suspect *p = &s->suspects[slot];
    const struct worker *w = &s->workers[lost->worker];
    p->lost_ms = s->now_ms;
    for (int i = 0; i < SUSPECT_LOSERS; i++) {
        if (p->losers[i] == w->handle && others_usable(&s->jobs[lost->job], w) &&
            ++p->repeats % SUSPECT_REPEATS != 0)
            return false;
    }
    p->losers[p->losses++ % SUSPECT_LOSERS] = w->handle;
    if (lost->alone)
        p->losses_alone++;
    sched_news_push(s, &(struct sched_action){.type = SCHED_UNIT_LOST,
                                              .worker = w->handle,
                                              .job = s->jobs[lost->job].id,
                                              .unit = lost->unit,
                                              .epoch = lost->epoch,
                                              .losses = p->losses,
                                              .alone = lost->alone});
    return p->losses_alone >= SCHED_LOSSES_ALONE;
}

/* The last lease of a unit ends without a result: its spots wait again, or its suspect holds them
 * together until the unit is leased again whole. */
static void unit_return(struct sched *s, uint32_t lease)
{
    struct lease *l = &s->leases[lease];
    struct job *j = &s->jobs[l->job];
    uint32_t suspect = l->suspect;
    if (suspect != SLOT_NONE && l->open < l->unit.cell_count) {
        /* Part of it was rendered after all: it is not the unit that kills. */
        suspect_free(s, suspect);
        suspect = SLOT_NONE;
    }
    if (suspect == SLOT_NONE) {
        l->open -= spots_hand_over(s, lease, l, OWNER_NONE);
    } else {
        struct suspect *p = &s->suspects[suspect];
        p->open = spots_hand_over(s, lease, l, OWNER_SUSPECT | suspect);
        p->lease = SLOT_NONE;
        l->open -= p->open;
        l->suspect = SLOT_NONE;
        chain_push(suspect_chain(j, p), s->suspect_pool.links, suspect);
    }
    TL_ASSERT(l->open == 0);
}

/* The unit of a lease that ends: others go on with it, or it returns. True: the job must fail. */
static bool unit_detach(struct sched *s, uint32_t lease, bool blame)
{
    struct lease *l = &s->leases[lease];
    bool fail = false;
    uint32_t stays = lease_leave(s, lease);
    if (stays == SLOT_NONE) {
        if (l->owner && l->open > 0) {
            fail = blame && suspect_blame(s, lease, l);
            unit_return(s, lease);
        } else if (l->suspect != SLOT_NONE) {
            suspect_free(s, l->suspect);
        }
        return fail;
    }
    uint32_t owner = stays;
    if (l->owner) {
        struct lease *heir = &s->leases[stays];
        heir->open = spots_hand_over(s, lease, l, stays);
        heir->owner = true;
        TL_ASSERT(heir->open == l->open);
        heir->suspect = l->suspect;
        if (heir->suspect != SLOT_NONE)
            s->suspects[heir->suspect].lease = stays;
        l->suspect = SLOT_NONE;
        l->open = 0;
    } else {
        while (!s->leases[owner].owner)
            owner = s->leases[owner].twin;
    }
    if (blame && s->leases[owner].open > 0)
        fail = suspect_blame(s, owner, l);
    if (s->leases[owner].twin == owner)
        set_solo(s, owner, true);
    return fail;
}

static void check_detach(struct sched *s, uint32_t lease)
{
    struct lease *l = &s->leases[lease];
    if (l->check == SLOT_NONE)
        return;
    struct job *j = &s->jobs[l->job];
    s->checks[l->check].lease = SLOT_NONE;
    chain_remove(&j->checks_out, s->check_pool.links, l->check);
    chain_push(&j->checks, s->check_pool.links, l->check);
    l->check = SLOT_NONE;
}

void lease_end(struct sched *s, uint32_t lease, enum lease_end how, bool blame)
{
    struct lease *l = &s->leases[lease];
    struct worker *w = &s->workers[l->worker];
    struct job *j = &s->jobs[l->job];
    struct worker_job *wj = worker_job_find(w, j->id);
    TL_ASSERT(!l->revoked && wj && wj->leases > 0 && w->held > 0);

    chain_remove(l->begun ? &w->begun : &w->queued, s->lease_worker_links, lease);
    timers_stop(&s->timers, lease);
    j->begun -= l->begun;
    w->held--;
    wj->leases--;
    if (l->alone)
        w->alone = false;

    if ((how == END_FAILED || how == END_TAKEN || how == END_DROPPED) && l->owner && l->open > 0 &&
        l->twin == lease)
        j->retried++;
    bool fail = unit_detach(s, lease, blame);
    check_detach(s, lease);
    chain_remove(lease_job_chain(j, l), s->lease_job_links, lease);
    struct unit unit = l->unit;
    uint32_t worker = l->worker, job = l->job;
    if ((how == END_REVOKED || how == END_TAKEN) && w->connected && !w->away) {
        l->revoked = true;
        chain_push(&s->revoked, s->lease_worker_links, lease);
    } else {
        slotmap_remove(&s->lease_map, lease);
    }
    worker_begin_leases(s, worker);
    worker_place(s, worker);
    if (fail)
        job_fail(s, job, SCHED_WHY_UNIT_KILLS, unit);
}

/* Ends every lease of a unit that is done. */
void lease_release_unit(struct sched *s, uint32_t lease)
{
    while (s->leases[lease].twin != lease)
        lease_end(s, s->leases[lease].twin, END_REVOKED, false);
    lease_end(s, lease, END_REVOKED, false);
}

/* One of the spots of this owner was taken from it. */
void lease_spot_lost(struct sched *s, uint32_t owner)
{
    if (owner & OWNER_SUSPECT) {
        struct suspect *p = &s->suspects[owner & ~OWNER_SUSPECT];
        TL_ASSERT(p->open > 0 && p->lease == SLOT_NONE);
        if (--p->open == 0)
            suspect_free(s, owner & ~OWNER_SUSPECT);
        return;
    }
    struct lease *l = &s->leases[owner];
    TL_ASSERT(l->owner && l->open > 0);
    if (--l->open == 0)
        lease_release_unit(s, owner);
}

/* How long a begun lease may take. */
static uint64_t lease_patience_ms(const struct sched *s, const struct lease *l)
{
    /* Nothing is known of its cost before the first result: then be patient. */
    uint64_t ms = s->limits.load_ms;
    if (l->expected_ms > 0) {
        ms = (uint64_t)l->expected_ms * s->limits.lease_factor;
        if (ms < s->limits.lease_ms_min)
            ms = s->limits.lease_ms_min;
    }
    /* More patience with a unit that was late before, and with a worker that was. */
    const struct worker_job *wj = worker_job_find(&s->workers[l->worker], s->jobs[l->job].id);
    uint32_t doublings = wj->late < LATE_DOUBLINGS_MAX ? wj->late : LATE_DOUBLINGS_MAX;
    if (l->suspect != SLOT_NONE)
        doublings += s->suspects[l->suspect].losses;
    return ms << (doublings < PATIENCE_DOUBLINGS_MAX ? doublings : PATIENCE_DOUBLINGS_MAX);
}

/* A worker has a free thread and the scene: from now on the lease has a deadline. */
void lease_begin(struct sched *s, uint32_t lease)
{
    struct lease *l = &s->leases[lease];
    struct worker *w = &s->workers[l->worker];
    TL_ASSERT(!l->begun && w->begun.count < w->threads);
    chain_remove(&w->queued, s->lease_worker_links, lease);
    chain_push(&w->begun, s->lease_worker_links, lease);
    l->begun = true;
    l->begun_ms = s->now_ms;
    s->jobs[l->job].begun++;

    if (l->expected_ms == 0)
        l->expected_ms = unit_expected_ms(s, w, &s->jobs[l->job], l->unit);
    timers_set(&s->timers, lease, s->now_ms + lease_patience_ms(s, l));
}

/* What begun units of the worker lack is on its way: it may take as long as a scene. */
void worker_leases_wait(struct sched *s, uint32_t worker)
{
    const struct worker *w = &s->workers[worker];
    for (uint32_t l = w->begun.head; l != SLOT_NONE; l = s->lease_worker_links[l].next) {
        uint64_t due_ms = s->leases[l].begun_ms + s->limits.load_ms;
        if (due_ms > s->timers.due_ms[l])
            timers_set(&s->timers, l, due_ms);
    }
}

/* It is there: from now on the job's units have their usual time. */
void worker_leases_go_on(struct sched *s, uint32_t worker, uint64_t job)
{
    const struct worker *w = &s->workers[worker];
    for (uint32_t l = w->begun.head; l != SLOT_NONE; l = s->lease_worker_links[l].next) {
        uint64_t due_ms = s->now_ms + lease_patience_ms(s, &s->leases[l]);
        if (s->jobs[s->leases[l].job].id == job && due_ms < s->timers.due_ms[l])
            timers_set(&s->timers, l, due_ms);
    }
}

void lease_timer_fired(struct sched *s, uint32_t lease)
{
    uint32_t worker = s->leases[lease].worker;
    struct worker *w = &s->workers[worker];
    w->timeouts++;
    w->lost++;
    worker_job_find(w, s->jobs[s->leases[lease].job].id)->late++;
    lease_end(s, lease, END_TAKEN, true);
    worker_fault(s, worker);
}

void job_leases_revoke(struct sched *s, uint32_t job)
{
    struct job *j = &s->jobs[job];
    /* The last of several copies moves from one chain to the other. */
    while (j->solo.count + j->others.count > 0)
        lease_end(s, j->others.count > 0 ? j->others.head : j->solo.head, END_REVOKED, false);
}

static uint32_t worker_lease_of(const struct sched *s, const struct worker *w, uint64_t job)
{
    const struct chain *chains[] = {&w->begun, &w->queued};
    for (int i = 0; i < 2; i++) {
        uint32_t l = chains[i]->head;
        while (l != SLOT_NONE && job != 0 && s->jobs[s->leases[l].job].id != job)
            l = s->lease_worker_links[l].next;
        if (l != SLOT_NONE)
            return l;
    }
    return SLOT_NONE;
}

/* Ends what a worker holds (of one job, or with job 0 of all); only begun leases can be blamed.
 * Looks anew each time, since blame may fail a job and end leases anywhere. */
void worker_leases_end(struct sched *s, uint32_t worker, uint64_t job, enum lease_end how,
                       bool blame)
{
    struct worker *w = &s->workers[worker];
    for (;;) {
        uint32_t l = worker_lease_of(s, w, job);
        if (l == SLOT_NONE)
            return;
        w->lost++;
        lease_end(s, l, how, blame && s->leases[l].begun);
    }
}
