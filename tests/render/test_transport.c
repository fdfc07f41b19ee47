/* Light transport against closed forms and against itself: no reference renderer needed. */
#include "tests/numerics/rows.h"

#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "tests/render/render_kit.h"
#include "tests/render/stats.h"
#include "worker/render/vec.h"

static void look(struct scene *s, double px, double py, double pz, double fov)
{
    const double at[3] = {px, py, pz};
    memcpy(s->camera.position, at, sizeof at);
    s->camera.fov = fov;
}

/* Albedo 1 in a sky of 1: nothing is created or lost, so each pixel is 1. */
static void furnace(enum job_profile profile, double each, double mean)
{
    struct scene s;
    scene_init(&s);
    kit_sphere(&s, 0, 0, 0, 1, kit_diffuse(&s, 1, 1, 1));
    kit_constant_sky(&s, 1);
    look(&s, 0, 0, 3, 45);
    struct job_spec spec = kit_spec(48, 64);
    spec.profile = profile;
    for (int single = 0; single < 2; single++) { /* at last pixels of a single sample */
        spec.spp = single ? 1 : 64;
        struct kit_picture p = kit_render(&s, &spec, 3);
        double error = kit_picture_mean(&p) - 1, worst = 0;
        assert_true(fabs(error) <= mean);
        for (size_t i = 0; i < 48 * 48 * 3; i++)
            worst = fmax(worst, fabs(p.mean[i] - 1));
        printf("  T14: %llu spp, mean off by %.2g, worst pixel by %.2g\n",
               (unsigned long long)spec.spp, error, worst);
        assert_true(worst <= each);
        assert_int_equal(p.counters.nonfinite, 0);
        kit_picture_free(&p);
    }
    scene_release(&s);
}

static void test_t14_furnace_random_walk(void **state)
{
    (void)state;
    furnace(JOB_PROFILE_RW, 1e-6, 1e-6);
}

static void test_t14_furnace_mis(void **state)
{
    (void)state;
    furnace(JOB_PROFILE_MIS, 1e-6, 1e-6);
}

static void test_t14_furnace_nee(void **state)
{
    (void)state;
    furnace(JOB_PROFILE_NEE, 1e-6, 1e-6);
}

/* Float decides: another triangle on a few rays of millions, and no lamp in its own shadow. */
static void test_fast_in_the_box(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    kit_cornell(&s, KIT_BOXES | KIT_AREA_LIGHT | KIT_GLASS_SPHERE);
    struct job_spec spec = kit_spec(32, 16);
    for (uint64_t seed = 1; seed <= 3; seed++) {
        spec.seed = seed;
        spec.precision = JOB_PRECISION_EXACT;
        struct kit_picture exact = kit_render(&s, &spec, 0);
        spec.precision = JOB_PRECISION_FAST;
        struct kit_picture fast = kit_render(&s, &spec, 0);
        double a = kit_picture_mean(&exact), b = kit_picture_mean(&fast);
        printf("  seed %llu: mean %.8f in double, %.8f in float\n", (unsigned long long)seed, a, b);
        assert_true(a > 0 && fabs(b - a) <= 1e-3 * a);
        kit_picture_free(&exact);
        kit_picture_free(&fast);
    }
    scene_release(&s);
}

/* A ball of n rings of 2n quads, cut in triangles, each corner on the sphere of radius 1. */
static void faceted_ball(struct scene *s, uint32_t n, uint32_t material)
{
    double *p = mem_alloc_array((size_t)(n + 1) * 2 * n, 3 * sizeof *p);
    uint32_t *t = mem_alloc_array((size_t)4 * n * n, 3 * sizeof *t), used = 0;
    assert_true(p && t);
    for (uint32_t i = 0; i <= n; i++)
        for (uint32_t k = 0; k < 2 * n; k++) {
            double *v = p + 3 * (size_t)(i * 2 * n + k), ring = VEC_PI * i / n;
            v[0] = sin(ring) * cos(VEC_PI * k / n);
            v[1] = cos(ring);
            v[2] = sin(ring) * sin(VEC_PI * k / n);
        }
    for (uint32_t i = 0; i < n; i++)
        for (uint32_t k = 0; k < 2 * n; k++) {
            uint32_t a = i * 2 * n + k, b = i * 2 * n + (k + 1) % (2 * n);
            const uint32_t both[6] = {a, b, a + 2 * n, b, b + 2 * n, a + 2 * n};
            memcpy(t + used, both, sizeof both);
            used += 6;
        }
    kit_mesh(s, p, (n + 1) * 2 * n, t, 4 * n * n, material);
    mem_free(p);
    mem_free(t);
}

