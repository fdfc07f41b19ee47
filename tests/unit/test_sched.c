/* The scheduler at work: order, sizes, prefetch, fairness, life of jobs and workers. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include "tests/unit/sched_rig.h"

/* --- One job ---------------------------------------------------------------------- */

static void test_one_worker_renders_every_spot_once(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 100, 6));
    assert_true(rig_join(&rig, 1, 2));
    uint64_t accepted = 0;
    double done = 0.0;
    while (rig.lease_count > 0) {
        struct rig_lease l = rig.leases[0];
        rig.now_ms += 20;
        assert_true(rig_result(&rig, &l, 1000 * l.unit.cell_count, 0));
        assert_int_equal(rig_count(&rig, SCHED_ACCEPT), 1);
        accepted += rig_find(&rig, SCHED_ACCEPT)->unit.cell_count;
        struct sched_job_info info = rig_info(&rig, 1);
        assert_true(info.done >= done);
        assert_true(info.spots_done == accepted);
        done = info.done;
    }
    assert_int_equal(accepted, 600);
    assert_int_equal(rig_count(&rig, SCHED_JOB_DONE), 1);
    assert_int_equal(rig_count(&rig, SCHED_CLOSE_JOB), 1);
    struct sched_job_info info = rig_info(&rig, 1);
    assert_int_equal(info.state, SCHED_DONE);
    assert_true(info.done == 1.0);
    assert_int_equal(info.retried, 0);
    for (uint32_t c = 0; c < 100; c++) {
        assert_int_equal(sched_frontier(rig.s, 1, c), 6);
        assert_true(sched_spot_done(rig.s, 1, c, 5));
    }
}

static void test_blocks_come_in_order_within_the_window(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 4, 8));
    assert_true(rig_join(&rig, 1, 64));
    /* 16 spots are open; the rig has checked that none is beyond its window. */
    assert_int_equal(rig_info(&rig, 1).spots_leased, 16);
    for (uint32_t i = 1; i < rig.lease_count; i++)
        assert_true(rig.leases[i].unit.block >= rig.leases[i - 1].unit.block);

    /* Block 1 of a cell alone opens nothing; block 0 then opens two. */
    struct rig_lease first[2] = {{0}};
    for (uint32_t i = 0; i < rig.lease_count; i++) {
        if (rig.leases[i].unit.cell_begin == 0 && rig.leases[i].unit.block < 2)
            first[rig.leases[i].unit.block] = rig.leases[i];
    }
    assert_true(rig_result(&rig, &first[1], 1000, 0));
    assert_int_equal(rig_count(&rig, SCHED_LEASE), 0);
    assert_int_equal(sched_frontier(rig.s, 1, 0), 0);
    assert_true(rig_result(&rig, &first[0], 1000, 0));
    assert_int_equal(sched_frontier(rig.s, 1, 0), 2);
    assert_int_equal(rig_count(&rig, SCHED_LEASE), 2);
    (void)rig_finish(&rig, 1000);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
}

static void test_first_units_are_small_then_last_a_second(void **state)
{
    (void)state;
    /* 1 ms a cell: the first guess is on the small side, units grow to 1 s. */
    assert_true(rig_add(&rig, 1, 100000, 2));
    assert_true(rig_join(&rig, 1, 1));
    struct rig_lease l = rig_lease_of(&rig, 1, 0);
    assert_true(l.unit.cell_count >= 20 && l.unit.cell_count <= 100);
    uint32_t largest = 0;
    for (int i = 0; i < 20; i++) {
        l = rig_lease_of(&rig, 1, 0);
        largest = l.unit.cell_count > largest ? l.unit.cell_count : largest;
        rig.now_ms += l.unit.cell_count;
        assert_true(rig_result(&rig, &l, 1000 * (uint64_t)l.unit.cell_count, 0));
    }
    assert_true(largest >= 900 && largest <= 1001);
    /* A worker that turns out ten times slower gets a tenth of that. */
    for (int i = 0; i < 30; i++) {
        l = rig_lease_of(&rig, 1, 0);
        rig.now_ms += 10 * (uint64_t)l.unit.cell_count;
        assert_true(rig_result(&rig, &l, 10000 * (uint64_t)l.unit.cell_count, 0));
    }
    l = rig_lease_of(&rig, 1, 0);
    assert_true(l.unit.cell_count >= 50 && l.unit.cell_count <= 200);
}

