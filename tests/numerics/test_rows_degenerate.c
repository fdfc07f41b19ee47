/* T10 to T12: meshes that builders choke on, deep trees, and the order of input. */
#include "tests/numerics/rows.h"

#include <math.h>
#include <stdlib.h>
#include <time.h>

#include "common/mem.h"
#include "common/scene.h"
#include "tests/prop/test_accel_kit.h"
#include "tests/render/render_kit.h"
#include "worker/render/accel_parts.h"

static double processor_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void add(struct gen_mesh *m, const double p[3][3])
{
    double e1[3], e2[3];
    for (int k = 0; k < 3; k++) {
        e1[k] = p[1][k] - p[0][k];
        e2[k] = p[2][k] - p[0][k];
    }
    assert_int_equal(gen_quad(m, p[0], e1, e2), ERR_OK);
}

static void random_triangle(uint64_t *state, double p[3][3])
{
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            p[i][k] = 2 * gen_random(state) - 1;
}

/* Every builder agrees with brute force, and no tree is deeper than the stack. */
static void check_against_brute(const char *what, struct gen_mesh *m, size_t ray_count)
{
    struct trace_scene s;
    size_t triangles = m->triangle_count, bad = 0;
    uint64_t seed = 3, deepest = 0;
    trace_scene_wrap(&s, m);
    struct ray *rays = mem_alloc_array(ray_count, sizeof *rays);
    assert_non_null(rays);
    for (size_t i = 0; i < ray_count; i++)
        kit_ray(&s, &seed, i, &rays[i]);
    struct accel *brute = kit_build(&s.input, JOB_BUILDER_NONE, ACCEL_ISA_AUTO, NULL);
    for (int builder = 0; builder < JOB_BUILDER_NONE; builder++) {
        struct accel_stats stats;
        struct accel *a = kit_build(&s.input, (enum job_builder)builder, ACCEL_ISA_AUTO, NULL);
        accel_stats_get(a, &stats);
        deepest = stats.depth_max > deepest ? stats.depth_max : deepest;
        bad += kit_differences(brute, a, rays, ray_count);
        accel_free(a);
    }
    printf("  %s: %zu triangles, depth %llu, %zu of %zu rays unlike brute force\n", what, triangles,
           (unsigned long long)deepest, bad, 2 * ray_count);
    assert_int_equal(bad, 0);
    assert_true(deepest <= BVH_DEPTH_MAX);
    accel_free(brute);
    mem_free(rays);
    trace_scene_release(&s);
}

/* Points, lines, doubles, mirror images and whole triangles in one mesh. */
static void test_t10_degenerates(void **state)
{
    (void)state;
    struct gen_mesh m;
    uint64_t random = 31;
    gen_mesh_init(&m);
    for (int i = 0; i < 300; i++) {
        double p[3][3];
        random_triangle(&random, p);
        if (i % 5 == 1)
            memcpy(p[2], p[1], sizeof p[1]); /* an edge */
        if (i % 5 == 2)
            for (int k = 0; k < 3; k++) /* collinear */
                p[2][k] = p[0][k] + 3 * (p[1][k] - p[0][k]);
        if (i % 5 == 3) {
            memcpy(p[1], p[0], sizeof p[0]); /* a point */
            memcpy(p[2], p[0], sizeof p[0]);
        }
        add(&m, (const double(*)[3])p);
        if (i % 5 == 4)
            add(&m, (const double(*)[3])p); /* twice */
    }
    check_against_brute("T10 degenerates", &m, rows_long ? 100000 : 3000);
}

/* As many triangles as one likes, all with their boxes around the same centre. */
static void test_t10_coincident_centres(void **state)
{
    (void)state;
    size_t quads = rows_long ? 500000 : 10000;
    struct gen_mesh m[2];
    double seconds[2];
    uint64_t random = 32;
    for (int kind = 0; kind < 2; kind++) {
        gen_mesh_init(&m[kind]);
        for (size_t i = 0; i < quads; i++) {
            double corner[3], e[2][3], at[3];
            for (int k = 0; k < 3; k++) {
                e[0][k] = 0.1 * gen_random(&random) - 0.05;
                e[1][k] = 0.1 * gen_random(&random) - 0.05;
                at[k] = kind ? 2 * gen_random(&random) - 1 : 0;
                corner[k] = at[k] - 0.5 * (e[0][k] + e[1][k]);
            }
            assert_int_equal(gen_quad(&m[kind], corner, e[0], e[1]), ERR_OK);
        }
        struct accel_mesh view = {m[kind].positions, m[kind].indices,
                                  (uint32_t)m[kind].vertex_count, (uint32_t)m[kind].triangle_count};
        struct accel_object object = {.type = ACCEL_TRIANGLES};
        struct accel_input input = {&view, 1, &object, 1};
        /* The least of some: what else the machine does only adds. */
        for (int run = 0; run < 5; run++) {
            double begin = processor_seconds();
            accel_free(kit_build(&input, JOB_BUILDER_SAH, ACCEL_ISA_AUTO, NULL));
            double spent = processor_seconds() - begin;
            seconds[kind] = run == 0 ? spent : fmin(seconds[kind], spent);
        }
    }
    printf("  T10 build time over that of triangles at random: %.2f\n", seconds[0] / seconds[1]);
    assert_true(seconds[0] <= 2 * seconds[1]);
    gen_mesh_release(&m[1]);
    check_against_brute("T10 coincident centres", &m[0], rows_long ? 60 : 30);
}

