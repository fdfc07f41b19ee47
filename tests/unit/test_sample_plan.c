/* Plans: the ladder of blocks, what is written is read again, a crop takes its part, and what does
 * not fit is refused. And the allocation that makes them. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "common/sample_plan.h"
#include "master/allocate.h"

static struct job_spec spec_of(uint32_t width, uint32_t height, uint64_t max_spp)
{
    struct job_spec s;
    job_spec_init(&s);
    s.width = width;
    s.height = height;
    s.crop = (struct job_crop){0, 0, width, height};
    s.spp = max_spp;
    s.stop = JOB_STOP_ERROR;
    s.target_error = 0.1;
    return s;
}

/* Blocks of each half follow each other without gaps, and the sums agree. */
static void test_ladder(void **state)
{
    (void)state;
    const uint64_t spps[] = {4, 15, 16, 100, 65536, JOB_ADAPTIVE_SPP_MAX};
    for (size_t k = 0; k < sizeof spps / sizeof *spps; k++) {
        struct job_spec spec = spec_of(32, 32, spps[k]);
        struct job_blocks b = job_spec_blocks(&spec);
        uint64_t next[2][2] = {{0}};
        assert_true(b.count <= JOB_BLOCKS_MAX && b.pilot >= 2 && b.count > b.pilot);
        for (uint32_t i = 0; i < b.count; i++) {
            struct job_block block = job_block_at(&b, i);
            assert_int_equal(block.half, i & 1);
            assert_int_equal(block.pilot, i < b.pilot);
            assert_true(block.begin == next[block.pilot][block.half] && block.count > 0);
            next[block.pilot][block.half] += block.count;
            assert_true(job_blocks_samples(&b, i + 1) == next[0][0] + next[0][1]);
        }
        assert_true(next[0][0] + next[0][1] <= spps[k]);
        assert_true(next[1][0] + next[1][1] == job_pilot_samples(&b) &&
                    job_pilot_samples(&b) <= spps[k]);
        assert_true(2 * job_ladder((b.count - b.pilot) / 2 + 1) > spps[k]);
    }
}

static bool read_text(const char *text, struct sample_plan *out, struct diag_list *problems)
{
    struct json_get g;
    diag_init(problems);
    if (json_get_open(&g, text, strlen(text), "p.json", problems) != ERR_OK)
        return false;
    enum err e = sample_plan_read(&g, g.root, out);
    json_get_close(&g);
    return e == ERR_OK;
}

/* Written for a picture, read for it and for a crop of it: the same blocks in the same squares. */
static void test_round_trip(void **state)
{
    (void)state;
    for (int kept = 0; kept < 2; kept++) {
        struct job_spec spec = spec_of(100, 70, 256);
        struct job_blocks blocks = job_spec_blocks(&spec);
        struct grid grid, part;
        uint16_t limits[64], back[64];
        assert_int_equal(grid_init(&grid, &spec), ERR_OK);
        for (uint32_t i = 0; i < grid.cell_count; i++)
            limits[i] =
                (uint16_t)((kept ? 1 : blocks.pilot + 1) + i % (blocks.count - blocks.pilot));
        struct buf b;
        buf_init(&b);
        sample_plan_put(&b, &grid, &blocks, limits, kept);
        buf_put_u8(&b, 0);
        assert_int_equal(buf_status(&b), ERR_OK);
        struct sample_plan plan;
        struct diag_list problems;
        uint32_t x, y;
        assert_true(read_text((const char *)b.data, &plan, &problems));
        assert_true(plan.pilot_kept == kept && plan.max_spp == 256);
        assert_true(sample_plan_limits(&plan, &grid, &blocks, back, &x, &y));
        assert_memory_equal(back, limits, grid.cell_count * sizeof *limits);

        spec.crop = (struct job_crop){37, 20, 30, 41};
        assert_int_equal(grid_init(&part, &spec), ERR_OK);
        assert_true(sample_plan_limits(&plan, &part, &blocks, back, &x, &y));
        for (uint32_t i = 0; i < part.cell_count; i++) {
            struct grid_rect r = grid_cell(&part, i);
            for (uint32_t k = 0; k < grid.cell_count; k++) {
                struct grid_rect of = grid_cell(&grid, k);
                bool same = of.x / GRID_SQUARE == r.x / GRID_SQUARE &&
                            of.y / GRID_SQUARE == r.y / GRID_SQUARE;
                if (same)
                    assert_int_equal(limits[k], back[i]);
            }
        }
        grid_release(&part);

        struct job_spec larger = spec_of(200, 70, 256);
        assert_int_equal(grid_init(&part, &larger), ERR_OK);
        assert_false(sample_plan_limits(&plan, &part, &blocks, back, &x, &y));
        assert_true(x >= 112 && y < 70);
        grid_release(&part);
        plan.spp[0] = 7; /* no number of blocks gives it */
        assert_false(sample_plan_limits(&plan, &grid, &blocks, back, &x, &y));
        sample_plan_release(&plan);
        diag_release(&problems);
        buf_release(&b);
        grid_release(&grid);
    }
}