static void test_no_unit_exceeds_a_quarter_of_a_share(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 64, 2));
    uint64_t left = 128;
    for (uint64_t w = 1; w <= 2; w++)
        assert_true(rig_join(&rig, w, 2));
    while (rig.lease_count > 0) {
        struct rig_lease l = rig.leases[0];
        struct sched_job_info before = rig_info(&rig, 1);
        left = before.spots - before.spots_done - before.spots_leased;
        /* 1 us a cell: by time alone everything would fit one unit. */
        assert_true(rig_result(&rig, &l, l.unit.cell_count, 0));
        for (uint32_t i = 0; i < rig.action_count; i++) {
            const struct sched_action *a = &rig.actions[i];
            if (a->type == SCHED_LEASE && a->kind == SCHED_KIND_FIRST)
                assert_true(a->unit.cell_count == 1 || a->unit.cell_count <= left / 16);
        }
    }
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
}

static void test_unit_cells_max_is_kept(void **state)
{
    (void)state;
    assert_true(rig_add_with(
        &rig, 1,
        (struct sched_job_add){.cell_count = 100000, .block_count = 2, .unit_cells_max = 7}));
    assert_true(rig_join(&rig, 1, 1));
    for (int i = 0; i < 50; i++) {
        struct rig_lease l = rig_lease_of(&rig, 1, 0);
        assert_true(l.unit.cell_count <= 7);
        assert_true(rig_result(&rig, &l, 1, 0));
    }
}

/* --- Prefetch --------------------------------------------------------------------- */

static void test_worker_holds_threads_and_two(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 10000, 2));
    assert_true(rig_join(&rig, 1, 3));
    assert_int_equal(rig_held(&rig, 1), 5);
    struct rig_lease l = rig_lease_of(&rig, 1, 0);
    assert_true(rig_result(&rig, &l, 100000, 0));
    assert_int_equal(rig_held(&rig, 1), 5);
}

static void test_long_round_trips_need_more_leases(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 100000, 2));
    assert_true(rig_join(&rig, 1, 4));
    assert_int_equal(rig_held(&rig, 1), 6);
    /* Units of 100 ms over a round trip of 200 ms: 12 end before the next can come. */
    assert_true(rig_feed(
        &rig, &(struct sched_event){.type = SCHED_WORKER_RTT, .worker = 1, .rtt_us = 200000}));
    assert_int_equal(rig_held(&rig, 1), 4 + 13);
}

static void test_idle_threads_come_before_prefetch(void **state)
{
    (void)state;
    assert_true(rig_join(&rig, 1, 2));
    assert_true(rig_join(&rig, 2, 2));
    /* Four cells, one block: one for each thread, though worker 1 has room for four. */
    assert_true(rig_add(&rig, 1, 4, 1));
    assert_int_equal(rig_held(&rig, 1), 2);
    assert_int_equal(rig_held(&rig, 2), 2);
}

/* --- Several jobs ------------------------------------------------------------------ */

