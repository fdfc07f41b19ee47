/* What users of other renderers reported, each rebuilt as a small scene. The names are the
 * trackers' (docs/NUMERICS.md tells the stories); what is asked is what their users asked for. */
#include "tests/numerics/rows.h"

#include <math.h>
#include <stdlib.h>

#include "common/mem.h"
#include "common/scene.h"
#include "tests/numerics/closed_mesh.h"
#include "tests/prop/test_accel_kit.h"
#include "tests/render/render_kit.h"
#include "worker/render/bsdf.h"
#include "worker/render/sampler.h"
#include "worker/render/wave.h"
#include "worker/scene/scene_build.h"

static const enum accel_isa isas[] = {ACCEL_ISA_SSE2, ACCEL_ISA_AVX2, ACCEL_ISA_AVX512};

static struct render_scene *build(const struct scene *s)
{
    struct job_spec spec = kit_spec(1, 1);
    struct render_scene *rs;
    assert_int_equal(scene_build(s, &spec, NULL, &rs), ERR_OK);
    return rs;
}

/* A ray of the world in scene space, t in world lengths. */
static struct ray world_ray(const struct render_scene *rs, const double org[3], const double dir[3])
{
    struct ray ray = {.tmax = (double)INFINITY};
    for (int k = 0; k < 3; k++) {
        ray.org[k] = (org[k] - rs->center[k]) * rs->scale;
        ray.dir[k] = dir[k] * rs->scale;
    }
    return ray;
}

static void assert_clean(const struct kit_picture *p)
{
    assert_int_equal(p->counters.nonfinite, 0);
    for (size_t i = 0; i < (size_t)p->width * p->height * 3; i++)
        assert_true(isfinite(p->mean[i]) && p->mean[i] >= 0);
}

/* Embree #387: a skinny triangle met under 0.52 degrees is "hit" at t = 12,291 though all its
 * vertices lie within 600. */
static void test_embree_387_t_within_the_triangle(void **state)
{
    (void)state;
    uint64_t random = 51;
    size_t hits = 0;
    for (int i = 0; i < 20000; i++) {
        float v[9];
        double along = 300 + 300 * gen_random(&random), low = 1e300, high = -1e300;
        for (int c = 0; c < 3; c++) {
            v[3 * c] = (float)(along + 100 * gen_random(&random));
            v[3 * c + 1] = (float)(1e-3 * gen_random(&random));
            v[3 * c + 2] = (float)(tan(0.52 * 3.14159265358979 / 180) * (double)v[3 * c] +
                                   1e-4 * gen_random(&random));
        }
        struct accel_mesh mesh = {v, (const uint32_t[3]){0, 1, 2}, 3, 1};
        struct accel_object object = {.type = ACCEL_TRIANGLES};
        struct accel_input input = {&mesh, 1, &object, 1};
        struct accel *a = kit_build(&input, JOB_BUILDER_SAH, isas[i % 3], NULL);
        struct ray ray = {.tmax = (double)INFINITY};
        double b = gen_random(&random), c = (1 - b) * gen_random(&random);
        for (int k = 0; k < 3; k++)
            ray.dir[k] =
                ((1 - b - c) * (double)v[k] + b * (double)v[3 + k] + c * (double)v[6 + k]) / 600;
        for (int k = 0; k < 3; k++) {
            low = fmin(low, (double)v[3 * k] / ray.dir[0]);
            high = fmax(high, (double)v[3 * k] / ray.dir[0]);
        }
        struct hit hit;
        accel_closest(a, &ray, &hit);
        if (hit.object != SCENE_NONE) {
            hits++;
            assert_true(hit.t >= low * (1 - 1e-7) && hit.t <= high * (1 + 1e-7));
        }
        accel_free(a);
    }
    assert_true(hits > 10000);
}

/* Embree #423: one ray hits under SSE and AVX and misses under AVX2. Rays at vertices and edges,
 * where a rounding decides. */
