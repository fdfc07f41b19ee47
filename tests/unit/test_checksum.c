/* checksum64: a known value; any changed bit, byte or length changes it. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "common/checksum.h"

enum { BYTES = 300 };

static void changes_are_seen(void **state)
{
    (void)state;
    unsigned char data[BYTES];
    for (int i = 0; i < BYTES; i++)
        data[i] = (unsigned char)(i * 7);
    for (size_t bytes = 0; bytes <= BYTES; bytes += bytes < 140 ? 1 : 40) {
        uint64_t sum = checksum64(data, bytes);
        assert_int_equal(checksum64(data, bytes), sum);
        if (bytes > 0)
            assert_int_not_equal(checksum64(data, bytes - 1), sum);
        for (size_t bit = 0; bit < 8 * bytes; bit++) {
            data[bit / 8] ^= (unsigned char)(1u << bit % 8);
            assert_int_not_equal(checksum64(data, bytes), sum);
            data[bit / 8] ^= (unsigned char)(1u << bit % 8);
        }
    }
}

/* Zeros behind the end are not nothing, and blocks that change places are seen. */
static void lengths_and_places_are_seen(void **state)
{
    (void)state;
    unsigned char zeros[BYTES] = {0}, data[128], turned[128];
    for (size_t bytes = 1; bytes <= BYTES; bytes++)
        assert_int_not_equal(checksum64(zeros, bytes), checksum64(zeros, bytes - 1));
    for (int i = 0; i < 128; i++) {
        data[i] = (unsigned char)i;
        turned[i] = (unsigned char)((i + 64) % 128);
    }
    assert_int_not_equal(checksum64(data, 128), checksum64(turned, 128));
}

/* Files outlive builds: the value is part of their format. */
static void the_value_stays(void **state)
{
    (void)state;
    assert_int_equal(checksum64("", 0), UINT64_C(0x3555866a2899426d));
    assert_int_equal(checksum64("Tilery", 6), UINT64_C(0xe61c5a7c833612ab));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(changes_are_seen),
        cmocka_unit_test(lengths_and_places_are_seen),
        cmocka_unit_test(the_value_stays),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
