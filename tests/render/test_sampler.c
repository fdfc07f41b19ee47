/* The samplers: in range, stratified, uncorrelated between dimensions, pixels and halves. */
#include "tests/numerics/rows.h"

#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "worker/render/sampler_parts.h"
#include "worker/render/sobol.h"

enum { DIMENSIONS = 256, SETS = DIMENSIONS / SAMPLER_SET_VALUES };

static const enum job_sampler types[] = {JOB_SAMPLER_SOBOL, JOB_SAMPLER_HALTON,
                                         JOB_SAMPLER_INDEPENDENT};

/* values[d * count + i]: dimension d of sample i, minus 1/2. */
static void fill(enum job_sampler type, uint32_t x, uint32_t half, size_t count, double *values)
{
    for (size_t i = 0; i < count; i++) {
        struct sampler s = sampler_of(type, 1, x, 3, half, i);
        for (uint32_t set = 0; set < SETS; set++) {
            double u[SAMPLER_SET_VALUES];
            sampler_set(&s, set, u);
            for (size_t k = 0; k < SAMPLER_SET_VALUES; k++) {
                assert_true(u[k] >= 0 && u[k] < 1);
                values[(set * SAMPLER_SET_VALUES + k) * count + i] = u[k] - 0.5;
            }
        }
    }
}

/* Sets far apart are others: dimensions have more bits than sets. They had not. */
static void far_sets_have_dimensions_of_their_own(void **state)
{
    (void)state;
    for (size_t t = 0; t < 3; t++) {
        struct sampler s = sampler_of(types[t], 1, 2, 3, 0, 5);
        for (uint32_t far = 0; far < 2; far++) {
            double near_u[SAMPLER_SET_VALUES], far_u[SAMPLER_SET_VALUES];
            sampler_set(&s, 2, near_u);
            sampler_set(&s, 2 + (UINT32_C(1) << (30 + far)), far_u);
            for (int k = 0; k < SAMPLER_SET_VALUES; k++)
                assert_true(near_u[k] != far_u[k]);
        }
    }
}

static double correlation(const double *a, const double *b, size_t count)
{
    double ab = 0, aa = 0, bb = 0;
    for (size_t i = 0; i < count; i++) {
        ab += a[i] * b[i];
        aa += a[i] * a[i];
        bb += b[i] * b[i];
    }
    return ab / sqrt(aa * bb);
}

/* T23: over `pixels` independent scrambles, the mean correlation of each pair of dimensions stays
 * within what chance gives. A sampler that used one dimension twice has correlation 1. */
static void test_t23_pairs(void **state)
{
    (void)state;
    static const size_t counts[] = {16, 256, 1024, 4096};
    for (size_t t = 0; t < 3; t++) {
        for (size_t c = 0; c < (rows_long ? 4 : 2); c++) {
            enum { PIXELS = 16 };
            size_t n = counts[c];
            double *values = mem_alloc_array(DIMENSIONS * n, sizeof *values);
            double *sums = mem_calloc(DIMENSIONS * DIMENSIONS, sizeof *sums);
            assert_non_null(values);
            assert_non_null(sums);
            for (uint32_t pixel = 0; pixel < PIXELS; pixel++) {
                fill(types[t], pixel, 0, n, values);
                for (size_t a = 0; a < DIMENSIONS; a++)
                    for (size_t b = 0; b < a; b++)
                        sums[a * DIMENSIONS + b] += correlation(values + a * n, values + b * n, n);
            }
            /* 32,640 pairs: 6 sigma is a chance of 1e-4 over all of them. */
            double bound = 6 / sqrt((double)n * PIXELS);
            for (size_t a = 0; a < DIMENSIONS; a++)
                for (size_t b = 0; b < a; b++)
                    assert_true(fabs(sums[a * DIMENSIONS + b] / PIXELS) <= bound);
            mem_free(values);
            mem_free(sums);
        }
    }
}