static void test_embree_423_every_kernel_agrees(void **state)
{
    (void)state;
    enum { RAYS = 30000 };
    struct gen_mesh mesh, view;
    struct trace_scene s;
    closed_make(CLOSED_HULL, &mesh);
    view = mesh;
    trace_scene_wrap(&s, &mesh);
    struct accel *a[3];
    for (int i = 0; i < 3; i++)
        a[i] = kit_build(&s.input, JOB_BUILDER_SAH, isas[i], NULL);
    uint64_t random = 52;
    for (size_t i = 0; i < RAYS; i++) {
        struct ray ray;
        struct hit hit[3];
        closed_ray(&view, &random, i, &ray);
        for (int k = 0; k < 3; k++) {
            ray.org[k] = 3 * (ray.org[k] + ray.dir[k]); /* from outside, at the same place */
            ray.dir[k] = -ray.org[k];
        }
        for (int k = 0; k < 3; k++)
            accel_closest(a[k], &ray, &hit[k]);
        for (int k = 1; k < 3; k++)
            assert_true(hit[k].object == hit[0].object && hit[k].primitive == hit[0].primitive &&
                        memcmp(&hit[k].t, &hit[0].t, sizeof hit[0].t) == 0);
    }
    for (int i = 0; i < 3; i++)
        accel_free(a[i]);
    trace_scene_release(&s);
}

/* Mitsuba 3 #1149: rays at the edge that two triangles share pass between them. A white wall of
 * two triangles, seen through its diagonal: no pixel shows the black behind. */
static void test_mitsuba3_1149_no_light_through_the_diagonal(void **state)
{
    (void)state;
    static const double wall[12] = {-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0};
    struct scene s;
    scene_init(&s);
    kit_emit(&s, kit_quad(&s, wall, SCENE_NONE), 1, 1, 1);
    struct render_scene *rs = build(&s);
    for (int i = -1000; i <= 1000; i++) {
        double x = i / 1000.0 * 0.999;
        for (int k = 0; k < 5; k++) {
            double org[3] = {0.1 * k - 0.2, 0.3 - 0.2 * k, 1.0 / (k + 1)};
            double dir[3] = {x - org[0], x - org[1], -org[2]};
            struct ray ray = world_ray(rs, org, dir);
            assert_true(accel_occluded(rs->accel, &ray));
        }
    }
    render_scene_free(rs);
    scene_release(&s);
}

/* Mitsuba 3 #550: an emitter seen at exactly 90 degrees gives NaN. A lamp that stands on the
 * floor, its plane through the pixels, and one seen edge-on by the camera. */
static void test_mitsuba3_550_emitter_at_right_angles(void **state)
{
    (void)state;
    static const double floor_quad[12] = {-4, 0, -4, -4, 0, 4, 4, 0, 4, 4, 0, -4};
    static const double standing[12] = {0, 0, -1, 0, 1, -1, 0, 1, 1, 0, 0, 1};
    static const double lying[12] = {-1, 0, 1.5, 1, 0, 1.5, 1, 0, 3, -1, 0, 3};
    for (int i = 0; i < 2; i++) {
        struct scene s;
        scene_init(&s);
        uint32_t grey = kit_diffuse(&s, 0.5, 0.5, 0.5);
        kit_quad(&s, floor_quad, grey);
        kit_emit(&s, kit_quad(&s, i ? lying : standing, SCENE_NONE), 5, 5, 5);
        s.camera.position[1] = i ? 0 : 3; /* in the floor's plane, or above the lamp */
        s.camera.position[2] = i ? 9 : 3;
        struct job_spec spec = kit_spec(32, 16);
        struct kit_picture p = kit_render(&s, &spec, 0);
        assert_clean(&p);
        assert_true(i == 1 || kit_picture_mean(&p) > 0);
        kit_picture_free(&p);
        scene_release(&s);
    }
}

