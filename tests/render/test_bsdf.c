/* Every bsdf: what is sampled has the density that is claimed (chi-square), eval, pdf and sample
 * agree, reciprocity holds, and no more light leaves than came. */
#include "tests/numerics/rows.h"

#include <math.h>
#include <string.h>

#include "common/dmath.h"
#include "common/mem.h"
#include "tests/render/stats.h"
#include "worker/render/conductor_parts.h"
#include "worker/render/gauss.h"
#include "worker/render/sampler.h"
#include "worker/render/warp.h"

/* The long form's map of the sphere; the short form has half as many cells each way. */
enum { ROWS_MAX = 80, COLUMNS_MAX = 160, CELLS_MAX = ROWS_MAX * COLUMNS_MAX, QUADRATURE = 6 };

static double random_value(uint64_t *state)
{
    *state += UINT64_C(0x9e3779b97f4a7c15);
    return (double)(sampler_mix(*state) >> 11) / 9007199254740992.0;
}

static struct material material_of(enum scene_material_type type)
{
    return (struct material){.type = type,
                             .texture = SCENE_NONE,
                             .color = {0.8, 0.7, 0.6},
                             .alpha_x = 0.3,
                             .alpha_y = 0.3,
                             .eta = 1.5,
                             .R = {1, 1, 1},
                             .T = {1, 1, 1},
                             .conductor_eta = {0.2, 0.92, 1.1},
                             .conductor_k = {3.9, 2.45, 2.14},
                             .roughness = 0.5,
                             .specular = 1,
                             .specular_color = {1, 1, 1},
                             .clearcoat_roughness = 0.3,
                             .sheen_alpha = 0.25};
}

/* The materials with a density, in variants. */
static size_t smooth_materials(struct material out[20])
{
    size_t n = 0;
    out[n++] = material_of(SCENE_MATERIAL_DIFFUSE);
    out[n] = material_of(SCENE_MATERIAL_DIFFUSE);
    out[n++].twosided = true;
    for (int k = 0; k < 4; k++) {
        out[n] = material_of(SCENE_MATERIAL_ROUGH_CONDUCTOR);
        out[n].distribution = k & 1 ? SCENE_GGX : SCENE_BECKMANN;
        out[n].alpha_x = k & 2 ? 0.15 : 0.5;
        out[n++].alpha_y = k & 2 ? 0.4 : 0.5;
    }
    for (int k = 0; k < 3; k++) {
        out[n] = material_of(SCENE_MATERIAL_ROUGH_DIELECTRIC);
        out[n].distribution = k & 1 ? SCENE_GGX : SCENE_BECKMANN;
        out[n++].eta = k & 2 ? 1 / 1.33 : 1.5;
    }
    for (int k = 0; k < 4; k++) {
        out[n] = material_of(SCENE_MATERIAL_PRINCIPLED);
        out[n].metallic = k == 1 ? 0.7 : 0;
        out[n].transmission = k == 2 ? 0.8 : 0;
        out[n].clearcoat = k == 3 ? 0.8 : 0;
        out[n].sheen_color = rgb_grey(k == 3 ? 0.9 : 0);
        principled_prepare(&out[n++]);
    }
    return n;
}

static struct bsdf bsdf_of(const struct material *m, rgb color)
{
    return (struct bsdf){.material = m,
                         .color = color,
                         .metallic = m->metallic,
                         .roughness = m->roughness,
                         .transmission = m->transmission};
}

static vec3 direction(double cosine, double turn)
{
    double s, c, sine = sqrt(1 - cosine * cosine);
    warp_sincos_turn(turn, &s, &c);
    return v3(sine * c, sine * s, cosine);
}

/* Tints and weights over 1 ask for more light than there is; what lies under them then gets none.
 * It got less than none: negative light. */
