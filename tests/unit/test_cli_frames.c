/* Frame ranges and numbered paths. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <string.h>

#include "client/frames.h"

static void parsed(const char *text, uint32_t first, uint32_t last)
{
    struct frames f;
    assert_true(frames_parse(text, &f));
    assert_int_equal(f.first, first);
    assert_int_equal(f.last, last);
}

static void test_ranges(void **state)
{
    (void)state;
    parsed("1-24", 1, 24);
    parsed("7", 7, 7);
    parsed("0-0", 0, 0);
    parsed("4294967295", UINT32_MAX, UINT32_MAX);
    parsed("1-100000", 1, 100000);
}

static void test_what_is_no_range(void **state)
{
    (void)state;
    static const char *const bad[] = {"",         "-",       "1-",   "-3",  "3-1",
                                      "1-2-3",    "a-b",     "1 -2", "1.5", "4294967296",
                                      "1-100001", "0x1-0x2", "+1-2"};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        struct frames f = {77, 78};
        assert_false(frames_parse(bad[i], &f));
        assert_int_equal(f.first, 77); /* untouched */
    }
}

static void named(const char *path, uint32_t frame, const char *expected)
{
    char out[64];
    assert_true(frames_path(path, frame, out, sizeof out));
    assert_string_equal(out, expected);
}

static void test_paths(void **state)
{
    (void)state;
    named("shot.####.json", 7, "shot.0007.json");
    named("#.json", 12, "12.json");
    named("####", 12345, "12345");
    named("a#/b##.exr", 3, "a#/b03.exr"); /* the last run counts */
    named("plain.json", 3, "plain.json");
    named("%s##%n.json", 1, "%s01%n.json");
    assert_true(frames_marked("x#"));
    assert_false(frames_marked("x"));
    char small[8];
    assert_false(frames_path("shot.####.json", 1, small, sizeof small));
    char exact[5];
    assert_true(frames_path("####", 1, exact, sizeof exact));
    assert_string_equal(exact, "0001");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_ranges),
        cmocka_unit_test(test_what_is_no_range),
        cmocka_unit_test(test_paths),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
