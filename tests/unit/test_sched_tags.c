/* Jobs that ask for tags: only workers that have all of them render them, whatever happens. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include "tests/unit/sched_rig.h"

enum { BIG = 1, FAST = 2 };

static bool join(uint64_t worker, uint32_t threads, uint64_t tags)
{
    return rig_feed(&rig, &(struct sched_event){.type = SCHED_WORKER_JOIN,
                                                .worker = worker,
                                                .join = {.threads = threads, .tags = tags}});
}

static bool add(uint64_t job, uint32_t cells, uint64_t tags)
{
    return rig_add_with(
        &rig, job, (struct sched_job_add){.cell_count = cells, .block_count = 2, .tags = tags});
}

static void test_only_who_has_all_of_them(void **state)
{
    (void)state;
    assert_true(join(1, 2, 0));
    assert_true(join(2, 2, BIG));
    assert_true(add(1, 400, BIG | FAST));
    assert_int_equal(rig.lease_count, 0);
    assert_int_equal(rig_info(&rig, 1).wait, SCHED_WAIT_WORKER);
    assert_true(join(3, 2, BIG | FAST | 8));
    assert_true(rig_held(&rig, 3) > 0);
    assert_int_equal(rig_info(&rig, 1).wait, SCHED_WAIT_NOTHING);
    /* The others are free for whoever asks for less. */
    assert_true(add(2, 400, BIG));
    assert_int_equal(rig_held(&rig, 1), 0);
    assert_true(rig_held(&rig, 2) > 0);
    assert_true(add(3, 400, 0));
    assert_true(rig_held(&rig, 1) > 0);
    (void)rig_finish(&rig, 1000);
    for (uint64_t job = 1; job <= 3; job++)
        assert_int_equal(rig_info(&rig, job).state, SCHED_DONE);
}

/* Units are cut for the threads that may take them, not for all of the farm's. */
static void test_threads_that_count(void **state)
{
    (void)state;
    assert_true(join(1, 1000, 0));
    assert_true(join(2, 1, FAST));
    assert_true(add(1, 400, FAST));
    uint32_t cells = rig_lease_of(&rig, 2, 0).unit.cell_count;
    assert_true(cells > 1); /* a quarter of 400 spots over 1,001 threads is none */
    /* They come and go. */
    assert_true(rig_worker(&rig, SCHED_WORKER_LOST, 2));
    assert_int_equal(rig_info(&rig, 1).wait, SCHED_WAIT_WORKER);
    assert_true(join(3, 1, FAST));
    assert_true(rig_held(&rig, 3) > 0);
}

static void test_no_copy_for_others(void **state)
{
    (void)state;
    assert_true(join(1, 1, BIG));
    assert_true(add(1, 1, BIG));
    assert_int_equal(rig_held(&rig, 1), 2);
    assert_true(join(2, 1, 0));
    rig_wait(&rig, 15000); /* long overdue: whoever may would get a copy */
    assert_int_equal(rig_held(&rig, 2), 0);
    assert_true(join(3, 1, BIG));
    rig_wait(&rig, 4000);
    assert_true(rig_held(&rig, 3) > 0);
}

/* A word gets another bit: the worker has it from then on. */
static void test_other_bits(void **state)
{
    (void)state;
    assert_true(join(1, 1, 0));
    assert_true(add(1, 40, FAST));
    assert_int_equal(rig.lease_count, 0);
    const struct sched_event retag = {.type = SCHED_WORKER_TAGS, .worker = 1, .tags = FAST};
    assert_true(rig_feed(&rig, &retag));
    assert_true(rig_held(&rig, 1) > 0);
    assert_false(rig_feed(&rig, &(struct sched_event){.type = SCHED_WORKER_TAGS, .worker = 9}));
}

/* It returns under another command line: what it brings along is not its any more. */
static void test_returns_without(void **state)
{
    (void)state;
    assert_true(join(1, 1, BIG));
    assert_true(add(1, 40, BIG));
    struct rig_lease l = rig_lease_of(&rig, 1, 0);
    struct sched_held held = {
        .job = 1, .epoch = l.epoch, .unit = l.unit, .state = SCHED_HELD_BEGUN};
    assert_true(rig_worker(&rig, SCHED_WORKER_LOST, 1));
    assert_true(
        rig_feed(&rig, &(struct sched_event){
                           .type = SCHED_WORKER_JOIN,
                           .worker = 1,
                           .join = {.threads = 1, .tags = FAST, .held = &held, .held_count = 1}}));
    assert_int_equal(rig_held(&rig, 1), 0);
    assert_int_equal(rig_count(&rig, SCHED_LEASE), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        RIG_TEST(test_only_who_has_all_of_them), RIG_TEST(test_threads_that_count),
        RIG_TEST(test_no_copy_for_others),       RIG_TEST(test_other_bits),
        RIG_TEST(test_returns_without),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
