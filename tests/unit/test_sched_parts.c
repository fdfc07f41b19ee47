/* The scheduler's small parts against plain arrays: cellset, slotmap, timers. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include "master/sched/cellset.h"
#include "master/sched/slotmap.h"
#include "master/sched/timers.h"

#include <stdlib.h>
#include <string.h>

static uint64_t rng_state;

static uint64_t rng(void)
{
    uint64_t x = rng_state += UINT64_C(0x9E3779B97F4A7C15);
    x = (x ^ (x >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    x = (x ^ (x >> 27)) * UINT64_C(0x94D049BB133111EB);
    return x ^ (x >> 31);
}

/* --- cellset ------------------------------------------------------------------ */

static uint32_t plain_next(const uint8_t *plain, uint32_t count, uint32_t from)
{
    while (from < count && !plain[from])
        from++;
    return from < count ? from : UINT32_MAX;
}

static void cellset_agrees(const struct cellset_shape *s, const uint64_t *words,
                           const uint8_t *plain)
{
    uint32_t from = (uint32_t)(rng() % s->cell_count);
    uint32_t found = cellset_next(s, words, from);
    assert_int_equal(found, plain_next(plain, s->cell_count, from));
    if (found == UINT32_MAX)
        return;
    uint32_t run_max = 1 + (uint32_t)(rng() % 300), run = 0;
    while (run < run_max && found + run < s->cell_count && plain[found + run])
        run++;
    assert_int_equal(cellset_run(s, words, found, run_max), run);
}

static void cellset_random(uint32_t cell_count, int density)
{
    struct cellset_shape s = cellset_shape_of(cell_count);
    uint64_t *words = mem_calloc(s.word_count, sizeof *words);
    uint8_t *plain = mem_calloc(cell_count, 1);
    assert_non_null(words);
    assert_non_null(plain);
    for (int step = 0; step < 4000; step++) {
        uint32_t cell = (uint32_t)(rng() % cell_count);
        uint32_t run = 1 + (uint32_t)(rng() % 100);
        bool add = (int)(rng() % 100) < density;
        for (; run > 0 && cell < cell_count; run--, cell++) {
            plain[cell] = add;
            (add ? cellset_add : cellset_remove)(&s, words, cell);
        }
        cellset_agrees(&s, words, plain);
    }
    for (uint32_t c = 0; c < cell_count; c++)
        assert_int_equal(cellset_has(&s, words, c), plain[c]);
    mem_free(words);
    mem_free(plain);
}

static void test_cellset_is_a_set(void **state)
{
    (void)state;
    const uint32_t counts[] = {1, 2, 63, 64, 65, 4095, 4096, 4097, 70000, 300000};
    for (size_t i = 0; i < sizeof counts / sizeof *counts; i++) {
        rng_state = counts[i];
        cellset_random(counts[i], 2);
        cellset_random(counts[i], 50);
        cellset_random(counts[i], 95);
    }
}

static void test_cellset_fill_holds_all(void **state)
{
    (void)state;
    const uint32_t counts[] = {1, 64, 65, 4096, 4097, 1 << 24};
    for (size_t i = 0; i < sizeof counts / sizeof *counts; i++) {
        struct cellset_shape s = cellset_shape_of(counts[i]);
        uint64_t *words = mem_calloc(s.word_count, sizeof *words);
        assert_non_null(words);
        cellset_fill(&s, words);
        assert_int_equal(cellset_run(&s, words, 0, UINT32_MAX), counts[i]);
        assert_int_equal(cellset_next(&s, words, counts[i] - 1), counts[i] - 1);
        assert_int_equal(cellset_next(&s, words, counts[i]), UINT32_MAX);
        for (uint32_t c = 0; c < counts[i]; c += 1 + counts[i] / 1000)
            cellset_remove(&s, words, c);
        uint32_t cell = cellset_next(&s, words, 0);
        assert_true(counts[i] < 1000 ? cell == UINT32_MAX : cell == 1);
        mem_free(words);
    }
}

/* --- slotmap ------------------------------------------------------------------ */

static void test_slotmap_finds_what_it_holds(void **state)
{
    (void)state;
    enum { CAPACITY = 100, KEYS = 400 };
    struct arena arena;
    arena_init(&arena);
    struct slotmap m;
    assert_int_equal(slotmap_init(&m, &arena, CAPACITY), ERR_OK);
    uint32_t slots[KEYS];
    memset(slots, 0xff, sizeof slots);
    uint32_t held = 0;
    rng_state = 7;
    for (int step = 0; step < 100000; step++) {
        uint32_t k = (uint32_t)(rng() % KEYS);
        uint64_t key = (uint64_t)k * k * 1000003 + 1;
        assert_int_equal(slotmap_find(&m, key), slots[k]);
        if (slots[k] != SLOT_NONE) {
            slotmap_remove(&m, slots[k]);
            slots[k] = SLOT_NONE;
            held--;
        } else {
            slots[k] = slotmap_add(&m, key);
            assert_int_equal(slots[k] == SLOT_NONE, held == CAPACITY);
            held += slots[k] != SLOT_NONE;
        }
        assert_int_equal(m.count, held);
    }
    assert_int_equal(slotmap_find(&m, 0), SLOT_NONE);
    arena_release(&arena);
}

/* --- timers ------------------------------------------------------------------- */

static uint64_t plain_due(const uint64_t *due, uint32_t count, uint32_t *id)
{
    uint64_t best = UINT64_MAX;
    for (uint32_t i = 0; i < count; i++) {
        if (due[i] < best) {
            best = due[i];
            *id = i;
        }
    }
    return best;
}

static void test_timers_fire_in_order(void **state)
{
    (void)state;
    enum { IDS = 50 };
    struct arena arena;
    arena_init(&arena);
    struct timers t;
    assert_int_equal(timers_init(&t, &arena, IDS), ERR_OK);
    uint64_t due[IDS];
    memset(due, 0xff, sizeof due);
    rng_state = 11;
    uint64_t now = 0;
    for (int step = 0; step < 50000; step++) {
        uint32_t id = (uint32_t)(rng() % IDS), first = UINT32_MAX;
        if (rng() % 4 == 0) {
            timers_stop(&t, id);
            due[id] = UINT64_MAX;
        } else {
            due[id] = now + rng() % 100;
            timers_set(&t, id, due[id]);
        }
        timers_check(&t);
        uint64_t earliest = plain_due(due, IDS, &first);
        assert_true(timers_due_ms(&t) == earliest);
        now += rng() % 3;
        if (earliest > now) {
            assert_int_equal(timers_pop(&t, now), UINT32_MAX);
            continue;
        }
        assert_int_equal(timers_pop(&t, now), first);
        due[first] = UINT64_MAX;
        assert_false(timers_running(&t, first));
    }
    arena_release(&arena);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_cellset_is_a_set),
        cmocka_unit_test(test_cellset_fill_holds_all),
        cmocka_unit_test(test_slotmap_finds_what_it_holds),
        cmocka_unit_test(test_timers_fire_in_order),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
