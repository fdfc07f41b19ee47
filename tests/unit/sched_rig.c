#include "tests/unit/sched_rig.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include <string.h>

void rig_start(struct rig *r, const struct sched_limits *limits)
{
    memset(r, 0, sizeof *r);
    struct sched_limits l;
    sched_limits_init(&l);
    l.worker_count_max = 64;
    l.job_count_max = RIG_JOBS;
    l.lease_count_max = 2048;
    l.suspect_count_max = 64;
    arena_init(&r->arena);
    assert_int_equal(sched_new(&r->arena, limits ? limits : &l, 1000, &r->s), ERR_OK);
    r->now_ms = 5000;
    r->auto_ready = true;
    r->epoch_last = 999;
}

void rig_stop(struct rig *r)
{
    for (int i = 0; i < RIG_JOBS; i++)
        mem_free(r->job_memory[i]);
    arena_release(&r->arena);
}

struct rig rig;

int rig_setup(void **state)
{
    (void)state;
    rig_start(&rig, NULL);
    return 0;
}

int rig_teardown(void **state)
{
    (void)state;
    rig_stop(&rig);
    return 0;
}

static bool told(const struct rig *r, uint64_t worker, uint64_t job)
{
    for (uint32_t i = 0; i < r->open_count; i++) {
        if (r->open[i] == (worker << 32 | job))
            return true;
    }
    return false;
}

static void untell(struct rig *r, uint64_t worker, uint64_t job)
{
    for (uint32_t i = 0; i < r->open_count;) {
        if (r->open[i] >> 32 == worker && (job == 0 || (r->open[i] & UINT32_MAX) == job))
            r->open[i] = r->open[--r->open_count];
        else
            i++;
    }
}

static void lease_drop(struct rig *r, uint64_t epoch)
{
    for (uint32_t i = 0; i < r->lease_count; i++) {
        if (r->leases[i].epoch != epoch)
            continue;
        memmove(&r->leases[i], &r->leases[i + 1], (--r->lease_count - i) * sizeof *r->leases);
        return;
    }
}

static void note_lease(struct rig *r, const struct sched_action *a)
{
    assert_true(a->epoch > r->epoch_last);
    r->epoch_last = a->epoch;
    assert_true(told(r, a->worker, a->job));
    assert_true(a->unit.cell_count > 0);
    for (uint32_t i = 0; i < a->unit.cell_count; i++)
        assert_true(a->unit.block <
                    sched_frontier(r->s, a->job, a->unit.cell_begin + i) + SCHED_WINDOW);
    assert_true(r->lease_count < RIG_LEASES);
    r->leases[r->lease_count++] = (struct rig_lease){
        .worker = a->worker, .job = a->job, .epoch = a->epoch, .unit = a->unit, .kind = a->kind};
}

static void drain(struct rig *r)
{
    struct sched_action a;
    while (sched_next(r->s, &a)) {
        assert_true(r->action_count < RIG_ACTIONS);
        r->actions[r->action_count++] = a;
        if (a.type == SCHED_LEASE) {
            note_lease(r, &a);
        } else if (a.type == SCHED_OPEN_JOB) {
            assert_false(told(r, a.worker, a.job));
            assert_true(r->open_count < sizeof r->open / sizeof *r->open);
            r->open[r->open_count++] = a.worker << 32 | a.job;
        } else if (a.type == SCHED_CLOSE_JOB) {
            assert_true(told(r, a.worker, a.job));
            untell(r, a.worker, a.job);
        } else if (a.type == SCHED_REVOKE) {
            lease_drop(r, a.epoch);
        }
    }
    sched_check(r->s);
}

static bool feed(struct rig *r, const struct sched_event *e)
{
    uint64_t calls = mem_call_count();
    bool done = sched_feed(r->s, r->now_ms, e);
    drain(r);
    assert_true(mem_call_count() == calls);
    return done;
}

static void ready_all(struct rig *r, uint32_t from)
{
    for (uint32_t i = from; i < r->action_count; i++) {
        struct sched_action a = r->actions[i];
        if (a.type == SCHED_OPEN_JOB)
            (void)feed(r, &(struct sched_event){
                              .type = SCHED_JOB_READY, .worker = a.worker, .job = a.job});
    }
}

static bool tells_of(const struct sched_join *join, uint64_t epoch)
{
    for (size_t i = 0; i < join->held_count; i++)
        if (join->held[i].epoch == epoch)
            return true;
    return false;
}

/* A worker that joins has what it says, and no more. */
static void note_join(struct rig *r, const struct sched_event *e)
{
    untell(r, e->worker, 0);
    for (uint32_t i = 0; i < r->lease_count;) {
        if (r->leases[i].worker == e->worker && !tells_of(&e->join, r->leases[i].epoch))
            lease_drop(r, r->leases[i].epoch);
        else
            i++;
    }
}

bool rig_feed(struct rig *r, const struct sched_event *e)
{
    r->action_count = 0;
    if (e->type == SCHED_WORKER_JOIN)
        note_join(r, e);
    /* A lost worker says nothing; the rig must not wait for it either. */
    if (e->type == SCHED_WORKER_LOST || e->type == SCHED_WORKER_LEFT) {
        untell(r, e->worker, 0);
        for (uint32_t i = 0; i < r->lease_count;) {
            if (r->leases[i].worker == e->worker)
                lease_drop(r, r->leases[i].epoch);
            else
                i++;
        }
    }
    if (e->type == SCHED_UNIT_FAILED)
        lease_drop(r, e->epoch);
    if (e->type == SCHED_RESULT)
        lease_drop(r, e->result.epoch);
    bool done = feed(r, e);
    if (r->auto_ready)
        ready_all(r, 0);
    return done;
}

