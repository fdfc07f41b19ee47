/* The scheduler after a restart of the master: blame, open checks and workers' past are kept. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include "tests/unit/sched_rig.h"

static const struct unit UNIT = {.cell_begin = 3, .cell_count = 4, .block = 0};

static bool add_blamed(const struct sched_blame *blame, size_t count)
{
    return rig_add_with(&rig, 1,
                        (struct sched_job_add){.cell_count = 20,
                                               .block_count = 1,
                                               .cell_cost = 1000.0,
                                               .blame = blame,
                                               .blame_count = count});
}

static bool lose(uint64_t worker)
{
    return rig_worker(&rig, SCHED_WORKER_LOST, worker);
}

static void test_blame_is_kept(void **state)
{
    (void)state;
    const struct sched_blame blame[] = {{UNIT, 7, false}, {UNIT, 8, false}, {UNIT, 9, true}};
    assert_true(add_blamed(blame, 3));
    assert_true(rig_join(&rig, 1, 4));
    /* It lost two workers: leased alone, whole, and first. */
    assert_int_equal(rig_held(&rig, 1), 1);
    struct rig_lease l = rig_lease_of(&rig, 1, 0);
    assert_memory_equal(&l.unit, &UNIT, sizeof UNIT);
    /* Two losses alone are left to it. */
    assert_true(lose(1));
    assert_int_equal(rig_info(&rig, 1).state, SCHED_ACTIVE);
    assert_true(rig_join(&rig, 2, 4));
    assert_int_equal(rig_held(&rig, 2), 1);
    assert_true(lose(2));
    const struct sched_action *failed = rig_find(&rig, SCHED_JOB_FAILED);
    assert_non_null(failed);
    assert_int_equal(failed->why, SCHED_WHY_UNIT_KILLS);
    assert_memory_equal(&failed->unit, &UNIT, sizeof UNIT);
}

static void test_a_failure_that_was_not_written_down(void **state)
{
    (void)state;
    struct sched_blame blame[5];
    for (int i = 0; i < 5; i++)
        blame[i] = (struct sched_blame){UNIT, (uint64_t)i + 1, i >= 2};
    assert_true(add_blamed(blame, 5));
    assert_int_equal(rig_info(&rig, 1).state, SCHED_FAILED);
}

static void test_blame_of_what_is_done_or_no_unit_is_ignored(void **state)
{
    (void)state;
    const struct sched_done done = {
        .cell_begin = 5, .cell_count = 1, .block_begin = 0, .block_end = 1};
    const struct sched_blame blame[] = {
        {UNIT, 7, true}, {{.cell_begin = 19, .cell_count = 2}, 7, true}, {{0}, 7, true}};
    assert_true(rig_add_with(&rig, 1,
                             (struct sched_job_add){.cell_count = 20,
                                                    .block_count = 1,
                                                    .cell_cost = 1000.0,
                                                    .done = &done,
                                                    .done_count = 1,
                                                    .blame = blame,
                                                    .blame_count = 3}));
    assert_true(rig_join(&rig, 1, 1));
    assert_true(rig_finish(&rig, 1000) > 0);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
    assert_int_equal(rig_info(&rig, 1).retried, 0);
}

static void add_checked(uint64_t digest)
{
    const struct sched_done done = {
        .cell_begin = 0, .cell_count = 20, .block_begin = 0, .block_end = 1};
    const struct sched_open_check checks[] = {
        {UNIT, 7, digest}, {{.cell_begin = 19, .cell_count = 2}, 7, 1}, {UNIT, 0, digest}};
    assert_true(rig_add_with(&rig, 1,
                             (struct sched_job_add){.cell_count = 20,
                                                    .block_count = 1,
                                                    .cell_cost = 1000.0,
                                                    .done = &done,
                                                    .done_count = 1,
                                                    .checks = checks,
                                                    .check_count = 3}));
    assert_int_equal(rig_info(&rig, 1).checks_open, 1);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_ACTIVE);
}

static void test_open_check_is_kept(void **state)
{
    (void)state;
    add_checked(rig_digest(1, UNIT));
    assert_true(rig_join(&rig, 7, 1)); /* has voted */
    assert_int_equal(rig_held(&rig, 7), 0);
    assert_true(rig_join(&rig, 8, 1));
    struct rig_lease l = rig_lease_of(&rig, 8, 0);
    assert_int_equal(l.kind, SCHED_KIND_CHECK);
    assert_true(rig_result(&rig, &l, 1000, 0));
    assert_int_equal(rig_count(&rig, SCHED_CHECK_CLOSED), 1);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
    assert_int_equal(rig_info(&rig, 1).verified, 1);
}

