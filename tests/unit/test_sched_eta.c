/* eta.h: the truth lies inside its interval in about 80 % of checks at 25, 50 and 75 %. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include "master/sched/eta.h"

#include <math.h>
#include <stdio.h>

static uint64_t rng_state;

static double uniform(void)
{
    uint64_t x = rng_state += UINT64_C(0x9E3779B97F4A7C15);
    x = (x ^ (x >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    x = (x ^ (x >> 27)) * UINT64_C(0x94D049BB133111EB);
    return ((double)((x ^ (x >> 31)) >> 11) + 0.5) * 0x1p-53;
}

static double normal(void)
{
    return sqrt(-2.0 * log(uniform())) * cos(6.283185307179586 * uniform());
}

enum { UNITS = 400, THREADS = 6, RENDERS = 1000, CHECKS = 3 };

struct render {
    double cost_s[UNITS], start_s[UNITS], end_s[UNITS], total_s;
};

/* Threads take units of drawn cost in order, as soon as they are free. */
static void render_draw(struct render *r, double sigma)
{
    double free_s[THREADS] = {0};
    r->total_s = 0.0;
    for (int u = 0; u < UNITS; u++) {
        int t = 0;
        for (int i = 1; i < THREADS; i++)
            t = free_s[i] < free_s[t] ? i : t;
        r->cost_s[u] = 0.4 * exp(sigma * normal());
        r->start_s[u] = free_s[t];
        r->end_s[u] = free_s[t] += r->cost_s[u];
        r->total_s = free_s[t] > r->total_s ? free_s[t] : r->total_s;
    }
}

/* What the scheduler knows when `share` of the units are done, and the truth. */
static double render_look(const struct render *r, double share, struct eta *e)
{
    *e = (struct eta){.threads = THREADS};
    double now_s = r->end_s[(int)(share * UNITS)];
    int open = 0;
    for (int u = 0; u < UNITS; u++) {
        if (r->end_s[u] <= now_s) {
            eta_spread_add(&e->spread, r->cost_s[u]);
        } else if (r->start_s[u] < now_s) {
            open++;
        }
    }
    e->unknown_units = UNITS - e->spread.count;
    e->unknown_s = e->spread.mean * (double)e->unknown_units;
    e->longest_open_s = open ? e->spread.mean : 0.0;
    e->elapsed_s = now_s;
    return r->total_s - now_s;
}

static double coverage(double sigma, double share)
{
    int inside = 0;
    static struct render r;
    for (int i = 0; i < RENDERS; i++) {
        render_draw(&r, sigma);
        struct eta e;
        double low_s, high_s, truth_s = render_look(&r, share, &e);
        assert_true(eta_left(&e, &low_s, &high_s));
        assert_true(low_s >= 0.0 && low_s <= high_s);
        inside += truth_s >= low_s && truth_s <= high_s;
    }
    return (double)inside / RENDERS;
}

static void test_truth_lies_inside(void **state)
{
    (void)state;
    const double sigmas[] = {0.2, 0.4, 0.7}, shares[] = {0.25, 0.5, 0.75};
    for (int s = 0; s < 3; s++) {
        for (int k = 0; k < CHECKS; k++) {
            rng_state = (uint64_t)(1000 * s + k);
            double c = coverage(sigmas[s], shares[k]);
            print_message("sigma %.1f at %.0f %%: truth inside in %.1f %%\n", sigmas[s],
                          100.0 * shares[k], 100.0 * c);
            assert_true(c > 0.70 && c < 0.95);
        }
    }
}

static void test_says_nothing_too_early(void **state)
{
    (void)state;
    struct eta e = {.unknown_s = 10.0, .unknown_units = 10, .threads = 2.0, .elapsed_s = 5.0};
    double low_s = -1.0, high_s = -1.0;
    for (int i = 0; i < ETA_UNITS_MIN - 1; i++)
        eta_spread_add(&e.spread, 1.0);
    assert_false(eta_left(&e, &low_s, &high_s));
    eta_spread_add(&e.spread, 1.0);
    assert_true(eta_left(&e, &low_s, &high_s));
    assert_true(low_s > 4.0 && low_s < 5.0 && high_s > 5.0 && high_s < 5.5);
    e.elapsed_s = 1.9;
    assert_false(eta_left(&e, &low_s, &high_s));
    e.elapsed_s = 5.0;
    e.threads = 0.0;
    assert_false(eta_left(&e, &low_s, &high_s));
}

static void test_spread(void **state)
{
    (void)state;
    struct eta_spread s = {0};
    assert_true(eta_spread_cv(&s) == 0.0);
    const double xs[] = {2, 4, 4, 4, 5, 5, 7, 9};
    for (int i = 0; i < 8; i++)
        eta_spread_add(&s, xs[i]);
    assert_true(fabs(s.mean - 5.0) < 1e-12);
    assert_true(fabs(eta_spread_cv(&s) - sqrt(32.0 / 7.0) / 5.0) < 1e-12);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_truth_lies_inside),
        cmocka_unit_test(test_says_nothing_too_early),
        cmocka_unit_test(test_spread),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
