/* Journal records: what was written is read back; nothing else is ever taken for a result. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <string.h>

#include "master/journal.h"

enum { BODY_BYTES = 900, RECORD_BYTES = JOURNAL_HEADER_BYTES + BODY_BYTES };

static unsigned char record[RECORD_BYTES];

static struct journal_result make_record(void)
{
    struct journal_result r = {.job = 42,
                               .sequence = 7,
                               .unit = {11, 3, 5},
                               .worker = 9,
                               .epoch = UINT64_C(1) << 40,
                               .samples = 12345,
                               .rays = 99999,
                               .nonfinite = 2,
                               .nonfinite_pixel = 77,
                               .nonfinite_sample = 4,
                               .render_us = 1000001,
                               .raw_bytes = 3072,
                               .body_bytes = BODY_BYTES};
    for (size_t i = 0; i < BODY_BYTES; i++)
        record[JOURNAL_HEADER_BYTES + i] = (unsigned char)(i * 131 + 7);
    (void)journal_header(&r, record + JOURNAL_HEADER_BYTES, record);
    return r;
}

static enum err read_back(const void *data, size_t bytes)
{
    struct journal_result out;
    digest d;
    const unsigned char *body;
    return journal_read(data, bytes, &out, &d, &body);
}

static void test_round_trip(void **state)
{
    (void)state;
    struct journal_result in = make_record(), out;
    digest written = journal_header(&in, record + JOURNAL_HEADER_BYTES, record), found;
    const unsigned char *body;
    assert_int_equal(journal_read(record, RECORD_BYTES, &out, &found, &body), ERR_OK);
    assert_memory_equal(&in, &out, sizeof in);
    assert_true(digest_equal(&written, &found));
    assert_ptr_equal(body, record + JOURNAL_HEADER_BYTES);
}

static void test_every_prefix(void **state)
{
    (void)state;
    (void)make_record();
    for (size_t bytes = 0; bytes < RECORD_BYTES; bytes++)
        assert_int_equal(read_back(record, bytes), ERR_CORRUPT);
    assert_int_equal(read_back(record, RECORD_BYTES), ERR_OK);
}

static void test_every_bit(void **state)
{
    (void)state;
    (void)make_record();
    for (size_t bit = 0; bit < RECORD_BYTES * 8; bit++) {
        record[bit / 8] ^= (unsigned char)(1 << (bit % 8));
        assert_int_equal(read_back(record, RECORD_BYTES), ERR_CORRUPT);
        record[bit / 8] ^= (unsigned char)(1 << (bit % 8));
    }
    assert_int_equal(read_back(record, RECORD_BYTES), ERR_OK);
}

/* A record that lies at the wrong place, behind zeros or inside another, is none. */
static void test_shifted(void **state)
{
    (void)state;
    (void)make_record();
    for (size_t at = 1; at < RECORD_BYTES; at++)
        assert_int_equal(read_back(record + at, RECORD_BYTES - at), ERR_CORRUPT);
    unsigned char zeros[RECORD_BYTES] = {0};
    assert_int_equal(read_back(zeros, sizeof zeros), ERR_CORRUPT);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_round_trip),
        cmocka_unit_test(test_every_prefix),
        cmocka_unit_test(test_every_bit),
        cmocka_unit_test(test_shifted),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
