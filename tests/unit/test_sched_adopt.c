/* Leases that a worker brings along when it joins: those that outlived a master or a connection. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include "tests/unit/sched_rig.h"

/* The rig's first epoch is 1,000: what an earlier master gave is below. */
static struct sched_held held_of(uint64_t epoch, uint32_t cell_begin, uint32_t cell_count,
                                 enum sched_held_state state)
{
    return (struct sched_held){
        .job = 1, .epoch = epoch, .unit = {cell_begin, cell_count, 0}, .state = state};
}

static struct rig_lease lease_of(uint64_t worker, const struct sched_held *h)
{
    return (struct rig_lease){.worker = worker, .job = h->job, .epoch = h->epoch, .unit = h->unit};
}

static bool join(uint64_t worker, uint32_t threads, const struct sched_held *held, size_t count)
{
    return rig_feed(&rig, &(struct sched_event){
                              .type = SCHED_WORKER_JOIN,
                              .worker = worker,
                              .join = {.threads = threads, .held = held, .held_count = count}});
}

static bool revoked(uint64_t epoch)
{
    for (uint32_t i = 0; i < rig.action_count; i++)
        if (rig.actions[i].type == SCHED_REVOKE && rig.actions[i].epoch == epoch)
            return true;
    return false;
}

static bool leased(uint32_t cell)
{
    for (uint32_t i = 0; i < rig.lease_count; i++) {
        struct unit u = rig.leases[i].unit;
        if (cell >= u.cell_begin && cell < u.cell_begin + u.cell_count)
            return true;
    }
    return false;
}

static bool add_quiet(uint32_t cells, uint32_t quiet_ms)
{
    return rig_add_with(
        &rig, 1,
        (struct sched_job_add){
            .cell_count = cells, .block_count = 1, .cell_cost = 1000.0, .quiet_ms = quiet_ms});
}

static void test_leases_outlive_the_master(void **state)
{
    (void)state;
    const struct sched_held held[] = {held_of(900, 0, 3, SCHED_HELD_RESULT),
                                      held_of(901, 3, 3, SCHED_HELD_BEGUN),
                                      held_of(902, 6, 3, SCHED_HELD_WAITING)};
    assert_true(rig_add(&rig, 1, 40, 1));
    assert_true(join(1, 1, held, 3));
    assert_int_equal(rig_count(&rig, SCHED_REVOKE), 0);
    assert_int_equal(rig_winfo(&rig, 1).leases, 3);
    assert_int_equal(rig_winfo(&rig, 1).state, SCHED_WORKER_BUSY); /* told of the job, and ready */
    for (uint32_t cell = 0; cell < 9; cell++)
        assert_false(leased(cell)); /* anew */
    for (int i = 0; i < 3; i++) {
        struct rig_lease l = lease_of(1, &held[i]);
        assert_true(rig_result(&rig, &l, 1000, 0));
        const struct sched_action *accepted = rig_find(&rig, SCHED_ACCEPT);
        assert_memory_equal(&accepted->unit, &held[i].unit, sizeof held[i].unit);
        assert_int_equal(accepted->epoch, held[i].epoch);
    }
    assert_true(rig_finish(&rig, 1000) > 0);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
    assert_int_equal(rig_info(&rig, 1).compared, 0);
    assert_int_equal(rig_info(&rig, 1).retried, 0);
}

static void test_a_job_that_goes_on_waits_for_its_workers(void **state)
{
    (void)state;
    const struct sched_held held = held_of(900, 0, 3, SCHED_HELD_BEGUN);
    assert_true(add_quiet(40, 600));
    assert_true(join(1, 1, NULL, 0)); /* has nothing, and gets nothing yet */
    assert_int_equal(rig_held(&rig, 1), 0);
    rig_wait(&rig, 400);
    assert_int_equal(rig_held(&rig, 1), 0);
    assert_true(join(2, 1, &held, 1));
    assert_int_equal(rig_winfo(&rig, 2).leases, 1);
    rig_wait(&rig, 300);
    assert_true(rig_held(&rig, 1) > 0);
    assert_false(leased(0));
}

