/* Lights: samples have the density that light_pdf claims, and the densities integrate to what the
 * light covers; film filters and warps keep their promises. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <string.h>

#include "common/dmath.h"
#include "common/mem.h"
#include "tests/render/render_kit.h"
#include "tests/render/stats.h"
#include "worker/render/lanes.h"
#include "worker/render/render_scene.h"
#include "worker/render/sampler.h"
#include "worker/render/sky_batch.h"
#include "worker/render/sphere_parts.h"
#include "worker/render/warp.h"
#include "worker/scene/scene_build.h"

/* A surface that takes light from everywhere. */
static const vec3 nowhere = {0, 0, 0};

static double random_value(uint64_t *state)
{
    *state += UINT64_C(0x9e3779b97f4a7c15);
    return (double)(sampler_mix(*state) >> 11) / 9007199254740992.0;
}

static void add_sky(struct scene *s)
{
    kit_constant_sky(s, 1);
    struct scene_texture *t = &s->textures[s->envmap.texture];
    t->type = SCENE_TEXTURE_CHECKERBOARD;
    for (int k = 0; k < 3; k++) {
        t->color[0][k] = 0.2;
        t->color[1][k] = 3;
    }
    t->uv_matrix[0] = 3;
    t->uv_matrix[4] = 2;
}

/* A lamp of each kind, and a sky with a pattern. */
static struct render_scene *lamps(bool sky)
{
    static const double quad[12] = {-1, 2, -1, 1, 2, -1, 1.2, 2.1, 1, -0.8, 2.1, 1};
    struct scene s;
    scene_init(&s);
    kit_emit(&s, kit_quad(&s, quad, SCENE_NONE), 1, 1, 1);
    kit_emit(&s, kit_sphere(&s, 2, 0, 0, 0.7, SCENE_NONE), 1, 1, 1);
    if (sky)
        add_sky(&s);
    struct job_spec spec = kit_spec(4, 1);
    struct render_scene *rs;
    assert_int_equal(scene_build(&s, &spec, NULL, &rs), ERR_OK);
    scene_release(&s);
    return rs;
}

/* Density of light_sample from p in direction w, over all lights that w meets. */
static double density(const struct render_scene *rs, vec3 p, vec3 w)
{
    double pdf = 0, sky;
    for (uint32_t i = 0; i < rs->lights.count; i++) {
        const struct light *l = &rs->lights.lights[i];
        if (l->type == LIGHT_ENVIRONMENT)
            continue;
        if (l->type == LIGHT_SPHERE) {
            vec3 d = v3_sub(l->v0, p);
            double along = v3_dot(d, w);
            if (along > 0 && v3_dot(d, d) - along * along < l->radius * l->radius)
                pdf += light_pdf(&rs->lights, i, p, nowhere, 1, 1);
            continue;
        }
        double cosine = -v3_dot(l->n, w);
        double t = v3_dot(v3_sub(l->v0, p), l->n) / -cosine;
        vec3 q = v3_sub(v3_mad(p, w, t), l->v0);
        double a = v3_dot(v3_cross(q, l->e2), l->n) / l->area;
        double b = v3_dot(v3_cross(l->e1, q), l->n) / l->area;
        bool in = l->type == LIGHT_QUAD && a >= 0 && a <= 1 && b >= 0 && b <= 1;
        if (cosine > 0 && t > 0 && in)
            pdf += light_pdf(&rs->lights, i, p, nowhere, t * t, cosine);
    }
    (void)environment_radiance(&rs->lights, nowhere, w, &sky);
    return pdf + sky;
}

enum { ROWS = 24, COLUMNS = 48, SAMPLES = 200000, QUADRATURE = 16 };

static vec3 sphere_point(double row, double column)
{
    double z = -1 + 2 * row / ROWS, s, c;
    double r = sqrt(1 - z * z);
    dmath_sincos(column / COLUMNS * 2 * VEC_PI, &s, &c);
    return v3(r * c, r * s, z);
}