/* The integrating sphere of facets: what is off falls with the square of their size. */
static void test_t13_facets(void **state)
{
    (void)state;
    const double rho = 0.7;
    double before = 0;
    for (uint32_t n = 16; n <= (rows_long ? 512u : 128u); n *= 2) {
        struct scene s;
        struct scene_material *m;
        scene_init(&s);
        uint32_t material = kit_material(&s, SCENE_MATERIAL_DIFFUSE, &m);
        m->color[0] = m->color[1] = m->color[2] = rho;
        m->twosided = true;
        faceted_ball(&s, n, material);
        kit_light(&s, SCENE_LIGHT_POINT);
        look(&s, 0.1, 0.2, 0.5, 90);
        struct job_spec spec = kit_spec(16, 64);
        spec.max_depth = 5;
        spec.rr_threshold = 0;
        double expected = rho / VEC_PI * (1 - rho * rho * rho * rho) / (1 - rho);
        struct kit_picture p = kit_render(&s, &spec, 0);
        double off = kit_picture_mean(&p) / expected - 1;
        printf("  T13: %u rings, off by %.3g, %.2f times less\n", n, off, before / off);
        assert_true(before == 0 || (before / off > 3.9 && before / off < 4.1));
        before = off;
        kit_picture_free(&p);
        scene_release(&s);
    }
}

/* Inside a sphere of albedo rho around a point light every point gets the same from every other:
 * L = rho I / (pi R^2) (1 - rho^D) / (1 - rho) with D = max_depth - 1 reflections. */
static void test_t13_integrating_sphere(void **state)
{
    (void)state;
    static const uint32_t depths[] = {2, 3, 5, 12, 65};
    static const double radii[] = {1e-6, 1, 1e6};
    double worst = 0;
    for (size_t i = 0; i < (rows_long ? 64 * 3 : 15); i++) {
        double rho = 0.7, radius = radii[i % 3];
        uint32_t depth = rows_long ? 2 + (uint32_t)i / 3 : depths[i / 3];
        struct scene s;
        scene_init(&s);
        struct scene_material *m;
        uint32_t material = kit_material(&s, SCENE_MATERIAL_DIFFUSE, &m);
        m->color[0] = m->color[1] = m->color[2] = rho;
        m->twosided = true;
        kit_sphere(&s, 0, 0, 0, radius, material);
        kit_light(&s, SCENE_LIGHT_POINT);
        look(&s, 0, 0, 0.5 * radius, 90);
        struct job_spec spec = kit_spec(8, 4);
        spec.max_depth = depth;
        spec.rr_threshold = 0;
        double power = 1;
        for (uint32_t k = 1; k < depth; k++)
            power *= rho;
        double expected =
            rho / (3.14159265358979323846 * radius * radius) * (1 - power) / (1 - rho);
        struct kit_picture p = kit_render(&s, &spec, 0);
        for (size_t k = 0; k < 8 * 8 * 3; k++)
            worst = fmax(worst, fabs(p.mean[k] / expected - 1));
        kit_picture_free(&p);
        scene_release(&s);
    }
    printf("  T13: worst pixel off by %.2g\n", worst);
    assert_true(worst <= 1e-6);
}

