/* Leases that a worker brings along when it joins: given before its connection broke, perhaps by a
 * master that has died since. Those that are still its own are marked; of the others, what nobody
 * else has got further with becomes its own again. */
#include "master/sched/sched_impl.h"

/* The lease that a spot belongs to; SLOT_NONE: none. */
static uint32_t lease_of_spot(const struct job *j, uint32_t cell, uint32_t block)
{
    if (job_spot_state(j, cell, block) != SPOT_LEASED)
        return SLOT_NONE;
    uint32_t owner = *job_spot_owner(j, cell, block);
    return owner & OWNER_SUSPECT ? SLOT_NONE : owner;
}

/* The pending suspect that holds all of this unit and may be rendered in company, or SLOT_NONE. */
static uint32_t suspect_of_unit(const struct sched *s, const struct job *j, struct unit u)
{
    for (uint32_t p = j->suspects.head; p != SLOT_NONE; p = s->suspect_pool.links[p].next)
        if (unit_equal(s->suspects[p].unit, u) && s->suspects[p].open == u.cell_count)
            return p;
    return SLOT_NONE;
}

static uint32_t check_of_unit(const struct sched *s, const struct job *j, struct unit u,
                              uint64_t worker)
{
    for (uint32_t c = j->checks.head; c != SLOT_NONE; c = s->check_pool.links[c].next)
        if (unit_equal(s->checks[c].unit, u) && !check_voted(&s->checks[c], worker))
            return c;
    return SLOT_NONE;
}

/* Others have cells of it, but have not begun: they are given something else. No more than `most`
 * leases, since each may make news. */
static void unbegun_take(struct sched *s, uint32_t worker, const struct job *j, struct unit u,
                         uint32_t *most)
{
    for (uint32_t i = 0; i<u.cell_count && * most> 0; i++) {
        uint32_t l = lease_of_spot(j, u.cell_begin + i, u.block);
        if (l == SLOT_NONE || s->leases[l].begun || !s->leases[l].solo ||
            s->leases[l].worker == worker || s->leases[l].suspect != SLOT_NONE)
            continue;
        lease_end(s, l, END_REVOKED, false);
        --*most;
    }
}

static uint32_t waiting_cells(const struct job *j, struct unit u)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < u.cell_count; i++)
        count += job_spot_state(j, u.cell_begin + i, u.block) == SPOT_WAITING;
    return count;
}

/* The lease, of another worker, that renders exactly this unit and may have one copy more. */
static uint32_t twin_of_unit(const struct sched *s, uint32_t worker, const struct job *j,
                             struct unit u)
{
    uint32_t l = lease_of_spot(j, u.cell_begin, u.block), count = 0;
    if (l == SLOT_NONE || !unit_equal(s->leases[l].unit, u) || s->leases[l].suspect != SLOT_NONE)
        return SLOT_NONE;
    uint32_t t = l;
    do {
        if (s->leases[t].worker == worker || ++count > COPIES_MAX)
            return SLOT_NONE;
        t = s->leases[t].twin;
    } while (t != l);
    return l;
}

/* Can the worker hold it at all? */
static bool adoptable(struct sched *s, uint32_t worker, const struct sched_held *h, uint32_t *job)
{
    struct worker *w = &s->workers[worker];
    *job = slotmap_find(&s->job_map, h->job);
    if (*job == SLOT_NONE || !worker_usable(w) || w->alone ||
        w->held >= s->limits.leases_per_worker_max || h->epoch == 0 || h->epoch >= s->epoch_next ||
        slotmap_find(&s->lease_map, h->epoch) != SLOT_NONE)
        return false;
    struct job *j = &s->jobs[*job];
    return job_is_live(j) && unit_within(j, h->unit) &&
           (j->unit_cells_max == 0 || h->unit.cell_count <= j->unit_cells_max) &&
           !worker_barred(s, w, j) && worker_job_get(s, w, j->id) &&
           /* A result to be verified must find room for its check. */
           !(j->verify_share > 0.0 && s->lease_map.count >= s->check_pool.free.count);
}

