/* half_round and half_clamp, against every half there is, made from its bits. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "common/half.h"

/* The value of a positive half's bits (IEEE 754 binary16), finite. */
static float value_of(uint32_t bits)
{
    int exponent = (int)(bits >> 10);
    double fraction = (double)(bits & 1023);
    return (float)(exponent == 0 ? ldexp(fraction, -24) : ldexp(1024 + fraction, exponent - 25));
}

static void test_every_half(void **state)
{
    (void)state;
    for (uint32_t bits = 0; bits < 0x7c00; bits++) {
        float v = value_of(bits);
        assert_true(half_round(v) == v);
        assert_true(half_round(-v) == -v);
    }
    assert_true(value_of(0x7bff) == HALF_MAX);
}

/* Half-way goes to the even neighbour; a hair to either side goes there. */
static void test_between(void **state)
{
    (void)state;
    for (uint32_t bits = 0; bits < 0x7bff; bits++) {
        float low = value_of(bits), high = value_of(bits + 1), middle = (low + high) / 2;
        assert_true(half_round(middle) == (bits & 1 ? high : low));
        assert_true(half_round(nextafterf(middle, 0)) == low);
        assert_true(half_round(nextafterf(middle, INFINITY)) == high);
    }
}

static void test_clamp(void **state)
{
    float v[] = {1, 65504, 65505, -1e30f, INFINITY, NAN, -INFINITY, 0};
    (void)state;
    assert_true(half_round(1e30f) == HALF_MAX && half_round(-INFINITY) == -HALF_MAX);
    assert_true(isnan(half_round(NAN)));
    assert_int_equal(half_clamp(v, sizeof v / sizeof *v), 4);
    assert_true(v[1] == 65504 && v[2] == 65504 && v[3] == -65504 && v[4] == 65504);
    assert_true(isnan(v[5]) && v[6] == -65504 && v[0] == 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_every_half),
        cmocka_unit_test(test_between),
        cmocka_unit_test(test_clamp),
    };
    return cmocka_run_group_tests_name("half", tests, NULL, NULL);
}