static void no_layer_takes_more_than_there_is(void **state)
{
    (void)state;
    for (int k = 0; k < 4; k++) {
        struct material m = material_of(SCENE_MATERIAL_PRINCIPLED);
        m.sheen_color = rgb_grey(k == 0 ? 20 : 0);
        m.specular = k == 1 ? 30 : 1;
        m.metallic = k == 2 ? 0.3 : 0;
        m.transmission = k == 3 ? 0.5 : 0;
        m.specular_color = k == 3 ? (rgb){1e3, 1, 0} : rgb_grey(1);
        principled_prepare(&m);
        struct bsdf b = bsdf_of(&m, k == 2 ? (rgb){9, 0.5, 0.1} : rgb_grey(0.7));
        for (int i = 0; i < 4096; i++) {
            double pdf;
            vec3 wo = direction((i % 16 + 0.5) / 16, 0.1);
            rgb f = bsdf_eval(&b, wo, direction((i / 16 % 16 - 7.5) / 8, (i / 256) / 16.0), &pdf);
            assert_true(f.r >= 0 && f.g >= 0 && f.b >= 0);
        }
    }
}

/* A map of the sphere in (cos theta, phi), and how many samples it gets. */
struct chi2_map {
    int rows, columns;
    size_t samples;
};

static struct chi2_map chi2_map(void)
{
    return rows_long ? (struct chi2_map){ROWS_MAX, COLUMNS_MAX, 1000000}
                     : (struct chi2_map){ROWS_MAX / 2, COLUMNS_MAX / 2, 300000};
}

/* Integral of the pdf over one cell, by the midpoint rule. */
static double cell_integral(const struct chi2_map *map, const struct bsdf *b, vec3 wo, int row,
                            int column)
{
    double sum = 0;
    for (int i = 0; i < QUADRATURE * QUADRATURE; i++) {
        double z = -1 + 2 * (row + (i % QUADRATURE + 0.5) / QUADRATURE) / map->rows;
        double pdf, turn = (column + (i / QUADRATURE + 0.5) / QUADRATURE) / map->columns;
        (void)bsdf_eval(b, wo, direction(z, turn), &pdf);
        assert_true(pdf >= 0);
        sum += pdf;
    }
    return sum / (QUADRATURE * QUADRATURE) * 4 * VEC_PI / (map->rows * map->columns);
}

static size_t cell_of(const struct chi2_map *map, vec3 w)
{
    int row = (int)((w.z + 1) / 2 * map->rows);
    double phi = dmath_atan2(w.y, w.x) / (2 * VEC_PI);
    int column = (int)((phi < 0 ? phi + 1 : phi) * map->columns);
    row = row < map->rows ? row : map->rows - 1;
    column = column < map->columns ? column : map->columns - 1;
    return (size_t)(row * map->columns + column);
}

/* How many standard deviations samples of `drawn` are off the density of `claimed`; 1e9 when one
 * lies where that is 0. */
static double samples_off(const struct chi2_map *map, const struct bsdf *drawn,
                          const struct bsdf *claimed, vec3 wo)
{
    static double expected[CELLS_MAX + 1], observed[CELLS_MAX + 1];
    int cells = map->rows * map->columns;
    memset(observed, 0, sizeof observed);
    double total = 0;
    for (int i = 0; i < cells; i++) {
        double p = cell_integral(map, claimed, wo, i / map->columns, i % map->columns);
        expected[i] = p * (double)map->samples;
        total += p;
    }
    assert_true(total < 1.01);
    expected[cells] = (total < 1 ? 1 - total : 0) * (double)map->samples; /* no sample */
    uint64_t state = 7;
    for (size_t i = 0; i < map->samples; i++) {
        struct bsdf_sample s;
        double u[3];
        for (int k = 0; k < 3; k++)
            u[k] = random_value(&state);
        if (bsdf_sample(drawn, wo, u, &s))
            observed[cell_of(map, s.wi)]++;
        else
            observed[cells]++;
    }
    for (int i = 0; i < cells; i++)
        if (expected[i] == 0 && observed[i] > 0)
            return 1e9;
    return stats_fit_z(expected, observed, (size_t)cells + (total < 0.999));
}

/* Every bsdf under four angles. Each test alone has the chance of Sidak's correction, so that all
 * of them together fail by chance once in a million. */