/* Mitsuba 3 PR #1888: beyond 4.29 G samples the seed is lost, and numbers repeat. */
static void test_mitsuba3_1888_no_repeats_beyond_32_bits(void **state)
{
    (void)state;
    static const enum job_sampler types[] = {JOB_SAMPLER_SOBOL, JOB_SAMPLER_HALTON,
                                             JOB_SAMPLER_INDEPENDENT};
    for (int t = 0; t < 3; t++) {
        size_t same[2] = {0, 0};
        for (uint64_t i = 0; i < 1000; i++) {
            double u[4][SAMPLER_SET_VALUES];
            struct sampler s[4] = {
                sampler_of(types[t], 1, 2, 3, 0, i),
                sampler_of(types[t], 1, 2, 3, 0, i + (UINT64_C(1) << 32)),
                sampler_of(types[t], 1 + (UINT64_C(1) << 32), 2, 3, 0, i),
            };
            for (int k = 0; k < 3; k++)
                sampler_set(&s[k], 5, u[k]);
            same[0] += u[0][0] == u[1][0];
            same[1] += u[0][0] == u[2][0];
        }
        assert_true(same[0] <= 2 && same[1] <= 2);
    }
}

/* pbrt-v4 #249: a triangle of 1e9 under a camera one above it: float and double builds differ. */
static void test_pbrt4_249_huge_triangle(void **state)
{
    (void)state;
    static const double ground[12] = {-1e9, 0, -1e9, -1e9, 0, 1e9, 1e9, 0, 1e9, 1e9, 0, -1e9};
    struct scene s;
    scene_init(&s);
    kit_quad(&s, ground, kit_diffuse(&s, 1, 1, 1));
    struct render_scene *rs = build(&s);
    for (int i = 0; i < 1000; i++) {
        double org[3] = {0.37 * i, 1, 1e3 * i}, dir[3] = {1e-3 * (i - 500), -1, 0.1};
        struct ray ray = world_ray(rs, org, dir);
        struct hit hit;
        accel_closest(rs->accel, &ray, &hit);
        assert_true(hit.object == 0);
        assert_true(fabs(hit.t - 1) <= 1e-12);
    }
    render_scene_free(rs);
    scene_release(&s);
}

/* pbrt-v3 #182, pbrt-v2 PR #33: triangles with one centroid; a count of 256 wrapped to 0 and made
 * a leaf an inner node. */
static void test_pbrt3_182_coincident_centroids(void **state)
{
    (void)state;
    for (size_t count = 254; count <= 1030; count += count == 258 ? 764 : 1) {
        struct gen_mesh m;
        struct trace_scene s;
        gen_mesh_init(&m);
        for (size_t i = 0; i < count; i++) {
            double size = 1 + (double)i / 2000;
            assert_int_equal(gen_quad(&m, (double[3]){-size, -size, 0}, (double[3]){2 * size, 0, 0},
                                      (double[3]){0, 2 * size, 0}),
                             ERR_OK);
        }
        m.triangle_count = count; /* some quads lose their second half: every count is met */
        trace_scene_wrap(&s, &m);
        struct ray rays[60];
        uint64_t random = 53;
        for (size_t i = 0; i < 60; i++)
            kit_ray(&s, &random, i, &rays[i]);
        struct accel *brute = kit_build(&s.input, JOB_BUILDER_NONE, ACCEL_ISA_AUTO, NULL);
        for (int builder = 0; builder < JOB_BUILDER_NONE; builder++) {
            struct accel *a = kit_build(&s.input, (enum job_builder)builder, ACCEL_ISA_AUTO, NULL);
            assert_int_equal(kit_differences(brute, a, rays, 60), 0);
            accel_free(a);
        }
        accel_free(brute);
        trace_scene_release(&s);
    }
}

/* pbrt-v3 #236, #237: structure between dimensions at 32 samples, and no numbers beyond dimension
 * 1,024. Neighbouring sets up to dimension 8,192, over many pixels. */
