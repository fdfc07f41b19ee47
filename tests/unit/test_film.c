/* Film: any order of arrival gives the same bits; what waits, resets, readers, saving. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "common/mem.h"
#include "master/film.h"

enum { UNITS_MAX = 4096 };

struct rig {
    struct job_spec spec;
    struct job_blocks blocks;
    struct grid grid;
    struct unit units[UNITS_MAX];
    uint32_t unit_count;
};

static uint64_t random_next(uint64_t *state)
{
    *state = *state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    uint64_t x = *state ^ (*state >> 33);
    return x * UINT64_C(0xff51afd7ed558ccd) >> 11;
}

/* Cuts every block into runs of 1..4 cells. */
static void rig_init(struct rig *r, uint32_t width, uint32_t height, uint64_t spp, uint64_t seed)
{
    job_spec_init(&r->spec);
    r->spec.width = width;
    r->spec.height = height;
    r->spec.crop = (struct job_crop){0, 0, width, height};
    r->spec.spp = spp;
    r->spec.tile = 8;
    r->blocks = job_blocks_of(spp);
    assert_int_equal(grid_init(&r->grid, &r->spec), ERR_OK);
    r->unit_count = 0;
    for (uint32_t block = 0; block < r->blocks.count; block++)
        for (uint32_t cell = 0; cell < r->grid.cell_count;) {
            uint32_t count = 1 + (uint32_t)(random_next(&seed) % 4);
            count = count < r->grid.cell_count - cell ? count : r->grid.cell_count - cell;
            assert_true(r->unit_count < UNITS_MAX);
            r->units[r->unit_count++] = (struct unit){cell, count, block};
            cell += count;
        }
}

/* Values that depend on pixel and block alone, so large and small that order shows in the sums. */
static float *unit_pixels(const struct rig *r, struct unit u)
{
    uint64_t pixels = grid_pixels(&r->grid, u.cell_begin, u.cell_count), at = 0;
    float *rgb = mem_alloc_array(pixels, FILM_CHANNELS * sizeof(float));
    assert_non_null(rgb);
    for (uint32_t i = 0; i < u.cell_count; i++) {
        struct grid_rect rect = grid_cell(&r->grid, u.cell_begin + i);
        for (uint32_t p = 0; p < rect.width * rect.height; p++, at++)
            for (uint64_t c = 0; c < FILM_CHANNELS; c++) {
                uint64_t key = ((u.cell_begin + i) * 977 + p) * 31 + c + u.block * UINT64_C(7919);
                rgb[c * pixels + at] = ldexpf((float)(random_next(&key) % 16777216),
                                              (int)(random_next(&key) % 60) - 60);
            }
    }
    return rgb;
}

static void add(const struct rig *r, struct film *f, struct unit u)
{
    float *rgb = unit_pixels(r, u);
    assert_int_equal(film_add(f, u, rgb), ERR_OK);
}

static digest picture_digest(const struct rig *r, const struct film *f)
{
    size_t pixels = (size_t)r->spec.crop.width * r->spec.crop.height;
    float *rgb = mem_calloc(pixels, FILM_CHANNELS * sizeof(float));
    assert_non_null(rgb);
    film_picture(f, rgb);
    digest d = digest_of(rgb, pixels * FILM_CHANNELS * sizeof(float));
    mem_free(rgb);
    return d;
}

static void shuffle(struct rig *r, uint64_t seed)
{
    for (uint32_t i = r->unit_count; i > 1; i--) {
        uint32_t j = (uint32_t)(random_next(&seed) % i);
        struct unit swap = r->units[i - 1];
        r->units[i - 1] = r->units[j];
        r->units[j] = swap;
    }
}

static digest in_order(const struct rig *r)
{
    struct film *f;
    assert_int_equal(film_new(&r->grid, &r->blocks, &f), ERR_OK);
    for (uint32_t i = 0; i < r->unit_count; i++)
        add(r, f, r->units[i]);
    assert_true(film_complete(f));
    digest d = picture_digest(r, f);
    film_free(f);
    return d;
}

