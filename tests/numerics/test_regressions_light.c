/* What users of other renderers reported, continued: rays that leave surfaces, and sums of many
 * samples. docs/NUMERICS.md tells the stories. */
#include "tests/numerics/rows.h"

#include <math.h>

#include "common/mem.h"
#include "tests/numerics/light_step.h"
#include "tests/prop/test_accel_kit.h"
#include "tests/render/render_kit.h"
#include "worker/scene/scene_build.h"

static const double pi = 3.14159265358979323846;

static struct render_scene *build(const struct scene *s)
{
    struct job_spec spec = kit_spec(1, 1);
    struct render_scene *rs;
    assert_int_equal(scene_build(s, &spec, NULL, &rs), ERR_OK);
    return rs;
}

static uint32_t bending(struct scene *s, double eta)
{
    struct scene_material *m;
    uint32_t index = kit_material(s, SCENE_MATERIAL_REFRACTION, &m);
    m->eta = eta;
    return index;
}

/* A ball of glass on which a ray along -z falls `miss` radii beside its middle: how far the ray
 * that leaves it is off in direction and in place (of its line, in radii). Snell: it turns by 2 (in
 * - out) towards the axis and passes the middle as near as before. */
static void lens_ray(const struct render_scene *rs, const double center[3], double radius,
                     double miss, double turn, double *direction, double *place)
{
    double x = cos(turn), y = sin(turn), r = radius * rs->scale;
    vec3 middle =
        v3((center[0] - rs->center[0]) * rs->scale, (center[1] - rs->center[1]) * rs->scale,
           (center[2] - rs->center[2]) * rs->scale);
    vec3 org = v3_add(middle, v3(miss * r * x, miss * r * y, 2 * r)), dir = v3(0, 0, -1);
    uint32_t object;
    for (int i = 0; i < 2; i++)
        assert_true(light_step(rs, &org, &dir, &object) && object == 0);
    double bend = 2 * (asin(miss) - asin(miss / 1.5));
    vec3 expected = v3(-sin(bend) * x, -sin(bend) * y, -cos(bend));
    double aside = v3_length(v3_cross(v3_sub(org, middle), dir)) / r;
    *direction = fmax(*direction, v3_abs_max(v3_sub(dir, expected)));
    *place = fmax(*place, fabs(aside - miss));
}

/* Mitsuba 3 #219: a lens of radius 250 at (278, 273, -5400) is out of focus, since rays that go on
 * through it start too far along the normal where coordinates are large. Here, and farther out. */
static void test_mitsuba3_219_lens_far_from_the_origin(void **state)
{
    (void)state;
    static const double factors[] = {0, 1, 1e2, 1e4};
    for (int i = 0; i < 4; i++) {
        double f = factors[i], direction = 0, place = 0;
        const double center[3] = {278 * f, 273 * f, -5400 * f};
        struct scene s;
        scene_init(&s);
        kit_sphere(&s, center[0], center[1], center[2], 250, bending(&s, 1.5));
        kit_sphere(&s, 0, 0, 600, 1,
                   kit_diffuse(&s, 1, 1, 1)); /* the scene reaches to the origin */
        struct render_scene *rs = build(&s);
        for (int k = 0; k < 99 * 12; k++)
            lens_ray(rs, center, 250, 0.01 * (k / 12), k % 12 * pi / 6, &direction, &place);
        printf("  a lens %g away: direction off by %.2g, place by %.2g radii\n", 5400 * f,
               direction, place);
        assert_true(direction <= 1e-12 * fmax(1, f) && place <= 1e-12 * fmax(1, f));
        render_scene_free(rs);
        scene_release(&s);
    }
}