static void test_a_lie_of_an_earlier_life_is_found(void **state)
{
    (void)state;
    add_checked(rig_digest(1, UNIT) + 1);
    assert_true(rig_join(&rig, 8, 1));
    assert_true(rig_join(&rig, 9, 1));
    for (uint64_t w = 8; w <= 9; w++) {
        struct rig_lease l = rig_lease_of(&rig, w, 0);
        assert_true(rig_result(&rig, &l, 1000, 0));
    }
    const struct sched_action *liar = rig_find(&rig, SCHED_LIAR);
    assert_non_null(liar);
    assert_int_equal(liar->worker, 7);
    assert_true(liar->accepted);
    /* It is kept out when it comes back: the caller has it in its books. */
    assert_true(rig_feed(&rig, &(struct sched_event){.type = SCHED_LIAR_SETTLED}));
}

static void test_a_check_is_told_before_its_result(void **state)
{
    (void)state;
    assert_true(rig_add_with(
        &rig, 1,
        (struct sched_job_add){
            .cell_count = 20, .block_count = 1, .cell_cost = 1000.0, .verify_share = 1.0}));
    assert_true(rig_join(&rig, 1, 1));
    struct rig_lease l = rig_lease_of(&rig, 1, 0);
    assert_true(rig_result(&rig, &l, 1000, 0));
    const struct sched_action *opened = rig_find(&rig, SCHED_CHECK_OPENED);
    const struct sched_action *accepted = rig_find(&rig, SCHED_ACCEPT);
    assert_non_null(opened);
    assert_non_null(accepted);
    assert_true(opened < accepted);
    assert_memory_equal(&opened->unit, &l.unit, sizeof l.unit);
}

static bool past(uint64_t worker, struct sched_past p)
{
    return rig_feed(&rig,
                    &(struct sched_event){.type = SCHED_WORKER_PAST, .worker = worker, .past = p});
}

static void test_a_liar_stays_out(void **state)
{
    (void)state;
    assert_true(past(5, (struct sched_past){.lied = true}));
    assert_true(rig_add(&rig, 1, 20, 1));
    assert_true(rig_join(&rig, 5, 2));
    assert_int_equal(rig_held(&rig, 5), 0);
    assert_int_equal(rig_winfo(&rig, 5).state, SCHED_WORKER_QUARANTINED);
    assert_false(past(5, (struct sched_past){0})); /* known: not told again */
}

static void test_a_pause_goes_on_and_the_next_is_longer(void **state)
{
    (void)state;
    assert_true(past(5, (struct sched_past){.pauses = 3, .until_ms = rig.now_ms + 5000}));
    assert_true(rig_add(&rig, 1, 20, 1));
    assert_true(rig_join(&rig, 5, 1));
    assert_int_equal(rig_winfo(&rig, 5).state, SCHED_WORKER_SET_ASIDE);
    assert_int_equal(rig_winfo(&rig, 5).pauses, 3);
    rig_wait(&rig, 4000);
    assert_int_equal(rig_held(&rig, 5), 0);
    rig_wait(&rig, 1100);
    assert_true(rig_held(&rig, 5) > 0);
}

/* Written down before somebody set the clock back by a day. */
static void test_no_pause_outlasts_the_longest(void **state)
{
    (void)state;
    assert_true(past(5, (struct sched_past){.pauses = 1, .until_ms = rig.now_ms + 86400000}));
    assert_true(rig_add(&rig, 1, 20, 1));
    assert_true(rig_join(&rig, 5, 1));
    rig_wait(&rig, 119000);
    assert_int_equal(rig_held(&rig, 5), 0);
    rig_wait(&rig, 2000);
    assert_true(rig_held(&rig, 5) > 0);
}

/* Simulation, seed 1001613: a unit that may only be rendered alone was leased to a worker that
 * hung, whose patience had doubled for every loss. */
static void test_a_unit_alone_does_not_wait_for_a_hung_worker(void **state)
{
    (void)state;
    const struct sched_blame blame[] = {{UNIT, 7, false}, {UNIT, 8, false}};
    assert_true(add_blamed(blame, 2));
    assert_true(rig_join(&rig, 1, 2)); /* takes it alone, and hangs */
    assert_true(rig_join(&rig, 2, 1));
    uint64_t start_ms = rig.now_ms;
    while (rig_info(&rig, 1).state != SCHED_DONE && rig.now_ms - start_ms < 60000) {
        rig_wait(&rig, 100);
        while (rig_held(&rig, 2) > 0) {
            struct rig_lease l = rig_lease_of(&rig, 2, 0);
            assert_true(rig_result(&rig, &l, 1000 * (uint64_t)l.unit.cell_count, 0));
        }
    }
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
    assert_int_equal(rig_winfo(&rig, 1).timeouts, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        RIG_TEST(test_blame_is_kept),
        RIG_TEST(test_a_failure_that_was_not_written_down),
        RIG_TEST(test_blame_of_what_is_done_or_no_unit_is_ignored),
        RIG_TEST(test_open_check_is_kept),
        RIG_TEST(test_a_lie_of_an_earlier_life_is_found),
        RIG_TEST(test_a_check_is_told_before_its_result),
        RIG_TEST(test_a_liar_stays_out),
        RIG_TEST(test_a_pause_goes_on_and_the_next_is_longer),
        RIG_TEST(test_no_pause_outlasts_the_longest),
        RIG_TEST(test_a_unit_alone_does_not_wait_for_a_hung_worker),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