static void test_higher_priority_goes_first(void **state)
{
    (void)state;
    struct sched_job_add add = {.cell_count = 100, .block_count = 1};
    assert_true(rig_add_with(&rig, 1, add));
    add.priority = 5;
    assert_true(rig_add_with(&rig, 2, add));
    assert_true(rig_join(&rig, 1, 2));
    for (uint32_t i = 0; i < rig_held(&rig, 1); i++)
        assert_int_equal(rig_lease_of(&rig, 1, i).job, 2);
    assert_int_equal(rig_info(&rig, 1).wait, SCHED_WAIT_BEHIND);
    assert_true(
        rig_feed(&rig, &(struct sched_event){.type = SCHED_JOB_PRIORITY, .job = 1, .priority = 9}));
    struct rig_lease l = rig_lease_of(&rig, 1, 0);
    assert_true(rig_result(&rig, &l, 1000, 0));
    assert_int_equal(rig_find(&rig, SCHED_LEASE)->job, 1);
    (void)rig_finish(&rig, 1000);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
    assert_int_equal(rig_info(&rig, 2).state, SCHED_DONE);
}

static void test_equals_share_the_threads(void **state)
{
    (void)state;
    for (uint64_t w = 1; w <= 8; w++)
        assert_true(rig_join(&rig, w, 4));
    for (uint64_t j = 1; j <= 3; j++)
        assert_true(rig_add(&rig, j, 20000, 2));
    for (int i = 0; i < 400; i++) {
        struct rig_lease l = rig.leases[0];
        rig.now_ms += 3;
        assert_true(rig_result(&rig, &l, 1000 * (uint64_t)l.unit.cell_count, 0));
    }
    uint32_t total = 0;
    double least_s = 1e9, most_s = 0;
    for (uint64_t j = 1; j <= 3; j++) {
        struct sched_job_info info = rig_info(&rig, j);
        total += info.leases;
        assert_in_range(info.leases, 12, 20);
        least_s = info.thread_seconds < least_s ? info.thread_seconds : least_s;
        most_s = info.thread_seconds > most_s ? info.thread_seconds : most_s;
    }
    assert_int_equal(total, 8 * 6);
    assert_true(most_s < 1.2 * least_s);
}

/* The first worker's oldest lease is answered; gives how long it took. */
static uint64_t one_result(uint64_t us_per_cell)
{
    struct rig_lease l = rig_lease_of(&rig, 1, 0);
    uint64_t us = us_per_cell * l.unit.cell_count;
    rig.now_ms += us / 1000;
    assert_true(rig_result(&rig, &l, us, 0));
    return us;
}

/* One thread, a large job whose units take a second, and a small one whose end makes its units
 * short: it gets half of the time, not half of the units. It took 28 times as long as alone. */
static void test_equals_share_the_time(void **state)
{
    enum { CELL_US = 20000, SMALL_CELLS = 60, ALONE_US = CELL_US * SMALL_CELLS * 2 };
    (void)state;
    assert_true(rig_join(&rig, 1, 1));
    assert_true(rig_add(&rig, 1, 60000, 2));
    while (rig_lease_of(&rig, 1, 0).unit.cell_count < 40)
        (void)one_result(CELL_US);
    assert_true(rig_add(&rig, 2, SMALL_CELLS, 2));
    uint64_t spent_us = 0;
    while (rig_info(&rig, 2).state != SCHED_DONE && spent_us < 100 * (uint64_t)ALONE_US)
        spent_us += one_result(CELL_US);
    /* What was queued before it, its own time twice over, and a unit of the other. */
    assert_in_range(spent_us, ALONE_US, 2 * ALONE_US + 4 * 1200000);
}

/* --- Life of a job ------------------------------------------------------------------ */

static void test_paused_job_gets_no_lease_but_takes_results(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 50, 2));
    assert_true(rig_join(&rig, 1, 1));
    assert_true(rig_job(&rig, SCHED_JOB_PAUSE, 1));
    assert_false(rig_job(&rig, SCHED_JOB_PAUSE, 1));
    while (rig.lease_count > 0) {
        struct rig_lease l = rig.leases[0];
        assert_true(rig_result(&rig, &l, 1000, 0));
        assert_int_equal(rig_count(&rig, SCHED_ACCEPT), 1);
        assert_int_equal(rig_count(&rig, SCHED_LEASE), 0);
    }
    assert_true(rig_job(&rig, SCHED_JOB_RESUME, 1));
    assert_int_equal(rig_held(&rig, 1), 3);
    (void)rig_finish(&rig, 1000);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
    assert_false(rig_job(&rig, SCHED_JOB_RESUME, 1));
    assert_false(rig_job(&rig, SCHED_JOB_CANCEL, 1));
}