/* The same statistic sees a sampler that draws one dimension twice. */
static void test_t23_dropped_dimension_fails(void **state)
{
    (void)state;
    enum { N = 256, PIXELS = 16 };
    double *values = mem_alloc_array(DIMENSIONS * N, sizeof *values), sum = 0;
    assert_non_null(values);
    for (uint32_t pixel = 0; pixel < PIXELS; pixel++) {
        fill(JOB_SAMPLER_SOBOL, pixel, 0, N, values);
        memcpy(values + 7 * N, values + 6 * N, N * sizeof *values);
        sum += correlation(values + 7 * N, values + 6 * N, N);
    }
    assert_true(sum / PIXELS > 6 / sqrt((double)N * PIXELS));
    mem_free(values);
}

/* Between halves and between neighbouring pixels nothing is shared. One pair of scrambles of the
 * same structure may correlate by anything up to 1; the mean over many must not. */
static void halves_and_pixels_are_independent(void **state)
{
    (void)state;
    enum { N = 16, REPEATS = 256 };
    double *a = mem_alloc_array(DIMENSIONS * N, sizeof *a);
    double *b = mem_alloc_array(DIMENSIONS * N, sizeof *b);
    for (size_t t = 0; t < 3; t++) {
        for (int other_half = 0; other_half < 2; other_half++) {
            double sum[DIMENSIONS] = {0};
            for (uint32_t r = 0; r < REPEATS; r++) {
                fill(types[t], 2 * r, 0, N, a);
                fill(types[t], 2 * r + (other_half ? 0 : 1), other_half ? 1 : 0, N, b);
                for (size_t d = 0; d < DIMENSIONS; d++)
                    sum[d] += correlation(a + d * N, b + d * N, N) / REPEATS;
            }
            for (size_t d = 0; d < DIMENSIONS; d++)
                assert_true(fabs(sum[d]) <= 6 / sqrt((double)REPEATS));
        }
    }
    mem_free(a);
    mem_free(b);
}

/* Any aligned run of 2^k samples has one value in each of 2^k intervals, in every dimension, and
 * the first two of a set one in each elementary box. */
static void sobol_is_a_net(void **state)
{
    (void)state;
    enum { LOG = 6, N = 1 << LOG };
    static const uint64_t begins[] = {
        0, N, 65536 - N, 65536, UINT64_C(1) << 32, (UINT64_C(1) << 40) + 3 * N};
    for (size_t run = 0; run < sizeof begins / sizeof *begins; run++) {
        for (uint32_t set = 0; set < 8; set++) {
            bool seen[SAMPLER_SET_VALUES][N] = {{0}}, boxes[LOG + 1][N] = {{0}};
            for (uint64_t i = 0; i < N; i++) {
                struct sampler s = sampler_of(JOB_SAMPLER_SOBOL, 9, 5, 6, 1, begins[run] + i);
                double u[SAMPLER_SET_VALUES];
                sampler_set(&s, set, u);
                for (size_t k = 0; k < SAMPLER_SET_VALUES; k++) {
                    size_t at = (size_t)(u[k] * N);
                    assert_false(seen[k][at]);
                    seen[k][at] = true;
                }
                for (uint32_t split = 0; split <= LOG; split++) {
                    size_t x = (size_t)(u[0] * (1u << split));
                    size_t y = (size_t)(u[1] * (1u << (LOG - split)));
                    assert_false(boxes[split][x << (LOG - split) | y]);
                    boxes[split][x << (LOG - split) | y] = true;
                }
            }
        }
    }
}

static uint32_t reversed(uint32_t v)
{
    uint32_t r = 0;
    for (int i = 0; i < 32; i++)
        r |= (v >> i & 1) << (31 - i);
    return r;
}

