/* The run: what a seed decides, the queue of events, the faults, and the end. */
#include "tests/sim/sim.h"

#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

static const uint32_t NO_CONN = UINT32_MAX;

void sim_fail(const struct sim *sim, const char *format, ...)
{
    (void)fprintf(stderr, "sim: seed %" PRIu64 " at %.6f s: ", sim->c.seed,
                  1e-6 * (double)sim->now_us);
    va_list args;
    va_start(args, format);
    (void)vfprintf(stderr, format, args);
    va_end(args);
    (void)fprintf(stderr, "\n  again: sim_farm --seed %" PRIu64 "\n", sim->c.seed);
    exit(1);
}

/* --- Chance ------------------------------------------------------------------------------ */

uint64_t sim_hash(uint64_t a, uint64_t b)
{
    uint64_t x = a * UINT64_C(0x9E3779B97F4A7C15) + b + UINT64_C(0x632BE59BD9B4E019);
    x = (x ^ (x >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    x = (x ^ (x >> 27)) * UINT64_C(0x94D049BB133111EB);
    return x ^ (x >> 31);
}

uint64_t sim_rand(struct sim *sim)
{
    return sim_hash(sim->rng++, sim->c.seed);
}

uint64_t sim_below(struct sim *sim, uint64_t n)
{
    return n ? sim_rand(sim) % n : 0;
}

static double uniform(struct sim *sim)
{
    return (double)(sim_rand(sim) >> 11) * 0x1p-53;
}

bool sim_chance(struct sim *sim, double p)
{
    return uniform(sim) < p;
}

uint64_t sim_spread(struct sim *sim, uint64_t mean)
{
    /* Sum of halvings: an exponential distribution without a logarithm. */
    double x = uniform(sim), scale = 0.0;
    while (x < 0.5 && scale < 10.0) {
        scale += 0.6931471805599453;
        x *= 2.0;
    }
    return (uint64_t)((double)mean * (scale + 1.3862943611198906 * (1.0 - x)));
}

/* --- Events ------------------------------------------------------------------------------- */

void *sim_grow(void *array, size_t count, size_t *capacity, size_t bytes)
{
    bool ok = mem_grow(&array, count, capacity, bytes);
    TL_ASSERT(ok);
    return array;
}

static bool before(const struct sim_event *a, const struct sim_event *b)
{
    return a->at_us != b->at_us ? a->at_us < b->at_us : a->order < b->order;
}

void sim_push(struct sim *sim, uint64_t at_us, struct sim_event e)
{
    e.at_us = at_us;
    e.order = sim->order++;
    sim->heap = sim_grow(sim->heap, sim->heap_count, &sim->heap_capacity, sizeof *sim->heap);
    size_t i = sim->heap_count++;
    while (i > 0 && before(&e, &sim->heap[(i - 1) / 2])) {
        sim->heap[i] = sim->heap[(i - 1) / 2];
        i = (i - 1) / 2;
    }
    sim->heap[i] = e;
}

static bool pop(struct sim *sim, struct sim_event *out)
{
    if (sim->heap_count == 0)
        return false;
    *out = sim->heap[0];
    struct sim_event last = sim->heap[--sim->heap_count];
    size_t i = 0;
    for (;;) {
        size_t child = 2 * i + 1;
        if (child >= sim->heap_count)
            break;
        if (child + 1 < sim->heap_count && before(&sim->heap[child + 1], &sim->heap[child]))
            child++;
        if (!before(&sim->heap[child], &last))
            break;
        sim->heap[i] = sim->heap[child];
        i = child;
    }
    sim->heap[i] = last;
    return true;
}

/* --- What a seed decides --------------------------------------------------------------------- */

static void config_size(struct sim *r, struct sim_config *c)
{
    uint64_t scale = sim_below(r, 100);
    uint64_t workers = scale < 80 ? 8 : scale < 98 ? 40 : 250;
    uint64_t cells = scale < 80 ? 200 : scale < 98 ? 1500 : 8000;
    c->workers = 1 + (uint32_t)sim_below(r, workers);
    c->jobs = 1 + (uint32_t)sim_below(r, 3);
    for (uint32_t i = 0; i < c->jobs; i++) {
        c->cells[i] = 1 + (uint32_t)sim_below(r, cells);
        c->blocks[i] = 1 + (uint32_t)sim_below(r, 10);
    }
    c->check_every = scale < 80 ? 16 : scale < 98 ? 256 : 4096;
}

static void config_faults(struct sim *r, struct sim_config *c)
{
    c->fault_us = 1000000 + sim_below(r, 15000000);
    c->fault_every_us = UINT64_C(1) << (15 + sim_below(r, 7)); /* 33 ms .. 2 s */
    c->master_crashes = sim_chance(r, 0.7);
    c->hang_share = sim_chance(r, 0.3) ? 0.02 : 0.0;
    c->fail_share = sim_chance(r, 0.3) ? 0.03 : 0.0;
    if (sim_chance(r, 0.3) && c->workers >= 4) {
        c->liars = 1 + (uint32_t)sim_below(r, c->workers / 4);
        c->verify = 1.0;
    } else if (sim_chance(r, 0.2) && c->workers >= 3) {
        c->verify = 0.1 + 0.9 * uniform(r);
    }
    if (sim_chance(r, 0.2) && c->workers >= c->liars + 4)
        c->zombies = 1;
    if (sim_chance(r, 0.08) && c->liars == 0)
        c->poison_cell = (int32_t)sim_below(r, c->cells[0]);
}

struct sim_config sim_config_of(uint64_t seed)
{
    struct sim r = {.c.seed = seed, .rng = 1};
    struct sim_config c = {.seed = seed, .poison_cell = -1};
    config_size(&r, &c);
    uint64_t spots = 0;
    for (uint32_t i = 0; i < c.jobs; i++)
        spots += (uint64_t)c.cells[i] * c.blocks[i];
    c.cost_spread = sim_chance(&r, 0.5) ? 2.0 * uniform(&r) : 0.0;
    c.latency_us = UINT32_C(1) << (6 + sim_below(&r, 11)); /* 64 us .. 65 ms */
    c.codec = sim_chance(&r, 0.25);
    c.handles_kept = sim_chance(&r, 0.3);
    if (!sim_chance(&r, 0.1))
        config_faults(&r, &c);
    /* The work takes about as long as the faults, on two and a half threads a worker. */
    double seconds = c.fault_us > 0 ? 1.5e-6 * (double)c.fault_us * (0.3 + uniform(&r))
                                    : 1.0 + 14.0 * uniform(&r);
    c.cost_us = 1e6 * seconds * 2.5 * c.workers / (double)spots;
    /* A spot is no longer than a thread's patience, on the slowest worker too. */
    double cost_max_us = 2e6 / (1.0 + 4.2 * c.cost_spread);
    if (c.cost_us > cost_max_us)
        c.cost_us = cost_max_us;
    c.cell_cost = c.cost_us * (double)(UINT64_C(1) << sim_below(&r, 8)) / 16.0 + 1.0;
    /* Half of the workers must be enough to decide who lied. */
    c.tags = sim_chance(&r, 0.3) && c.liars == 0 && c.workers >= 6;
    c.late = sim_chance(&r, 0.3) ? 1 + (uint32_t)sim_below(&r, 3) : 0;
    return c;
}

/* --- Faults --------------------------------------------------------------------------------------
 */

static void fault_on_job(struct sim *sim)
{
    static const enum sched_event_type types[] = {
        SCHED_JOB_PAUSE,  SCHED_JOB_RESUME, SCHED_JOB_CANCEL,   SCHED_JOB_RETRY,
        SCHED_JOB_RESUME, SCHED_JOB_RETRY,  SCHED_JOB_PRIORITY, SCHED_JOB_HOLD};
    struct sched_event e = {.type = types[sim_below(sim, sizeof types / sizeof *types)],
                            .job = 1 + sim_below(sim, sim->c.jobs)};
    if (e.type == SCHED_JOB_PRIORITY)
        e.priority = (int32_t)sim_below(sim, 3) - 1;
    if (e.type == SCHED_JOB_HOLD)
        e.hold = sim_chance(sim, 0.5);
    if (e.type == SCHED_JOB_RETRY)
        master_retry(sim, e.job);
    else
        master_feed(sim, &e);
}

static void fault(struct sim *sim)
{
    uint32_t worker = (uint32_t)sim_below(sim, sim->c.workers);
    struct sim_worker *w = &sim->workers[worker];
    uint64_t kind = sim_below(sim, 100);
    if (kind < 25) {
        worker_kill(sim, worker, sim_chance(sim, 0.3), 1000 + sim_spread(sim, 1000000));
    } else if (kind < 40 && w->conn != NO_CONN) {
        net_close(sim, w->conn, SIDE_MASTER, sim_chance(sim, 0.2));
        master_conn_lost(sim, w->conn);
    } else if (kind < 50 && w->conn != NO_CONN) {
        uint32_t conn = w->conn;
        net_close(sim, conn, SIDE_WORKER, sim_chance(sim, 0.2));
        worker_conn_lost(sim, worker, conn);
    } else if (kind < 65 && w->conn != NO_CONN) {
        net_stall(sim, w->conn, (enum sim_side)sim_below(sim, 2), sim_spread(sim, 3000000));
    } else if (kind < 75) {
        worker_stop(sim, worker, sim_spread(sim, 4000000));
    } else if (kind < 80) {
        worker_resend_some(sim, worker);
    } else if (kind < 90) {
        fault_on_job(sim);
    } else if (kind < 93 && w->conn != NO_CONN && sim->m.alive) {
        master_feed(sim, &(struct sched_event){.type = SCHED_WORKER_DRAIN, .worker = w->handle});
    } else if (sim->c.master_crashes && sim_chance(sim, 0.5)) {
        master_kill(sim);
    }
}

static bool job_ended(const struct sim *sim, uint32_t job)
{
    if (job == 0 && sim->c.poison_cell >= 0)
        return sim->poison_named;
    return sim->jobs[job].done;
}

static bool all_ended(const struct sim *sim)
{
    if (!sim->healed || !sim->m.alive || sim->disk.pending_count > 0)
        return false;
    for (uint32_t i = 0; i < sim->c.jobs; i++) {
        if (!job_ended(sim, i))
            return false;
    }
    return true;
}

/* After the faults: whoever runs the farm resumes and retries what did not end by itself. */
static void operate(struct sim *sim)
{
    for (uint32_t i = 0; i < sim->c.jobs && sim->m.alive; i++) {
        master_feed(sim, &(struct sched_event){.type = SCHED_JOB_RESUME, .job = i + 1});
        master_feed(sim, &(struct sched_event){.type = SCHED_JOB_HOLD, .job = i + 1});
        if (!job_ended(sim, i))
            master_retry(sim, i + 1);
    }
    sim_push(sim, sim->now_us + 5000000, (struct sim_event){.type = EV_OPERATOR});
}

static void heal(struct sim *sim)
{
    sim->healed = true;
    sim->healed_us = sim->now_us;
    for (uint32_t i = 0; i < sim->c.workers; i++)
        worker_heal(sim, i);
    /* Deadlines, pauses and patience with loading, and four times the work; what the fast ones
     * rendered may have to be verified by the slow ones. */
    uint64_t work = (sim->c.verify > 0.0 ? UINT64_C(40) : 4) * (sim->c.tags ? 2 : 1);
    sim->deadline_us = sim->now_us + 240000000 + work * sim->stats.ideal_us;
    operate(sim);
}

/* --- The run
 * ------------------------------------------------------------------------------------------ */

static void dispatch(struct sim *sim, struct sim_event *e)
{
    switch (e->type) {
    case EV_PACKET:
    case EV_CLOSED:
    case EV_SILENT:
    case EV_UNSTALL:
        net_event(sim, e);
        break;
    case EV_CONNECT:
    case EV_WORKER_UP:
    case EV_LOADED:
    case EV_RENDERED:
    case EV_BROUGHT:
    case EV_ASK:
    case EV_CONTINUE:
    case EV_LEFT:
        worker_event(sim, e);
        break;
    case EV_MASTER_UP:
    case EV_TICK:
    case EV_COMMITTED:
        master_event(sim, e);
        break;
    case EV_FAULT:
        if (sim->healed)
            break;
        fault(sim);
        sim_push(sim, sim->now_us + sim_spread(sim, sim->c.fault_every_us),
                 (struct sim_event){.type = EV_FAULT});
        break;
    case EV_HEAL:
        heal(sim);
        break;
    case EV_OPERATOR:
        operate(sim);
        break;
    }
}

/* The time that all of it would take if every thread were always busy. */
static uint64_t ideal_us(const struct sim *sim)
{
    double work_us = 0.0, threads = 0.0;
    for (uint32_t i = 0; i < sim->c.jobs; i++) {
        for (uint32_t cell = 0; cell < sim->c.cells[i]; cell++) {
            for (uint32_t b = 0; b < sim->c.blocks[i]; b++)
                work_us += (double)spot_cost_us(sim, i, cell, b);
        }
    }
    for (uint32_t i = 0; i < sim->c.workers; i++) {
        const struct sim_worker *w = &sim->workers[i];
        threads += w->zombie || w->liar ? 0.0 : w->threads / w->slow;
    }
    return (uint64_t)(work_us / threads);
}

static void explain_stuck(const struct sim *sim)
{
    for (uint32_t i = 0; i < sim->c.jobs && sim->m.alive; i++) {
        struct sched_job_info info;
        if (!sched_job_info(sim->m.s, i + 1, &info))
            continue;
        (void)fprintf(stderr,
                      "  job %u: %s, waits %d, %" PRIu64 " of %" PRIu64 " done, %" PRIu64
                      " leased, %u leases, %" PRIu64 " checks\n",
                      i + 1, sched_job_state_name(info.state), (int)info.wait, info.spots_done,
                      info.spots, info.spots_leased, info.leases, info.checks_open);
    }
    for (uint32_t i = 0; i < sim->c.workers && i < 20 && sim->m.alive; i++) {
        const struct sim_worker *w = &sim->workers[i];
        struct sched_worker_info info;
        if (!sched_worker_info(sim->m.s, w->handle, &info))
            continue;
        (void)fprintf(
            stderr, "  worker %" PRIu64 ": %s, %u leases, %u threads; runs %u, queues %zu%s%s\n",
            w->handle, sched_worker_state_name(info.state), info.leases, info.threads,
            w->running_count, w->queue_count, w->zombie ? ", zombie" : "", w->liar ? ", liar" : "");
    }
}

static void start(struct sim *sim)
{
    sim->workers = mem_calloc(sim->c.workers, sizeof *sim->workers);
    TL_ASSERT(sim->workers);
    sim->handle_next = 1;
    book_init(sim);
    for (uint32_t i = 0; i < sim->c.workers; i++)
        worker_init(sim, i);
    sim->stats.ideal_us = ideal_us(sim);
    master_up(sim);
    sim_push(sim, sim->c.fault_us, (struct sim_event){.type = EV_HEAL});
    if (sim->c.fault_us > 0)
        sim_push(sim, sim_spread(sim, sim->c.fault_every_us), (struct sim_event){.type = EV_FAULT});
    sim->deadline_us = UINT64_MAX;
}

static void end(struct sim *sim)
{
    for (size_t i = 0; i < sim->heap_count; i++)
        mem_free(sim->heap[i].data);
    mem_free(sim->heap);
    net_free(sim);
    master_free(sim);
    book_free(sim);
    for (uint32_t i = 0; i < sim->c.workers; i++)
        worker_free(&sim->workers[i]);
    mem_free(sim->workers);
}

struct sim_stats sim_run(const struct sim_config *c)
{
    struct sim sim = {.c = *c, .rng = 1000};
    start(&sim);
    struct sim_event e;
    while (!all_ended(&sim) && pop(&sim, &e)) {
        TL_ASSERT(e.at_us >= sim.now_us);
        sim.now_us = e.at_us;
        if (sim.now_us > sim.deadline_us) {
            explain_stuck(&sim);
            sim_fail(&sim, "not done %.0f s after the last fault",
                     1e-6 * (double)(sim.now_us - sim.healed_us));
        }
        dispatch(&sim, &e);
    }
    SIM_CHECK(&sim, all_ended(&sim), "nothing happens any more, and it is not done");
    sched_check(sim.m.s);
    book_final(&sim);
    sim.stats.virtual_us = sim.now_us;
    struct sim_stats stats = sim.stats;
    end(&sim);
    return stats;
}
