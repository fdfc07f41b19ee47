/* Predictions against pilots whose law is known: error falls as a power of the samples, from 1 to
 * 1.9, and time is a line; both with log-normal noise. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "client/predict.h"

static uint64_t state_of_random;

/* splitmix64; twelve uniforms less 6 have the variance 1. */
static double normal(void)
{
    double sum = -6;
    for (int i = 0; i < 12; i++) {
        uint64_t z = (state_of_random += UINT64_C(0x9e3779b97f4a7c15));
        z = (z ^ z >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
        z = (z ^ z >> 27) * UINT64_C(0x94d049bb133111eb);
        sum += (double)((z ^ z >> 31) >> 11) * 0x1p-53;
    }
    return sum;
}

static double error_of(double spp, double power)
{
    return 0.01 * pow(spp / 16, -power);
}

static double time_of(double spp)
{
    return 0.3 + 0.02 * spp;
}

/* Seconds of a thread over those it had a processor. */
static const double STRETCH = 12;

static struct pilots pilots_of(double power, double error_noise, double time_noise)
{
    struct pilots p = {.count = PILOTS_MAX, .load_s = 1, .gain = 1, .pixel_ratio = 1};
    for (int i = 0; i < PILOTS_MAX; i++) {
        struct pilot *q = &p.of[i];
        q->spp = 4 << 2 * i;
        q->relmse = error_of(q->spp, power) * exp(error_noise * normal());
        q->deviation = error_noise * q->relmse;
        q->busy_s = time_of(q->spp) * exp(time_noise * normal());
        q->cpu_s = (i == 0 ? 0.5 : 0) + 0.04 * q->spp;
        q->core_s = STRETCH * q->cpu_s;
    }
    return p;
}

static void near(double value, double expected, double relative)
{
    if (!(fabs(value - expected) <= relative * fabs(expected)))
        fail_msg("%.12g is not %.12g", value, expected);
}

/* Without noise: the power within what the belief in 1.3 pulls, and the line exactly. */
static void test_fits(void **state)
{
    (void)state;
    for (double power = 1; power < 1.95; power += 0.1) {
        struct pilots p = pilots_of(power, 0, 0);
        struct error_fit error = predict_fit_error(&p);
        assert_true(error.known);
        near(error.power, power, 0.035);
        near(exp(error.level), 0.01, 0.04);
        struct time_fit time = predict_fit_time(&p);
        near(time.fixed_s, 0.3, 1e-9);
        near(time.spp_s, 0.02, 1e-9);
        struct cost_fit cost = predict_fit_cost(&p);
        assert_true(cost.known);
        near(cost.fixed_s, 0.5, 1e-9);
        near(cost.spp_s, 0.04, 1e-9);
        near(cost.stretch, STRETCH, 1e-9);
    }
}

/* 80 % intervals hold 70 to 95 % of what comes, whatever the power. */
static void test_coverage(void **state)
{
    (void)state;
    const double powers[] = {1, 1.3, 1.6, 1.9};
    state_of_random = 1;
    for (int k = 0; k < 4; k++) {
        int error_in = 0, time_in = 0, draws = 2000;
        for (int i = 0; i < draws; i++) {
            struct pilots p = pilots_of(powers[k], 0.3, 0.15);
            struct job_spec spec = {.stop = JOB_STOP_SPP, .spp = 256};
            struct prediction said = predict(&p, &spec);
            double error = error_of(256, powers[k]) * exp(0.32 * normal());
            double seconds = 1 + time_of(256) * exp(0.15 * normal());
            error_in += said.relmse_low <= error && error <= said.relmse_high;
            time_in += said.seconds_low <= seconds && seconds <= said.seconds_high;
        }
        assert_in_range(error_in, draws * 70 / 100, draws * 95 / 100);
        assert_in_range(time_in, draws * 60 / 100, draws * 95 / 100);
    }
}

/* The doubt grows with the way from the pilots. */
static void test_distance(void **state)
{
    (void)state;
    struct pilots p = pilots_of(1.3, 0, 0);
    double before = 0;
    for (uint64_t spp = 64; spp <= 65536; spp *= 4) {
        struct job_spec spec = {.stop = JOB_STOP_SPP, .spp = spp};
        struct prediction said = predict(&p, &spec);
        double ratio = said.relmse_high / said.relmse_low;
        assert_true(ratio > before);
        before = ratio;
    }
}

/* A target: the samples that the power asks for. No error at all: the pilot is enough. */
static void test_target(void **state)
{
    (void)state;
    struct pilots p = pilots_of(1.5, 0, 0);
    struct job_spec spec = {.stop = JOB_STOP_ERROR, .spp = 65536, .target_error = 1e-4};
    /* 1.03 times for the steps of looks, the claim's doubt, and 1.15 for samples that are no power
     * of two, and 1.5 for plans; 1.2 times the samples of that. */
    double sure = 1.03 * exp(0.1), power = predict_fit_error(&p).power;
    near(predict(&p, &spec).spp_mean, 1.2 * 16 * pow(sure * 1.15 * 1.5 * 0.01 / 1e-4, 1 / power),
         0.03);
    double steps = 1.03 * (1 + 0.3 * (predict_fit_error(&p).power - 1.2));
    near(predict(&p, &spec).relmse, 1e-4 / steps / exp(0.1), 1e-9);
    /* A deviation of a tenth: the bound is exp(sqrt(0.23^2 + 0.1^2)) away. In four times the pixels
     * half. */
    for (int i = 0; i < PILOTS_MAX; i++)
        p.of[i].deviation = 0.1 * p.of[i].relmse;
    near(predict(&p, &spec).relmse, 1e-4 / steps / exp(hypot(0.23, 0.1)), 0.01);
    p.pixel_ratio = 4;
    near(predict(&p, &spec).relmse, 1e-4 / steps / exp(hypot(0.115, 0.1)), 0.01);
    p.pixel_ratio = 1;
    for (int i = 0; i < PILOTS_MAX; i++)
        p.of[i].relmse = p.of[i].deviation = 0;
    struct prediction said = predict(&p, &spec);
    assert_true(said.spp_mean == 2 && said.seconds > 0 && isfinite(said.seconds_high));
}

/* Times that fall with the samples (another program had the machine) still give a cost. */
static void test_noisy_times(void **state)
{
    (void)state;
    struct pilots p = pilots_of(1.3, 0, 0);
    p.of[0].busy_s = 9;
    p.of[1].busy_s = 2;
    p.of[2].busy_s = 1;
    struct time_fit f = predict_fit_time(&p);
    assert_true(f.spp_s > 0 && f.fixed_s >= 0 && f.deviation > 0.5);
}

/* A machine to ourselves makes the time sure; processor time that is not to be seen is not told. */
static void test_stretch(void **state)
{
    (void)state;
    struct job_spec spec = {.stop = JOB_STOP_SPP, .spp = 256};
    struct pilots p = pilots_of(1.3, 0, 0);
    struct prediction shared = predict(&p, &spec);
    near(shared.core_s, 0.5 + 0.04 * 256, 1e-9);
    for (int i = 0; i < PILOTS_MAX; i++)
        p.of[i].core_s = p.of[i].cpu_s;
    struct prediction alone = predict(&p, &spec);
    near(alone.seconds, shared.seconds, 1e-9);
    assert_true(alone.seconds_high / alone.seconds_low < 1.65);
    assert_true(shared.seconds_high / shared.seconds_low > 1.65);
    p.of[1].cpu_s = (double)NAN;
    struct prediction unseen = predict(&p, &spec);
    assert_true(isnan(unseen.core_s) && unseen.seconds_high > alone.seconds_high);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_fits),        cmocka_unit_test(test_coverage),
        cmocka_unit_test(test_distance),    cmocka_unit_test(test_target),
        cmocka_unit_test(test_noisy_times), cmocka_unit_test(test_stretch),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