/* Mitsuba 3 PR #1871: what lies less than an epsilon under a cornea of glass is not seen. */
static void test_mitsuba3_1871_surfaces_closer_than_an_epsilon(void **state)
{
    (void)state;
    static const double gaps[] = {4e-5, 1e-8, 1e-12, 1e-14};
    for (int i = 0; i < 4; i++) {
        struct scene s;
        scene_init(&s);
        kit_sphere(&s, 0, 0, 0, 1 + gaps[i], bending(&s, 1.5));
        kit_sphere(&s, 0, 0, 0, 1, kit_diffuse(&s, 1, 0, 0));
        struct render_scene *rs = build(&s);
        for (int k = 0; k < 2000; k++) {
            uint32_t object = SCENE_NONE;
            double miss = 0.99 * sqrt((k + 0.5) / 2000), turn = 2.399963 * k;
            vec3 org =
                v3(miss * cos(turn) * rs->scale, miss * sin(turn) * rs->scale, 2 * rs->scale);
            vec3 dir = v3(0, 0, -1);
            assert_true(light_step(rs, &org, &dir, &object) && object == 0);
            (void)light_step(rs, &org, &dir, &object);
            assert_int_equal(object, 1);
        }
        render_scene_free(rs);
        scene_release(&s);
    }
}

/* Mitsuba 2 #206: rays that enter a cube do not find the way out. Glass of index 1: in, out, gone.
 */
static void test_mitsuba2_206_what_enters_a_cube_leaves_it(void **state)
{
    (void)state;
    static const double corners[24] = {-1, -1, -1, 1, -1, -1, -1, 1, -1, 1, 1, -1,
                                       -1, -1, 1,  1, -1, 1,  -1, 1, 1,  1, 1, 1};
    static const uint32_t faces[36] = {0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4,
                                       2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7, 5};
    struct scene s;
    uint64_t random = 61;
    scene_init(&s);
    kit_mesh(&s, corners, 8, faces, 12, bending(&s, 1));
    struct render_scene *rs = build(&s);
    for (int i = 0; i < 100000; i++) {
        double from[3], to[3];
        for (int k = 0; k < 3; k++) {
            to[k] = 1.8 * gen_random(&random) - 0.9;
            from[k] = 8 * gen_random(&random) - 4;
        }
        from[i % 3] = i % 2 ? 3 : -3;
        vec3 org = v3_scale(v3_of(from), rs->scale);
        vec3 dir = v3_unit(v3_sub(v3_scale(v3_of(to), rs->scale), org));
        uint32_t object;
        assert_true(light_step(rs, &org, &dir, &object));
        assert_true(light_step(rs, &org, &dir, &object));
        assert_false(light_step(rs, &org, &dir, &object));
    }
    render_scene_free(rs);
    scene_release(&s);
}

/* Mitsuba 3 #512: a ball seen by an orthographic camera far away has rings. */
static void test_mitsuba3_512_no_rings_from_far_away(void **state)
{
    (void)state;
    struct kit_picture near_by = {0};
    for (int k = 1; k <= 9; k++) {
        struct scene s;
        scene_init(&s);
        kit_sphere(&s, 0, 0, 0, 1, kit_diffuse(&s, 0.8, 0.8, 0.8));
        struct scene_light *l = kit_light(&s, SCENE_LIGHT_DIRECTIONAL);
        for (int c = 0; c < 3; c++)
            l->direction[c] = -1 / sqrt(3);
        s.camera.type = SCENE_CAMERA_ORTHOGRAPHIC;
        s.camera.ortho_height = 1.2; /* nothing but ball */
        s.camera.position[2] = pow(10, k);
        struct job_spec spec = kit_spec(24, 16);
        struct kit_picture p = kit_render(&s, &spec, 0);
        double worst = 0;
        if (k == 1)
            near_by = p;
        assert_true(kit_picture_mean(&p) > 0);
        for (size_t i = 0; i < 24 * 24 * 3; i++)
            worst = fmax(worst, fabs(p.mean[i] - near_by.mean[i]));
        worst /= kit_picture_mean(&near_by);
        printf("  seen from 10^%d: off by %.2g of the mean\n", k, worst);
        assert_true(worst <= 1e-6); /* doubles have steps of 1e-7 out there */
        if (k > 1)
            kit_picture_free(&p);
        scene_release(&s);
    }
    kit_picture_free(&near_by);
}

/* tinybvh PR #283: an absolute epsilon on the determinant, which goes with the square of the edges,
 * makes a triangle of 0.2 mm vanish. Down to where floats end, by every kernel and builder. */