/* The three profiles, with and without roulette, estimate the same light. */
static void assert_profiles_agree(const struct scene *s, uint64_t spp)
{
    double mean[3], variance[3];
    for (int k = 0; k < 3; k++) {
        struct job_spec spec = kit_spec(24, spp);
        spec.profile = (enum job_profile)k;
        spec.rr_threshold = k == 0 ? 0.5 : 0;
        assert_int_equal(kit_estimate(s, spec, &mean[k], &variance[k]), 0);
        assert_true(mean[k] > 0);
    }
    for (int k = 1; k < 3; k++) {
        print_message("mean %g +- %g against %g +- %g\n", mean[k], sqrt(variance[k]), mean[0],
                      sqrt(variance[0]));
        double z = (mean[k] - mean[0]) / sqrt(variance[k] + variance[0]);
        assert_true(fabs(z) < 5);
    }
}

static void test_t20_profiles_in_the_box(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    kit_cornell(&s, KIT_BOXES | KIT_AREA_LIGHT);
    assert_profiles_agree(&s, 64);
    scene_release(&s);
}

/* A rough conductor under a small sphere light, a large one and a sky. */
static void test_t20_profiles_on_metal(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    static const double plate[12] = {-2, -1, 2, 2, -1, 2, 2, -1, -2, -2, -1, -2};
    struct scene_material *m;
    uint32_t metal = kit_material(&s, SCENE_MATERIAL_ROUGH_CONDUCTOR, &m);
    m->alpha_x = 0.3;
    m->alpha_y = 0.15;
    static const double eta[3] = {0.2, 0.92, 1.1}, k[3] = {3.9, 2.45, 2.14};
    memcpy(m->etaT, eta, sizeof eta);
    memcpy(m->k, k, sizeof k);
    kit_quad(&s, plate, metal);
    kit_emit(&s, kit_sphere(&s, -1, 0.5, -1, 0.2, SCENE_NONE), 20, 10, 5);
    kit_emit(&s, kit_sphere(&s, 1, 0.5, -1, 0.8, SCENE_NONE), 1, 2, 3);
    kit_constant_sky(&s, 0.2);
    look(&s, 0, 1, 5, 45);
    assert_profiles_agree(&s, 128);
    scene_release(&s);
}

/* Glass, metal, a rough pane, cloth and lamps in a box under a sky: all that paths may share or
 * not. */
static void zoo(struct scene *s)
{
    kit_cornell(s, KIT_AREA_LIGHT | KIT_BOXES);
    struct scene_material *m;
    uint32_t glass = kit_material(s, SCENE_MATERIAL_GLASS, &m);
    kit_sphere(s, -0.3, 0.9, 0.6, 0.25, glass);
    uint32_t metal = kit_material(s, SCENE_MATERIAL_ROUGH_CONDUCTOR, &m);
    m->alpha_x = m->alpha_y = 0.3;
    m->etaT[0] = 0.2;
    m->k[0] = m->k[1] = m->k[2] = 3;
    kit_sphere(s, 0.3, 0.3, 0.7, 0.3, metal);
    uint32_t frosted = kit_material(s, SCENE_MATERIAL_ROUGH_DIELECTRIC, &m);
    m->alpha_x = m->alpha_y = 0.4;
    kit_sphere(s, 0.6, 1.3, 0.2, 0.25, frosted);
    uint32_t cloth = kit_material(s, SCENE_MATERIAL_PRINCIPLED, &m);
    m->color[1] = 0.2;
    m->metallic = 0;
    m->roughness = 0.6;
    m->transmission = 0.4;
    m->sheen_color[2] = 0.8;
    m->sheen_roughness = 0.5;
    kit_sphere(s, -0.6, 1.5, 0.1, 0.3, cloth);
    kit_emit(s, kit_sphere(s, 0.8, 0.2, 0.2, 0.08, SCENE_NONE), 10, 8, 20);
    kit_constant_sky(s, 0.3);
}

