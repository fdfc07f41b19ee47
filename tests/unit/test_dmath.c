/* Deterministic functions: close to the truth, and the same bits on every machine; decimal numbers
 * exactly rounded. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/digest.h"
#include "common/dmath.h"
#include "common/number.h"

enum { SAMPLES = 20000 };

static uint64_t state = 1;

static double uniform(double low, double high)
{
    state = state * UINT64_C(6364136223846793005) + 1;
    return low + (high - low) * ((double)(state >> 11) * 0x1p-53);
}

static const struct {
    const char *name;
    double (*ours)(double);
    long double (*truth)(long double);
    double low, high;
} functions[] = {
    {"sin", dmath_sin, sinl, -100, 100},    {"cos", dmath_cos, cosl, -100, 100},
    {"tan", dmath_tan, tanl, -1.5, 1.5},    {"asin", dmath_asin, asinl, -1, 1},
    {"acos", dmath_acos, acosl, -1, 1},     {"atan", dmath_atan, atanl, -50, 50},
    {"exp", dmath_exp, expl, -700, 700},    {"exp2", dmath_exp2, exp2l, -1000, 1000},
    {"expm1", dmath_expm1, expm1l, -5, 5},  {"log", dmath_log, logl, 1e-9, 1e9},
    {"log2", dmath_log2, log2l, 1e-9, 1e9}, {"log1p", dmath_log1p, log1pl, -0.99, 9},
    {"cbrt", dmath_cbrt, cbrtl, -1e6, 1e6}, {"sinh", dmath_sinh, sinhl, -20, 20},
    {"cosh", dmath_cosh, coshl, -20, 20},   {"tanh", dmath_tanh, tanhl, -5, 5},
    {"erf", dmath_erf, erfl, -4, 4},
};

static void results_are_within_an_ulp_or_so(void **unused)
{
    (void)unused;
    for (size_t f = 0; f < sizeof functions / sizeof *functions; f++) {
        for (int i = 0; i < SAMPLES; i++) {
            double x = uniform(functions[f].low, functions[f].high);
            double got = functions[f].ours(x);
            long double truth = functions[f].truth((long double)x);
            double ulp = nextafter(fabs((double)truth), HUGE_VAL) - fabs((double)truth);
            if (!(fabsl((long double)got - truth) <= 1.1L * (long double)ulp))
                fail_msg("%s(%.17g) = %.17g", functions[f].name, x, got);
        }
    }
}

static void two_arguments_agree(void **unused)
{
    (void)unused;
    for (int i = 0; i < SAMPLES; i++) {
        double x = uniform(1e-3, 1e3), y = uniform(-20, 20), s, c;
        long double p = powl((long double)x, (long double)y);
        assert_true(fabsl((long double)dmath_pow(x, y) - p) <= 4e-16L * p);
        long double a = atan2l((long double)y, (long double)x - 500);
        assert_true(fabsl((long double)dmath_atan2(y, x - 500) - a) <= 4e-16L * fabsl(a) + 1e-300L);
        dmath_sincos(y, &s, &c);
        assert_true(fabs(s * s + c * c - 1) < 1e-15);
    }
    assert_true(dmath_sinpi(0.5) == 1 && dmath_cospi(0.5) == 0 && dmath_cospi(1) == -1);
    assert_true(isnan(dmath_acos(2)) && isnan(dmath_log(-1)) && dmath_exp(-HUGE_VAL) == 0);
    assert_true(dmath_pow(0, 0) == 1 && dmath_pow(0, 2) == 0);
}

static void srgb_goes_both_ways(void **unused)
{
    (void)unused;
    for (int i = 0; i <= 255; i++) {
        double code = i / 255.0;
        assert_true(fabs(dmath_srgb_encode(dmath_srgb_decode(code)) - code) < 1e-12);
    }
    assert_true(dmath_srgb_encode(0) == 0 && fabs(dmath_srgb_encode(1) - 1) < 1e-15);
    assert_true(dmath_srgb_encode(-0.5) == -dmath_srgb_encode(0.5));
}

/* The bits of all functions over a fixed set of arguments. A change here changes pictures: raise
 * DETERMINISM_NUMBER with it. */
