/* Scheduler: cells with different numbers of blocks, limits that rise, and the cut of a job whose
 * time is up. The rig checks every invariant after every step. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <string.h>

#include "tests/unit/sched_rig.h"

enum { CELLS = 40, BLOCKS = 12 };

static const uint64_t weights[BLOCKS] = {2, 2, 6, 6, 2, 2, 2, 2, 4, 4, 8, 8};

/* Four workers and an open job; limits[i] = base + i % spread. */
static void start(uint16_t limits[CELLS], uint32_t base, uint32_t spread)
{
    rig_start(&rig, NULL);
    rig.auto_ready = true;
    for (uint64_t w = 1; w <= 4; w++)
        assert_true(rig_join(&rig, w, 2));
    for (uint32_t i = 0; i < CELLS; i++)
        limits[i] = (uint16_t)(base + i % spread);
    assert_true(rig_add_with(&rig, 1,
                             (struct sched_job_add){.cell_count = CELLS,
                                                    .block_count = BLOCKS,
                                                    .limits = limits,
                                                    .block_weights = weights,
                                                    .open = true}));
}

static bool set_limits(const uint16_t *limits, bool cut, bool final)
{
    return rig_feed(&rig, &(struct sched_event){
                              .type = SCHED_JOB_LIMITS, .job = 1, .limits = {limits, cut, final}});
}

static uint64_t sum(const uint16_t limits[CELLS])
{
    uint64_t total = 0;
    for (uint32_t i = 0; i < CELLS; i++)
        total += limits[i];
    return total;
}

/* An open job is rendered to its limits and stays; the last limits end it. */
static void test_rising_limits(void **state)
{
    uint16_t limits[CELLS], now[CELLS];
    (void)state;
    start(limits, 2, 1);
    (void)rig_finish(&rig, 1000);
    assert_true(rig_info(&rig, 1).spots_done == sum(limits));
    assert_int_equal(rig_info(&rig, 1).state, SCHED_ACTIVE);
    assert_int_equal(sched_waiting(rig.s, 1), 0);
    for (uint32_t round = 1; round <= 3; round++) {
        for (uint32_t i = 0; i < CELLS; i++)
            limits[i] = (uint16_t)(2 + round * (1 + i % 3));
        assert_true(set_limits(limits, false, round == 3));
        assert_true(sched_limits_get(rig.s, 1, now));
        assert_memory_equal(now, limits, sizeof now);
        (void)rig_finish(&rig, 1000);
        assert_true(rig_info(&rig, 1).spots_done == sum(limits));
    }
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
    assert_false(set_limits(limits, false, true)); /* over */
    rig_stop(&rig);
}

/* Lower limits leave what is done or leased; the cut takes back what is not begun. */
static void test_cut(void **state)
{
    uint16_t limits[CELLS], ones[CELLS], now[CELLS];
    (void)state;
    start(limits, BLOCKS, 1);
    for (uint32_t k = 0; k < 30; k++) {
        struct rig_lease l = rig_lease_of(&rig, 1 + k % 4, 0);
        assert_true(rig_result(&rig, &l, 100000, 0));
    }
    uint64_t done = rig_info(&rig, 1).spots_done;
    for (uint32_t i = 0; i < CELLS; i++)
        ones[i] = 1;
    assert_true(set_limits(ones, true, false));
    assert_true(rig_count(&rig, SCHED_REVOKE) > 0);
    struct sched_job_info info = rig_info(&rig, 1);
    assert_true(info.spots_done == done);
    for (uint64_t w = 1; w <= 4; w++)
        assert_true(rig_held(&rig, w) <= 2 + 2); /* begun, and new ones below the limits */
    assert_true(sched_limits_get(rig.s, 1, now));
    assert_true(sum(now) < sum(limits));
    assert_true(set_limits(NULL, false, true));
    (void)rig_finish(&rig, 1000);
    info = rig_info(&rig, 1);
    assert_true(info.spots == sum(now) && info.spots_done == info.spots);
    assert_int_equal(info.state, SCHED_DONE);
    rig_stop(&rig);
}