/* Means of 4 x 4 pixel blocks over seeds, and the variances of those. */
static void block_means(const struct scene *s, struct job_spec spec, int seeds, double *mean,
                        double *variance)
{
    size_t side = spec.width / 4, blocks = side * side * 3;
    memset(mean, 0, blocks * sizeof *mean);
    memset(variance, 0, blocks * sizeof *variance);
    for (int seed = 0; seed < seeds; seed++) {
        spec.seed = (uint64_t)seed + 100;
        struct kit_picture p = kit_render(s, &spec, 0);
        assert_int_equal(p.counters.nonfinite, 0);
        for (size_t b = 0; b < blocks; b++) {
            double v = 0;
            size_t plane = (size_t)spec.width * spec.width, k = b / (side * side);
            size_t x = b % side * 4, y = b / side % side * 4;
            for (size_t i = 0; i < 16; i++)
                v += p.mean[k * plane + (y + i / 4) * spec.width + x + i % 4] / 16;
            mean[b] += v;
            variance[b] += v * v;
        }
        kit_picture_free(&p);
    }
    for (size_t b = 0; b < blocks; b++) {
        mean[b] /= seeds;
        variance[b] = (variance[b] / seeds - mean[b] * mean[b]) / (seeds - 1);
    }
}

/* Paths that share (MIS) against paths that do not (NEE), block by block. */
static void test_t20_sharing(void **state)
{
    (void)state;
    enum { SIDE = 24, BLOCKS = SIDE / 4 * SIDE / 4 * 3, PICTURES = 10 };
    static double mean[2][BLOCKS], variance[2][BLOCKS];
    struct scene s;
    scene_init(&s);
    zoo(&s);
    struct job_spec spec = kit_spec(SIDE, 32);
    spec.max_depth = 6;
    block_means(&s, spec, PICTURES, mean[0], variance[0]);
    spec.profile = JOB_PROFILE_NEE;
    spec.spp = 64;
    block_means(&s, spec, PICTURES, mean[1], variance[1]);
    double worst = 0, sum2 = 0;
    for (int b = 0; b < BLOCKS; b++) {
        double z = (mean[0][b] - mean[1][b]) / sqrt(variance[0][b] + variance[1][b]);
        worst = fabs(z) > worst ? fabs(z) : worst;
        sum2 += z * z;
    }
    print_message("worst block %g standard deviations off, mean square %g\n", worst, sum2 / BLOCKS);
    assert_true(worst < 8);
    assert_true(sum2 / BLOCKS < 2);
    scene_release(&s);
}

/* --- Against a reference ----------------------------------------------------- */

enum { REFERENCE_SIDE = 12, REFERENCE_VALUES = REFERENCE_SIDE * REFERENCE_SIDE * 3, SEEDS = 16 };

/* Means over SEEDS pictures, and the variances of those means. The last is a mean over the picture
 * in which each pixel has a weight. */
struct means {
    double mean[REFERENCE_VALUES + 1], variance[REFERENCE_VALUES + 1];
};

static void means_of(const struct scene *s, struct job_spec spec, uint64_t first_seed,
                     const double *weight, struct means *out)
{
    memset(out, 0, sizeof *out);
    for (uint64_t seed = 0; seed < SEEDS; seed++) {
        spec.seed = first_seed + seed;
        struct kit_picture p = kit_render(s, &spec, 0);
        assert_int_equal(p.counters.nonfinite, 0);
        double whole = 0;
        for (int i = 0; i <= REFERENCE_VALUES; i++) {
            double v = i < REFERENCE_VALUES ? p.mean[i] : whole;
            assert_true(isfinite(v));
            whole += weight && i < REFERENCE_VALUES ? weight[i] * v : 0;
            out->mean[i] += v / SEEDS;
            out->variance[i] += v * v / SEEDS;
        }
        kit_picture_free(&p);
    }
    for (int i = 0; i <= REFERENCE_VALUES; i++) {
        double left = out->variance[i] - out->mean[i] * out->mean[i];
        out->variance[i] = (left > 0 ? left : 0) / (SEEDS - 1);
    }
}