static void test_tinybvh_283_small_triangles(void **state)
{
    (void)state;
    static const enum accel_isa isas[] = {ACCEL_ISA_SSE2, ACCEL_ISA_AVX2, ACCEL_ISA_AVX512};
    for (double size = 2e-4; size > 1e-38; size /= 10) {
        float z = (float)size, v[9] = {0, 0, 0, z, 0, 0, 0, z, 0};
        struct accel_mesh mesh = {v, (const uint32_t[3]){0, 1, 2}, 3, 1};
        struct accel_object object = {.type = ACCEL_TRIANGLES};
        struct accel_input input = {&mesh, 1, &object, 1};
        for (int isa = 0; isa < 3; isa++)
            for (int builder = 0; builder <= JOB_BUILDER_NONE; builder++) {
                struct accel *a = kit_build(&input, (enum job_builder)builder, isas[isa], NULL);
                struct ray ray = {.org = {(double)z / 3, (double)z / 3, -1},
                                  .dir = {0, 0, 1},
                                  .tmax = (double)INFINITY};
                struct hit hit;
                accel_closest(a, &ray, &hit);
                if (hit.object == SCENE_NONE || hit.t != 1)
                    fail_msg("a triangle of %g: t %g", size, hit.t);
                ray.org[0] = 1.01 * (double)z; /* and nothing beside it */
                assert_false(accel_occluded(a, &ray));
                accel_free(a);
            }
    }
}

/* One pixel of a white floor under a sky, or under a lamp straight above. */
static double one_pixel(bool sky, uint64_t spp)
{
    static const double ground[12] = {-9, 0, -9, -9, 0, 9, 9, 0, 9, 9, 0, -9};
    struct scene s;
    scene_init(&s);
    kit_quad(&s, ground, kit_diffuse(&s, 0.5, 0.5, 0.5));
    if (sky) {
        kit_constant_sky(&s, 1);
    } else {
        struct scene_light *l = kit_light(&s, SCENE_LIGHT_DIRECTIONAL);
        l->direction[0] = l->direction[2] = 0;
        l->direction[1] = -1;
        l->intensity[0] = l->intensity[1] = l->intensity[2] = 1;
    }
    s.camera.position[1] = 3;
    s.camera.position[2] = 1;
    s.camera.fov = 1e-3;
    struct job_spec spec = kit_spec(1, spp);
    spec.max_depth = 2;
    struct kit_picture p = kit_render(&s, &spec, 0);
    assert_int_equal(p.counters.nonfinite, 0);
    double mean = p.mean[1];
    kit_picture_free(&p);
    scene_release(&s);
    return mean;
}

/* Mitsuba 2 #82: the more samples, the worse: at 10^7 a grey of 0.5 is 0.505, at 10^8 it is 1. Up
 * to 10^6 here, with --long to 10^8. */
static void test_mitsuba2_82_many_samples_do_not_drift(void **state)
{
    (void)state;
    int most = rows_long ? 8 : 6;
    for (int k = 0; k <= most; k++) {
        uint64_t spp = (uint64_t)pow(10, k);
        double off[2] = {one_pixel(true, spp) / 0.5 - 1, one_pixel(false, spp) / (0.5 / pi) - 1};
        printf("  10^%d samples: sky off by %.2g, lamp by %.2g\n", k, off[0], off[1]);
        assert_true(fabs(off[0]) <= 6 / sqrt((double)spp) && fabs(off[1]) <= 1e-6);
    }
}

int main(int argc, char **argv)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_mitsuba3_219_lens_far_from_the_origin),
        cmocka_unit_test(test_mitsuba3_1871_surfaces_closer_than_an_epsilon),
        cmocka_unit_test(test_mitsuba2_206_what_enters_a_cube_leaves_it),
        cmocka_unit_test(test_mitsuba3_512_no_rings_from_far_away),
        cmocka_unit_test(test_tinybvh_283_small_triangles),
        cmocka_unit_test(test_mitsuba2_82_many_samples_do_not_drift),
    };
    return ROWS_RUN(argc, argv, tests);
}
