/* The numbered invariants of sched.h, asserted over every table. */
#include "master/sched/sched_impl.h"

/* 1, 2, 4: each spot is in one state, owners cover their spots, counters agree. */
static void check_spots(const struct sched *s, const struct job *j)
{
    uint64_t done = 0, waiting = 0, leased = 0, shut = 0, weight = 0, weight_done = 0;
    for (uint32_t cell = 0; cell < j->cell_count; cell++) {
        uint32_t frontier = j->frontier[cell];
        weight += j->weight_below[j->limit[cell]];
        TL_ASSERT(frontier <= j->limit[cell] && j->limit[cell] <= j->block_count);
        TL_ASSERT(frontier == j->limit[cell] || *job_spot_owner(j, cell, frontier) != OWNER_DONE);
        for (uint32_t b = 0; b < j->block_count; b++) {
            enum spot_state state = job_spot_state(j, cell, b);
            const uint64_t *set = j->waiting + (size_t)b * j->shape.word_count;
            TL_ASSERT(cellset_has(&j->shape, set, cell) == (state == SPOT_WAITING));
            done += state == SPOT_DONE;
            waiting += state == SPOT_WAITING;
            leased += state == SPOT_LEASED;
            shut += state == SPOT_SHUT && b < j->limit[cell];
            weight_done += state == SPOT_DONE ? job_weight(j, b) : 0;
            if (state != SPOT_LEASED)
                continue;
            uint32_t owner = *job_spot_owner(j, cell, b);
            struct unit u = owner & OWNER_SUSPECT ? s->suspects[owner & ~OWNER_SUSPECT].unit
                                                  : s->leases[owner].unit;
            TL_ASSERT(owner & OWNER_SUSPECT
                          ? &s->jobs[s->suspects[owner & ~OWNER_SUSPECT].job] == j
                          : &s->jobs[s->leases[owner].job] == j && s->leases[owner].owner);
            TL_ASSERT(u.block == b && cell >= u.cell_begin && cell < u.cell_begin + u.cell_count);
        }
    }
    TL_ASSERT(done == j->spots.done && waiting == j->spots.waiting && leased == j->spots.leased);
    TL_ASSERT(done + waiting + leased + shut == job_spot_count(j));
    TL_ASSERT(weight == j->weight_count && weight_done == j->weight_done);
}

/* What is left by cost agrees with the cells. */
static void check_progress(const struct job *j)
{
    uint64_t known = 0, measured = 0;
    double known_s = 0.0, spent_s = 0.0;
    for (uint32_t cell = 0; cell < j->cell_count; cell++) {
        measured += j->measured[cell];
        spent_s += j->spent_s[cell];
        if (j->cost_s[cell] <= 0.0f)
            continue;
        for (uint32_t b = 0; b < j->limit[cell]; b++) {
            uint64_t left = job_spot_state(j, cell, b) != SPOT_DONE ? job_weight(j, b) : 0;
            known += left;
            known_s += (double)left * (double)j->cost_s[cell];
        }
    }
    double error = known_s - j->known_s;
    TL_ASSERT(known == j->known_weight);
    TL_ASSERT(error <= 1e-6 * (1.0 + known_s) && error >= -1e-6 * (1.0 + known_s));
    TL_ASSERT(measured == j->measured_weight);
    error = spent_s - j->committed_s;
    TL_ASSERT(error <= 1e-6 * (1.0 + spent_s) && error >= -1e-6 * (1.0 + spent_s));
    TL_ASSERT(j->done_shown >= 0.0 && j->done_shown <= 1.0);
    TL_ASSERT(j->done_shown >= job_done_share(j) - 1e-9 || j->units == 0);
}

static uint32_t owned(const struct job *j, struct unit u, uint32_t owner)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < u.cell_count; i++) {
        uint32_t cell = u.cell_begin + i;
        count += job_spot_state(j, cell, u.block) == SPOT_LEASED &&
                 *job_spot_owner(j, cell, u.block) == owner;
    }
    return count;
}

/* 2, 3, 5, 6, 9, 10, 12: one lease against its worker, job, unit and ring. */
static void check_lease(const struct sched *s, uint32_t slot)
{
    const struct lease *l = &s->leases[slot];
    const struct worker *w = &s->workers[l->worker];
    const struct job *j = &s->jobs[l->job];
    TL_ASSERT(!l->revoked && s->lease_map.keys[slot] == l->epoch && l->epoch < s->epoch_next);
    TL_ASSERT(slotmap_used(&s->worker_map, l->worker) && slotmap_used(&s->job_map, l->job));
    TL_ASSERT(w->connected && !w->set_aside && !w->quarantined);
    TL_ASSERT(job_is_live(j) && worker_has_tags(w, j));
    TL_ASSERT(l->begun == timers_running(&s->timers, slot));
    TL_ASSERT(l->owner ? l->open > 0 && owned(j, l->unit, slot) == l->open : l->open == 0);
    TL_ASSERT(l->solo == (l->owner && l->twin == slot));
    TL_ASSERT(l->suspect == SLOT_NONE || (l->owner && s->suspects[l->suspect].lease == slot));
    TL_ASSERT(l->check == SLOT_NONE || (!l->owner && s->checks[l->check].lease == slot));
    TL_ASSERT(l->kind == SCHED_KIND_CHECK ? l->check != SLOT_NONE : true);
    TL_ASSERT(!l->alone || (w->alone && w->held == 1));

    uint32_t owners = 0;
    uint32_t t = slot;
    do {
        const struct lease *twin = &s->leases[t];
        owners += twin->owner;
        TL_ASSERT(t == slot || twin->worker != l->worker);
        TL_ASSERT(twin->job == l->job && twin->unit.cell_begin == l->unit.cell_begin &&
                  twin->unit.cell_count == l->unit.cell_count && twin->unit.block == l->unit.block);
        t = twin->twin;
    } while (t != slot);
    TL_ASSERT(owners == (l->check == SLOT_NONE ? 1 : 0));
}