/* Each pixel by what it is sure of, so that one edge of a lamp does not drown the rest. */
static void weigh(const struct means *pilot, double weight[REFERENCE_VALUES])
{
    for (int i = 0; i < REFERENCE_VALUES; i++)
        weight[i] = 1 / (sqrt(pilot->variance[i]) + 1e-3 * pilot->mean[i] + 1e-9);
}

/* Chance of two means as far apart, by Welch's test; 1 where neither has any noise and both agree
 * to floats. */
static double chance(const struct means *a, const struct means *b, int i, double *z)
{
    double v = a->variance[i], w = b->variance[i], d = a->mean[i] - b->mean[i];
    *z = 0;
    if (fabs(d) <= 1e-6 * fabs(a->mean[i]))
        return 1;
    *z = d / sqrt(v + w);
    double degrees = (v + w) * (v + w) / (v * v + w * w) * (SEEDS - 1);
    return v + w > 0 ? stats_t_two_sided(*z, degrees) : 0;
}

/* True if no pixel and channel is off beyond chance, nor the whole picture. `tests`: how many such
 * pixels there are in all, for Sidak's correction to a millionth. */
static bool agrees(const char *what, const struct means *a, const struct means *b, double tests)
{
    double least = 1, z, one = -expm1(log1p(-1e-6) / tests);
    for (int i = 0; i < REFERENCE_VALUES; i++)
        least = fmin(least, chance(a, b, i, &z));
    (void)chance(a, b, REFERENCE_VALUES, &z);
    printf(
        "  T20 %-32s least chance of a pixel %.1e (line %.1e), the whole %+.2f sigma, %+.4f %%\n",
        what, least, one, z, 100 * (a->mean[REFERENCE_VALUES] / b->mean[REFERENCE_VALUES] - 1));
    return least > one && fabs(z) < 4;
}

/* A way to render that must not change what is estimated. */
struct way {
    const char *name;
    enum job_profile profile;
    enum job_sampler sampler;
    enum job_builder builder;
    enum job_precision precision;
    enum job_light_choice lights;
    double rr;
    uint32_t tile;
};

static const struct way ways[] = {
    {.name = "shared paths", .rr = 0},
    {.name = "shared paths, roulette", .rr = 0.5},
    {.name = "roulette", .profile = JOB_PROFILE_NEE, .rr = 0.5},
    {.name = "independent", .profile = JOB_PROFILE_NEE, .sampler = JOB_SAMPLER_INDEPENDENT},
    {.name = "halton", .profile = JOB_PROFILE_NEE, .sampler = JOB_SAMPLER_HALTON},
    {.name = "sobol, tiles of 7", .profile = JOB_PROFILE_NEE, .tile = 7},
    {.name = "median", .profile = JOB_PROFILE_NEE, .builder = JOB_BUILDER_MEDIAN},
    {.name = "float", .profile = JOB_PROFILE_NEE, .precision = JOB_PRECISION_FAST},
    {.name = "lights by power", .lights = JOB_LIGHT_CHOICE_POWER},
    {.name = "lights alike", .lights = JOB_LIGHT_CHOICE_UNIFORM},
};
enum { WAYS = sizeof ways / sizeof *ways };
static const uint32_t depths[] = {4, 2, 9};

static struct job_spec way_spec(const struct way *w, uint32_t depth, uint64_t spp)
{
    struct job_spec spec = kit_spec(REFERENCE_SIDE, spp);
    spec.max_depth = depth;
    spec.rr_threshold = w->rr;
    spec.profile = w->profile;
    spec.sampler = w->sampler;
    spec.builder = w->builder;
    spec.precision = w->precision;
    spec.light_choice = w->lights;
    spec.tile = w->tile ? w->tile : spec.tile;
    return spec;
}

/* Every way against 2^16 samples a pixel (--long; else 2^12) of other seeds, without sharing and
 * roulette, at depth 4 (--long: and 2 and 9); and lamps that are 3 % brighter must be found out. */