static void samples_have_the_density(void **state)
{
    (void)state;
    static double expected[ROWS * COLUMNS], observed[ROWS * COLUMNS];
    for (int sky = 0; sky < 2; sky++) {
        struct render_scene *rs = lamps(sky);
        assert_int_equal(rs->lights.count, sky ? 3 : 2);
        vec3 p = v3(0.1, -0.2, 0.05);
        double total = 0;
        memset(observed, 0, sizeof observed);
        for (int i = 0; i < ROWS * COLUMNS; i++) {
            double sum = 0;
            for (int k = 0; k < QUADRATURE * QUADRATURE; k++)
                sum += density(rs, p,
                               sphere_point(i / COLUMNS + (k / QUADRATURE + 0.5) / QUADRATURE,
                                            i % COLUMNS + (k % QUADRATURE + 0.5) / QUADRATURE));
            double mass = sum / (QUADRATURE * QUADRATURE) * 4 * VEC_PI / (ROWS * COLUMNS);
            expected[i] = mass * SAMPLES;
            total += mass;
        }
        assert_true(fabs(total - 1) < 0.01);
        uint64_t random = 1;
        for (int i = 0; i < SAMPLES; i++) {
            struct light_sample s;
            double u[3] = {random_value(&random), random_value(&random), random_value(&random)};
            assert_true(light_sample(&rs->lights, p, nowhere, u[0], u[1], u[2], &s));
            assert_true(fabs(v3_length(s.wi) - 1) < 1e-12);
            double phi = dmath_atan2(s.wi.y, s.wi.x) / (2 * VEC_PI);
            int row = (int)((s.wi.z + 1) / 2 * ROWS);
            int column = (int)((phi < 0 ? phi + 1 : phi) * COLUMNS);
            observed[(row < ROWS ? row : ROWS - 1) * COLUMNS +
                     (column < COLUMNS ? column : COLUMNS - 1)]++;
        }
        /* The quadrature of a lamp's outline is off by up to a part in a hundred of a cell. */
        for (int i = 0; i < ROWS * COLUMNS; i++) {
            double slack = 0.02 * expected[i] + 0.01 * SAMPLES / 64.0;
            double d = fabs(observed[i] - expected[i]);
            assert_true(d <= slack + 6 * sqrt(expected[i]));
        }
        render_scene_free(rs);
    }
}

/* The tabulated sky against uniform directions: the same integral. */
static void sky_is_the_same_both_ways(void **state)
{
    (void)state;
    struct render_scene *rs = lamps(true);
    const struct light_table *t = &rs->lights;
    uint64_t random = 5;
    double uniform = 0, drawn = 0;
    enum { N = 400000 };
    int drawn_count = 0;
    for (int i = 0; i < N; i++) {
        double pdf, a = random_value(&random), b = random_value(&random);
        uniform += environment_radiance(t, nowhere, warp_sphere(a, b), &pdf).g * 4 * VEC_PI / N;
        struct light_sample s;
        double choose = 1 - t->lights[t->environment_light].probability * random_value(&random);
        if (choose >= 1)
            continue;
        assert_true(light_sample(t, v3(0, 0, 0), nowhere, choose, a, b, &s));
        if (!s.distant)
            continue;
        rgb seen = environment_radiance(t, nowhere, s.wi, &pdf);
        assert_true(fabs(pdf / s.pdf - 1) < 1e-6 || fabs(seen.g - s.radiance.g) > 0);
        drawn += s.radiance.g / s.pdf * t->lights[t->environment_light].probability;
        drawn_count++;
    }
    drawn /= drawn_count;
    assert_true(fabs(drawn / uniform - 1) < 0.01);
    render_scene_free(rs);
}

/* Nothing but a sky, as light for a profile. */
static struct render_scene *open_air(enum job_profile profile)
{
    struct scene s;
    scene_init(&s);
    (void)kit_sphere(&s, 2, 0, 0, 0.7, SCENE_NONE);
    add_sky(&s);
    struct job_spec spec = kit_spec(4, 1);
    struct render_scene *rs;
    spec.profile = profile;
    assert_int_equal(scene_build(&s, &spec, NULL, &rs), ERR_OK);
    scene_release(&s);
    return rs;
}

