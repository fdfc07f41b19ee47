/* Splits of space (builder sbvh), and what they ask of a hit: it lies at its triangle, not only
 * within its box, since the pieces of a triangle have boxes of their own (docs/TRACING.md, 1, 4).
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "common/mem.h"
#include "common/scene.h"
#include "tests/prop/test_accel_kit.h"

static bool is_long;

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Needles are too thin for sums of double. */
typedef __float128 quad;

static quad quad_dot(const double a[3], const double b[3])
{
    return (quad)a[0] * b[0] + (quad)a[1] * b[1] + (quad)a[2] * b[2];
}

/* The largest component of p less the nearest point of segment a, a + e. */
static double off_segment(const double p[3], const double a[3], const double e[3])
{
    double ap[3], most = 0, size = dot(e, e);
    for (int k = 0; k < 3; k++)
        ap[k] = p[k] - a[k];
    double along = size > 0 ? dot(ap, e) / size : 0;
    along = fmin(fmax(along, 0), 1);
    for (int k = 0; k < 3; k++)
        most = fmax(most, fabs(ap[k] - along * e[k]));
    return most;
}

/* How far p is from a triangle at most: from its nearest edge, or where it lies above the inside
 * from its plane, if that is less. */
static double off_triangle(const double p[3], const double v[3][3])
{
    double e1[3], e2[3], e3[3], ap[3];
    for (int k = 0; k < 3; k++) {
        e1[k] = v[1][k] - v[0][k];
        e2[k] = v[2][k] - v[0][k];
        e3[k] = v[2][k] - v[1][k];
        ap[k] = p[k] - v[0][k];
    }
    double off = fmin(off_segment(p, v[0], e1), off_segment(p, v[0], e2));
    off = fmin(off, off_segment(p, v[1], e3));
    quad a = quad_dot(e1, e1), b = quad_dot(e1, e2), c = quad_dot(e2, e2);
    quad d = quad_dot(ap, e1), e = quad_dot(ap, e2), det = a * c - b * b;
    quad x = (d * c - e * b) / det, y = (e * a - d * b) / det;
    double above = 0;
    if (!(x >= 0 && y >= 0 && x + y <= 1))
        return off;
    for (int k = 0; k < 3; k++)
        above = fmax(above, fabs((double)(ap[k] - x * e1[k] - y * e2[k])));
    return fmin(off, above);
}

/* A triangle of any shape, from a flat one to a needle, and a ray through its plane at any slope,
 * from upright to all but within it, that meets it or passes it by closely. */
static void make_case(uint64_t *seed, float v[3][3], struct ray *ray)
{
    double size = ldexp(1, -(int)(gen_random(seed) * 12)), thin[3], through[3], n[3];
    double narrow = ldexp(1, -(int)(gen_random(seed) * 28)), a = gen_random(seed);
    double b = (1 - a) * gen_random(seed), lift = ldexp(1, -(int)(gen_random(seed) * 56));
    double e[2][3], turn = 4 * gen_random(seed) - 2, far = ldexp(1, (int)(gen_random(seed) * 6));
    for (int k = 0; k < 3; k++) {
        double corner = 2 * gen_random(seed) - 1, along = 2 * gen_random(seed) - 1;
        thin[k] = 2 * gen_random(seed) - 1;
        v[0][k] = (float)corner;
        v[1][k] = (float)(corner + size * along);
        v[2][k] = (float)(corner + size * (along * gen_random(seed) + narrow * thin[k]));
        e[0][k] = (double)v[1][k] - (double)v[0][k];
        e[1][k] = (double)v[2][k] - (double)v[0][k];
        through[k] = (double)v[0][k] + a * e[0][k] + b * e[1][k];
    }
    for (int k = 0; k < 3; k++)
        n[k] = e[0][(k + 1) % 3] * e[1][(k + 2) % 3] - e[0][(k + 2) % 3] * e[1][(k + 1) % 3];
    double length = sqrt(dot(n, n)), side = sqrt(dot(e[0], e[0])) + 1e-300;
    length = length > 0 ? length : 1;
    *ray = (struct ray){.tmin = 0, .tmax = (double)INFINITY};
    for (int k = 0; k < 3; k++) { /* along e0, along what is upright on it in the plane, upwards */
        double across = n[(k + 1) % 3] * e[0][(k + 2) % 3] - n[(k + 2) % 3] * e[0][(k + 1) % 3];
        double dir = (e[0][k] + turn * across / length) / side + lift * n[k] / length;
        ray->dir[k] = dir;
        ray->org[k] = through[k] - far * dir;
    }
}

