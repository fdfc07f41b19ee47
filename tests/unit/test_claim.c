/* The rule of --target-error: its bound, what makes no claim, and how far a job goes on. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <math.h>

#include "master/allocate.h"
#include "master/claim.h"

/* An error of so many pixels alike. */
static struct film_error error_of(double relmse, double effective)
{
    return (struct film_error){.known = true,
                               .relmse = relmse,
                               .relmse_deviation = relmse / sqrt(effective),
                               .effective = effective};
}

/* The bound is above the error, less so the surer it is, and scales with it. */
static void test_bound(void **state)
{
    (void)state;
    double before = INFINITY;
    for (double effective = 1; effective < 1e6; effective *= 3) {
        struct film_error e = error_of(0.01, effective), twice = error_of(0.02, effective);
        double upper = claim_upper(&e);
        assert_true(upper > 0.01 && upper < before);
        assert_true(fabs(claim_upper(&twice) / upper - 2) < 1e-12);
        before = upper;
    }
    struct film_error e = error_of(0.01, 100);
    assert_true(fabs(claim_upper(&e) - 0.01 * exp(hypot(0.23, 0.1))) < 1e-12);
    assert_true(claim_stands(&e, 0.0129) && !claim_stands(&e, 0.0128));
    /* However many pixels a picture has, what it states may be a little off. */
    struct film_error large = error_of(0.01, 1e12);
    assert_true(fabs(claim_upper(&large) - 0.01 * exp(0.1)) < 1e-6);
}

/* Nothing known, no claim; nothing wrong, any claim. */
static void test_edges(void **state)
{
    (void)state;
    struct film_error unknown = {0}, none = {.known = true};
    assert_true(isinf(claim_upper(&unknown)) && !claim_stands(&unknown, 1e9));
    assert_true(claim_stands(&none, 1e-30));
}

/* A handful of spikes vouches for nothing, however small the error. */
static void test_few_pixels(void **state)
{
    (void)state;
    struct film_error few = error_of(1e-9, 7.9), enough = error_of(1e-9, 8.1);
    assert_false(claim_stands(&few, 1));
    assert_true(claim_stands(&enough, 1));
    assert_true(claim_growth(&few, 1) > 1.2 && claim_growth(&few, 1) < 1.3);
}

/* A job goes on the further, the more is missing, and never stands still. */
static void test_growth(void **state)
{
    (void)state;
    double before = 1;
    for (double target = 0.02; target > 1e-6; target /= 1.5) {
        struct film_error e = error_of(0.01, 1000);
        double growth = claim_growth(&e, target);
        assert_true(growth > 1 && growth >= before && growth <= 4);
        before = growth;
    }
    assert_true(before == 4);
}

/* Small steps of a small picture: each look has a cell more to see, and the end is told. */
static void test_more(void **state)
{
    (void)state;
    struct job_spec spec;
    job_spec_init(&spec);
    spec.width = spec.height = 32;
    spec.crop = (struct job_crop){0, 0, 32, 32};
    spec.spp = 64;
    spec.stop = JOB_STOP_ERROR;
    spec.target_error = 0.01;
    spec.tile = GRID_SQUARE;
    struct job_blocks blocks = job_spec_blocks(&spec);
    struct grid grid;
    assert_int_equal(grid_init(&grid, &spec), ERR_OK);
    const float shares[4] = {1, 1, 1, 1};
    struct film_error e = error_of(0.01, 1e6);
    uint16_t limits[4];
    double mean = 4;
    (void)allocate_limits(&grid, &blocks, shares, mean, 0, limits);
    uint32_t before = limits[0], looks = 0;
    for (; claim_more(&grid, &blocks, shares, &e, 0.011, &mean, limits); looks++) {
        assert_true(limits[0] > before && mean < 200);
        before = limits[0];
    }
    assert_int_equal(before, blocks.count);
    assert_int_equal(looks, 7); /* 8, 12, 16, 24, 32, 48, 64 samples */
    grid_release(&grid);
}

/* However far the pilot says that the target is, the first look comes soon. */
static void test_first(void **state)
{
    (void)state;
    struct job_spec spec;
    job_spec_init(&spec);
    spec.width = spec.height = 32;
    spec.crop = (struct job_crop){0, 0, 32, 32};
    spec.stop = JOB_STOP_ERROR;
    spec.target_error = 0.01;
    spec.spp = 65536;
    spec.tile = GRID_SQUARE;
    struct job_blocks blocks = job_spec_blocks(&spec);
    struct grid grid;
    assert_int_equal(grid_init(&grid, &spec), ERR_OK);
    const float shares[4] = {1, 1, 1, 1};
    const double far[4] = {256, 256, 256, 256}, near[4] = {5, 5, 5, 5};
    uint16_t limits[4];
    assert_true(claim_first(&grid, &blocks, far, shares, 1e-6, limits) == 16);
    assert_int_equal(job_blocks_samples(&blocks, limits[0]), 16);
    double mean = claim_first(&grid, &blocks, near, shares, 0.005, limits);
    assert_true(mean > 4 && mean < 8);
    grid_release(&grid);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_bound),      cmocka_unit_test(test_edges),
        cmocka_unit_test(test_few_pixels), cmocka_unit_test(test_growth),
        cmocka_unit_test(test_more),       cmocka_unit_test(test_first),
    };
    return cmocka_run_group_tests_name("claim", tests, NULL, NULL);
}
