/* What an earlier life of the master knew: blame of units, checks that were open, workers' past. */
#include "master/sched/sched_impl.h"

static bool all_in_state(const struct job *j, struct unit u, enum spot_state state)
{
    for (uint32_t i = 0; i < u.cell_count; i++)
        if (job_spot_state(j, u.cell_begin + i, u.block) != state)
            return false;
    return true;
}

/* The pending suspect of exactly this unit, made of waiting spots if there is none; SLOT_NONE: a
 * part of it was rendered since, or the table is full. */
static uint32_t suspect_restored(struct sched *s, uint32_t job, struct unit u)
{
    struct job *j = &s->jobs[job];
    const uint32_t heads[] = {j->suspects.head, j->suspects_alone.head};
    for (int i = 0; i < 2; i++)
        for (uint32_t p = heads[i]; p != SLOT_NONE; p = s->suspect_pool.links[p].next)
            if (unit_equal(s->suspects[p].unit, u))
                return p;
    uint32_t slot = s->suspect_pool.free.head;
    if (slot == SLOT_NONE || !all_in_state(j, u, SPOT_WAITING))
        return SLOT_NONE;
    chain_remove(&s->suspect_pool.free, s->suspect_pool.links, slot);
    s->suspects[slot] =
        (struct suspect){.job = job, .unit = u, .lease = SLOT_NONE, .open = u.cell_count};
    for (uint32_t i = 0; i < u.cell_count; i++)
        job_spot_take(j, u.cell_begin + i, u.block, OWNER_SUSPECT | slot);
    chain_push(&j->suspects, s->suspect_pool.links, slot);
    return slot;
}

void job_blame_restore(struct sched *s, uint32_t job, const struct sched_blame *blame, size_t count)
{
    struct job *j = &s->jobs[job];
    uint32_t killer = SLOT_NONE;
    for (size_t i = 0; i < count; i++) {
        if (!unit_within(j, blame[i].unit))
            continue;
        uint32_t slot = suspect_restored(s, job, blame[i].unit);
        if (slot == SLOT_NONE)
            continue;
        struct suspect *p = &s->suspects[slot];
        chain_remove(suspect_chain(j, p), s->suspect_pool.links, slot);
        p->losers[p->losses++ % SUSPECT_LOSERS] = blame[i].worker;
        p->losses_alone += blame[i].alone;
        p->lost_ms = s->now_ms;
        chain_push(suspect_chain(j, p), s->suspect_pool.links, slot);
        if (p->losses_alone >= SCHED_LOSSES_ALONE)
            killer = slot;
    }
    /* Its failure was not written down any more. */
    if (killer != SLOT_NONE)
        job_fail(s, job, SCHED_WHY_UNIT_KILLS, s->suspects[killer].unit);
}

void job_checks_restore(struct sched *s, uint32_t job, const struct sched_open_check *checks,
                        size_t count)
{
    struct job *j = &s->jobs[job];
    for (size_t i = 0; i < count; i++) {
        const struct sched_open_check *c = &checks[i];
        if (unit_within(j, c->unit) && c->worker != 0 && all_in_state(j, c->unit, SPOT_DONE))
            (void)check_new(s, job, c->unit,
                            (struct vote){.worker = c->worker, .digest = c->digest});
    }
}

bool worker_past(struct sched *s, uint64_t handle, const struct sched_past *past)
{
    if (handle == 0 || slotmap_find(&s->worker_map, handle) != SLOT_NONE)
        return false;
    uint32_t worker = worker_add(s, handle);
    if (worker == SLOT_NONE)
        return false;
    struct worker *w = &s->workers[worker];
    w->quarantined = past->lied;
    w->pauses = past->pauses < PAUSES_MAX ? past->pauses : PAUSES_MAX;
    w->set_aside = past->until_ms > s->now_ms;
    /* No pause is longer, whatever the clock was when it was written down. */
    uint64_t latest_ms = s->now_ms + s->limits.pause_ms_max;
    w->until_ms = past->until_ms < latest_ms ? past->until_ms : latest_ms;
    worker_place(s, worker);
    return true;
}