/* What draws over the sphere, below the horizon left out, observe beside what the density promises;
 * returns the second moment of light times cosine over density. */
static double compare_draws(const struct light_table *t, vec3 n)
{
    static double expected[ROWS * COLUMNS], observed[ROWS * COLUMNS];
    double total = 0, moment = 0;
    memset(observed, 0, sizeof observed);
    for (int i = 0; i < ROWS * COLUMNS; i++) {
        expected[i] = 0;
        for (int k = 0; k < QUADRATURE * QUADRATURE; k++) {
            double pdf;
            vec3 w = sphere_point(i / COLUMNS + (k / QUADRATURE + 0.5) / QUADRATURE,
                                  i % COLUMNS + (k % QUADRATURE + 0.5) / QUADRATURE);
            (void)environment_radiance(t, n, w, &pdf);
            assert_true(pdf > 0 || v3_dot(w, n) <= 0);
            pdf *= 4 * VEC_PI / (ROWS * COLUMNS) / (QUADRATURE * QUADRATURE);
            total += pdf;
            expected[i] += v3_dot(w, n) > 0 ? pdf * SAMPLES : 0;
        }
    }
    assert_true(fabs(total - 1) < 0.01);
    uint64_t random = 3;
    for (int i = 0; i < SAMPLES; i++) {
        struct light_sample s;
        double a = random_value(&random), b = random_value(&random);
        if (!light_sample(t, v3(0, 0, 0), n, 0, a, b, &s))
            continue;
        double phi = dmath_atan2(s.wi.y, s.wi.x) / (2 * VEC_PI);
        double weight = s.radiance.g * v3_dot(s.wi, n) / s.pdf;
        int row = (int)((s.wi.z + 1) / 2 * ROWS);
        int column = (int)((phi < 0 ? phi + 1 : phi) * COLUMNS);
        observed[(row < ROWS ? row : ROWS - 1) * COLUMNS +
                 (column < COLUMNS ? column : COLUMNS - 1)]++;
        moment += weight * weight / SAMPLES;
    }
    /* The quadrature of an edge of the pattern or of the horizon is off by a part of a cell. */
    for (int i = 0; i < ROWS * COLUMNS; i++) {
        double slack = 0.02 * expected[i] + 0.01 * SAMPLES / 64.0;
        assert_true(fabs(observed[i] - expected[i]) <= slack + 6 * sqrt(expected[i]));
    }
    return moment;
}

/* The sky is drawn by its light and the cosine at the normal: on a grid point of the tables, far
 * from any, and for both kinds of tables. */
static void sky_is_drawn_for_the_normal(void **state)
{
    (void)state;
    const vec3 normals[] = {{0, 0, 1}, {0, -1, 0}, {0.31, -0.52, 0.43}, {-0.61, 0.07, -0.83}};
    for (int k = 0; k < 8; k++) {
        vec3 n = v3_unit(normals[k / 2]);
        struct render_scene *rs = open_air(k % 2 ? JOB_PROFILE_NEE : JOB_PROFILE_MIS);
        double moment = compare_draws(&rs->lights, n);
        if (k % 2) {
            /* Of light times cosine drawn exactly, the second moment is the square of the mean. */
            double mean = 0;
            enum { N = 100000 };
            for (int i = 0; i < N; i++) {
                double pdf;
                vec3 w = warp_sphere((i + 0.5) / N, fmod(i * 0.6180339887498949, 1));
                double cosine = v3_dot(w, n);
                rgb sky = environment_radiance(&rs->lights, n, w, &pdf);
                mean += cosine > 0 ? sky.g * cosine * 4 * VEC_PI / N : 0;
            }
            assert_true(moment < 1.2 * mean * mean);
        }
        render_scene_free(rs);
    }
}

static double component(const double numbers[], uint64_t *random)
{
    int k = (int)(random_value(random) * 4);
    return k == 3 ? random_value(random) * 2 - 1 : numbers[k];
}