static void test_t10_none_and_one(void **state)
{
    (void)state;
    struct accel_object object = {.type = ACCEL_TRIANGLES};
    static const float v[9] = {-1, -1, 0, 1, -1, 0, 0, 1, 0};
    static const uint32_t index[3] = {0, 1, 2};
    for (uint32_t count = 0; count < 2; count++)
        for (int builder = 0; builder < JOB_BUILDER_COUNT; builder++) {
            struct accel_mesh mesh = {v, index, 3, count};
            struct accel_input input = {&mesh, 1, &object, 1};
            struct accel *a = kit_build(&input, (enum job_builder)builder, ACCEL_ISA_AUTO, NULL);
            struct ray ray = {{0, 0, 2}, {0, 0, -1}, 0, (double)INFINITY};
            struct hit hit;
            accel_closest(a, &ray, &hit);
            assert_int_equal(hit.object, count ? 0 : SCENE_NONE);
            assert_true(!count || hit.t == 2);
            assert_int_equal(accel_occluded(a, &ray), count);
            accel_free(a);
        }
}

/* --- T11 ---------------------------------------------------------------------- */

/* Sizes and places that shrink by two, down to where floats end. */
static void test_t11_shrinking(void **state)
{
    (void)state;
    for (int kind = 0; kind < 3; kind++) {
        struct gen_mesh m;
        gen_mesh_init(&m);
        for (int k = 0; k < (kind == 2 ? 4 * 126 : 149); k++) {
            double size = ldexp(1, kind == 2 ? -(k / 4) : -k);
            double x = kind == 1 ? 1 - size : size; /* towards 1: doubles of one place */
            double p[3][3] = {{x, x, 0}, {x + 0.5 * size, x, 0}, {x, x + 0.5 * size, 0}};
            add(&m, (const double(*)[3])p);
        }
        check_against_brute(kind == 0   ? "T11 towards 0"
                            : kind == 1 ? "T11 towards 1"
                                        : "T11 four by four",
                            &m, rows_long ? 30000 : 1500);
    }
}

/* Clusters of clusters, each 2^-6 of the size of what holds it. */
static void test_t11_clusters(void **state)
{
    (void)state;
    size_t clusters = rows_long ? 100000 : 3000;
    struct gen_mesh m;
    uint64_t random = 33;
    gen_mesh_init(&m);
    for (size_t i = 0; i < clusters; i++) {
        double at[3] = {0, 0, 0}, size = 1;
        for (size_t level = 0; level < i % 20; level++) {
            for (int k = 0; k < 3; k++)
                at[k] += size * (gen_random(&random) < 0.5 ? 0.25 : 0.75);
            size *= 0x1p-6;
        }
        double p[3][3];
        random_triangle(&random, p);
        for (int c = 0; c < 3; c++)
            for (int k = 0; k < 3; k++)
                p[c][k] = at[k] + size * 0.1 * p[c][k];
        add(&m, (const double(*)[3])p);
    }
    check_against_brute("T11 clusters", &m, rows_long ? 500 : 300);
}

/* --- T12 ---------------------------------------------------------------------- */

/* Swaps triangles about; place[i]: where triangle i went. */
static void shuffle(uint32_t *indices, size_t count, uint32_t *place, uint64_t *random)
{
    uint32_t *at = mem_alloc_array(count, sizeof *at); /* at[i]: which triangle is there */
    assert_non_null(at);
    for (size_t i = 0; i < count; i++)
        at[i] = (uint32_t)i;
    for (size_t i = count - 1; i > 0; i--) {
        size_t j = (size_t)(gen_random(random) * (double)(i + 1));
        uint32_t swap[3], which = at[i];
        memcpy(swap, indices + 3 * i, sizeof swap);
        memcpy(indices + 3 * i, indices + 3 * j, sizeof swap);
        memcpy(indices + 3 * j, swap, sizeof swap);
        at[i] = at[j];
        at[j] = which;
    }
    for (size_t i = 0; i < count; i++)
        place[at[i]] = (uint32_t)i;
    mem_free(at);
}