/* Its journal is too long, say: what is out goes on, nothing follows until it is let go. */
static void test_held_job_gets_no_lease_but_takes_results(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 64, 2));
    assert_true(rig_join(&rig, 1, 2));
    struct sched_event hold = {.type = SCHED_JOB_HOLD, .job = 1, .hold = true};
    assert_true(rig_feed(&rig, &hold));
    uint32_t held = rig_held(&rig, 1);
    assert_true(held > 0);
    for (; held > 0; held--) {
        struct rig_lease l = rig_lease_of(&rig, 1, 0);
        assert_true(rig_result(&rig, &l, 1000, 0));
        assert_int_equal(rig_count(&rig, SCHED_ACCEPT), 1);
        assert_int_equal(rig_held(&rig, 1), held - 1);
    }
    rig_wait(&rig, 1000);
    assert_int_equal(rig_held(&rig, 1), 0);
    assert_int_equal(rig_info(&rig, 1).wait, SCHED_WAIT_NOTHING);
    hold.hold = false;
    assert_true(rig_feed(&rig, &hold));
    assert_true(rig_held(&rig, 1) > 0);
    rig_finish(&rig, 1000);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
}

static void test_cancel_revokes_and_retry_goes_on(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 50, 2));
    assert_true(rig_join(&rig, 1, 2));
    struct rig_lease done = rig_lease_of(&rig, 1, 0), late = rig_lease_of(&rig, 1, 1);
    assert_true(rig_result(&rig, &done, 1000, 0));
    assert_true(rig_job(&rig, SCHED_JOB_CANCEL, 1));
    assert_int_equal(rig_count(&rig, SCHED_REVOKE), 4);
    assert_int_equal(rig_count(&rig, SCHED_CLOSE_JOB), 1);
    assert_int_equal(rig.lease_count, 0);
    assert_true(rig_result(&rig, &late, 1000, 0));
    assert_int_equal(rig_find(&rig, SCHED_IGNORE)->why, SCHED_WHY_NO_JOB);

    assert_true(rig_job(&rig, SCHED_JOB_RETRY, 1));
    assert_true(rig_info(&rig, 1).spots_done == done.unit.cell_count);
    assert_true(rig_result(&rig, &late, 1000, 0));
    assert_int_equal(rig_count(&rig, SCHED_ACCEPT), 1);
    (void)rig_finish(&rig, 1000);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
}

static void test_removed_job_is_forgotten(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 50, 2));
    assert_true(rig_join(&rig, 1, 2));
    struct rig_lease late = rig_lease_of(&rig, 1, 0);
    assert_true(rig_job(&rig, SCHED_JOB_REMOVE, 1));
    assert_int_equal(rig_count(&rig, SCHED_REVOKE), 4);
    assert_int_equal(rig_count(&rig, SCHED_CLOSE_JOB), 1);
    struct sched_job_info info;
    assert_false(sched_job_info(rig.s, 1, &info));
    assert_true(rig_result(&rig, &late, 1000, 0));
    assert_int_equal(rig_find(&rig, SCHED_IGNORE)->why, SCHED_WHY_NO_JOB);
    assert_false(rig_job(&rig, SCHED_JOB_REMOVE, 1));
    /* Its slots serve again, as often as one likes. */
    for (int i = 0; i < 100; i++) {
        assert_true(rig_add(&rig, 2, 5, 1));
        assert_true(rig_job(&rig, SCHED_JOB_REMOVE, 2));
    }
    assert_true(rig_add(&rig, 1, 5, 1));
    (void)rig_finish(&rig, 1000);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
}