/* A unit vector, often one on an axis or a fold of the tables; seldom none. */
static vec3 any_normal(uint64_t *random)
{
    static const double numbers[3] = {0, 1, -1};
    vec3 n = v3(component(numbers, random), component(numbers, random), component(numbers, random));
    return v3_abs_max(n) > 0 ? v3_unit(n) : n;
}

/* A batch of lights drawn, of any size, has the bits of light_sample, the sky among them or alone;
 * a batch of directions those of environment_radiance. */
static void batches_have_the_bits_of_one(void **state)
{
    (void)state;
    uint64_t random = 11;
    for (int k = 0; k < 4000; k++) {
        static struct render_scene *rs;
        if (k % 2000 == 0)
            rs = k ? lamps(true) : open_air(JOB_PROFILE_MIS);
        uint32_t count = (uint32_t)(random_value(&random) * (LIGHT_POINTS_MAX + 1)), there = 0;
        struct light_point points[LIGHT_POINTS_MAX];
        struct light_sample many[LIGHT_POINTS_MAX], one;
        vec3 n[LIGHT_POINTS_MAX], w[LIGHT_POINTS_MAX];
        rgb sky[LIGHT_POINTS_MAX];
        double pdfs[LIGHT_POINTS_MAX], pdf;
        for (uint32_t i = 0; i < count; i++) {
            n[i] = any_normal(&random);
            w[i] = warp_sphere(random_value(&random), random_value(&random));
            points[i] = (struct light_point){v3(0, 0, 0), n[i], random_value(&random),
                                             random_value(&random), random_value(&random)};
        }
        there = light_sample_points(&rs->lights, count, points, many);
        environment_radiances(&rs->lights, count, n, w, sky, pdfs);
        for (uint32_t i = 0; i < count; i++) {
            const struct light_point *p = &points[i];
            bool is = light_sample(&rs->lights, p->p, p->n, p->choose, p->u, p->v, &one);
            assert_int_equal(there >> i & 1, is);
            if (is) {
                assert_memory_equal(&many[i].wi, &one.wi, sizeof one.wi);
                assert_memory_equal(&many[i].radiance, &one.radiance, sizeof one.radiance);
                assert_memory_equal(&many[i].pdf, &one.pdf, sizeof one.pdf);
                assert_true(many[i].distant == one.distant && many[i].delta == one.delta);
            }
            rgb seen = environment_radiance(&rs->lights, n[i], w[i], &pdf);
            assert_memory_equal(&sky[i], &seen, sizeof seen);
            assert_memory_equal(&pdfs[i], &pdf, sizeof pdf);
        }
        if (k % 2000 == 1999)
            render_scene_free(rs);
    }
}

/* Nor do the draws of one vertex know of each other: lamps of all kinds, spheres among them. */
static void candidates_have_the_bits_of_one(void **state)
{
    (void)state;
    struct render_scene *rs = lamps(true);
    uint64_t random = 13;
    for (int k = 0; k < 2000; k++) {
        double choose[LIGHT_TREE_DRAWS_MAX], u[LIGHT_TREE_DRAWS_MAX], v[LIGHT_TREE_DRAWS_MAX];
        uint32_t count = 1 + (uint32_t)(random_value(&random) * LIGHT_TREE_DRAWS_MAX);
        struct light_sample many[LIGHT_TREE_DRAWS_MAX], one;
        vec3 n = any_normal(&random), p = v3(0, random_value(&random), 0);
        for (uint32_t i = 0; i < count; i++) {
            choose[i] = (i + random_value(&random)) / count;
            u[i] = random_value(&random);
            v[i] = random_value(&random);
        }
        uint32_t there = light_sample_many(&rs->lights, p, n, count, choose, u, v, many);
        for (uint32_t i = 0; i < count; i++) {
            bool is = light_sample(&rs->lights, p, n, choose[i], u[i], v[i], &one);
            assert_int_equal(there >> i & 1, is);
            if (!is)
                continue;
            assert_memory_equal(&many[i].wi, &one.wi, sizeof one.wi);
            assert_memory_equal(&many[i].radiance, &one.radiance, sizeof one.radiance);
            assert_memory_equal(&many[i].pdf, &one.pdf, sizeof one.pdf);
            if (!one.distant)
                assert_memory_equal(&many[i].target, &one.target, sizeof one.target);
        }
    }
    render_scene_free(rs);
}

