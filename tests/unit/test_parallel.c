/* parallel_for: every turn once, and a turn may wait for all before it. */
#include <setjmp.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "common/parallel.h"

enum { TURNS = 1000 };

struct tally {
    atomic_int met[TURNS];
    atomic_size_t over; /* turns, in their order */
};

static void count_turn(void *arg, size_t i)
{
    struct tally *t = arg;
    atomic_fetch_add(&t->met[i], 1);
}

static void wait_turn(void *arg, size_t i)
{
    struct tally *t = arg;
    while (atomic_load(&t->over) < i)
        continue;
    atomic_fetch_add(&t->met[i], 1);
    atomic_store(&t->over, i + 1);
}

static void check(size_t count, void (*turn)(void *arg, size_t i))
{
    static struct tally t;
    atomic_store(&t.over, 0);
    for (size_t i = 0; i < TURNS; i++)
        atomic_store(&t.met[i], 0);
    parallel_for(count, turn, &t);
    for (size_t i = 0; i < TURNS; i++)
        assert_int_equal(atomic_load(&t.met[i]), i < count ? 1 : 0);
}

static void test_each_once(void **state)
{
    (void)state;
    const size_t counts[] = {0, 1, 2, 3, PARALLEL_THREADS_MAX, TURNS};
    for (size_t i = 0; i < sizeof counts / sizeof *counts; i++)
        check(counts[i], count_turn);
}

static void test_turns_wait_for_those_before(void **state)
{
    (void)state;
    for (int run = 0; run < 20; run++)
        check(100, wait_turn);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_each_once),
        cmocka_unit_test(test_turns_wait_for_those_before),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