static void test_restored_spots_are_not_leased(void **state)
{
    (void)state;
    const struct sched_done done[] = {
        {.cell_begin = 0, .cell_count = 50, .block_begin = 0, .block_end = 8},
        {.cell_begin = 50, .cell_count = 10, .block_begin = 0, .block_end = 3},
        {.cell_begin = 55, .cell_count = 3, .block_begin = 4, .block_end = 6},
        {.cell_begin = 60, .cell_count = 1, .block_begin = 1, .block_end = 3},
        {.cell_begin = 60, .cell_count = 1, .block_begin = 0, .block_end = 2},
        {.cell_begin = 61, .cell_count = 1, .block_begin = 6, .block_end = 8}, /* beyond */
    };
    assert_true(rig_add_with(&rig, 1,
                             (struct sched_job_add){.cell_count = 64,
                                                    .block_count = 8,
                                                    .done = done,
                                                    .done_count = sizeof done / sizeof *done}));
    assert_true(rig_info(&rig, 1).spots_done == 50 * 8 + 10 * 3 + 3 * 2 + 3);
    assert_int_equal(sched_frontier(rig.s, 1, 55), 3);
    assert_true(sched_spot_done(rig.s, 1, 55, 5));
    assert_false(sched_spot_done(rig.s, 1, 55, 3));
    assert_int_equal(sched_frontier(rig.s, 1, 60), 3);
    assert_int_equal(sched_frontier(rig.s, 1, 61), 0);
    assert_true(rig_info(&rig, 1).done > 0.8);

    assert_true(rig_join(&rig, 1, 1));
    uint64_t accepted = 0;
    while (rig.lease_count > 0) {
        struct rig_lease l = rig.leases[0];
        assert_true(rig_result(&rig, &l, 1000, 0));
        assert_int_equal(rig_count(&rig, SCHED_COMPARE), 0);
        accepted += rig_find(&rig, SCHED_ACCEPT)->unit.cell_count;
    }
    assert_int_equal(accepted, 64 * 8 - (50 * 8 + 10 * 3 + 3 * 2 + 3));
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
}

/* Of a cell that starts again the seconds of all its spots were taken off, also of those from an
 * earlier life, which nobody had measured: the rest looked cheap (seed 60021325 of tests/sim). */
static void test_a_cell_that_starts_again_takes_off_what_it_took(void **state)
{
    (void)state;
    const struct sched_done done = {.cell_count = 1, .block_end = 1};
    assert_true(rig_add_with(
        &rig, 1,
        (struct sched_job_add){.cell_count = 2, .block_count = 8, .done = &done, .done_count = 1}));
    struct rig_lease l = {.worker = 1, .job = 1, .epoch = 1000, .unit = {0, 1, 1}};
    assert_true(rig_result(&rig, &l, 10000000, 0));
    for (uint32_t block = 0; block < 8; block++) {
        l = (struct rig_lease){.worker = 1, .job = 1, .epoch = 1001 + block, .unit = {1, 1, block}};
        assert_true(rig_result(&rig, &l, 100000, 0));
    }
    double shown = rig_info(&rig, 1).done;
    assert_true(shown > 0.1 && shown < 0.2); /* 12 of 72 s */
    assert_true(rig_feed(
        &rig, &(struct sched_event){.type = SCHED_CELLS_RESET, .job = 1, .unit = {0, 1, 0}}));
    assert_int_equal(rig_info(&rig, 1).spots_done, 8);
    assert_true(rig_info(&rig, 1).done == shown); /* 0.8 of 81 s, but it never goes back */
}