static void test_any_order(void **state)
{
    (void)state;
    for (uint64_t seed = 1; seed <= 8; seed++) {
        struct rig r;
        rig_init(&r, 61, 45, 100, seed);
        digest expected = in_order(&r);
        shuffle(&r, seed);
        struct film *f;
        assert_int_equal(film_new(&r.grid, &r.blocks, &f), ERR_OK);
        for (uint32_t i = 0; i < r.unit_count; i++) {
            assert_false(film_complete(f));
            assert_false(film_has_any(f, r.units[i]));
            add(&r, f, r.units[i]);
            assert_true(film_has_any(f, r.units[i]));
            film_check(f);
        }
        assert_true(film_complete(f));
        assert_int_equal(film_waiting_bytes(f), 0);
        digest found = picture_digest(&r, f);
        assert_true(digest_equal(&expected, &found));
        film_free(f);
        grid_release(&r.grid);
    }
}

static void test_pixel_value(void **state)
{
    (void)state;
    struct rig r;
    rig_init(&r, 9, 5, 3, 1);
    struct film *f;
    assert_int_equal(film_new(&r.grid, &r.blocks, &f), ERR_OK);
    assert_int_equal(r.blocks.count, 2);
    for (uint32_t i = 0; i < r.unit_count; i++) {
        uint64_t pixels = grid_pixels(&r.grid, r.units[i].cell_begin, r.units[i].cell_count);
        float *rgb = mem_alloc_array(pixels, 3 * sizeof(float));
        assert_non_null(rgb);
        for (uint64_t p = 0; p < 3 * pixels; p++)
            rgb[p] = (float)(p / pixels + 1) * (r.units[i].block ? 10.0F : 2.0F);
        assert_int_equal(film_add(f, r.units[i], rgb), ERR_OK);
    }
    float picture[9 * 5 * 3];
    film_picture(f, picture);
    for (int p = 0; p < 9 * 5; p++)
        for (int c = 0; c < 3; c++)
            assert_true(picture[p * 3 + c] == (float)(12.0 * (c + 1) / 3.0));
    struct film_error e;
    film_error_estimate(f, &e);
    assert_true(e.known && e.relmse > 0 && e.relmse_low <= e.relmse && e.relmse <= e.relmse_high);
    assert_true(fabs(e.mean - 8.0) < 1e-12);
    film_free(f);
    grid_release(&r.grid);
}

static void test_twice_is_refused(void **state)
{
    (void)state;
    struct rig r;
    rig_init(&r, 32, 32, 4, 2);
    struct film *f;
    assert_int_equal(film_new(&r.grid, &r.blocks, &f), ERR_OK);
    add(&r, f, (struct unit){2, 3, 0});
    digest before = picture_digest(&r, f);
    for (uint32_t begin = 0; begin < 5; begin++) {
        struct unit u = {begin, 5 - begin, 0};
        float *rgb = unit_pixels(&r, u);
        assert_int_equal(film_add(f, u, rgb), ERR_STATE);
        mem_free(rgb);
    }
    digest after = picture_digest(&r, f);
    assert_true(digest_equal(&before, &after));
    film_free(f);
    grid_release(&r.grid);
}

/* While somebody reads, nothing changes under his eyes; after, all is there. */
static void test_readers(void **state)
{
    (void)state;
    struct rig r;
    rig_init(&r, 40, 40, 64, 3);
    digest expected = in_order(&r);
    shuffle(&r, 9);
    struct film *f;
    assert_int_equal(film_new(&r.grid, &r.blocks, &f), ERR_OK);
    for (uint32_t i = 0; i < r.unit_count; i++) {
        if (i % 7 == 0)
            film_read_begin(f);
        digest before = picture_digest(&r, f);
        add(&r, f, r.units[i]);
        if (i % 7 < 3) {
            digest after = picture_digest(&r, f);
            assert_true(digest_equal(&before, &after));
        }
        /* What is held is not in a file that is saved now: a checkpoint must wait. */
        assert_int_equal(film_holds(f), i % 7 <= 3);
        if (i % 7 == 3 || (i + 1 == r.unit_count && i % 7 < 3))
            film_read_end(f);
        film_check(f);
    }
    digest found = picture_digest(&r, f);
    assert_true(film_complete(f) && digest_equal(&expected, &found));
    film_free(f);
    grid_release(&r.grid);
}

/* --- Reset -------------------------------------------------------------- */