static void test_t18_chi2(void **state)
{
    (void)state;
    static const double cosines[] = {0.95, 0.5, 0.15, -0.6};
    struct chi2_map map = chi2_map();
    struct material m[20];
    size_t count = smooth_materials(m);
    double limit = stats_sidak_z(1e-6, 4 * (double)count), worst = 0;
    for (size_t i = 0; i < count; i++) {
        struct bsdf b = bsdf_of(&m[i], m[i].color);
        for (int k = 0; k < 4; k++) {
            double z = samples_off(&map, &b, &b, direction(cosines[k], 0.1 + 0.2 * k));
            worst = z > worst ? z : worst;
            if (!(z < limit))
                fail_msg(
                    "material %zu (type %d): %g standard deviations off the density at wo.z %g", i,
                    m[i].type, z, cosines[k]);
        }
    }
    printf("  T18: %zu tests of %d x %d cells, %zu samples: %.2f standard deviations at most of "
           "%.2f\n",
           4 * count, map.rows, map.columns, map.samples, worst, limit);
}

/* The same test sees a roughness that is off by 4 %. */
static void test_t18_wrong_density_fails(void **state)
{
    (void)state;
    struct chi2_map map = chi2_map();
    struct material m[20];
    size_t count = smooth_materials(m), tried = 0;
    for (size_t i = 0; i < count; i++) {
        struct material other = m[i];
        if (m[i].type != SCENE_MATERIAL_ROUGH_CONDUCTOR)
            continue;
        other.alpha_x *= 1.04;
        other.alpha_y *= 1.04;
        struct bsdf a = bsdf_of(&m[i], m[i].color), b = bsdf_of(&other, other.color);
        assert_true(samples_off(&map, &a, &b, direction(0.95, 0.1)) > stats_sidak_z(1e-6, 52));
        tried++;
    }
    assert_true(tried > 0);
}

static bool close_to(double a, double b)
{
    return fabs(a - b) <= 1e-9 * (fabs(a) + fabs(b));
}

/* weight pdf = f, and sample's pdf is eval's. */
static void sample_agrees_with_eval(void **state)
{
    (void)state;
    struct material m[20];
    size_t count = smooth_materials(m);
    uint64_t random = 3;
    for (size_t i = 0; i < count; i++) {
        struct bsdf b = bsdf_of(&m[i], m[i].color);
        for (int k = 0; k < 20000; k++) {
            vec3 wo = direction(2 * random_value(&random) - 1, random_value(&random));
            double u[3] = {random_value(&random), random_value(&random), random_value(&random)};
            struct bsdf_sample s;
            if (!bsdf_sample(&b, wo, u, &s))
                continue;
            double pdf;
            rgb f = bsdf_eval(&b, wo, s.wi, &pdf);
            assert_true(fabs(v3_length(s.wi) - 1) < 1e-9);
            assert_true(close_to(pdf, s.pdf));
            assert_true(close_to(f.r, s.weight.r * s.pdf));
            assert_true(close_to(f.b, s.weight.b * s.pdf));
        }
    }
}

/* f(a, b) = f(b, a) where nothing crosses the surface; across it, up to the square of the index
 * ratio. */
static void test_t19_reciprocity(void **state)
{
    (void)state;
    struct material m[20];
    size_t count = smooth_materials(m);
    uint64_t random = 5;
    for (size_t i = 0; i < count; i++) {
        struct bsdf b = bsdf_of(&m[i], m[i].color);
        for (int k = 0; k < 100000; k++) {
            vec3 wo = direction(2 * random_value(&random) - 1, random_value(&random));
            vec3 wi = direction(2 * random_value(&random) - 1, random_value(&random));
            double pdf;
            rgb there = bsdf_eval(&b, wo, wi, &pdf), back = bsdf_eval(&b, wi, wo, &pdf);
            double ratio = 1;
            if (wo.z * wi.z < 0 && m[i].type == SCENE_MATERIAL_ROUGH_DIELECTRIC)
                ratio = wo.z > 0 ? m[i].eta * m[i].eta : 1 / (m[i].eta * m[i].eta);
            double f = there.g / fabs(wi.z) * ratio, g = back.g / fabs(wo.z);
            if (!(fabs(f - g) <= 1e-12 * (fabs(f) + fabs(g)) + 1e-13))
                fail_msg("material %zu (type %d): %.17g there, %.17g back for wo.z %g, wi.z %g", i,
                         m[i].type, f, g, wo.z, wi.z);
        }
    }
}