static void test_wholly_restored_job_is_done_at_once(void **state)
{
    (void)state;
    const struct sched_done done = {.cell_count = 9, .block_end = 4};
    assert_true(rig_add_with(
        &rig, 1,
        (struct sched_job_add){.cell_count = 9, .block_count = 4, .done = &done, .done_count = 1}));
    assert_int_equal(rig_count(&rig, SCHED_JOB_DONE), 1);
}

static void test_impossible_jobs_are_refused(void **state)
{
    (void)state;
    assert_int_equal(sched_job_bytes(0, 1), 0);
    assert_int_equal(sched_job_bytes(1, 0), 0);
    assert_int_equal(sched_job_bytes(1, JOB_BLOCKS_MAX + 1), 0);
    assert_int_equal(sched_job_bytes((uint32_t)GRID_CELLS_MAX + 1, 1), 0);
    assert_true(rig_add(&rig, 1, 4, 1));
    struct sched_event again = {
        .type = SCHED_JOB_ADD,
        .job = 1,
        .add = {.cell_count = 4, .block_count = 1, .cell_cost = 1, .memory = rig.job_memory[1]}};
    assert_false(rig_feed(&rig, &again));
    again.job = 0;
    assert_false(rig_feed(&rig, &again));
    const struct sched_done beyond = {.cell_begin = 3, .cell_count = 2, .block_end = 1};
    again.job = 2;
    again.add.done = &beyond;
    again.add.done_count = 1;
    assert_false(rig_feed(&rig, &again));
    again.add.done_count = 0;
    again.add.verify_share = 1.5;
    assert_false(rig_feed(&rig, &again));
}

/* --- Life of a worker ---------------------------------------------------------------- */

static void test_leases_have_no_deadline_before_ready(void **state)
{
    (void)state;
    rig.auto_ready = false;
    assert_true(rig_add(&rig, 1, 100, 1));
    assert_true(rig_join(&rig, 1, 2));
    assert_int_equal(rig_winfo(&rig, 1).state, SCHED_WORKER_LOADING);
    /* It loads for nine minutes and keeps its leases. */
    rig_wait(&rig, 540000);
    assert_int_equal(rig_held(&rig, 1), 4);
    assert_true(rig_ready(&rig, 1, 1));
    assert_true(rig_ready(&rig, 1, 1)); /* it may say so again */
    assert_int_equal(rig_winfo(&rig, 1).state, SCHED_WORKER_BUSY);
    struct rig_lease l = rig_lease_of(&rig, 1, 0);
    assert_true(rig_result(&rig, &l, 1000, 0));
    /* Now what it takes is known; a begun lease may take 20 s. */
    assert_true(rig_winfo(&rig, 1).timeouts == 0);
}

static void test_draining_worker_finishes_and_says_so(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 100, 1));
    assert_true(rig_join(&rig, 1, 2));
    assert_true(rig_worker(&rig, SCHED_WORKER_DRAIN, 1));
    assert_int_equal(rig_winfo(&rig, 1).state, SCHED_WORKER_DRAINING);
    for (int i = 0; i < 4; i++) {
        assert_int_equal(rig_count(&rig, SCHED_DRAINED), 0);
        struct rig_lease l = rig_lease_of(&rig, 1, 0);
        assert_true(rig_result(&rig, &l, 1000, 0));
        assert_int_equal(rig_count(&rig, SCHED_LEASE), 0);
    }
    assert_int_equal(rig_count(&rig, SCHED_DRAINED), 1);
    assert_true(rig_worker(&rig, SCHED_WORKER_LEFT, 1));
    assert_int_equal(rig_info(&rig, 1).wait, SCHED_WAIT_WORKER);
    /* An idle one is drained at once. */
    assert_true(rig_job(&rig, SCHED_JOB_PAUSE, 1));
    assert_true(rig_join(&rig, 2, 1));
    assert_true(rig_worker(&rig, SCHED_WORKER_DRAIN, 2));
    assert_int_equal(rig_count(&rig, SCHED_DRAINED), 1);
}