static void test_reset(void **state)
{
    (void)state;
    for (uint64_t seed = 1; seed <= 6; seed++) {
        struct rig r;
        rig_init(&r, 48, 33, 80, seed);
        digest expected = in_order(&r);
        shuffle(&r, seed * 3);
        struct film *f;
        assert_int_equal(film_new(&r.grid, &r.blocks, &f), ERR_OK);
        uint32_t half = r.unit_count / 2, begin = 3, count = 5;
        for (uint32_t i = 0; i < half; i++)
            add(&r, f, r.units[i]);
        bool reading = seed % 2 == 0;
        if (reading)
            film_read_begin(f);
        assert_int_equal(film_reset(f, begin, count), ERR_OK);
        for (uint32_t block = 0; block < r.blocks.count; block++)
            assert_false(film_has_any(f, (struct unit){begin, count, block}));
        /* What the cells had comes again, cell by cell; the rest as it comes. */
        for (uint32_t i = 0; i < r.unit_count; i++)
            for (uint32_t c = 0; c < r.units[i].cell_count; c++) {
                struct unit one = {r.units[i].cell_begin + c, 1, r.units[i].block};
                if (!film_has_any(f, one))
                    add(&r, f, one);
            }
        if (reading)
            film_read_end(f);
        film_check(f);
        digest found = picture_digest(&r, f);
        assert_true(film_complete(f) && digest_equal(&expected, &found));
        film_free(f);
        grid_release(&r.grid);
    }
}

/* --- Saving ------------------------------------------------------------- */

struct memory {
    unsigned char data[1 << 20];
    size_t bytes, at;
};

static enum err memory_write(void *ctx, const void *data, size_t bytes)
{
    struct memory *m = ctx;
    assert_true(bytes <= sizeof m->data - m->bytes);
    memcpy(m->data + m->bytes, data, bytes);
    m->bytes += bytes;
    return ERR_OK;
}

static enum err memory_read(void *ctx, void *data, size_t bytes)
{
    struct memory *m = ctx;
    if (bytes > m->bytes - m->at)
        return ERR_CORRUPT;
    memcpy(data, m->data + m->at, bytes);
    m->at += bytes;
    return ERR_OK;
}

static struct memory memory;

/* Takes the film; gives it as it comes back. */
static struct film *save_and_load(struct film *f, const struct rig *r)
{
    struct film *again;
    memory.bytes = memory.at = 0;
    assert_int_equal(film_save(f, memory_write, &memory), ERR_OK);
    assert_int_equal(film_load(&r->grid, &r->blocks, memory_read, &memory, &again), ERR_OK);
    film_check(again);
    assert_int_equal(film_present_count(again), film_present_count(f));
    film_free(f);
    return again;
}

static void test_save_and_go_on(void **state)
{
    (void)state;
    struct rig r;
    rig_init(&r, 45, 37, 90, 4);
    digest expected = in_order(&r);
    shuffle(&r, 11);
    struct film *f;
    assert_int_equal(film_new(&r.grid, &r.blocks, &f), ERR_OK);
    for (uint32_t i = 0; i < r.unit_count; i++) {
        add(&r, f, r.units[i]);
        if (i % 5 != 0)
            continue;
        f = save_and_load(f, &r);
    }
    digest found = picture_digest(&r, f);
    assert_true(film_complete(f) && digest_equal(&expected, &found));
    film_free(f);
    grid_release(&r.grid);
}

/* Cut or foreign bytes are refused, whatever they are. */
static void test_load_damaged(void **state)
{
    (void)state;
    struct rig r;
    rig_init(&r, 20, 12, 40, 5);
    shuffle(&r, 5);
    struct film *f, *again = NULL;
    assert_int_equal(film_new(&r.grid, &r.blocks, &f), ERR_OK);
    for (uint32_t i = 0; i < r.unit_count / 2; i++)
        add(&r, f, r.units[i]);
    memory.bytes = 0;
    assert_int_equal(film_save(f, memory_write, &memory), ERR_OK);
    size_t whole = memory.bytes;
    for (size_t bytes = 0; bytes < whole; bytes += 1 + bytes / 16) {
        memory.bytes = bytes;
        memory.at = 0;
        assert_int_not_equal(film_load(&r.grid, &r.blocks, memory_read, &memory, &again), ERR_OK);
    }
    memory.bytes = whole;
    for (size_t i = 0; i < 28; i++) { /* what identifies it; the rest has its digest in the file */
        memory.data[i] ^= 1;
        memory.at = 0;
        assert_int_not_equal(film_load(&r.grid, &r.blocks, memory_read, &memory, &again), ERR_OK);
        memory.data[i] ^= 1;
    }
    film_free(f);
    grid_release(&r.grid);
}