static void test_pbrt3_236_no_structure_in_high_dimensions(void **state)
{
    (void)state;
    enum { N = 32, PIXELS = 128, SETS = 2048, STEP = 64 };
    double bound = 6 / sqrt((double)N * PIXELS);
    for (uint32_t set = 0; set + 1 < SETS; set += STEP) {
        double ab[8] = {0}, aa[8] = {0}, bb[8] = {0};
        for (uint32_t pixel = 0; pixel < PIXELS; pixel++)
            for (uint64_t i = 0; i < N; i++) {
                struct sampler s = sampler_of(JOB_SAMPLER_SOBOL, 1, pixel, 7, 0, i);
                double u[2][SAMPLER_SET_VALUES];
                sampler_set(&s, set, u[0]);
                sampler_set(&s, set + 1, u[1]);
                for (int k = 0; k < 8; k++) { /* within the set, and with the next */
                    double a = u[0][k % 4] - 0.5;
                    double b = (k < 4 ? u[0][(k + 1) % 4] : u[1][k % 4]) - 0.5;
                    ab[k] += a * b;
                    aa[k] += a * a;
                    bb[k] += b * b;
                }
            }
        for (int k = 0; k < 8; k++)
            assert_true(fabs(ab[k] / sqrt(aa[k] * bb[k])) <= bound);
    }
}

/* POV-Ray #469: nothing beyond a distance of 1e7 is seen. */
static void test_povray_469_no_farthest_distance(void **state)
{
    (void)state;
    for (int k = 1; k <= 15; k++) {
        struct scene s;
        scene_init(&s);
        double far = pow(10, k);
        kit_sphere(&s, 0, 0, -far, 1, kit_diffuse(&s, 1, 1, 1));
        kit_sphere(&s, 0, 0, 3, 1, kit_diffuse(&s, 1, 1, 1));
        struct render_scene *rs = build(&s);
        double org[3] = {0, 0, 0}, dir[3] = {0, 0, -1};
        struct ray ray = world_ray(rs, org, dir);
        struct hit hit;
        accel_closest(rs->accel, &ray, &hit);
        assert_int_equal(hit.object, 0);
        assert_true(fabs(hit.t - (far - 1)) <= 1e-12 * far);
        render_scene_free(rs);
        scene_release(&s);
    }
}

/* MoonRay #251: faces without area in a mesh light give NaN, in vector mode only. The same picture
 * as without them. */
static void test_moonray_251_degenerate_light_faces(void **state)
{
    (void)state;
    double mean[2];
    for (int bad = 0; bad < 2; bad++) {
        struct scene s;
        scene_init(&s);
        kit_cornell(&s, KIT_BOXES | KIT_AREA_LIGHT);
        struct scene_object *lamp = NULL;
        for (size_t i = 0; i < s.object_count; i++)
            lamp = s.objects[i].emits ? &s.objects[i] : lamp;
        assert_non_null(lamp);
        struct scene_mesh *m = &s.meshes[lamp->mesh];
        if (bad) {
            static const uint32_t faces[15] = {0, 1, 2, 0, 2, 3, 0, 0, 0, 1, 1, 2, 3, 1, 3};
            m->indices = mem_realloc_array(m->indices, 15, sizeof *m->indices);
            assert_non_null(m->indices);
            memcpy(m->indices, faces, sizeof faces);
            m->triangle_count = 5;
        }
        struct job_spec spec = kit_spec(24, 64);
        struct kit_picture p = kit_render(&s, &spec, 0);
        assert_clean(&p);
        mean[bad] = kit_picture_mean(&p);
        kit_picture_free(&p);
        scene_release(&s);
    }
    assert_true(mean[0] > 0 && fabs(mean[1] / mean[0] - 1) < 0.02);
}

/* Blender T43835: decals a millimetre above the ground turn black some 100 to 400 metres from the
 * origin: their shadow rays meet the decal or the ground. */