static void test_full_tables_say_no(void **state)
{
    (void)state;
    for (uint64_t w = 1; w <= 64; w++)
        assert_true(rig_join(&rig, w, 1));
    assert_false(rig_join(&rig, 65, 1));
    /* The place of one that is gone is given away, oldest first. */
    assert_true(rig_worker(&rig, SCHED_WORKER_LOST, 7));
    assert_true(rig_worker(&rig, SCHED_WORKER_LOST, 8));
    assert_true(rig_join(&rig, 65, 1));
    struct sched_worker_info info;
    assert_false(sched_worker_info(rig.s, 7, &info));
    assert_true(sched_worker_info(rig.s, 8, &info));
    assert_false(rig_worker(&rig, SCHED_WORKER_LOST, 7));
    assert_false(rig_join(&rig, 0, 1));
    assert_false(rig_join(&rig, 66, 0));
}

static void test_a_worker_that_joins_late_gets_work_at_once(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 1000, 4));
    assert_true(rig_join(&rig, 1, 2));
    struct rig_lease l = rig_lease_of(&rig, 1, 0);
    assert_true(rig_result(&rig, &l, 1000, 0));
    assert_true(rig_join(&rig, 2, 4));
    assert_int_equal(rig_held(&rig, 2), 6);
}

static void test_farm_info_counts(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 10, 1));
    assert_true(rig_add(&rig, 2, 10, 1));
    assert_true(rig_job(&rig, SCHED_JOB_PAUSE, 2));
    assert_true(rig_join(&rig, 1, 3));
    assert_true(rig_join(&rig, 2, 5));
    assert_true(rig_worker(&rig, SCHED_WORKER_LOST, 2));
    struct sched_farm_info f;
    sched_farm_info(rig.s, &f);
    assert_int_equal(f.workers, 1);
    assert_int_equal(f.threads, 3);
    assert_int_equal(f.jobs[SCHED_ACTIVE], 1);
    assert_int_equal(f.jobs[SCHED_PAUSED], 1);
    assert_int_equal(f.leases, rig.lease_count);
    assert_true(f.epoch_next == sched_epoch_next(rig.s) && f.epoch_next > rig.epoch_last);
}

static void test_limits_out_of_range_are_refused(void **state)
{
    (void)state;
    struct sched_limits l;
    struct sched *s;
    sched_limits_init(&l);
    assert_int_equal(sched_new(&rig.arena, &l, 0, &s), ERR_LIMIT);
    l.worker_count_max = 0;
    assert_int_equal(sched_new(&rig.arena, &l, 1, &s), ERR_LIMIT);
    sched_limits_init(&l);
    l.pause_ms_max = l.pause_ms_min - 1;
    assert_int_equal(sched_new(&rig.arena, &l, 1, &s), ERR_LIMIT);
}

static void test_every_allocation_may_fail(void **state)
{
    (void)state;
    struct sched_limits l;
    sched_limits_init(&l);
    l.worker_count_max = l.lease_count_max = l.job_count_max = l.suspect_count_max = 20000;
    struct arena arena;
    struct sched *s;
    for (uint64_t n = 0;; n++) {
        arena_init(&arena);
        mem_fail_after(n);
        enum err e = sched_new(&arena, &l, 1, &s);
        mem_fail_after(UINT64_MAX);
        arena_release(&arena);
        if (e == ERR_OK)
            break;
        assert_int_equal(e, ERR_NOMEM);
        assert_true(n < 1000);
    }
}

/* --- Time ----------------------------------------------------------------------------- */

/* A worker with one thread and a job of which it is known what a unit costs. */
static void begin_known(void)
{
    assert_true(rig_add(&rig, 1, 64, 2));
    assert_true(rig_join(&rig, 1, 1));
    for (int i = 0; i < 3; i++) {
        struct rig_lease l = rig_lease_of(&rig, 1, 0);
        assert_true(rig_result(&rig, &l, 1000, 0));
    }
}