/* Sums, means, counts and the error of a pixel, before and after a stay on disk. */
static void test_aovs(void **state)
{
    (void)state;
    struct rig r;
    rig_init(&r, 11, 7, 4, 6);
    grid_release(&r.grid);
    assert_true(aov_parse("object,albedo,samples,error", &r.spec.aov, NULL));
    assert_int_equal(grid_init(&r.grid, &r.spec), ERR_OK);
    assert_int_equal(r.grid.plane_count, 3 + 1 + 3);
    struct film *f, *plain;
    assert_int_equal(film_new(&r.grid, &r.blocks, &f), ERR_OK);
    enum { PIXELS = 11 * 7 };
    for (uint32_t block = 0; block < 2; block++) {
        float *values = mem_alloc_array(PIXELS, 7 * sizeof *values);
        assert_non_null(values);
        for (size_t i = 0; i < 7 * PIXELS; i++)
            values[i] = (float)(i / PIXELS + 8 * block);
        struct unit unit = {0, r.grid.cell_count, block};
        assert_int_equal(film_add(f, unit, values), ERR_OK);
        struct film *again;
        memory.bytes = memory.at = 0;
        assert_int_equal(film_save(f, memory_write, &memory), ERR_OK);
        assert_int_equal(film_load(&r.grid, &r.blocks, memory_read, &memory, &again), ERR_OK);
        film_free(f);
        f = again;
    }
    float out[PIXELS];
    film_aov(f, FILM_AOV_SUM, 3, out);
    assert_true(out[0] == 3 + 11 && out[PIXELS - 1] == 14);
    film_aov(f, FILM_AOV_MEAN, 6, out);
    assert_true(out[5] == (6 + 14) / 4.0f);
    film_aov(f, FILM_AOV_SAMPLES, 0, out);
    assert_true(out[5] == 4);
    /* Means (0 + 1 + 2) / 2 and (8 + 9 + 10) / 2: 12 apart, a third for each, halved. */
    film_aov(f, FILM_AOV_ERROR, 0, out);
    assert_true(fabsf(out[5] - 2) < 1e-6f);
    /* A film of another width is no such film. */
    struct job_spec narrow = r.spec;
    narrow.aov = 0;
    struct grid other;
    assert_int_equal(grid_init(&other, &narrow), ERR_OK);
    memory.at = 0;
    assert_int_equal(film_load(&other, &r.blocks, memory_read, &memory, &plain), ERR_CORRUPT);
    grid_release(&other);
    film_free(f);
    grid_release(&r.grid);
}

/* --- Cells with different numbers of blocks ---------------------------- */

/* A pilot that is dropped, kept or never rendered; then a plan of two stages; saved and loaded on
 * the way. The picture is that of the samples that count, whatever came between. */