/* 6, 7, 8: a worker's lists, and the list that it is in. */
static void check_worker(const struct sched *s, uint32_t slot)
{
    const struct worker *w = &s->workers[slot];
    TL_ASSERT(w->held == w->begun.count + w->queued.count);
    TL_ASSERT(w->begun.count <= w->threads && w->held <= s->limits.leases_per_worker_max);
    TL_ASSERT(w->held == 0 || (w->connected && !w->set_aside && !w->quarantined));
    TL_ASSERT(!w->alone || w->held == 1);
    TL_ASSERT(w->counted == worker_usable(w));
    TL_ASSERT(!w->away || (w->connected && w->list == LIST_NONE));
    TL_ASSERT(!w->away || timers_running(&s->timers, s->limits.lease_count_max + slot));
    TL_ASSERT((w->list == LIST_GONE) == !w->connected);
    TL_ASSERT(w->list != LIST_STARVING || (worker_usable(w) && w->held < w->threads));
    uint32_t leases = 0;
    for (int i = 0; i < WORKER_JOBS; i++) {
        leases += w->jobs[i].leases;
        TL_ASSERT(w->jobs[i].leases == 0 || (w->jobs[i].open && w->jobs[i].job != 0));
        TL_ASSERT(!w->jobs[i].ready || w->jobs[i].open);
    }
    TL_ASSERT(leases == w->held);
    for (uint32_t l = w->begun.head; l != SLOT_NONE; l = s->lease_worker_links[l].next)
        TL_ASSERT(s->leases[l].begun && s->leases[l].worker == slot);
    for (uint32_t l = w->queued.head; l != SLOT_NONE; l = s->lease_worker_links[l].next)
        TL_ASSERT(!s->leases[l].begun && s->leases[l].worker == slot);
}

/* 9, 10: what is held back and checked belongs to the job. */
static void check_job(const struct sched *s, uint32_t slot)
{
    const struct job *j = &s->jobs[slot];
    uint32_t begun = 0;
    const uint32_t heads[] = {j->solo.head, j->others.head};
    for (int i = 0; i < 2; i++) {
        for (uint32_t l = heads[i]; l != SLOT_NONE; l = s->lease_job_links[l].next) {
            TL_ASSERT(s->leases[l].job == slot);
            begun += s->leases[l].begun;
        }
    }
    TL_ASSERT(begun == j->begun);
    const struct chain *const held[] = {&j->suspects, &j->suspects_alone};
    for (int i = 0; i < 2; i++) {
        for (uint32_t p = held[i]->head; p != SLOT_NONE; p = s->suspect_pool.links[p].next) {
            const struct suspect *suspect = &s->suspects[p];
            TL_ASSERT(suspect->job == slot && suspect->lease == SLOT_NONE && suspect->open > 0);
            TL_ASSERT(owned(j, suspect->unit, OWNER_SUSPECT | p) == suspect->open);
            TL_ASSERT((suspect->losses >= SCHED_LOSSES_COMPANY) == (i == 1));
        }
    }
    for (uint32_t c = j->checks_out.head; c != SLOT_NONE; c = s->check_pool.links[c].next) {
        const struct check *check = &s->checks[c];
        TL_ASSERT(check->job == slot && check->lease != SLOT_NONE);
        for (uint32_t v = 0; v < check->vote_count; v++)
            TL_ASSERT(check->votes[v].worker != s->workers[s->leases[check->lease].worker].handle);
    }
    TL_ASSERT(job_is_live(j) ||
              (j->solo.count == 0 && j->others.count == 0 && j->suspects.count == 0 &&
               j->suspects_alone.count == 0 && j->checks_out.count == 0));
    bool complete = j->spots.done == job_spot_count(j) && j->checks.count == 0 &&
                    j->checks_out.count == 0 && s->liars_unsettled == 0 && !j->open;
    TL_ASSERT(j->state != SCHED_DONE || j->spots.done == job_spot_count(j));
    TL_ASSERT(!job_is_live(j) || !complete);
    check_spots(s, j);
    check_progress(j);
}

void sched_check(const struct sched *s)
{
    uint32_t threads = 0, leases = 0, reserved = 0, reserved_jobs = 0;
    for (uint32_t i = 0; i < s->limits.worker_count_max; i++) {
        if (!slotmap_used(&s->worker_map, i))
            continue;
        check_worker(s, i);
        threads += s->workers[i].counted ? s->workers[i].threads : 0;
        leases += s->workers[i].held;
        reserved += s->workers[i].reserved_job != 0 &&
                    slotmap_find(&s->job_map, s->workers[i].reserved_job) != SLOT_NONE;
    }
    for (uint32_t i = 0; i < s->limits.lease_count_max; i++) {
        if (slotmap_used(&s->lease_map, i) && !s->leases[i].revoked)
            check_lease(s, i);
    }
    for (uint32_t i = 0; i < s->job_rank_count; i++) {
        const struct job *j = &s->jobs[s->job_rank[i]];
        TL_ASSERT(i == 0 || s->jobs[s->job_rank[i - 1]].priority >= j->priority);
        TL_ASSERT(j->threads == threads_with(s, j->tags));
        reserved_jobs += j->reserved;
        check_job(s, s->job_rank[i]);
    }
    TL_ASSERT(threads == s->threads);
    TL_ASSERT(leases + s->revoked.count == s->lease_map.count);
    TL_ASSERT(reserved == reserved_jobs);
    timers_check(&s->timers);
}