/* The triangles in another order: each ray meets the same triangle under its new number, with the
 * same bits, but for ties at shared corners and edges, where t is still the same. */
static void test_t12_numbers_stay(void **state)
{
    (void)state;
    struct trace_scene s, t;
    uint64_t random = 34;
    size_t count = rows_long ? 1000000 : 20000, other = 0;
    assert_int_equal(trace_scene_make(&s, TRACE_BALL70K), ERR_OK);
    assert_int_equal(trace_scene_make(&t, TRACE_BALL70K), ERR_OK);
    size_t triangles = s.mesh[0].triangle_count;
    uint32_t *place = mem_alloc_array(triangles, sizeof *place);
    assert_non_null(place);
    shuffle(t.mesh[0].indices, triangles, place, &random);
    struct accel *a = kit_build(&s.input, JOB_BUILDER_SAH, ACCEL_ISA_AUTO, NULL);
    for (int builder = 0; builder < JOB_BUILDER_NONE; builder++) {
        struct accel *b = kit_build(&t.input, (enum job_builder)builder, ACCEL_ISA_AUTO, NULL);
        for (size_t i = 0; i < count; i++) {
            struct ray ray;
            struct hit x, y;
            kit_ray(&s, &random, i, &ray);
            accel_closest(a, &ray, &x);
            accel_closest(b, &ray, &y);
            assert_int_equal(x.object, y.object);
            if (x.object == SCENE_NONE)
                continue;
            assert_memory_equal(&x.t, &y.t, sizeof x.t);
            bool same = y.primitive == place[x.primitive];
            other += !same;
            if (same)
                assert_true(memcmp(&x.b1, &y.b1, sizeof x.b1) == 0 &&
                            memcmp(&x.b2, &y.b2, sizeof x.b2) == 0 &&
                            memcmp(x.ng, y.ng, sizeof x.ng) == 0);
            else
                assert_true(i % 3 != 2); /* only those aimed at vertices and edges */
        }
        accel_free(b);
    }
    printf("  T12: %zu of %zu rays met the other triangle of a tie\n", other, 2 * count);
    accel_free(a);
    mem_free(place);
    trace_scene_release(&s);
    trace_scene_release(&t);
}

/* The same picture from every builder and from meshes in any order. */
static void test_t12_pictures(void **state)
{
    (void)state;
    struct kit_picture first = {0};
    uint64_t random = 35;
    for (int i = 0; i < 2 * JOB_BUILDER_COUNT; i++) {
        struct scene s;
        scene_init(&s);
        kit_cornell(&s, KIT_BOXES | KIT_AREA_LIGHT | KIT_DISC);
        if (i >= JOB_BUILDER_COUNT)
            for (size_t k = 0; k < s.mesh_count; k++) {
                uint32_t place[64];
                assert_true(s.meshes[k].triangle_count <= 64);
                shuffle(s.meshes[k].indices, s.meshes[k].triangle_count, place, &random);
            }
        struct job_spec spec = kit_spec(24, 4);
        spec.builder = (enum job_builder)(i % JOB_BUILDER_COUNT);
        /* A lamp's triangles are lights in order: where they are sampled the order is visible. */
        spec.integrator =
            i >= JOB_BUILDER_COUNT ? JOB_INTEGRATOR_INTERSECTION_TEST : JOB_INTEGRATOR_PATH;
        struct kit_picture p = kit_render(&s, &spec, 0);
        if (i == 0) {
            first = p;
        } else if (i < JOB_BUILDER_COUNT) {
            assert_memory_equal(p.mean, first.mean, 24 * 24 * 3 * sizeof *p.mean);
            kit_picture_free(&p);
        } else {
            /* The unshuffled mesh under the same integrator. */
            struct scene plain;
            scene_init(&plain);
            kit_cornell(&plain, KIT_BOXES | KIT_AREA_LIGHT | KIT_DISC);
            spec.builder = JOB_BUILDER_SAH;
            struct kit_picture q = kit_render(&plain, &spec, 0);
            assert_memory_equal(p.mean, q.mean, 24 * 24 * 3 * sizeof *p.mean);
            kit_picture_free(&p);
            kit_picture_free(&q);
            scene_release(&plain);
        }
        scene_release(&s);
    }
    kit_picture_free(&first);
}

int main(int argc, char **argv)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_t10_degenerates),  cmocka_unit_test(test_t10_coincident_centres),
        cmocka_unit_test(test_t10_none_and_one), cmocka_unit_test(test_t11_shrinking),
        cmocka_unit_test(test_t11_clusters),     cmocka_unit_test(test_t12_numbers_stay),
        cmocka_unit_test(test_t12_pictures),
    };
    return ROWS_RUN(argc, argv, tests);
}