static void assert_same_batch(const struct sky_batch *a, const struct sky_batch *b)
{
    assert_memory_equal(a->w, b->w, sizeof a->w);
    assert_memory_equal(a->x, b->x, sizeof a->x);
    assert_memory_equal(a->y, b->y, sizeof a->y);
    assert_memory_equal(a->pdf, b->pdf, sizeof a->pdf);
}

/* The loops of all instruction sets that this processor has give the same bits. */
static void batches_are_the_same_in_all_vectors(void **state)
{
    (void)state;
    struct render_scene *rs = open_air(JOB_PROFILE_MIS);
    const struct environment *sky = &rs->lights.environment;
    uint64_t random = 5;
    for (int k = 0; k < 2000; k++) {
        struct sky_batch b, wide;
        memset(&b, 0, sizeof b);
        for (int i = 0; i < SKY_BATCH; i++) {
            vec3 n = any_normal(&random);
            b.n[0][i] = n.x;
            b.n[1][i] = n.y;
            b.n[2][i] = n.z;
            b.x[i] = random_value(&random);
            b.y[i] = random_value(&random);
        }
        struct sky_batch plain = b;
        sky_draw_sse2(sky, &plain);
        sky_look_sse2(sky, &plain);
        for (int level = LANES_AVX2; level <= (int)lanes_level(); level++) {
            wide = b;
            (level == LANES_AVX2 ? sky_draw_avx2 : sky_draw_avx512)(sky, &wide);
            (level == LANES_AVX2 ? sky_look_avx2 : sky_look_avx512)(sky, &wide);
            assert_same_batch(&wide, &plain);
        }
    }
    render_scene_free(rs);
}

/* So have those that draw on spheres, which do what is done for one. */
static void spheres_are_the_same_in_all_vectors(void **state)
{
    (void)state;
    static sphere_loop *const loops[LANES_LEVELS] = {sphere_loop_sse2, sphere_loop_avx2,
                                                     sphere_loop_avx512};
    uint64_t random = 9;
    for (int k = 0; k < 4000; k++) {
        struct sphere_batch asked = {.u = {0}};
        double numbers[SPHERE_MANY][19];
        vec3 p = v3(random_value(&random), random_value(&random), random_value(&random));
        for (int i = 0; i < SPHERE_MANY; i++) {
            for (int j = 0; j < 19; j++)
                numbers[i][j] = random_value(&random);
            asked.u[i] = numbers[i][0];
            asked.v[i] = numbers[i][1];
            asked.cap[i] = numbers[i][2];
            asked.distance2[i] = numbers[i][3];
            asked.distance[i] = numbers[i][4];
            for (int axis = 0; axis < 3; axis++) {
                asked.s[axis][i] = numbers[i][5 + axis];
                asked.t[axis][i] = numbers[i][8 + axis];
                asked.n[axis][i] = numbers[i][11 + axis];
                asked.center[axis][i] = numbers[i][14 + axis];
            }
            asked.radius[i] = numbers[i][17];
            asked.error[i] = numbers[i][18] * 1e-12;
        }
        for (int level = LANES_SSE2; level <= (int)lanes_level(); level++) {
            struct sphere_batch b = asked;
            loops[level](p, &b);
            for (int i = 0; i < SPHERE_MANY; i++) {
                const double *x = numbers[i];
                struct sphere_view view = {
                    x[2], x[3], x[4], {v3_of(x + 5), v3_of(x + 8), v3_of(x + 11)}};
                vec3 wi, target;
                double pdf;
                sphere_draw(&view, p, v3_of(x + 14), x[17], x[18] * 1e-12, x[0], x[1], &wi, &target,
                            &pdf);
                assert_true(b.wi[0][i] == wi.x && b.wi[1][i] == wi.y && b.wi[2][i] == wi.z);
                assert_true(b.target[0][i] == target.x && b.target[1][i] == target.y);
                assert_true(b.target[2][i] == target.z && b.pdf[i] == pdf);
            }
        }
    }
}