bool rig_worker(struct rig *r, enum sched_event_type type, uint64_t worker)
{
    return rig_feed(r, &(struct sched_event){.type = type, .worker = worker});
}

bool rig_job(struct rig *r, enum sched_event_type type, uint64_t job)
{
    return rig_feed(r, &(struct sched_event){.type = type, .job = job});
}

bool rig_join(struct rig *r, uint64_t worker, uint32_t threads)
{
    return rig_feed(r, &(struct sched_event){.type = SCHED_WORKER_JOIN,
                                             .worker = worker,
                                             .join = {.threads = threads}});
}

bool rig_ready(struct rig *r, uint64_t worker, uint64_t job)
{
    return rig_feed(r,
                    &(struct sched_event){.type = SCHED_JOB_READY, .worker = worker, .job = job});
}

void rig_wait(struct rig *r, uint64_t ms)
{
    uint64_t end_ms = r->now_ms + ms;
    r->action_count = 0;
    for (;;) {
        uint64_t due_ms = sched_deadline_ms(r->s);
        if (due_ms > end_ms)
            break;
        if (due_ms > r->now_ms)
            r->now_ms = due_ms;
        uint32_t from = r->action_count;
        (void)feed(r, &(struct sched_event){.type = SCHED_TICK});
        if (r->auto_ready)
            ready_all(r, from);
    }
    r->now_ms = end_ms;
    (void)feed(r, &(struct sched_event){.type = SCHED_TICK});
}

bool rig_add_with(struct rig *r, uint64_t job, struct sched_job_add add)
{
    assert_true(job > 0 && job < RIG_JOBS);
    mem_free(r->job_memory[job]);
    r->job_memory[job] = mem_alloc_aligned(sched_job_bytes(add.cell_count, add.block_count), 64);
    assert_non_null(r->job_memory[job]);
    add.memory = r->job_memory[job];
    if (add.cell_cost <= 0.0)
        add.cell_cost = 1000.0;
    return rig_feed(r, &(struct sched_event){.type = SCHED_JOB_ADD, .job = job, .add = add});
}

bool rig_add(struct rig *r, uint64_t job, uint32_t cells, uint32_t blocks)
{
    return rig_add_with(r, job, (struct sched_job_add){.cell_count = cells, .block_count = blocks});
}

uint64_t rig_digest(uint64_t job, struct unit unit)
{
    uint64_t digest = job * 31 + unit.block;
    for (uint32_t i = 0; i < unit.cell_count; i++)
        digest = digest * UINT64_C(0x100000001B3) + unit.cell_begin + i;
    return digest;
}

bool rig_result(struct rig *r, const struct rig_lease *l, uint64_t us, uint64_t lie)
{
    struct rig_lease copy = *l;
    return rig_feed(
        r, &(struct sched_event){.type = SCHED_RESULT,
                                 .worker = copy.worker,
                                 .job = copy.job,
                                 .result = {.unit = copy.unit,
                                            .epoch = copy.epoch,
                                            .samples = (uint64_t)copy.unit.cell_count * 1000,
                                            .render_us = us,
                                            .digest = rig_digest(copy.job, copy.unit) + lie}});
}

struct rig_lease rig_lease_of(const struct rig *r, uint64_t worker, uint32_t i)
{
    for (uint32_t k = 0; k < r->lease_count; k++) {
        if (r->leases[k].worker == worker && i-- == 0)
            return r->leases[k];
    }
    fail_msg("worker %lu holds no such lease", (unsigned long)worker);
    return (struct rig_lease){0};
}

uint32_t rig_held(const struct rig *r, uint64_t worker)
{
    uint32_t held = 0;
    for (uint32_t k = 0; k < r->lease_count; k++)
        held += r->leases[k].worker == worker;
    return held;
}

uint32_t rig_count(const struct rig *r, enum sched_action_type type)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < r->action_count; i++)
        count += r->actions[i].type == type;
    return count;
}

const struct sched_action *rig_find(const struct rig *r, enum sched_action_type type)
{
    for (uint32_t i = 0; i < r->action_count; i++) {
        if (r->actions[i].type == type)
            return &r->actions[i];
    }
    fail_msg("no action of type %d", (int)type);
    return NULL;
}

uint32_t rig_finish(struct rig *r, uint64_t us_per_cell)
{
    uint32_t count = 0;
    while (r->lease_count > 0) {
        struct rig_lease l = r->leases[0];
        r->now_ms += 1 + us_per_cell * l.unit.cell_count / 1000;
        assert_true(rig_result(r, &l, us_per_cell * l.unit.cell_count, 0));
        assert_true(++count < 100000);
    }
    return count;
}

struct sched_job_info rig_info(const struct rig *r, uint64_t job)
{
    struct sched_job_info info;
    assert_true(sched_job_info(r->s, job, &info));
    return info;
}

struct sched_worker_info rig_winfo(const struct rig *r, uint64_t worker)
{
    struct sched_worker_info info;
    assert_true(sched_worker_info(r->s, worker, &info));
    return info;
}