static void test_what_others_have_not_begun_comes_back(void **state)
{
    (void)state;
    rig.auto_ready = false;
    assert_true(rig_add(&rig, 1, 4, 1));
    assert_true(join(1, 1, NULL, 0)); /* holds cells 0, 1 and 2, one each, and loads the scene */
    assert_int_equal(rig_held(&rig, 1), 3);
    const struct sched_held held[] = {held_of(900, 1, 2, SCHED_HELD_BEGUN),
                                      held_of(901, 0, 1, SCHED_HELD_WAITING)};
    uint64_t taken[] = {rig_lease_of(&rig, 1, 1).epoch, rig_lease_of(&rig, 1, 2).epoch};
    assert_true(join(2, 1, held, 2));
    assert_true(revoked(taken[0]) && revoked(taken[1]));
    /* Neither has begun cell 0: it stays where it is. */
    assert_true(revoked(901) && !revoked(900));
}

static void test_what_others_have_begun_is_rendered_once_more_at_most(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 40, 1));
    assert_true(join(1, 1, NULL, 0));
    struct rig_lease begun = rig_lease_of(&rig, 1, 0);
    struct sched_held same = held_of(900, 0, begun.unit.cell_count, SCHED_HELD_BEGUN);
    assert_true(join(2, 1, &same, 1)); /* the same unit: whoever is first */
    assert_false(revoked(900));
    struct rig_lease l = lease_of(2, &same);
    assert_true(rig_result(&rig, &l, 1000, 0));
    assert_true(revoked(begun.epoch));

    struct rig_lease next = rig_lease_of(&rig, 1, 0);
    struct sched_held part =
        held_of(901, next.unit.cell_begin, next.unit.cell_count - 1, SCHED_HELD_BEGUN);
    assert_true(part.unit.cell_count > 0);
    assert_true(join(3, 1, &part, 1)); /* cut otherwise: no use */
    assert_true(revoked(901));
}

static void test_what_is_done_is_not_wanted(void **state)
{
    (void)state;
    const struct sched_done done = {
        .cell_begin = 0, .cell_count = 4, .block_begin = 0, .block_end = 1};
    assert_true(rig_add_with(&rig, 1,
                             (struct sched_job_add){.cell_count = 40,
                                                    .block_count = 1,
                                                    .cell_cost = 1000.0,
                                                    .done = &done,
                                                    .done_count = 1}));
    const struct sched_held held[] = {held_of(900, 0, 2, SCHED_HELD_RESULT),
                                      held_of(901, 2, 2, SCHED_HELD_BEGUN),
                                      held_of(902, 2, 4, SCHED_HELD_BEGUN)};
    assert_true(join(1, 1, held, 3));
    /* A result comes anyway, and is compared; of the last, half is of use. */
    assert_true(!revoked(900) && revoked(901) && !revoked(902));
    struct rig_lease l = lease_of(1, &held[0]);
    assert_true(rig_result(&rig, &l, 1000, 0));
    assert_int_equal(rig_count(&rig, SCHED_COMPARE), 1);
    l = lease_of(1, &held[2]);
    assert_true(rig_result(&rig, &l, 1000, 0));
    assert_int_equal(rig_find(&rig, SCHED_ACCEPT)->unit.cell_begin, 4);
}

static void test_a_worker_comes_back_with_the_unit_it_was_lost_with(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 40, 1));
    assert_true(join(1, 1, NULL, 0));
    struct rig_lease l = rig_lease_of(&rig, 1, 0);
    assert_true(rig_worker(&rig, SCHED_WORKER_LOST, 1));
    assert_int_equal(rig_count(&rig, SCHED_UNIT_LOST), 1);
    const struct sched_held held = {1, l.epoch, l.unit, SCHED_HELD_BEGUN};
    assert_true(join(1, 1, &held, 1));
    assert_false(leased(l.unit.cell_begin));
    assert_true(rig_result(&rig, &l, 1000, 0));
    assert_int_equal(rig_find(&rig, SCHED_ACCEPT)->unit.cell_count, l.unit.cell_count);
}

static void test_a_check_goes_on(void **state)
{
    (void)state;
    const struct unit unit = {3, 4, 0};
    const struct sched_done done = {
        .cell_begin = 0, .cell_count = 20, .block_begin = 0, .block_end = 1};
    const struct sched_open_check check = {unit, 7, rig_digest(1, unit)};
    assert_true(rig_add_with(&rig, 1,
                             (struct sched_job_add){.cell_count = 20,
                                                    .block_count = 1,
                                                    .cell_cost = 1000.0,
                                                    .done = &done,
                                                    .done_count = 1,
                                                    .checks = &check,
                                                    .check_count = 1}));
    const struct sched_held held = held_of(900, 3, 4, SCHED_HELD_BEGUN);
    assert_true(join(7, 1, &held, 1)); /* has voted: its own bits prove nothing */
    assert_true(revoked(900));
    assert_true(join(8, 1, &held, 1));
    assert_false(revoked(900));
    assert_int_equal(rig.lease_count, 0); /* not asked of anybody else */
    struct rig_lease l = lease_of(8, &held);
    assert_true(rig_result(&rig, &l, 1000, 0));
    assert_int_equal(rig_count(&rig, SCHED_CHECK_CLOSED), 1);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
}