static void planned_film(enum film_pilot pilot)
{
    struct rig r = {0};
    job_spec_init(&r.spec);
    r.spec.width = 40;
    r.spec.height = 40;
    r.spec.crop = (struct job_crop){0, 0, 40, 40};
    r.spec.spp = 64;
    r.spec.stop = JOB_STOP_TIME;
    r.spec.time_limit_s = 1;
    r.blocks = job_spec_blocks(&r.spec);
    assert_int_equal(grid_init(&r.grid, &r.spec), ERR_OK);
    assert_int_equal(r.grid.cell_count, 9);
    uint16_t limits[9], first[9];
    for (uint32_t cell = 0; cell < 9; cell++) {
        limits[cell] = (uint16_t)(r.blocks.pilot + 2 * (1 + cell % 3));
        first[cell] = (uint16_t)(r.blocks.pilot + 2);
    }
    struct film *f;
    assert_int_equal(film_new(&r.grid, &r.blocks, &f), ERR_OK);
    if (pilot == FILM_PILOT_SKIPPED) {
        assert_true(film_plan(f, limits, pilot));
    } else {
        assert_int_equal(film_total_count(f), 9 * r.blocks.pilot);
        for (uint32_t block = 0; block < r.blocks.pilot; block++)
            add(&r, f, (struct unit){0, 9, block});
        assert_true(film_complete(f));
        film_read_begin(f);
        assert_false(film_plan(f, first, pilot));
        film_read_end(f);
        assert_true(film_plan(f, first, pilot));
        assert_false(film_complete(f));
    }
    for (uint32_t block = r.blocks.pilot; block < r.blocks.count; block++) {
        if (block == r.blocks.pilot + 2) {
            assert_true(film_complete(f) == (pilot != FILM_PILOT_SKIPPED));
            assert_true(film_plan(f, limits, FILM_PILOT_DROPPED)); /* later calls decide nothing */
        }
        for (uint32_t cell = 0; cell < 9; cell++)
            if (block < limits[cell])
                add(&r, f, (struct unit){cell, 1, block});
        film_check(f);
        if (block == r.blocks.pilot + 1)
            f = save_and_load(f, &r);
    }
    assert_true(film_complete(f));
    assert_memory_equal(film_limits(f), limits, sizeof limits);

    float picture[40 * 40 * 3];
    film_picture(f, picture);
    uint64_t spp_min, spp_max;
    double spp_mean, kept = pilot == FILM_PILOT_KEPT ? 16 : 0;
    film_samples(f, &spp_min, &spp_mean, &spp_max);
    assert_true((double)spp_min == 4 + kept && (double)spp_max == 12 + kept);
    for (uint32_t cell = 0; cell < 9; cell++) {
        struct grid_rect rect = grid_cell(&r.grid, cell);
        double half[2] = {0}, samples = kept + (double)job_blocks_samples(&r.blocks, limits[cell]);
        for (uint32_t block = kept > 0 ? 0 : r.blocks.pilot; block < limits[cell]; block++) {
            float *rgb = unit_pixels(&r, (struct unit){cell, 1, block});
            half[block & 1] += (double)rgb[0];
            mem_free(rgb);
        }
        float expected = (float)((half[0] + half[1]) / samples);
        assert_true(picture[(rect.y * 40 + rect.x) * 3] == expected);
    }
    film_free(f);
    grid_release(&r.grid);
}

static void test_plan(void **state)
{
    (void)state;
    planned_film(FILM_PILOT_DROPPED);
    planned_film(FILM_PILOT_KEPT);
    planned_film(FILM_PILOT_SKIPPED);
}

/* --- Memory and error --------------------------------------------------- */

static void test_out_of_memory(void **state)
{
    (void)state;
    struct rig r;
    rig_init(&r, 32, 32, 40, 6);
    for (uint64_t n = 0;; n++) {
        struct film *f = NULL;
        mem_fail_after(n);
        enum err e = film_new(&r.grid, &r.blocks, &f);
        mem_fail_after(UINT64_MAX);
        if (e == ERR_OK) {
            assert_true(n > 3);
            film_free(f);
            break;
        }
        assert_int_equal(e, ERR_NOMEM);
    }
    struct film *f;
    assert_int_equal(film_new(&r.grid, &r.blocks, &f), ERR_OK);
    float *rgb = unit_pixels(&r, r.units[0]);
    mem_fail_after(0);
    assert_int_equal(film_add(f, r.units[0], rgb), ERR_NOMEM);
    mem_fail_after(UINT64_MAX);
    assert_false(film_has_any(f, r.units[0]));
    assert_int_equal(film_add(f, r.units[0], rgb), ERR_OK);
    film_free(f);
    grid_release(&r.grid);
}

/* The estimate from the halves is right on average, and its interval holds the truth: noise of a
 * known variance on a constant picture. */