static void test_refused(void **state)
{
    (void)state;
    static const char *const bad[] = {
        "[]",
        "{}",
        "{\"job\":\"j1\",\"state\":\"done\"}",
        "{\"plan\":null}",
        "{\"columns\":2,\"rows\":2,\"max_spp\":64,\"pilot\":\"kept\",\"spp\":[4,4,4]}",
        "{\"columns\":2,\"rows\":1,\"max_spp\":64,\"pilot\":\"kept\",\"spp\":[4,-4]}",
        "{\"columns\":2,\"rows\":1,\"max_spp\":64,\"pilot\":\"kept\",\"spp\":[4,4.5]}",
        "{\"columns\":2,\"rows\":1,\"max_spp\":2,\"pilot\":\"kept\",\"spp\":[4,4]}",
        "{\"columns\":2,\"rows\":1,\"max_spp\":64,\"pilot\":\"lost\",\"spp\":[4,4]}",
        "{\"square\":8,\"columns\":2,\"rows\":1,\"max_spp\":64,\"pilot\":\"kept\",\"spp\":[4,4]}",
        "{\"columns\":2,\"rows\":1,\"max_spp\":64,\"pilot\":\"kept\",\"spp\":[4,4],\"more\":1}",
        "{\"columns\":4096,\"rows\":4096,\"max_spp\":64,\"pilot\":\"kept\",\"spp\":[4]}",
    };
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        struct sample_plan plan;
        struct diag_list problems;
        assert_false(read_text(bad[i], &plan, &problems));
        assert_true(problems.error_count > 0);
        diag_release(&problems);
    }
}

/* Two kinds of squares, one with 16 times the variance: 16^0.4 = 3.03 times the samples, and about
 * the work of the best allocation there is. */
static void test_allocation(void **state)
{
    (void)state;
    struct job_spec spec = spec_of(160, 160, 65536);
    struct job_blocks blocks = job_spec_blocks(&spec);
    struct grid grid;
    double terms[100], squares[100];
    float shares[100], scratch[100];
    uint16_t limits[100];
    assert_int_equal(grid_init(&grid, &spec), ERR_OK);
    for (uint32_t i = 0; i < grid.cell_count; i++) {
        terms[i] = 256 * (grid_cell(&grid, i).x < 80 ? 0.16 : 0.01);
        squares[i] = terms[i] * terms[i] / 256;
    }
    allocate_shares(&grid, terms, squares, shares, scratch);
    for (uint32_t i = 0; i < grid.cell_count; i++) {
        uint32_t x = grid_cell(&grid, i).x;
        if (x < 64 || x >= 96) /* elsewhere neighbours differ */
            assert_true(fabs((double)shares[i] - (x < 80 ? 1.504 : 0.496)) < 0.15);
    }
    assert_true(allocate_gain(&grid, terms, shares) < 0.78 &&
                allocate_gain(&grid, terms, shares) > 0.73); /* exact: 0.735 */
    double mean = allocate_mean_for(&grid, &blocks, terms, shares, 1, 1e-3, limits);
    assert_true(allocate_limits(&grid, &blocks, shares, mean, 0, limits));
    double predicted = allocate_predict(&grid, &blocks, terms, 1, limits);
    assert_true(predicted <= 1e-3 && predicted > 0.8e-3);
    double work = 0;
    for (uint32_t i = 0; i < grid.cell_count; i++)
        work += (double)job_blocks_samples(&blocks, limits[i]) / grid.cell_count;
    double pilot = (double)job_pilot_samples(&blocks);
    double perfect = (0.5 * (0.4 + 0.1)) * (0.5 * (0.4 + 0.1)) * pilot / 1e-3;
    assert_true(work < 1.15 * perfect && work > 0.95 * perfect);
    /* Where error falls with the square of the samples, the ratio to the pilot is the root. */
    double few = allocate_mean_for(&grid, &blocks, terms, shares, 2, 1e-3, limits);
    assert_true(allocate_limits(&grid, &blocks, shares, few, 0, limits));
    predicted = allocate_predict(&grid, &blocks, terms, 2, limits);
    assert_true(predicted <= 1e-3 && predicted > 0.6e-3);
    assert_true(few > pilot && few < 1.2 * sqrt(mean * pilot));
    assert_false(allocate_limits(&grid, &blocks, shares, 1e9, 0, limits)); /* all at the end */
    grid_release(&grid);
}