/* White material, mean weight of what leaves: at most 1; exactly 1 for the lossless ones. */
static void no_energy_is_made(void **state)
{
    (void)state;
    struct material m[20];
    size_t count = smooth_materials(m);
    m[count++] = material_of(SCENE_MATERIAL_MIRROR);
    m[count++] = material_of(SCENE_MATERIAL_GLASS);
    uint64_t random = 11;
    for (size_t i = 0; i < count; i++) {
        struct bsdf b = bsdf_of(&m[i], rgb_grey(1));
        for (int k = 0; k < 8; k++) {
            vec3 wo = direction(random_value(&random), random_value(&random));
            double sum = 0;
            for (int j = 0; j < 20000; j++) {
                double u[3] = {random_value(&random), random_value(&random), random_value(&random)};
                struct bsdf_sample s;
                if (bsdf_sample(&b, wo, u, &s))
                    sum += s.weight.g * s.eta2;
            }
            assert_true(sum / 20000 <= 1 + 1e-3);
            if (m[i].type == SCENE_MATERIAL_MIRROR || m[i].type == SCENE_MATERIAL_GLASS)
                assert_true(sum / 20000 >= 1 - 1e-9);
        }
    }
}

/* Snell's law and the angle of total reflection, a few roundings either side. */
static void test_t15_snell(void **state)
{
    (void)state;
    static const double etas[] = {1, 1 + 1e-7, 1.5, 100};
    for (int e = 0; e < 4; e++) {
        struct material m = material_of(SCENE_MATERIAL_REFRACTION);
        m.eta = etas[e];
        struct bsdf b = bsdf_of(&m, rgb_grey(1));
        for (int k = 0; k <= 900; k++) {
            double s, c, u[3] = {0};
            dmath_sincos(k * 0.1 * (VEC_PI / 180), &s, &c);
            vec3 wo = v3(s, 0, c);
            struct bsdf_sample in, out;
            if (wo.z <= 0)
                continue;
            assert_true(bsdf_sample(&b, wo, u, &in));
            assert_true(in.flags & BSDF_TRANSMIT);
            assert_true(fabs(in.wi.x * m.eta + wo.x) <= 8 * 1.2e-16);
            assert_true(fabs(v3_length(in.wi) - 1) <= 1e-15);
            /* And back the same way. */
            assert_true(bsdf_sample(&b, in.wi, u, &out));
            if (c > 1e-3) {
                assert_true(out.flags & BSDF_TRANSMIT);
                assert_true(fabs(out.wi.x - wo.x) <= 4e-16);
            }
        }
    }
}

/* The critical angle by units in the last place of its sine: glass and the bare refraction take
 * the branch that exact arithmetic on the very direction takes, beyond two of them either way. */
static void test_t16_total_reflection(void **state)
{
    (void)state;
    static const double etas[] = {1.0001, 1.33, 1.5, 2.4, 100};
    for (int e = 0; e < 5; e++) {
        struct material m[2] = {material_of(SCENE_MATERIAL_GLASS),
                                material_of(SCENE_MATERIAL_REFRACTION)};
        m[0].eta = m[1].eta = etas[e];
        double critical = 1 / etas[e], ulp = nextafter(critical, 2) - critical;
        for (int k = -64; k <= 64; k++) {
            double sine = critical + k * ulp;
            vec3 wo = v3(sine, 0, -sqrt((1 - sine) * (1 + sine)));
            bool reflects = (__float128)sine * (__float128)etas[e] > 1;
            for (int i = 0; i < 2; i++) {
                struct bsdf b = bsdf_of(&m[i], rgb_grey(1));
                double u[3] = {0.5, 0.5, 0.999999};
                struct bsdf_sample s;
                bool any = bsdf_sample(&b, wo, u, &s);
                if (k >= 2 && reflects)
                    assert_true(any && !(s.flags & BSDF_TRANSMIT) && s.wi.z < 0);
                if (i == 1 && k <= -2 && !reflects)
                    assert_true(any && (s.flags & BSDF_TRANSMIT) && s.wi.z >= 0);
                if (any) {
                    assert_true(fabs(v3_length(s.wi) - 1) < 1e-12);
                    assert_true(rgb_is_finite(s.weight));
                }
            }
        }
    }
}

