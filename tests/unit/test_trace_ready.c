/* Rays made ready in SIMD (trace_ready.h) are those of trace_ray_init: the same bits in all that
 * decides, and boxes widened by as much along each axis.
 *
 * The second is how a mistake went unseen: along z, boxes were widened by 16 u R whatever was asked
 * for, where double decides 9 and where float does 393. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <math.h>

#include "tests/unit/test_trace_ready.h"

enum { RAYS = 20000 };
static const double reach = 10.0;

static double uniform(uint64_t *state)
{
    *state = *state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (double)(*state >> 11) * 0x1p-52 - 1.0;
}

/* Of all sizes, some with equal, zero or huge components. */
static struct ray some_ray(uint64_t *state, int number)
{
    struct ray ray = {.tmin = 0.0, .tmax = 100.0};
    double size = ldexp(1.0, number % 7 == 0 ? number % 400 - 200 : 0);
    for (int k = 0; k < 3; k++) {
        ray.org[k] = 30.0 * uniform(state);
        ray.dir[k] = size * uniform(state);
    }
    if (number % 5 == 0)
        ray.dir[number % 3] = ray.dir[(number + 1) % 3];
    if (number % 11 == 0)
        ray.dir[number % 3] = number % 2 ? 0.0 : -0.0;
    return ray;
}

static void check_decision(const struct trace_ray *r, const struct trace_ray *plain)
{
    double more = plain->rescale / r->rescale; /* a power of two */
    for (int k = 0; k < 3; k++) {
        assert_true(r->org[k] == plain->org[k] && r->porg[k] == plain->porg[k]);
        assert_true(r->dir[k] * more == plain->dir[k]);
        assert_int_equal(r->axis[k], plain->axis[k]);
        assert_int_equal(r->row[k], plain->row[k]);
    }
    assert_true(r->shear[0] == plain->shear[0] && r->shear[1] == plain->shear[1]);
    assert_true(r->shear[2] == plain->shear[2] * more);
    assert_true(r->slack == plain->slack);
}

/* By how much each slab is widened either way, in units of 2^-24 R; rounding takes up to two. */
static void check_pads(const struct trace_ray *r, double pad)
{
    double size = r->slack * 0x1p30;
    for (int k = 0; k < 3; k++) {
        double between = (double)r->near_offset[k] - (double)r->far_offset[k];
        double units = fabs(0.5 * between / (double)r->inverse[k]) / (0x1p-24 * size);
        assert_in_range((uint64_t)(units * 16.0), (uint64_t)((pad - 2.0) * 16.0),
                        (uint64_t)((pad + 2.0) * 16.0));
    }
}

static void check_rays(bool (*ready)(double, const struct ray *, struct trace_ray *), double pad)
{
    uint64_t state = 1;
    for (int i = 0; i < RAYS; i++) {
        struct ray ray = some_ray(&state, i);
        struct trace_ray r, plain;
        bool is = trace_ray_init(ray.org, ray.dir, 1.0, reach, pad, &plain);
        assert_int_equal(ready(reach, &ray, &r), is);
        if (!is)
            continue;
        check_decision(&r, &plain);
        check_pads(&r, pad);
    }
}

static bool has_avx2(void)
{
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
}

static void test_exact(void **state)
{
    (void)state;
    if (!has_avx2())
        skip();
    check_rays(test_ready_exact, TRACE_PAD);
}

static void test_fast(void **state)
{
    (void)state;
    if (!has_avx2())
        skip();
    check_rays(test_ready_fast, TRACE_PAD_FAST);
}

/* What is not finite, or has no direction, hits nothing. */
static void test_unfit(void **state)
{
    (void)state;
    const double bad[] = {INFINITY, -INFINITY, NAN};
    struct trace_ray r;
    if (!has_avx2())
        skip();
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < 3; i++) {
            struct ray ray = {.dir = {1.0, 2.0, 3.0}, .tmax = 1.0}, turned = ray;
            ray.org[k] = bad[i];
            assert_false(test_ready_exact(reach, &ray, &r));
            turned.dir[k] = bad[i];
            assert_false(test_ready_exact(reach, &turned, &r));
        }
    struct ray still = {.dir = {0.0, -0.0, 0.0}, .tmax = 1.0};
    assert_false(test_ready_exact(reach, &still, &r));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_exact),
        cmocka_unit_test(test_fast),
        cmocka_unit_test(test_unfit),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