static void test_nothing_false_is_believed(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 40, 1));
    const struct sched_held held[] = {
        held_of(0, 0, 1, SCHED_HELD_BEGUN),                     /* no epoch */
        held_of(1000, 1, 1, SCHED_HELD_BEGUN),                  /* one that was never given */
        held_of(900, 39, 2, SCHED_HELD_BEGUN),                  /* beyond the job */
        held_of(901, 0, 0, SCHED_HELD_BEGUN),                   /* no unit */
        {1, 902, {0, 1, 1}, SCHED_HELD_BEGUN},                  /* no such block */
        {2, 903, {0, 1, 0}, SCHED_HELD_BEGUN},                  /* no such job */
        held_of(904, 30, 2, SCHED_HELD_BEGUN),                  /* good */
        held_of(904, 32, 2, SCHED_HELD_BEGUN),                  /* twice the same epoch */
        held_of(905, 30, 2, SCHED_HELD_BEGUN),                  /* twice the same unit */
        held_of(906, UINT32_MAX, UINT32_MAX, SCHED_HELD_BEGUN), /* overflows */
    };
    const size_t count = sizeof held / sizeof *held;
    assert_true(join(1, 4, held, count));
    for (size_t i = 0; i < count; i++)
        assert_int_equal(revoked(held[i].epoch), held[i].epoch != 904);
    (void)rig_finish(&rig, 1000);
    struct rig_lease l = lease_of(1, &held[6]);
    assert_true(rig_result(&rig, &l, 1000, 0));
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
}

static void test_a_liar_brings_nothing(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 40, 1));
    assert_true(rig_feed(
        &rig,
        &(struct sched_event){.type = SCHED_WORKER_PAST, .worker = 5, .past = {.lied = true}}));
    const struct sched_held held = held_of(900, 0, 3, SCHED_HELD_BEGUN);
    assert_true(join(5, 1, &held, 1));
    assert_true(revoked(900));
    assert_int_equal(rig_winfo(&rig, 5).leases, 0);
}

static void test_more_than_a_worker_can_hold(void **state)
{
    (void)state;
    enum { MORE = 600 };
    static struct sched_held held[MORE];
    for (uint32_t i = 0; i < MORE; i++)
        held[i] = held_of(100 + i, i, 1, SCHED_HELD_WAITING);
    assert_true(rig_add(&rig, 1, MORE, 1));
    assert_true(join(1, 1, held, MORE));
    assert_int_equal(rig_winfo(&rig, 1).leases, 256);
}

/* --- A connection that breaks while the master lives -------------------------------------------
 */

/* Joins again with all of its leases that are out: the first `begun` of them begun. */
static bool come_back(uint64_t worker, uint32_t threads, uint32_t begun)
{
    struct sched_held held[16];
    uint32_t count = rig_held(&rig, worker);
    assert_true(count <= 16);
    for (uint32_t i = 0; i < count; i++) {
        struct rig_lease l = rig_lease_of(&rig, worker, i);
        held[i] = (struct sched_held){l.job, l.epoch, l.unit,
                                      i < begun ? SCHED_HELD_BEGUN : SCHED_HELD_WAITING};
    }
    return join(worker, threads, held, count);
}

static void test_back_in_time_nothing_is_lost(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 40, 1));
    assert_true(join(1, 1, NULL, 0));
    uint32_t held = rig_held(&rig, 1);
    struct rig_lease first = rig_lease_of(&rig, 1, 0);
    assert_true(rig_worker(&rig, SCHED_WORKER_AWAY, 1));
    assert_false(rig_worker(&rig, SCHED_WORKER_AWAY, 1));
    rig_wait(&rig, 500);
    assert_int_equal(rig_winfo(&rig, 1).leases, held);
    assert_true(come_back(1, 1, 1));
    assert_int_equal(rig_count(&rig, SCHED_OPEN_JOB), 1); /* told again */
    assert_int_equal(rig_count(&rig, SCHED_REVOKE), 0);
    assert_int_equal(rig_count(&rig, SCHED_WORKER_NEWS), 0);
    assert_int_equal(rig_lease_of(&rig, 1, 0).epoch, first.epoch);
    rig_wait(&rig, 2000); /* the end of its absence is forgotten */
    assert_int_equal(rig_winfo(&rig, 1).state, SCHED_WORKER_BUSY);
    assert_true(rig_finish(&rig, 1000) > 0);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
    assert_int_equal(rig_info(&rig, 1).retried, 0);
    assert_int_equal(rig_info(&rig, 1).compared, 0);
    assert_int_equal(rig_winfo(&rig, 1).lost, 0);
}

