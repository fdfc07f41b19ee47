/* The metrics of compare, against closed forms. tests/e2e compares them with numpy. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#include "client/metrics.h"

enum { SIDE = 40, VALUES = SIDE * SIDE * 3 };

static float x[VALUES], r[VALUES];

static void near(double value, double expected, double tolerance)
{
    if (!(fabs(value - expected) <= tolerance))
        fail_msg("%.12g is not %.12g", value, expected);
}

static struct metrics compare(void)
{
    struct metrics m;
    assert_int_equal(metrics_compare(x, r, SIDE, SIDE, &m), ERR_OK);
    return m;
}

static void fill(float value)
{
    for (int i = 0; i < VALUES; i++)
        x[i] = r[i] = value;
}

static void test_identical(void **state)
{
    (void)state;
    fill(0.5f);
    struct metrics m = compare();
    assert_true(m.identical);
    assert_true(m.rmse == 0 && m.relmse == 0 && m.relmse_trimmed == 0 && m.mape == 0);
    near(m.ssim, 1, 1e-6);
    assert_true(m.psnr > 1e300);
}

/* A constant offset: every closed form is at hand. */
static void test_offset(void **state)
{
    (void)state;
    fill(2);
    for (int i = 0; i < VALUES; i++)
        x[i] = 2.5f;
    struct metrics m = compare();
    assert_false(m.identical);
    near(m.rmse, 0.5, 1e-12);
    near(m.relmse, 0.25 / (4 + 0.01 * 4), 1e-12);
    near(m.relmse_trimmed, m.relmse, 1e-12);
    near(m.mape, 0.5 / (2 + 0.02), 1e-12);
    near(m.max_difference, 0.5, 0);
    near(m.mean_x, 2.5, 1e-12);
    assert_true(m.psnr > 1e300); /* both are white on a display */
}

/* One bad pixel of 1,600 is within the trimmed share (1 of 1,600). */
static void test_trim(void **state)
{
    (void)state;
    fill(1);
    for (int c = 0; c < 3; c++)
        x[3 * (7 * SIDE + 9) + c] = 101;
    struct metrics m = compare();
    near(m.relmse, 100.0 * 100 / 1.01 / (SIDE * SIDE), 1e-9);
    assert_true(m.relmse_trimmed == 0);
    near(m.max_difference, 100, 0);
    assert_int_equal(m.max_x, 9);
    assert_int_equal(m.max_y, 7);
}

static void test_black(void **state)
{
    (void)state;
    fill(0);
    struct metrics m = compare();
    assert_true(m.relmse == 0 && m.mape == 0);
}

/* -0 and 0 are equal numbers but not the same bits. */
static void test_bits(void **state)
{
    (void)state;
    fill(0);
    x[5] = -0.0f;
    struct metrics m = compare();
    assert_false(m.identical);
    assert_true(m.rmse == 0);
}

static void test_nonfinite(void **state)
{
    (void)state;
    fill(1);
    x[0] = NAN;
    x[1] = INFINITY;
    r[3] = -INFINITY;
    struct metrics m = compare();
    assert_true(m.nonfinite_x == 2 && m.nonfinite_r == 1);
    assert_true(m.values == VALUES - 3);
    assert_true(m.relmse == 0 && m.rmse == 0);
    assert_true(m.ssim == m.ssim); /* no NaN */
}

/* SSIM of two constant pictures has the luminance term only. */
static void test_ssim_constant(void **state)
{
    (void)state;
    fill(0);
    for (int i = 0; i < VALUES; i++)
        x[i] = 1;
    struct metrics m = compare();
    near(m.ssim, 1e-4 / (1 + 1e-4), 1e-6);
    near(m.psnr, 0, 1e-9);
}

static void test_heat(void **state)
{
    unsigned char a[3], b[3];
    (void)state;
    metrics_heat(0, a);
    metrics_heat(0.001, b);
    assert_memory_equal(a, b, 3);
    metrics_heat(1, a);
    metrics_heat(50, b);
    assert_memory_equal(a, b, 3);
    assert_int_equal(a[0], 255);
    metrics_heat((double)NAN, a);
    assert_int_equal(a[2], 255);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_identical),     cmocka_unit_test(test_offset),
        cmocka_unit_test(test_trim),          cmocka_unit_test(test_black),
        cmocka_unit_test(test_bits),          cmocka_unit_test(test_nonfinite),
        cmocka_unit_test(test_ssim_constant), cmocka_unit_test(test_heat),
    };
    return cmocka_run_group_tests_name("cli_metrics", tests, NULL, NULL);
}