/* The table is what Joe and Kuo's numbers give. */
static void sobol_table_follows_the_recurrence(void **state)
{
    (void)state;
    static const uint32_t degree[4] = {0, 1, 2, 3}, inner[4] = {0, 0, 1, 1};
    static const uint32_t first[4][3] = {{0}, {1}, {1, 3}, {1, 3, 1}};
    for (size_t d = 0; d < 4; d++) {
        uint32_t v[32];
        for (uint32_t i = 0; i < 32; i++) {
            uint32_t s = degree[d];
            if (d == 0)
                v[i] = 1u << (31 - i);
            else if (i < s)
                v[i] = first[d][i] << (31 - i);
            else {
                v[i] = v[i - s] ^ v[i - s] >> s;
                for (uint32_t k = 1; k < s; k++)
                    v[i] ^= (inner[d] >> (s - 1 - k) & 1) * v[i - k];
            }
        }
        for (uint32_t digit = 0; digit < 8; digit++) {
            for (uint32_t value = 0; value < 16; value++) {
                uint32_t x = 0;
                for (uint32_t bit = 0; bit < 4; bit++)
                    x ^= (value >> bit & 1) * v[4 * digit + bit];
                assert_int_equal(sobol_digits[digit][value][d], reversed(x));
            }
        }
    }
}

/* Halton's first digits of each dimension go through all values before any comes again. */
static void halton_is_stratified(void **state)
{
    (void)state;
    static const uint32_t base[4] = {2, 3, 5, 7};
    for (uint32_t k = 0; k < 4; k++) {
        uint32_t seen = 0;
        for (uint64_t i = 0; i < base[k]; i++) {
            struct sampler s = sampler_of(JOB_SAMPLER_HALTON, 4, 1, 1, 0, i);
            double u[SAMPLER_SET_VALUES];
            sampler_set(&s, 0, u);
            seen |= 1u << (uint32_t)(u[k] * base[k]);
        }
        assert_int_equal(seen, (1u << base[k]) - 1);
    }
}

/* Indices at and beyond 2^31 and 2^32 are as good as any. */
static void test_t22_indices(void **state)
{
    (void)state;
    for (size_t t = 0; t < 3; t++) {
        double last = -1;
        for (uint64_t i = 0; i < 64; i++) {
            static const uint64_t bases[] = {0x7ffffff0u, 0xfffffff0u, UINT64_C(1) << 39};
            struct sampler s = sampler_of(types[t], 1, 65534, 65534, 1, bases[i % 3] + i);
            double u[SAMPLER_SET_VALUES];
            sampler_set(&s, 1u << 20, u);
            assert_true(u[0] >= 0 && u[0] < 1 && u[0] != last);
            last = u[0];
        }
    }
}

enum { MANY = 101 };

/* Samples as a wave has them; with `far`, beyond 2^16 and beyond 2^32 among them. */
static void many_samplers(enum job_sampler type, bool far, struct sampler s[MANY])
{
    for (uint32_t i = 0; i < MANY; i++) {
        uint64_t index = i < 50 ? i : (uint64_t)i * 655;
        if (far && i % 7 == 6)
            index = i % 2 ? UINT64_C(0xfffffffb0) + i : 65536 + i;
        s[i] = sampler_of(type, 3, i / 4, 11, i & 1, index);
    }
}

static void assert_same_sets(const struct sampler s[], uint32_t count, uint32_t set,
                             uint32_t values, double u[][MANY])
{
    for (uint32_t i = 0; i < count; i++) {
        double one[SAMPLER_SET_VALUES];
        sampler_some(&s[i], set, values, one);
        for (uint32_t k = 0; k < values; k++)
            assert_memory_equal(&one[k], &u[k][i], sizeof one[k]);
    }
}