static void test_hits_lie_at_their_triangle(void **state)
{
    (void)state;
    static const uint32_t indices[3] = {0, 1, 2};
    size_t count = is_long ? 10000000 : 100000, hits = 0, off_many = 0;
    uint64_t seed = 48;
    double most = 0;
    for (size_t i = 0; i < count; i++) {
        float v[3][3];
        struct ray ray;
        struct hit hit;
        make_case(&seed, v, &ray);
        struct accel_mesh mesh = {v[0], indices, 3, 1};
        struct accel_object object = {.type = ACCEL_TRIANGLES};
        struct accel_input input = {&mesh, 1, &object, 1};
        struct accel *a = kit_build(&input, JOB_BUILDER_NONE, ACCEL_ISA_AUTO, NULL);
        accel_closest(a, &ray, &hit);
        accel_free(a);
        if (hit.object == SCENE_NONE)
            continue;
        double p[3], corners[3][3], size = 0, reach = 0;
        for (int k = 0; k < 3; k++) {
            p[k] = ray.org[k] + hit.t * ray.dir[k];
            size = fmax(size, fabs(ray.org[k]));
            for (int j = 0; j < 3; j++) {
                corners[j][k] = (double)v[j][k];
                reach = fmax(reach, fabs(corners[j][k]));
            }
        }
        double off = off_triangle(p, corners) / (size + reach);
        hits++;
        most = fmax(most, off);
        off_many += off > 0x1p-29;
    }
    printf("  %zu hits of %zu rays lie off their triangle by 2^%.1f R at most, %zu of them by over "
           "2^-29 R\n",
           hits, count, log2(most), off_many);
    assert_true(hits > count / 10);
    assert_int_equal(off_many, 0);
}

/* --- Trees of pieces ----------------------------------------------------------- */

/* Needles and large triangles that lie askew, among them a few so thin that float makes lines of
 * them, and two spheres that no plane may cut. */
static void make_askew(struct trace_scene *s, struct accel_object objects[3])
{
    struct gen_mesh m;
    uint64_t seed = 49;
    gen_mesh_init(&m);
    assert_int_equal(gen_needles(&m, 400, 0.8, 0.8, 1e-3, 1), ERR_OK);
    assert_int_equal(gen_needles(&m, 100, 0.8, 0.8, 1e-9, 2), ERR_OK);
    for (int i = 0; i < 50; i++) {
        double corner[3], e1[3], e2[3];
        for (int k = 0; k < 3; k++) {
            corner[k] = gen_random(&seed) - 1;
            e1[k] = 2 * gen_random(&seed) - 1;
            e2[k] = 2 * gen_random(&seed) - 1;
        }
        assert_int_equal(gen_quad(&m, corner, e1, e2), ERR_OK);
    }
    trace_scene_wrap(s, &m);
    objects[0] = s->input.objects[0];
    objects[1] =
        (struct accel_object){.type = ACCEL_SPHERE, .center = {0.2, 0.1, 0}, .radius = 0.5};
    objects[2] = (struct accel_object){.type = ACCEL_SPHERE, .center = {0, -0.4, 0}, .radius = 0.1};
    s->input.objects = objects;
    s->input.object_count = 3;
}