/* The same process is back before its old connection is known to be dead. */
static void test_back_before_it_was_missed(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 40, 1));
    assert_true(join(1, 2, NULL, 0));
    uint64_t epoch = rig_lease_of(&rig, 1, 0).epoch;
    assert_true(come_back(1, 2, 2));
    assert_int_equal(rig_count(&rig, SCHED_REVOKE), 0);
    assert_int_equal(rig_lease_of(&rig, 1, 0).epoch, epoch);
    assert_true(rig_finish(&rig, 1000) > 0);
    assert_int_equal(rig_info(&rig, 1).retried, 0);
    assert_int_equal(rig_winfo(&rig, 1).lost, 0);
}

static void test_what_was_lost_on_the_way_is_nobodys_fault(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 40, 1));
    assert_true(join(1, 1, NULL, 0));
    assert_int_equal(rig_held(&rig, 1), 3);
    struct rig_lease kept = rig_lease_of(&rig, 1, 1), lost = rig_lease_of(&rig, 1, 0);
    assert_true(rig_worker(&rig, SCHED_WORKER_AWAY, 1));
    const struct sched_held held = {1, kept.epoch, kept.unit, SCHED_HELD_BEGUN};
    assert_true(join(1, 1, &held, 1));
    assert_int_equal(rig_count(&rig, SCHED_UNIT_LOST), 0);
    assert_false(revoked(kept.epoch));
    assert_true(leased(lost.unit.cell_begin)); /* anew */
    assert_true(rig_finish(&rig, 1000) > 0);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
    assert_int_equal(rig_info(&rig, 1).retried, 2);
    assert_int_equal(rig_info(&rig, 1).compared, 0);
}

/* Whoever renders what may kill it holds nothing else, whatever it brings along: here a unit that
 * it was to give back, but the message was lost with the connection. */
static void test_alone_it_takes_up_nothing(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 1, 2));
    for (uint64_t worker = 1; worker <= 2; worker++) {
        assert_true(join(worker, 1, NULL, 0));
        assert_int_equal(rig_lease_of(&rig, worker, 0).unit.block, 0);
        assert_true(rig_worker(&rig, SCHED_WORKER_LOST, worker));
    }
    assert_true(join(3, 1, NULL, 0));
    assert_int_equal(rig_held(&rig, 3), 1);
    struct rig_lease alone = rig_lease_of(&rig, 3, 0);
    assert_int_equal(alone.unit.block, 0);
    const struct sched_held held[] = {
        {1, alone.epoch, alone.unit, SCHED_HELD_BEGUN},
        {1, 900, {0, 1, 1}, SCHED_HELD_WAITING},
    };
    assert_true(rig_worker(&rig, SCHED_WORKER_AWAY, 3));
    assert_true(join(3, 1, held, 2)); /* the rig checks the invariants */
    assert_int_equal(rig_held(&rig, 3), 1);
    assert_true(revoked(900));
    assert_true(rig_finish(&rig, 1000) > 0);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
}

static void test_who_stays_away_is_lost(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 40, 1));
    assert_true(join(1, 1, NULL, 0));
    assert_true(rig_worker(&rig, SCHED_WORKER_AWAY, 1));
    rig_wait(&rig, 599);
    assert_int_equal(rig_count(&rig, SCHED_UNIT_LOST), 0);
    rig_wait(&rig, 1);
    assert_int_equal(rig_count(&rig, SCHED_UNIT_LOST), 1);
    assert_int_equal(rig_find(&rig, SCHED_WORKER_NEWS)->state, SCHED_WORKER_GONE);
    assert_int_equal(rig_find(&rig, SCHED_WORKER_NEWS)->losses, 3);
    assert_int_equal(rig_winfo(&rig, 1).state, SCHED_WORKER_GONE);
    assert_int_equal(rig_winfo(&rig, 1).leases, 0);
}