static void test_a_begun_lease_has_its_time(void **state)
{
    (void)state;
    begin_known();
    rig_wait(&rig, 19000);
    assert_int_equal(rig_winfo(&rig, 1).timeouts, 0);
    rig_wait(&rig, 2000);
    assert_int_equal(rig_winfo(&rig, 1).timeouts, 1);
}

/* What a begun unit lacks may take as long to come as a scene, but no longer. */
static void test_a_worker_that_asks_for_chunks_has_time(void **state)
{
    (void)state;
    begin_known();
    struct rig_lease held = rig_lease_of(&rig, 1, 0);
    for (int i = 0; i < 3; i++) {
        rig_wait(&rig, 15000);
        assert_true(rig_worker(&rig, SCHED_WORKER_ASKS, 1));
    }
    assert_int_equal(rig_winfo(&rig, 1).timeouts, 0);
    assert_int_equal(rig_lease_of(&rig, 1, 0).epoch, held.epoch);
    /* All has come: the usual time, and not a second more. */
    assert_true(rig_ready(&rig, 1, 1));
    rig_wait(&rig, 19000);
    assert_int_equal(rig_winfo(&rig, 1).timeouts, 0);
    rig_wait(&rig, 2000);
    assert_int_equal(rig_winfo(&rig, 1).timeouts, 1);
}

static void test_asking_for_ever_gains_nothing(void **state)
{
    (void)state;
    begin_known();
    for (int i = 0; i < 59; i++) {
        assert_true(rig_worker(&rig, SCHED_WORKER_ASKS, 1));
        rig_wait(&rig, 10000);
    }
    assert_int_equal(rig_winfo(&rig, 1).timeouts, 0);
    assert_true(rig_worker(&rig, SCHED_WORKER_ASKS, 1));
    rig_wait(&rig, 11000);
    assert_int_equal(rig_winfo(&rig, 1).timeouts, 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        RIG_TEST(test_a_begun_lease_has_its_time),
        RIG_TEST(test_a_worker_that_asks_for_chunks_has_time),
        RIG_TEST(test_asking_for_ever_gains_nothing),
        RIG_TEST(test_one_worker_renders_every_spot_once),
        RIG_TEST(test_blocks_come_in_order_within_the_window),
        RIG_TEST(test_first_units_are_small_then_last_a_second),
        RIG_TEST(test_no_unit_exceeds_a_quarter_of_a_share),
        RIG_TEST(test_unit_cells_max_is_kept),
        RIG_TEST(test_worker_holds_threads_and_two),
        RIG_TEST(test_long_round_trips_need_more_leases),
        RIG_TEST(test_idle_threads_come_before_prefetch),
        RIG_TEST(test_higher_priority_goes_first),
        RIG_TEST(test_equals_share_the_threads),
        RIG_TEST(test_equals_share_the_time),
        RIG_TEST(test_paused_job_gets_no_lease_but_takes_results),
        RIG_TEST(test_held_job_gets_no_lease_but_takes_results),
        RIG_TEST(test_cancel_revokes_and_retry_goes_on),
        RIG_TEST(test_removed_job_is_forgotten),
        RIG_TEST(test_restored_spots_are_not_leased),
        RIG_TEST(test_a_cell_that_starts_again_takes_off_what_it_took),
        RIG_TEST(test_wholly_restored_job_is_done_at_once),
        RIG_TEST(test_impossible_jobs_are_refused),
        RIG_TEST(test_leases_have_no_deadline_before_ready),
        RIG_TEST(test_draining_worker_finishes_and_says_so),
        RIG_TEST(test_full_tables_say_no),
        RIG_TEST(test_a_worker_that_joins_late_gets_work_at_once),
        RIG_TEST(test_farm_info_counts),
        RIG_TEST(test_limits_out_of_range_are_refused),
        RIG_TEST(test_every_allocation_may_fail),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