static void test_t20_against_reference(void **state)
{
    (void)state;
    static struct means reference, other;
    static double weight[REFERENCE_VALUES];
    const struct way plain = {.profile = JOB_PROFILE_NEE};
    uint64_t reference_spp = (UINT64_C(1) << (rows_long ? 16 : 12)) / SEEDS,
             spp = reference_spp / 4;
    double tests = 3.0 * WAYS * REFERENCE_VALUES;
    bool all = true;
    struct scene s;
    scene_init(&s);
    zoo(&s);
    int last = rows_long ? 2 : 0;
    for (int d = 0; d <= last; d++) {
        means_of(&s, way_spec(&plain, depths[d], spp), 5000, NULL, &other);
        weigh(&other, weight);
        means_of(&s, way_spec(&plain, depths[d], reference_spp), 1000, weight, &reference);
        for (int i = 0; i < WAYS; i++) {
            char what[64];
            (void)snprintf(what, sizeof what, "depth %u, %s", depths[d], ways[i].name);
            means_of(&s, way_spec(&ways[i], depths[d], spp), 1, weight, &other);
            all &= agrees(what, &other, &reference, tests);
        }
    }
    for (size_t i = 0; i < s.object_count; i++)
        for (int k = 0; k < 3; k++)
            s.objects[i].radiance[k] *= 1.03;
    s.envmap.scale *= 1.03;
    means_of(&s, way_spec(&ways[0], depths[last], spp), 1, weight, &other);
    assert_false(agrees("lamps 3 % brighter", &other, &reference, tests));
    scene_release(&s);
    assert_true(all);
}

/* Rays of a picture with paths that share over those without. */
static double rays_of_sharing(const struct scene *s)
{
    struct job_spec spec = kit_spec(24, 16);
    spec.max_depth = 6;
    double rays[2];
    for (int k = 0; k < 2; k++) {
        spec.profile = k ? JOB_PROFILE_MIS : JOB_PROFILE_NEE;
        struct kit_picture p = kit_render(s, &spec, 0);
        rays[k] = (double)p.counters.rays;
        kit_picture_free(&p);
    }
    return rays[1] / rays[0];
}

/* Shadow rays for sharing are cast in a box full of light between walls, not on a dark stage under
 * a sky. */
static void sharing_where_it_pays(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    kit_cornell(&s, KIT_BOXES | KIT_AREA_LIGHT);
    double box = rays_of_sharing(&s);
    scene_release(&s);
    scene_init(&s);
    static const double floor[12] = {-4, 0, 4, 4, 0, 4, 4, 0, -4, -4, 0, -4};
    uint32_t grey = kit_diffuse(&s, 0.3, 0.3, 0.3);
    kit_quad(&s, floor, grey);
    kit_sphere(&s, 0, 0.5, 0, 0.5, grey);
    kit_constant_sky(&s, 1);
    look(&s, 0, 1, 5, 45);
    double open = rays_of_sharing(&s);
    scene_release(&s);
    print_message("rays with sharing over those without: box %.2f, open stage %.2f\n", box, open);
    assert_true(box > 1.3);
    assert_true(open < 1.05);
}

int main(int argc, char **argv)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_t14_furnace_random_walk),
        cmocka_unit_test(test_t14_furnace_mis),
        cmocka_unit_test(test_t14_furnace_nee),
        cmocka_unit_test(test_fast_in_the_box),
        cmocka_unit_test(test_t13_integrating_sphere),
        cmocka_unit_test(test_t13_facets),
        cmocka_unit_test(test_t20_profiles_in_the_box),
        cmocka_unit_test(test_t20_profiles_on_metal),
        cmocka_unit_test(test_t20_sharing),
        cmocka_unit_test(test_t20_against_reference),
        cmocka_unit_test(sharing_where_it_pays),
    };
    return ROWS_RUN(argc, argv, tests);
}