static void test_the_absent_get_nothing_and_the_idle_copy_them(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 6, 1));
    assert_true(join(1, 1, NULL, 0));
    assert_true(join(2, 1, NULL, 0));
    assert_int_equal(rig_held(&rig, 1), 3);
    assert_int_equal(rig_held(&rig, 2), 3);
    assert_true(rig_worker(&rig, SCHED_WORKER_AWAY, 1));
    assert_true(rig_add(&rig, 2, 10, 1));
    assert_int_equal(rig_held(&rig, 1), 3);
    while (rig_held(&rig, 2) > 0) { /* its own, then copies */
        struct rig_lease l = rig_lease_of(&rig, 2, 0);
        assert_true(rig_result(&rig, &l, 1000, 0));
    }
    assert_int_equal(rig_info(&rig, 2).state, SCHED_DONE);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
    assert_int_equal(rig_info(&rig, 1).speculated, 3);
    assert_int_equal(rig_info(&rig, 1).retried, 0);
    assert_int_equal(rig_count(&rig, SCHED_REVOKE), 0); /* nobody is there to hear it */
}

/* A worker that comes back for ever and delivers nothing loses its units when their time is up. */
static void test_coming_back_does_not_lengthen_a_lease(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 400, 1));
    assert_true(join(1, 1, NULL, 0));
    for (int i = 0; i < 3; i++) {
        struct rig_lease l = rig_lease_of(&rig, 1, 0);
        assert_true(rig_result(&rig, &l, 1000, 0)); /* its cost is known now */
    }
    uint64_t since_ms = rig.now_ms;
    while (rig_winfo(&rig, 1).timeouts == 0 && rig.now_ms < since_ms + 60000) {
        assert_true(rig_worker(&rig, SCHED_WORKER_AWAY, 1));
        rig_wait(&rig, 400);
        assert_true(come_back(1, 1, 1));
    }
    assert_int_equal(rig_winfo(&rig, 1).timeouts, 1);
    assert_true(rig.now_ms - since_ms <= 20000 + 400);
    assert_int_equal(rig_winfo(&rig, 1).state, SCHED_WORKER_BUSY);
}

/* Nor does it give more time to load a scene. */
static void test_coming_back_does_not_lengthen_loading(void **state)
{
    (void)state;
    rig.auto_ready = false;
    assert_true(rig_add(&rig, 1, 40, 1));
    assert_true(join(1, 1, NULL, 0));
    uint64_t since_ms = rig.now_ms;
    while (rig_winfo(&rig, 1).leases > 0 && rig.now_ms < since_ms + 700000) {
        assert_true(rig_worker(&rig, SCHED_WORKER_AWAY, 1));
        rig_wait(&rig, 500);
        assert_true(come_back(1, 1, 0));
    }
    assert_true(rig.now_ms - since_ms <= 600000 + 500);
}

static void test_fewer_threads_than_before(void **state)
{
    (void)state;
    assert_true(rig_add(&rig, 1, 40, 1));
    assert_true(join(1, 4, NULL, 0));
    assert_true(rig_worker(&rig, SCHED_WORKER_AWAY, 1));
    assert_true(come_back(1, 1, 4));
    assert_true(rig_finish(&rig, 1000) > 0);
    assert_int_equal(rig_info(&rig, 1).state, SCHED_DONE);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        RIG_TEST(test_leases_outlive_the_master),
        RIG_TEST(test_a_job_that_goes_on_waits_for_its_workers),
        RIG_TEST(test_what_others_have_not_begun_comes_back),
        RIG_TEST(test_what_others_have_begun_is_rendered_once_more_at_most),
        RIG_TEST(test_what_is_done_is_not_wanted),
        RIG_TEST(test_a_worker_comes_back_with_the_unit_it_was_lost_with),
        RIG_TEST(test_a_check_goes_on),
        RIG_TEST(test_nothing_false_is_believed),
        RIG_TEST(test_a_liar_brings_nothing),
        RIG_TEST(test_more_than_a_worker_can_hold),
        RIG_TEST(test_back_in_time_nothing_is_lost),
        RIG_TEST(test_back_before_it_was_missed),
        RIG_TEST(test_what_was_lost_on_the_way_is_nobodys_fault),
        RIG_TEST(test_alone_it_takes_up_nothing),
        RIG_TEST(test_who_stays_away_is_lost),
        RIG_TEST(test_the_absent_get_nothing_and_the_idle_copy_them),
        RIG_TEST(test_coming_back_does_not_lengthen_a_lease),
        RIG_TEST(test_coming_back_does_not_lengthen_loading),
        RIG_TEST(test_fewer_threads_than_before),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