/* Against the C library's long doubles. */
static void gauss_is_exact(void **state)
{
    (void)state;
    enum { STEPS = 20000 };
    for (int i = 0; i <= STEPS; i++) {
        double x = 700.0 * i / STEPS, power = gauss_exp(-x);
        assert_true(fabsl(power / expl(-(long double)x) - 1) < 5e-16L);
        x = 6.6 * i / STEPS;
        long double exact = erfcl(x) * expl((long double)x * x);
        assert_true(fabsl(gauss_erfcx(x) / exact - 1) < 3e-15L);
        double bell;
        for (int sign = -1; sign <= 1; sign += 2) {
            double below = gauss_below(sign * x, &bell);
            exact = erfcl(-sign * (long double)x);
            assert_true(fabsl(below - exact) < 1e-14L * exact);
        }
        assert_true(fabsl(bell / expl(-(long double)x * x) - 1) < 1e-14L);
    }
    assert_true(gauss_exp(0) == 1 && gauss_exp(-709) == 0 && gauss_exp(-(double)INFINITY) == 0);
}

/* bsdf_eval_many has the bits of bsdf_eval, from either side, whichever of them are asked for. */
static void many_are_as_one(void **state)
{
    (void)state;
    struct material materials[20];
    size_t count = smooth_materials(materials);
    uint64_t random = 21;
    for (size_t i = 0; i < 400 * count; i++) {
        struct material *m = &materials[i % count];
        m->twosided = random_value(&random) < 0.5;
        struct bsdf b = bsdf_of(m, (rgb){0.9, 0.5, 0.1});
        vec3 wo = direction(2 * random_value(&random) - 1, random_value(&random)), wi[BSDF_MANY];
        for (int k = 0; k < BSDF_MANY; k++)
            wi[k] = direction(2 * random_value(&random) - 1, random_value(&random));
        uint32_t mask = (uint32_t)(random_value(&random) * 256);
        rgb f[BSDF_MANY];
        double pdf[BSDF_MANY];
        bsdf_eval_many(&b, wo, mask, wi, f, pdf);
        for (int k = 0; k < BSDF_MANY; k++) {
            if (!(mask >> k & 1))
                continue;
            double one_pdf;
            rgb one = bsdf_eval(&b, wo, wi[k], &one_pdf);
            assert_memory_equal(&one, &f[k], sizeof one);
            assert_memory_equal(&one_pdf, &pdf[k], sizeof one_pdf);
        }
    }
}

/* So has the loop of each instruction set. */
static void loops_are_equal(void **state)
{
    (void)state;
    conductor_loop *loops[3] = {conductor_loop_sse2};
    int loop_count = 1;
    if (__builtin_cpu_supports("avx2"))
        loops[loop_count++] = conductor_loop_avx2;
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl"))
        loops[loop_count++] = conductor_loop_avx512;
    uint64_t random = 4;
    for (int i = 0; i < 4000; i++) {
        struct conductor c = {.ax = 0.01 + random_value(&random),
                              .ay = 0.01 + random_value(&random),
                              .eta2 = {0.04, 0.8, 1.2},
                              .k2 = {15, 6, 4},
                              .wo = direction(random_value(&random), random_value(&random)),
                              .reach = 0.3};
        struct conductor_batch asked = {.pdf = {0}}, first;
        for (int k = 0; k < BSDF_MANY; k++) {
            vec3 wi = direction(2 * random_value(&random) - 1, random_value(&random));
            asked.x[k] = wi.x;
            asked.y[k] = wi.y;
            asked.z[k] = wi.z;
        }
        for (int l = 0; l < loop_count; l++) {
            struct conductor_batch batch = asked;
            loops[l](&c, i % 2 ? SCENE_GGX : SCENE_BECKMANN, &batch);
            if (l == 0)
                first = batch;
            assert_memory_equal(&batch, &first, sizeof batch);
        }
    }
}

int main(int argc, char **argv)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(gauss_is_exact),
        cmocka_unit_test(many_are_as_one),
        cmocka_unit_test(loops_are_equal),
        cmocka_unit_test(test_t18_chi2),
        cmocka_unit_test(test_t18_wrong_density_fails),
        cmocka_unit_test(sample_agrees_with_eval),
        cmocka_unit_test(test_t19_reciprocity),
        cmocka_unit_test(no_energy_is_made),
        cmocka_unit_test(no_layer_takes_more_than_there_is),
        cmocka_unit_test(test_t15_snell),
        cmocka_unit_test(test_t16_total_reflection),
    };
    return ROWS_RUN(argc, argv, tests);
}