/* A sphere sends nothing into itself, even one that lets half of the light through. Points on it
 * once saw it from outside when a rounding said so, and took the light of their own other side. */
static void spheres_do_not_light_themselves(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    uint32_t grey = kit_diffuse(&s, 0.6, 0.6, 0.6);
    s.materials[grey].twosided = s.materials[grey].alpha_used = true;
    s.materials[grey].alpha = 0.5;
    s.materials[grey].alpha_cutoff = -1;
    kit_emit(&s, kit_sphere(&s, 3, 0.1, -0.2, 0.7, grey), 5, 5, 5);
    kit_sphere(&s, -4, 0, 0, 1, SCENE_NONE); /* black; moves the middle of the scene */
    memcpy(s.camera.position, (const double[]){3.1, 0.2, -0.1}, sizeof s.camera.position);
    s.camera.fov = 90;
    for (int profile = 0; profile < JOB_PROFILE_COUNT; profile++) {
        struct job_spec spec = kit_spec(32, 16);
        spec.profile = (enum job_profile)profile;
        struct kit_picture p = kit_render(&s, &spec, 0);
        assert_true(kit_picture_mean(&p) == 0);
        kit_picture_free(&p);
    }
    scene_release(&s);
}

/* Mean weight 1, and weighted samples have the filter's moments. */
static void filters_are_drawn_as_they_are(void **state)
{
    (void)state;
    for (int type = 0; type < JOB_FILTER_COUNT; type++) {
        struct job_spec spec = kit_spec(4, 1);
        spec.filter = (enum job_filter)type;
        spec.filter_radius = type == JOB_FILTER_BOX ? 0.5 : 2;
        struct film_filter f;
        film_filter_init(&f, &spec);
        double mean = 0, first = 0, second = 0, exact = 0, norm = 0;
        enum { N = 100000 };
        for (int i = 0; i < N; i++) {
            double w, x = film_filter_sample(&f, (i + 0.5) / N, &w);
            assert_true(fabs(x) <= spec.filter_radius);
            mean += w / N;
            first += w * x / N;
            second += w * x * x / N;
            double y = spec.filter_radius * (2 * (i + 0.5) / N - 1);
            norm += film_filter_value(&f, y) / N;
            exact += film_filter_value(&f, y) * y * y / N;
        }
        assert_true(fabs(mean - 1) < 1e-4);
        assert_true(fabs(first) < 1e-4);
        assert_true(fabs(second - exact / norm) < 1e-3);
    }
}

static void polynomials_are_sines(void **state)
{
    (void)state;
    for (int i = 0; i <= 100000; i++) {
        double s, c, u = i / 100001.0;
        warp_sincos_turn(u, &s, &c);
        assert_true(fabs(s - sin(2 * VEC_PI * u)) < 1e-15);
        assert_true(fabs(c - cos(2 * VEC_PI * u)) < 1e-15);
        assert_true(fabs(warp_turn_of(3 * s, 3 * c) - u) < 4e-16);
    }
    assert_true(warp_turn_of(0, 0) == 0 && warp_turn_of(0, 2) == 0);
    assert_true(warp_turn_of(1, 0) == 0.25 && warp_turn_of(0, -1) == 0.5);
    assert_true(warp_turn_of(-1, 0) == 0.75 && warp_turn_of(-1, 1) == 0.875);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(samples_have_the_density),
        cmocka_unit_test(sky_is_the_same_both_ways),
        cmocka_unit_test(sky_is_drawn_for_the_normal),
        cmocka_unit_test(batches_have_the_bits_of_one),
        cmocka_unit_test(candidates_have_the_bits_of_one),
        cmocka_unit_test(batches_are_the_same_in_all_vectors),
        cmocka_unit_test(spheres_are_the_same_in_all_vectors),
        cmocka_unit_test(spheres_do_not_light_themselves),
        cmocka_unit_test(filters_are_drawn_as_they_are),
        cmocka_unit_test(polynomials_are_sines),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