static void test_error_estimate(void **state)
{
    (void)state;
    int inside = 0;
    double total = 0, truth_total = 0;
    enum { TRIALS = 100 };
    for (uint64_t trial = 1; trial <= TRIALS; trial++) {
        struct rig r;
        rig_init(&r, 48, 48, 32, trial);
        struct film *f;
        uint64_t seed = trial * 7919;
        assert_int_equal(film_new(&r.grid, &r.blocks, &f), ERR_OK);
        for (uint32_t i = 0; i < r.unit_count; i++) {
            uint64_t pixels = grid_pixels(&r.grid, r.units[i].cell_begin, r.units[i].cell_count);
            struct job_block block = job_block_at(&r.blocks, r.units[i].block);
            float *rgb = mem_alloc_array(pixels, 3 * sizeof(float));
            assert_non_null(rgb);
            for (uint64_t p = 0; p < 3 * pixels; p++) {
                double sum = 0; /* of samples that are uniform on [0, 2) */
                for (uint64_t s = 0; s < block.count; s++)
                    sum += (double)(random_next(&seed) % 1048576) / 524288.0;
                rgb[p] = (float)sum;
            }
            assert_int_equal(film_add(f, r.units[i], rgb), ERR_OK);
        }
        struct film_error e;
        film_error_estimate(f, &e);
        assert_true(e.known);
        float picture[48 * 48 * 3];
        film_picture(f, picture);
        double truth = 0;
        for (int i = 0; i < 48 * 48 * 3; i++)
            truth += ((double)picture[i] - 1) * ((double)picture[i] - 1) / 1.01;
        truth /= 48 * 48 * 3;
        truth_total += truth;
        total += e.relmse;
        /* Expected relMSE: variance 1/3 over 32 samples, over 1 + 0.01. */
        double expected = 1.0 / 3.0 / 32.0 / 1.01;
        inside += e.relmse_low <= expected * 1.02 && expected * 0.98 <= e.relmse_high;
        assert_true(e.mean_low < 1.02 && e.mean_high > 0.98);
        film_free(f);
        grid_release(&r.grid);
    }
    print_message("estimated %.6f, true %.6f, inside %d of %d\n", total / TRIALS,
                  truth_total / TRIALS, inside, (int)TRIALS);
    /* The picture itself in the denominator adds some per cent where noise is strong. */
    assert_true(total / truth_total > 0.99 && total / truth_total < 1.05);
    assert_true(inside >= 88);
}

/* What a pixel of a grey test picture sums up in a block; *seed is there for noise. */
typedef float pixel_sum(const struct job_block *block, uint32_t x, uint32_t y, uint32_t hits,
                        uint64_t *seed);

/* The error of such a picture. `hits`: for the pixels. */
static struct film_error grey_error(uint32_t side, uint64_t spp, uint64_t seed, pixel_sum *sum,
                                    uint32_t hits)
{
    struct rig r;
    struct film *f;
    struct film_error e;
    rig_init(&r, side, side, spp, 1);
    assert_int_equal(film_new(&r.grid, &r.blocks, &f), ERR_OK);
    for (uint32_t i = 0; i < r.unit_count; i++) {
        struct unit u = r.units[i];
        uint64_t pixels = grid_pixels(&r.grid, u.cell_begin, u.cell_count), at = 0;
        struct job_block block = job_block_at(&r.blocks, u.block);
        float *rgb = mem_alloc_array(pixels, 3 * sizeof(float));
        assert_non_null(rgb);
        for (uint32_t k = 0; k < u.cell_count; k++) {
            struct grid_rect rect = grid_cell(&r.grid, u.cell_begin + k);
            for (uint32_t p = 0; p < rect.width * rect.height; p++, at++) {
                float grey =
                    sum(&block, rect.x + p % rect.width, rect.y + p / rect.width, hits, &seed);
                for (uint64_t c = 0; c < 3; c++)
                    rgb[c * pixels + at] = grey;
            }
        }
        assert_int_equal(film_add(f, u, rgb), ERR_OK);
    }
    film_error_estimate(f, &e);
    assert_true(e.known && e.relmse > 0);
    film_free(f);
    grid_release(&r.grid);
    return e;
}

/* A uniform number in [0,1). */
static float noise_of(uint64_t *seed)
{
    return (float)(random_next(seed) % 1048576) / 1048576;
}

/* Is it the first block of half A? */
static bool is_first(const struct job_block *block)
{
    return block->half == 0 && block->begin == 0;
}

enum { BAR_SIDE = 48, BAR = 44, SPIKES_SIDE = 64 };

