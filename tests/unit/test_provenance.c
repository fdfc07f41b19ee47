/* Who gave what: noted, reset, checked, saved and read again. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include <string.h>

#include "common/buf.h"
#include "common/mem.h"
#include "master/provenance.h"

enum { CELLS = 10, BLOCKS = 4 };

static const struct unit UNIT = {.cell_begin = 2, .cell_count = 3, .block = 1};
static const uint64_t HASHES[] = {11, 12, 13};

static enum err put(void *ctx, const void *data, size_t bytes)
{
    buf_put(ctx, data, bytes);
    return buf_status(ctx);
}

static enum err get(void *ctx, void *data, size_t bytes)
{
    struct buf_reader *r = ctx;
    const void *at = buf_get(r, bytes);
    if (!at)
        return ERR_CORRUPT;
    if (bytes > 0)
        memcpy(data, at, bytes);
    return ERR_OK;
}

static void make(struct provenance *p)
{
    assert_int_equal(provenance_init(p, CELLS, BLOCKS), ERR_OK);
    provenance_note(p, UNIT, 7, HASHES);
    assert_int_equal(provenance_open_check(p, UNIT), ERR_OK);
    assert_int_equal(provenance_open_check(p, UNIT), ERR_OK); /* once */
    assert_int_equal(p->check_count, 1);
}

static void test_whose_bits(void **state)
{
    (void)state;
    struct provenance p;
    make(&p);
    uint32_t worker = 0;
    uint64_t hash = 0;
    assert_true(provenance_of_unit(&p, UNIT, &worker, &hash));
    assert_int_equal(worker, 7);
    uint64_t folded = 0;
    for (int i = 0; i < 3; i++)
        folded = provenance_fold(folded, HASHES[i]);
    assert_int_equal(hash, folded);
    assert_true(provenance_touched(&p, 7, 4));
    assert_false(provenance_touched(&p, 7, 5));
    assert_false(provenance_touched(&p, 8, 4));

    /* A cell of another worker: no one gave the unit whole. */
    provenance_note(&p, (struct unit){3, 1, 1}, 8, HASHES);
    assert_false(provenance_of_unit(&p, UNIT, &worker, &hash));
    assert_false(provenance_of_unit(&p, (struct unit){8, 3, 1}, &worker, &hash));
    assert_false(provenance_of_unit(&p, (struct unit){0, 1, 0}, &worker, &hash));
    provenance_release(&p);
}

static void test_reset_ends_checks_that_touch(void **state)
{
    (void)state;
    struct provenance p;
    make(&p);
    assert_int_equal(provenance_open_check(&p, (struct unit){6, 2, 0}), ERR_OK);
    provenance_reset(&p, 4, 2);
    assert_int_equal(p.check_count, 1);
    assert_int_equal(p.checks[0].cell_begin, 6);
    assert_false(provenance_touched(&p, 7, 4));
    assert_true(provenance_touched(&p, 7, 3));
    provenance_close_check(&p, (struct unit){6, 2, 0});
    provenance_close_check(&p, (struct unit){6, 2, 0});
    assert_int_equal(p.check_count, 0);
    provenance_release(&p);
}

static void test_widened_to_whole_checks(void **state)
{
    (void)state;
    struct provenance p;
    make(&p); /* 2..4 */
    assert_int_equal(provenance_open_check(&p, (struct unit){4, 4, 0}), ERR_OK);
    uint32_t begin = 7, count = 2;
    provenance_widen(&p, &begin, &count); /* 7..8 -> 4..8 -> 2..8 */
    assert_int_equal(begin, 2);
    assert_int_equal(count, 7);
    begin = 8, count = 2;
    provenance_widen(&p, &begin, &count);
    assert_int_equal(begin, 8);
    assert_int_equal(count, 2);
    provenance_release(&p);
}

static void test_saved_and_read_again(void **state)
{
    (void)state;
    struct provenance p, copy, back;
    make(&p);
    assert_int_equal(provenance_copy(&p, &copy), ERR_OK);
    struct buf b;
    buf_init(&b);
    assert_int_equal(provenance_save(&copy, put, &b), ERR_OK);
    struct buf_reader r = buf_reader_of(b.data, b.bytes);
    assert_int_equal(provenance_load(CELLS, BLOCKS, get, &r, &back), ERR_OK);
    uint32_t worker = 0;
    uint64_t hash = 0;
    assert_true(provenance_of_unit(&back, UNIT, &worker, &hash));
    assert_int_equal(worker, 7);
    assert_int_equal(back.check_count, 1);
    assert_memory_equal(&back.checks[0], &UNIT, sizeof UNIT);
    provenance_release(&back);

    /* Of another shape, or cut anywhere: damaged. */
    r = buf_reader_of(b.data, b.bytes);
    assert_int_equal(provenance_load(CELLS + 1, BLOCKS, get, &r, &back), ERR_CORRUPT);
    for (size_t bytes = 0; bytes < b.bytes; bytes++) {
        r = buf_reader_of(b.data, bytes);
        assert_int_equal(provenance_load(CELLS, BLOCKS, get, &r, &back), ERR_CORRUPT);
    }
    /* A check outside of the picture. */
    uint32_t outside = CELLS;
    memcpy(b.data + b.bytes - sizeof UNIT, &outside, sizeof outside);
    r = buf_reader_of(b.data, b.bytes);
    assert_int_equal(provenance_load(CELLS, BLOCKS, get, &r, &back), ERR_CORRUPT);
    buf_release(&b);
    provenance_release(&copy);
    provenance_release(&p);
}

static void test_empty(void **state)
{
    (void)state;
    struct provenance back;
    struct buf b;
    buf_init(&b);
    assert_int_equal(provenance_save(NULL, put, &b), ERR_OK);
    struct buf_reader r = buf_reader_of(b.data, b.bytes);
    assert_int_equal(provenance_load(CELLS, BLOCKS, get, &r, &back), ERR_OK);
    assert_int_equal(back.cell_count, 0);
    provenance_release(&back);
    buf_release(&b);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_whose_bits),
        cmocka_unit_test(test_reset_ends_checks_that_touch),
        cmocka_unit_test(test_widened_to_whole_checks),
        cmocka_unit_test(test_saved_and_read_again),
        cmocka_unit_test(test_empty),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