static void test_blender_43835_decals_far_out(void **state)
{
    (void)state;
    for (double out = 100; out <= 6400; out *= 4) {
        const double ground[12] = {out - 9, 0, -9, out - 9, 0, 9, out + 9, 0, 9, out + 9, 0, -9};
        const double decal[12] = {out - 1, 1e-3, -1, out - 1, 1e-3, 1,
                                  out + 1, 1e-3, 1,  out + 1, 1e-3, -1};
        struct scene s;
        scene_init(&s);
        kit_quad(&s, ground, kit_diffuse(&s, 0.1, 0.1, 0.1));
        kit_quad(&s, decal, kit_diffuse(&s, 1, 1, 1));
        /* So that the scene reaches from the origin to there. */
        kit_sphere(&s, 0, 0, 0, 1, kit_diffuse(&s, 1, 1, 1));
        s.seed_light_position[0] = s.camera.position[0] = s.camera.look_at[0] = out;
        s.seed_light_position[1] = 20;
        s.camera.position[1] = 5;
        s.camera.position[2] = 0;
        s.camera.look_at[1] = 0;
        s.camera.ref_up[1] = 0;
        s.camera.ref_up[2] = -1;
        s.camera.fov = 15; /* nothing but decal */
        s.seed_light_flux[0] = s.seed_light_flux[1] = s.seed_light_flux[2] = 1e3;
        struct job_spec spec = kit_spec(24, 4);
        spec.integrator = JOB_INTEGRATOR_INTERSECTION_TEST;
        struct kit_picture p = kit_render(&s, &spec, 0);
        assert_clean(&p);
        double expected = 1e3 / (20.0 * 20.0) / 3.14159265358979; /* within the angles seen */
        for (size_t i = 0; i < 24 * 24 * 3; i++)
            assert_true(p.mean[i] > 0.9 * expected && p.mean[i] < 1.1 * expected);
        kit_picture_free(&p);
        scene_release(&s);
    }
}

/* bepuphysics2 #354, tinybvh PR #192, madmann91/bvh #108: data on which trees grow deeper than a
 * fixed stack. Each triangle a little outside of all before, by a factor. */
static void test_fixed_stacks(void **state)
{
    (void)state;
    static const double factors[] = {1.05, 1.3, 2, 10};
    for (int f = 0; f < 4; f++) {
        struct gen_mesh m;
        struct trace_scene s;
        double x = 1e-30;
        gen_mesh_init(&m);
        for (int i = 0; i < 4000 && x < 1e30; i++, x *= factors[f])
            assert_int_equal(gen_quad(&m, (double[3]){x, 0, 0}, (double[3]){0.01 * x, 0, 0},
                                      (double[3]){0, 0.5 * x, 0}),
                             ERR_OK);
        trace_scene_wrap(&s, &m);
        struct ray rays[100];
        uint64_t random = 54;
        for (size_t i = 0; i < 100; i++)
            kit_ray(&s, &random, i, &rays[i]);
        struct accel *brute = kit_build(&s.input, JOB_BUILDER_NONE, ACCEL_ISA_AUTO, NULL);
        for (int builder = 0; builder < JOB_BUILDER_NONE; builder++) {
            struct accel_stats stats;
            struct accel *a = kit_build(&s.input, (enum job_builder)builder, ACCEL_ISA_AUTO, NULL);
            accel_stats_get(a, &stats);
            assert_true(stats.depth_max <= 64);
            assert_int_equal(kit_differences(brute, a, rays, 100), 0);
            accel_free(a);
        }
        accel_free(brute);
        trace_scene_release(&s);
    }
}

/* Mitsuba #184: pictures differ between thread counts. The tree, byte for byte, is
 * test_accel's; here the picture. */
static void test_mitsuba_184_threads_change_no_bit(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    kit_cornell(&s, KIT_BOXES | KIT_AREA_LIGHT | KIT_GLASS_SPHERE);
    struct job_spec spec = kit_spec(20, 4);
    struct kit_picture one = kit_render(&s, &spec, 0), many = kit_render(&s, &spec, 1);
    assert_memory_equal(one.mean, many.mean, 20 * 20 * 3 * sizeof *one.mean);
    struct accel_runner runner = kit_runner(8);
    struct render_scene *rs[2];
    assert_int_equal(scene_build(&s, &spec, NULL, &rs[0]), ERR_OK);
    assert_int_equal(scene_build(&s, &spec, &runner, &rs[1]), ERR_OK);
    uint64_t random = 55;
    for (int i = 0; i < 5000; i++) {
        struct ray ray = {.tmax = (double)INFINITY};
        struct hit hit[2];
        for (int k = 0; k < 3; k++) {
            ray.org[k] = 2 * gen_random(&random) - 1;
            ray.dir[k] = 2 * gen_random(&random) - 1;
        }
        for (int k = 0; k < 2; k++)
            accel_closest(rs[k]->accel, &ray, &hit[k]);
        assert_int_equal(hit[0].object, hit[1].object);
        if (hit[0].object != SCENE_NONE)
            assert_memory_equal(&hit[0].t, &hit[1].t, sizeof hit[0].t);
    }
    render_scene_free(rs[0]);
    render_scene_free(rs[1]);
    kit_picture_free(&one);
    kit_picture_free(&many);
    scene_release(&s);
}