/* What is done is taken up again with the limits, whichever come later. */
static void test_restored(void **state)
{
    uint16_t limits[CELLS];
    (void)state;
    rig_start(&rig, NULL);
    rig.auto_ready = true;
    for (uint32_t i = 0; i < CELLS; i++)
        limits[i] = (uint16_t)(3 + i % 5);
    const struct sched_done done[] = {{0, CELLS, 0, 3}, {5, 10, 3, BLOCKS}};
    assert_true(rig_add_with(&rig, 1,
                             (struct sched_job_add){.cell_count = CELLS,
                                                    .block_count = BLOCKS,
                                                    .limits = limits,
                                                    .done = done,
                                                    .done_count = 2}));
    uint64_t expected = 0;
    for (uint32_t i = 0; i < CELLS; i++)
        expected += i >= 5 && i < 15 ? limits[i] : 3;
    assert_true(rig_info(&rig, 1).spots_done == expected);
    assert_true(rig_join(&rig, 1, 4));
    (void)rig_finish(&rig, 1000);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
    rig_stop(&rig);
}

/* Workers are lost, cells are reset and limits change, in any order: every invariant holds, and in
 * the end every spot is done once. */
static void test_trouble(void **state)
{
    uint16_t limits[CELLS];
    (void)state;
    for (uint32_t seed = 1; seed <= 60; seed++) {
        uint32_t x = seed * 2654435761u;
        start(limits, 1, 3);
        for (uint32_t k = 0; k < 60; k++) {
            x = x * 1664525u + 1013904223u;
            uint32_t choice = x >> 28, cell = (x >> 8) % CELLS, w = 1 + (x >> 20) % 4;
            if (choice < 9) {
                if (rig_held(&rig, w) > 0) {
                    struct rig_lease l = rig_lease_of(&rig, w, 0);
                    (void)rig_result(&rig, &l, 1000 + x % 5000, 0);
                }
            } else if (choice < 11) {
                (void)rig_worker(&rig, SCHED_WORKER_LOST, w);
                rig_wait(&rig, 200);
                assert_true(rig_join(&rig, w, 2));
            } else if (choice < 12) {
                (void)rig_feed(&rig, &(struct sched_event){.type = SCHED_CELLS_RESET,
                                                           .job = 1,
                                                           .unit = {cell, 1, x % 2}});
            } else {
                limits[cell] = (uint16_t)(1 + x % BLOCKS);
                assert_true(set_limits(limits, choice == 15, false));
                assert_true(sched_limits_get(rig.s, 1, limits));
            }
        }
        assert_true(set_limits(NULL, false, true));
        for (int i = 0; i < 50 && rig_info(&rig, 1).state != SCHED_DONE; i++) {
            rig_wait(&rig, 10000);
            (void)rig_finish(&rig, 1000);
        }
        assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
        assert_true(rig_info(&rig, 1).spots_done == sum(limits));
        rig_stop(&rig);
    }
}

/* Times are by weight: what took a second for weight 2 is expected to take four for weight 8. */
static void test_weights(void **state)
{
    uint16_t limits[CELLS];
    (void)state;
    start(limits, 2, 1);
    (void)rig_finish(&rig, 1000000);
    for (uint32_t i = 0; i < CELLS; i++)
        limits[i] = BLOCKS;
    assert_true(set_limits(limits, false, true));
    double left_s = sched_left_seconds(rig.s, 1), weight = 6 + 6 + 2 * 4 + 4 * 2 + 8 * 2;
    assert_true(left_s > 0.99 * CELLS * weight / 2 && left_s < 1.01 * CELLS * weight / 2);
    rig_stop(&rig);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_rising_limits), cmocka_unit_test(test_cut),
        cmocka_unit_test(test_restored),      cmocka_unit_test(test_trouble),
        cmocka_unit_test(test_weights),
    };
    return cmocka_run_group_tests_name("sched_limits", tests, NULL, NULL);
}
