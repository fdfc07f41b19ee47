/* How fast a count rises: from the first result on, in lumps, over pauses. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include "master/rate.h"

static void idle_time_does_not_count(void **state)
{
    (void)state;
    struct rate r = {0};
    rate_add(&r, 1000000, 77); /* late, of work that has ended */
    assert_float_equal(rate_per_s(&r, 1000000), 0, 0);
    rate_begin(&r, 2000000);
    assert_float_equal(rate_per_s(&r, 2000000), 0, 0);
    assert_float_equal(rate_per_s(&r, 2000400), 0, 0);
    rate_add(&r, 2000500, 600);
    assert_float_equal(rate_per_s(&r, 2000500), 1200, 1e-9);
    rate_begin(&r, 2000600); /* goes on */
    assert_float_equal(rate_per_s(&r, 2000600), 1200, 1e-9);
    rate_end(&r);
    assert_float_equal(rate_per_s(&r, 2000700), 0, 0);
}

/* 1,000 a second in lumps of 700 ms, then 5,000: the old rate is forgotten within two marks. */
static void lumps_and_changes(void **state)
{
    (void)state;
    struct rate r = {0};
    rate_begin(&r, 0);
    int64_t now = 0;
    for (int i = 0; i < 20; i++) {
        now += 700;
        rate_add(&r, now, 700);
        assert_float_equal(rate_per_s(&r, now), 1000, 1e-9);
        assert_float_equal(rate_per_s(&r, now + 600), 1000, 1e-9); /* between two lumps */
    }
    int64_t change = now;
    while (now - change < 3 * RATE_MARK_MS) {
        now += 700;
        rate_add(&r, now, 3500);
    }
    assert_float_equal(rate_per_s(&r, now), 5000, 1e-9);
}

/* A farm that hangs is not as fast as it was. */
static void silence_counts(void **state)
{
    (void)state;
    struct rate r = {0};
    rate_begin(&r, 0);
    rate_add(&r, 1000, 1000);
    assert_float_equal(rate_per_s(&r, 1000 + RATE_MARK_MS), 1000, 1e-9);
    assert_float_equal(rate_per_s(&r, 10000), 100, 1e-9);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(idle_time_does_not_count),
        cmocka_unit_test(lumps_and_changes),
        cmocka_unit_test(silence_counts),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