/* pbrt-v4 #313: NaN from u all but 1. Every material at the ends of [0, 1). */
static void test_pbrt4_313_u_all_but_one(void **state)
{
    (void)state;
    static const double ends[] = {0, 0x1p-1074, 0x1p-53, 0.5, 1 - 0x1p-24, 1 - 0x1p-53};
    static const double cosines[] = {1, 0.7, 1e-3, 1e-9, 1e-300};
    for (int type = 0; type <= SCENE_MATERIAL_BLACK; type++) {
        struct material m = {.type = (enum scene_material_type)type,
                             .texture = SCENE_NONE,
                             .color = {0.8, 0.8, 0.8},
                             .alpha_x = 0.1,
                             .alpha_y = 0.3,
                             .eta = 1.5,
                             .R = {1, 1, 1},
                             .T = {1, 1, 1},
                             .conductor_eta = {0.2, 0.9, 1.1},
                             .conductor_k = {3.9, 2.4, 2.1},
                             .roughness = 0.5,
                             .transmission = 0.5,
                             .specular = 1,
                             .specular_color = {1, 1, 1},
                             .clearcoat = 0.5,
                             .clearcoat_roughness = 0.1,
                             .sheen_alpha = 0.25};
        principled_prepare(&m);
        for (int i = 0; i < 6 * 6 * 6 * 5 * 2; i++) {
            double z = cosines[i / 216 % 5] * (i / 1080 ? -1 : 1);
            vec3 wo = v3(sqrt((1 - z) * (1 + z)), 0, z);
            double u[3] = {ends[i % 6], ends[i / 6 % 6], ends[i / 36 % 6]};
            struct bsdf b = {.material = &m,
                             .color = m.color,
                             .roughness = m.roughness,
                             .transmission = m.transmission};
            struct bsdf_sample s;
            if (!bsdf_sample(&b, wo, u, &s))
                continue;
            assert_true(rgb_is_finite(s.weight) && isfinite(s.pdf) && s.pdf > 0);
            assert_true(s.weight.r >= 0 && fabs(v3_length(s.wi) - 1) < 1e-6);
        }
    }
}

int main(int argc, char **argv)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_embree_387_t_within_the_triangle),
        cmocka_unit_test(test_embree_423_every_kernel_agrees),
        cmocka_unit_test(test_mitsuba3_1149_no_light_through_the_diagonal),
        cmocka_unit_test(test_mitsuba3_550_emitter_at_right_angles),
        cmocka_unit_test(test_mitsuba3_1888_no_repeats_beyond_32_bits),
        cmocka_unit_test(test_mitsuba_184_threads_change_no_bit),
        cmocka_unit_test(test_pbrt4_249_huge_triangle),
        cmocka_unit_test(test_pbrt4_313_u_all_but_one),
        cmocka_unit_test(test_pbrt3_182_coincident_centroids),
        cmocka_unit_test(test_pbrt3_236_no_structure_in_high_dimensions),
        cmocka_unit_test(test_povray_469_no_farthest_distance),
        cmocka_unit_test(test_moonray_251_degenerate_light_faces),
        cmocka_unit_test(test_blender_43835_decals_far_out),
        cmocka_unit_test(test_fixed_stacks),
    };
    return ROWS_RUN(argc, argv, tests);
}