/* A dark picture with some noise and a bright bar at the right. `hits` dark pixels beside the bar
 * have one sample, of half A, that saw it: pixels that would hide behind themselves. */
static float bar_sum(const struct job_block *block, uint32_t x, uint32_t y, uint32_t hits,
                     uint64_t *seed)
{
    enum { STEP = 8 };
    const float dark = 0.02f, bright = 10;
    float noise = 2 * noise_of(seed);
    bool hit = x == BAR - 1 && y % STEP == 0 && y / STEP < hits;
    return (x < BAR ? dark * noise : bright) * (float)block->count +
           (hit && is_first(block) ? bright : 0);
}

static struct film_error bar_error(uint32_t hits)
{
    return grey_error(BAR_SIDE, 32, 5, bar_sum, hits);
}

/* A hit puts half A at 10 / 16 over half B: a variance of 0.098. Over the square of the dark pixels
 * around, with the floor of 0.0073, that is 13 of relMSE; were the pixel its own level, 0.9.
 * Nothing tells which, so six of 2,304 pixels make the error one that is not to be trusted. */
static void test_error_beside_bright(void **state)
{
    (void)state;
    struct film_error calm = bar_error(0), hit = bar_error(6);
    double each = (hit.relmse - calm.relmse) * 48 * 48 / 6;
    print_message("each %.3f, effective %.1f and %.1f\n", each, calm.effective, hit.effective);
    assert_true(each > 1.5 && each < 5);
    assert_true(calm.effective > 100 && hit.effective < FILM_EFFECTIVE_MIN);
}

/* A calm picture; `spikes` pixels have a hit of 1,000 in one sample of half A. */
static float spiky_sum(const struct job_block *block, uint32_t x, uint32_t y, uint32_t spikes,
                       uint64_t *seed)
{
    enum { STEP = 9 };
    float noise = 0.7f * noise_of(seed) - 0.35f;
    bool hit = x == y && x % STEP == 4 && x / STEP < spikes;
    return (float)block->count * (1 + noise) + (hit && is_first(block) ? 1000 : 0);
}

/* The same with noise in its first rows alone, and none elsewhere. */
static float part_sum(const struct job_block *block, uint32_t x, uint32_t y, uint32_t rows,
                      uint64_t *seed)
{
    float sum = spiky_sum(block, x, y, 0, seed);
    return y < rows ? sum : (float)block->count;
}

/* Noise in a small part of the picture is no heavy tail; a few spikes are, and never fewer than one
 * pixel carries an error. The interval says the same: a factor of exp(1.96 / sqrt(size)). */
static void test_effective_size(void **state)
{
    (void)state;
    struct film_error all = grey_error(SPIKES_SIDE, 16, 11, spiky_sum, 0),
                      part = grey_error(SPIKES_SIDE, 16, 11, part_sum, 4);
    print_message("effective size %.1f of 4096, %.1f of 256\n", all.effective, part.effective);
    assert_true(all.effective > 1000 && all.effective < 4096);
    assert_true(part.effective > 64 && part.effective < 256);
    for (uint32_t spikes = 1; spikes <= 6; spikes++) {
        struct film_error e = grey_error(SPIKES_SIDE, 16, 11, spiky_sum, spikes);
        double factor = exp(1.96 / sqrt(e.effective));
        print_message("%u spikes: %.2f\n", spikes, e.effective);
        assert_true(e.effective >= 1 && e.effective < 1.5 * spikes + 0.5);
        assert_true(fabs(e.relmse_high / e.relmse / factor - 1) < 1e-3);
        assert_true(fabs(e.relmse / e.relmse_low / factor - 1) < 1e-3);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_any_order),
        cmocka_unit_test(test_pixel_value),
        cmocka_unit_test(test_twice_is_refused),
        cmocka_unit_test(test_readers),
        cmocka_unit_test(test_reset),
        cmocka_unit_test(test_save_and_go_on),
        cmocka_unit_test(test_load_damaged),
        cmocka_unit_test(test_aovs),
        cmocka_unit_test(test_plan),
        cmocka_unit_test(test_out_of_memory),
        cmocka_unit_test(test_error_estimate),
        cmocka_unit_test(test_error_beside_bright),
        cmocka_unit_test(test_effective_size),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