/* Makes it a lease of the worker again if there is a use for it; SLOT_NONE: there is none. */
static uint32_t adopt(struct sched *s, uint32_t worker, const struct sched_held *h, uint32_t *take)
{
    uint32_t job;
    if (!adoptable(s, worker, h, &job))
        return SLOT_NONE;
    struct job *j = &s->jobs[job];
    bool begun = h->state != SCHED_HELD_WAITING;
    if (begun)
        unbegun_take(s, worker, j, h->unit, take);
    uint32_t waiting = waiting_cells(j, h->unit), lease;
    if (begun ? waiting > 0 : waiting == h->unit.cell_count) {
        lease = lease_make(s, worker, job, h->unit, SCHED_KIND_FIRST, h->epoch);
        if (lease != SLOT_NONE)
            lease_own(s, lease);
        return lease;
    }
    if (!begun)
        return SLOT_NONE;
    uint32_t suspect = suspect_of_unit(s, j, h->unit);
    if (suspect != SLOT_NONE) {
        lease = lease_make(s, worker, job, h->unit, SCHED_KIND_RETRY, h->epoch);
        if (lease != SLOT_NONE)
            lease_own_suspect(s, lease, suspect);
        return lease;
    }
    uint32_t twin = twin_of_unit(s, worker, j, h->unit);
    if (twin != SLOT_NONE) {
        lease = lease_make(s, worker, job, h->unit, SCHED_KIND_COPY, h->epoch);
        if (lease != SLOT_NONE)
            lease_join(s, lease, twin);
        return lease;
    }
    uint32_t check = check_of_unit(s, j, h->unit, s->workers[worker].handle);
    if (check == SLOT_NONE)
        return SLOT_NONE;
    lease = lease_make(s, worker, job, h->unit, SCHED_KIND_CHECK, h->epoch);
    if (lease != SLOT_NONE)
        lease_own_check(s, lease, check);
    return lease;
}

void worker_told(struct sched *s, uint32_t worker, const struct sched_held *held, size_t count)
{
    const struct worker *w = &s->workers[worker];
    const struct chain *chains[] = {&w->begun, &w->queued};
    for (int i = 0; i < 2; i++)
        for (uint32_t l = chains[i]->head; l != SLOT_NONE; l = s->lease_worker_links[l].next)
            s->leases[l].told = false;
    for (size_t i = 0; i < count && i < s->limits.leases_per_worker_max; i++) {
        uint32_t l = slotmap_find(&s->lease_map, held[i].epoch);
        if (l != SLOT_NONE && !s->leases[l].revoked && s->leases[l].worker == worker &&
            s->jobs[s->leases[l].job].id == held[i].job &&
            worker_has_tags(w, &s->jobs[s->leases[l].job]) &&
            unit_equal(s->leases[l].unit, held[i].unit))
            s->leases[l].told = true;
    }
}

void worker_adopt(struct sched *s, uint32_t worker, const struct sched_held *held, size_t count)
{
    struct worker *w = &s->workers[worker];
    uint32_t take = s->limits.leases_per_worker_max;
    for (size_t i = 0; i < count && i < s->limits.leases_per_worker_max; i++) {
        const struct sched_held *h = &held[i];
        uint32_t lease = adopt(s, worker, h, &take);
        if (lease == SLOT_NONE) {
            /* A result is on its way all the same; it is taken or compared when it comes. */
            if (h->state != SCHED_HELD_RESULT && slotmap_find(&s->lease_map, h->epoch) == SLOT_NONE)
                sched_news_push(s, &(struct sched_action){.type = SCHED_REVOKE,
                                                          .worker = w->handle,
                                                          .job = h->job,
                                                          .unit = h->unit,
                                                          .epoch = h->epoch});
            continue;
        }
        struct worker_job *wj = worker_job_find(w, h->job);
        if (wj->open)
            continue;
        worker_job_open(s, worker, wj);
        sched_news_push(
            s, &(struct sched_action){.type = SCHED_OPEN_JOB, .worker = w->handle, .job = h->job});
    }
}