/* A square whose error lies in one pixel is believed a third, and the others to it as little as
 * they are sure: where all is measured well, a bright square stays a square. */
static void test_spikes_are_shared(void **state)
{
    (void)state;
    struct job_spec spec = spec_of(80, 80, 65536);
    struct grid grid;
    double terms[25], squares[25];
    float sure[25], spike[25], scratch[25];
    assert_int_equal(grid_init(&grid, &spec), ERR_OK);
    uint32_t middle = 0, beside = 0;
    for (uint32_t i = 0; i < grid.cell_count; i++) {
        struct grid_rect r = grid_cell(&grid, i);
        middle = r.x == 32 && r.y == 32 ? i : middle;
        beside = r.x == 48 && r.y == 32 ? i : beside;
        terms[i] = r.x == 32 && r.y == 32 ? 256 * 0.32 : 256 * 0.01;
        squares[i] = terms[i] * terms[i] / 256;
    }
    allocate_shares(&grid, terms, squares, sure, scratch);
    squares[middle] = terms[middle] * terms[middle];
    allocate_shares(&grid, terms, squares, spike, scratch);
    /* 32^0.4 = 4 times what is around it; a third of that and two thirds of 1 are 2. */
    assert_true(fabs((double)(sure[middle] / sure[beside]) - 4) < 0.1);
    assert_true(fabs((double)(spike[middle] / spike[beside]) - 2) < 0.1);
    /* Where the pilot saw nothing, a third is its own, and that is nothing. */
    terms[middle] = squares[middle] = 0;
    allocate_shares(&grid, terms, squares, sure, scratch);
    assert_true(fabs((double)(sure[middle] / sure[beside]) - 0.667) < 0.02);
    grid_release(&grid);
}

/* Plans go by whole sets of well spread samples and halfway, and never far from what is asked. */
static void test_plan_steps(void **state)
{
    (void)state;
    struct job_spec spec = spec_of(16, 16, 5000);
    struct job_blocks blocks = job_spec_blocks(&spec);
    struct grid grid;
    assert_int_equal(grid_init(&grid, &spec), ERR_OK);
    uint64_t last = job_blocks_samples(&blocks, blocks.count), before = 0;
    for (double mean = 1; mean < 20000; mean *= 1.01) {
        const float share = 1;
        uint16_t limit;
        bool more = allocate_limits(&grid, &blocks, &share, mean, 0, &limit);
        uint64_t spp = job_blocks_samples(&blocks, limit), odd = spp;
        while (odd % 2 == 0)
            odd /= 2;
        assert_true(odd == 1 || odd == 3 || spp == last);
        assert_true(spp >= before && more == (spp < last));
        double near = mean < 8 ? 1.42 : 1.23; /* the ladder begins with 4 and 8 */
        if (mean >= 4 && mean <= (double)last)
            assert_true((double)spp < near * mean && mean < near * (double)spp);
        before = spp;
    }
    assert_true(before == last);
    grid_release(&grid);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_ladder),
        cmocka_unit_test(test_round_trip),
        cmocka_unit_test(test_refused),
        cmocka_unit_test(test_allocation),
        cmocka_unit_test(test_spikes_are_shared),
        cmocka_unit_test(test_plan_steps),
    };
    return cmocka_run_group_tests_name("sample_plan", tests, NULL, NULL);
}