/* Half of the rays run along needles, all but in their planes, the others are any. */
static void make_ray_along(const struct trace_scene *s, uint64_t *seed, size_t i, struct ray *out)
{
    const struct accel_mesh *m = &s->views[0];
    const uint32_t *v = &m->indices[3 * (size_t)(gen_random(seed) * m->triangle_count)];
    double far = ldexp(1, (int)(gen_random(seed) * 8)),
           off = ldexp(1, -(int)(gen_random(seed) * 50));
    kit_ray(s, seed, i, out);
    if (i % 2)
        return;
    for (size_t k = 0; k < 3; k++) {
        double a = (double)m->positions[3 * (size_t)v[0] + k];
        double b = (double)m->positions[3 * (size_t)v[1] + k];
        double c = (double)m->positions[3 * (size_t)v[2] + k];
        out->dir[k] = b - a + 0.5 * (c - a) + off * (2 * gen_random(seed) - 1);
        out->org[k] = 0.5 * a + 0.25 * (b + c) - far * out->dir[k];
    }
}

static void test_pieces_answer_as_triangles(void **state)
{
    (void)state;
    const enum accel_isa isas[] = {ACCEL_ISA_SSE2, ACCEL_ISA_AVX2, ACCEL_ISA_AVX512};
    struct trace_scene s;
    struct accel_object objects[3];
    uint64_t seed = 50;
    size_t count = is_long ? 300000 : 3000, bad = 0;
    make_askew(&s, objects);
    struct ray *rays = mem_alloc_array(count, sizeof *rays);
    assert_non_null(rays);
    for (size_t i = 0; i < count; i++)
        make_ray_along(&s, &seed, i, &rays[i]);
    struct accel *brute = kit_build(&s.input, JOB_BUILDER_NONE, ACCEL_ISA_AUTO, NULL);
    struct accel_options fast = {.builder = JOB_BUILDER_SAH, .precision = JOB_PRECISION_FAST};
    struct accel *whole = NULL;
    assert_int_equal(accel_new(&s.input, &fast, NULL, &whole), ERR_OK);
    for (int i = 0; i < 9; i++) {
        struct accel_options options = {.builder = JOB_BUILDER_SBVH,
                                        .isa = isas[i % 3],
                                        .compact = i / 3 == 1,
                                        .precision =
                                            i / 3 == 2 ? JOB_PRECISION_FAST : JOB_PRECISION_EXACT};
        struct accel *a = NULL;
        assert_int_equal(accel_new(&s.input, &options, NULL, &a), ERR_OK);
        bad += kit_differences(i / 3 == 2 ? whole : brute, a, rays, count);
        accel_free(a);
    }
    printf("  %zu rays, %zu differ\n", count, bad);
    assert_int_equal(bad, 0);
    accel_free(whole);
    accel_free(brute);
    mem_free(rays);
    trace_scene_release(&s);
}

/* Of long triangles trees of pieces cost less, of others no more; references at most double. */
static void test_pieces_pay_for_needles(void **state)
{
    (void)state;
    const struct {
        enum trace_scene_id scene;
        double cost_most;
    } cases[] = {
        {TRACE_NEEDLES, 0.75}, {TRACE_FRAME, 0.6}, {TRACE_CORNELL, 1.0}, {TRACE_BALL70K, 1.005}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct trace_scene s;
        struct accel_stats whole, pieces;
        assert_int_equal(trace_scene_make(&s, cases[i].scene), ERR_OK);
        struct accel *a = kit_build(&s.input, JOB_BUILDER_SAH, ACCEL_ISA_AUTO, NULL);
        struct accel *b = kit_build(&s.input, JOB_BUILDER_SBVH, ACCEL_ISA_AUTO, NULL);
        accel_stats_get(a, &whole);
        accel_stats_get(b, &pieces);
        printf("  %s: SAH %.1f for %.1f, bytes %.2f of what they were\n",
               trace_scene_names[cases[i].scene], pieces.sah_cost, whole.sah_cost,
               (double)pieces.bytes / (double)whole.bytes);
        assert_true(pieces.sah_cost <= cases[i].cost_most * whole.sah_cost);
        assert_true(pieces.leaf_count <= 2 * s.triangle_count);
        assert_true((double)pieces.bytes <= 2.25 * (double)whole.bytes);
        accel_free(a);
        accel_free(b);
        trace_scene_release(&s);
    }
}

int main(int argc, char **argv)
{
    is_long = kit_long(argc, argv);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_hits_lie_at_their_triangle),
        cmocka_unit_test(test_pieces_answer_as_triangles),
        cmocka_unit_test(test_pieces_pay_for_needles),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