/* Many at once have the bits of each alone. */
static void sets_of_many(void **state)
{
    (void)state;
    static const uint32_t sets[] = {0, 1, 63, 64, 1u << 29};
    struct sampler s[MANY];
    double u[SAMPLER_SET_VALUES][MANY];
    double *const out[SAMPLER_SET_VALUES] = {u[0], u[1], u[2], u[3]};
    for (size_t t = 0; t < 3 * 2; t++) {
        many_samplers(types[t / 2], t & 1, s);
        for (size_t k = 0; k < sizeof sets / sizeof *sets; k++) {
            sampler_sets(s, MANY, sets[k], 2, out);
            assert_same_sets(s, MANY, sets[k], 2, u);
            sampler_sets(s, MANY, sets[k], 4, out);
            assert_same_sets(s, MANY, sets[k], 4, u);
        }
    }
}

/* The Halton kernels; `seed` varies the keys. */
static void assert_halton_kernels(const struct sampler near[], const struct sampler far[],
                                  uint32_t dimension, uint32_t base, uint64_t seed)
{
    struct sampler s[MANY];
    double u[SAMPLER_SET_VALUES];
    for (uint32_t i = 0; i < MANY; i++)
        s[i] = (struct sampler){sampler_mix(near[i].key + seed), near[i].index, JOB_SAMPLER_HALTON};
    for (int wide = 0; wide < 2; wide++) {
        double out[MANY];
        if (wide ? !sampler_has_avx512() : !sampler_has_avx2())
            continue;
        assert_int_equal(wide ? sampler_halton_avx512(s, MANY, dimension, base, out)
                              : sampler_halton_avx2(s, MANY, dimension, base, out),
                         96);
        for (uint32_t i = 0; i < 96; i++) {
            sampler_set(&s[i], dimension / SAMPLER_SET_VALUES, u);
            assert_memory_equal(&out[i], &u[dimension % SAMPLER_SET_VALUES], sizeof *u);
        }
        assert_int_equal(wide ? sampler_halton_avx512(far, MANY, dimension, base, out)
                              : sampler_halton_avx2(far, MANY, dimension, base, out),
                         0);
    }
}

/* Every kernel that runs here does all whole vectors of near samples, and stops before a far one.
 */
static void kernels_give_the_same_bits(void **state)
{
    (void)state;
    struct sampler near[MANY], far[MANY];
    double u[SAMPLER_SET_VALUES][MANY];
    double *const out[SAMPLER_SET_VALUES] = {u[0], u[1], u[2], u[3]};
    many_samplers(JOB_SAMPLER_SOBOL, false, near);
    many_samplers(JOB_SAMPLER_SOBOL, true, far);
    for (uint32_t set = 0; set < 40; set++) {
        static const uint32_t bases[4] = {2, 3, 13, 1619};
        static const uint32_t dimensions[4] = {0, 1, 5, 255};
        assert_halton_kernels(near, far, dimensions[set % 4], bases[set % 4], set);
        if (sampler_has_avx2()) {
            assert_int_equal(sampler_sobol_avx2(near, MANY, set, out), 96);
            assert_same_sets(near, 96, set, 4, u);
            assert_int_equal(sampler_sobol_avx2(far, MANY, set, out), 0);
        }
        if (sampler_has_avx512()) {
            assert_int_equal(sampler_sobol_avx512(near, MANY, set, out), 96);
            assert_same_sets(near, 96, set, 4, u);
            assert_int_equal(sampler_sobol_avx512(far, MANY, set, out), 0);
        }
    }
}

int main(int argc, char **argv)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(far_sets_have_dimensions_of_their_own),
        cmocka_unit_test(test_t23_pairs),
        cmocka_unit_test(test_t23_dropped_dimension_fails),
        cmocka_unit_test(halves_and_pixels_are_independent),
        cmocka_unit_test(sobol_is_a_net),
        cmocka_unit_test(sobol_table_follows_the_recurrence),
        cmocka_unit_test(halton_is_stratified),
        cmocka_unit_test(test_t22_indices),
        cmocka_unit_test(sets_of_many),
        cmocka_unit_test(kernels_give_the_same_bits),
    };
    return ROWS_RUN(argc, argv, tests);
}