static void bits_are_those_of_every_machine(void **unused)
{
    (void)unused;
    static double results[sizeof functions / sizeof *functions * 1000 + 1000];
    size_t n = 0;
    char hex[DIGEST_HEX_BYTES];
    state = 42;
    for (size_t f = 0; f < sizeof functions / sizeof *functions; f++)
        for (int i = 0; i < 1000; i++)
            results[n++] = functions[f].ours(uniform(functions[f].low, functions[f].high));
    for (int i = 0; i < 1000; i++) {
        double x = uniform(1e-3, 1e3); /* one draw before the other: C does not order arguments */
        results[n++] = dmath_pow(x, uniform(-9, 9));
    }
    digest d = digest_of(results, n * sizeof *results);
    digest_to_hex(&d, hex);
    assert_string_equal(hex, "b60aa25cccafbc1fb01e512c3d9a4c886e8396c6ed5a76b9d5acead1f6616ab9");
}

static void numbers_are_exactly_rounded(void **unused)
{
    (void)unused;
    static const char *const fixed[] = {
        "0",
        "-0",
        "1",
        ".5",
        "5.",
        "1e22",
        "1e23",
        "123456789012345678901234567890",
        "2.2250738585072011e-308",
        "4.9406564584124654e-324",
        "1e-400",
        "1e400",
        "9007199254740993",
        "0.1",
        "-1.7976931348623157e308",
        "0.000000000000000000000000000000000000000000000000000000000000001e63"};
    for (size_t i = 0; i < sizeof fixed / sizeof *fixed; i++) {
        double v, truth = strtod(fixed[i], NULL);
        assert_ptr_equal(number_parse(fixed[i], fixed[i] + strlen(fixed[i]), &v),
                         fixed[i] + strlen(fixed[i]));
        assert_memory_equal(&v, &truth, sizeof v);
    }
    for (int i = 0; i < SAMPLES; i++) {
        char text[64];
        uint64_t bits = 0;
        double v, truth;
        state = state * UINT64_C(6364136223846793005) + 1;
        bits = state ^ state >> 17;
        memcpy(&truth, &bits, sizeof truth);
        if (!isfinite(truth))
            continue;
        (void)snprintf(text, sizeof text, "%.*g", i % 20 + 1, truth);
        truth = strtod(text, NULL);
        assert_non_null(number_parse(text, text + strlen(text), &v));
        assert_memory_equal(&v, &truth, sizeof v);
        number_format(truth, text);
        assert_true(strtod(text, NULL) == truth);
    }
}

static void what_is_no_number_is_refused(void **unused)
{
    (void)unused;
    static const char *const bad[] = {"", "-", "+", ".", "e5", "nan", "inf", "-.", "x"};
    double v;
    int64_t whole;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        assert_null(number_parse(bad[i], bad[i] + strlen(bad[i]), &v));
        assert_null(number_parse_int(bad[i], bad[i] + strlen(bad[i]), &whole));
    }
    const char *half = "1e+";
    assert_ptr_equal(number_parse(half, half + 3, &v), half + 1);
    const char *low = "-9223372036854775808", *beyond = "9223372036854775808";
    assert_non_null(number_parse_int(low, low + 20, &whole));
    assert_true(whole == INT64_MIN);
    assert_null(number_parse_int(beyond, beyond + 19, &whole));
    const char *corner = "12/3";
    assert_ptr_equal(number_parse_int(corner, corner + 4, &whole), corner + 2);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(results_are_within_an_ulp_or_so),
        cmocka_unit_test(two_arguments_agree),
        cmocka_unit_test(srgb_goes_both_ways),
        cmocka_unit_test(bits_are_those_of_every_machine),
        cmocka_unit_test(numbers_are_exactly_rounded),
        cmocka_unit_test(what_is_no_number_is_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
