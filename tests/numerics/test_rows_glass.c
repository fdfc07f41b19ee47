/* T15 and T17: light through slabs and nests of glass; T22: counters beyond 2^32. */
#include "tests/numerics/rows.h"

#include <math.h>

#include "common/mem.h"
#include "tests/numerics/light_step.h"
#include "tests/render/render_kit.h"
#include "worker/scene/scene_build.h"

static struct render_scene *build(struct scene *s)
{
    struct job_spec spec = kit_spec(1, 1);
    struct render_scene *rs;
    assert_int_equal(scene_build(s, &spec, NULL, &rs), ERR_OK);
    return rs;
}

/* The angles of T15: by tenths of a degree, and then ever nearer to 90. */
static double slab_angle(int i)
{
    enum { TENTHS = 899 };
    return i <= TENTHS ? 0.1 * i : 90 - pow(10, TENTHS - i);
}

/* One ray through both planes: how far its direction is off, and its place in thicknesses. */
static void slab_ray(const struct render_scene *rs, double eta, double degrees, double *direction,
                     double *place)
{
    /* The cosine of what is left to 90 degrees: cos(theta) itself loses digits there. */
    double rest = (90 - degrees) * VEC_PI / 180, sine = cos(rest), cosine = sin(rest);
    vec3 d = v3_unit(v3(sine, 0, -cosine)), dir = d;
    vec3 from = v3_mad(v3(0, 0, 0.5 * rs->scale), d, -0.5 * rs->scale / cosine), org = from;
    uint32_t object;
    assert_true(light_step(rs, &org, &dir, &object) && object == 0);
    assert_true(light_step(rs, &org, &dir, &object) && object == 1);
    *direction = v3_abs_max(v3_sub(dir, d));
    /* The distance of the two lines. */
    double aside = v3_length(v3_cross(v3_sub(org, from), d)) / rs->scale;
    *place = fabs(aside - sine * (1 - cosine / sqrt(eta * eta - sine * sine)));
}

/* A slab one thick: light leaves as it came, moved aside by t sin(1 - cos / sqrt(n^2 - sin^2)). The
 * direction inside is rounded to doubles: its sine is off by u of itself, and so the cosine outside
 * by u tan(theta), whatever is done on the way (docs/NUMERICS.md, T15). Where light meets a plane
 * is known to some u of the plane's triangles, and it starts behind them by that much. */
static void slab_of_width(double w, int steps, double *worst_direction, double *worst_place)
{
    const double top[12] = {-w, -w, 0.5, w, -w, 0.5, w, w, 0.5, -w, w, 0.5};
    const double low[12] = {-w, -w, -0.5, -w, w, -0.5, w, w, -0.5, w, -w, -0.5};
    static const double etas[] = {1, 1 + 1e-7, 1.5, 100};
    for (int e = 0; e < 4; e++) {
        struct scene s;
        struct scene_material *m;
        scene_init(&s);
        uint32_t glass = kit_material(&s, SCENE_MATERIAL_REFRACTION, &m);
        m->eta = etas[e];
        kit_quad(&s, top, glass);
        kit_quad(&s, low, glass);
        struct render_scene *rs = build(&s);
        for (int i = 0; i < steps; i++) {
            double direction, place, cosine = sin((90 - slab_angle(i)) * VEC_PI / 180);
            slab_ray(rs, etas[e], slab_angle(i), &direction, &place);
            *worst_direction = fmax(*worst_direction, direction * cosine);
            *worst_place = fmax(*worst_place, place);
        }
        render_scene_free(rs);
        scene_release(&s);
    }
}

static void test_t15_slab(void **state)
{
    (void)state;
    static const double widths[] = {64, 0x1p21};
    static const int steps[] = {880, 903}; /* up to 87.9 and 89.9999 degrees */
    for (int i = 0; i < 2; i++) {
        double direction = 0, place = 0;
        slab_of_width(widths[i], steps[i], &direction, &place);
        printf("  T15: %g wide, direction off by %.1f u / cos, place by %.2g thicknesses\n",
               2 * widths[i], direction / 0x1p-53, place);
        assert_true(direction <= 8 * 0x1p-53);
        assert_true(place <= 1e-13 * 2 * widths[i]);
    }
}

/* Glass of index 1 between camera and scene is not there. */
static void test_t15_index_one_is_air(void **state)
{
    (void)state;
    static const enum scene_material_type types[] = {SCENE_MATERIAL_REFRACTION,
                                                     SCENE_MATERIAL_GLASS};
    struct job_spec spec = kit_spec(24, 4);
    spec.integrator = JOB_INTEGRATOR_INTERSECTION_TEST;
    for (int i = 0; i < 2; i++) {
        struct kit_picture p[2];
        for (int glass = 0; glass < 2; glass++) {
            struct scene s;
            struct scene_material *m;
            scene_init(&s);
            kit_cornell(&s, KIT_BOXES);
            uint32_t air = kit_material(&s, types[i], &m);
            m->eta = 1;
            /* In front of the camera, or far behind it: the scene's box stays what it is. */
            kit_sphere(&s, 0, 1, 5.5, 0.4, glass ? air : kit_diffuse(&s, 1, 1, 1));
            if (!glass) {
                kit_sphere(&s, 0, 1, 5.5, 0.4, air);
                s.objects[s.object_count - 2].center[2] = 7.9;
            } else {
                kit_sphere(&s, 0, 1, 7.9, 0.4, air);
            }
            if (!glass) {
                s.objects[s.object_count - 1].center[0] = 0.5;
                s.objects[s.object_count - 1].center[2] = 7.9;
            }
            p[glass] = kit_render(&s, &spec, 0);
            scene_release(&s);
        }
        for (size_t k = 0; k < 24 * 24 * 3; k++)
            assert_true(fabs(p[1].mean[k] - p[0].mean[k]) <= 1e-6 * fabs(p[0].mean[k]) + 1e-9);
        kit_picture_free(&p[0]);
        kit_picture_free(&p[1]);
    }
}

/* Shells within shells, 500 of them, alternately glass and water against what is around: 1,000
 * refractions in and out. Bouguer: n r sin(theta) is the same at each, so the ray leaves as far
 * from the middle as it came. */
static void test_t17_nested_dielectrics(void **state)
{
    (void)state;
    enum { SHELLS = 500 };
    double worst = 0, worst_length = 0;
    struct scene s;
    scene_init(&s);
    uint32_t material[2];
    struct scene_material *m;
    material[0] = kit_material(&s, SCENE_MATERIAL_REFRACTION, &m);
    m->eta = 1.5 / 1.33; /* glass in water */
    material[1] = kit_material(&s, SCENE_MATERIAL_REFRACTION, &m);
    m->eta = 1.33 / 1.5; /* water in glass */
    for (int i = 0; i < SHELLS; i++)
        kit_sphere(&s, 0, 0, 0, 1 - 0.5 * i / SHELLS, material[i % 2]);
    struct render_scene *rs = build(&s);
    for (int k = 0; k < 40; k++) {
        double miss = 0.01 * k; /* of the line from the middle */
        vec3 org = v3(miss * rs->scale, 0, 4), dir = v3(0, 0, -1);
        uint32_t object = 0, inside = 0;
        for (int i = 0; i < 2 * SHELLS; i++) {
            assert_true(light_step(rs, &org, &dir, &object));
            /* In order: shell i on the way in, and out of the same ones in reverse. */
            assert_int_equal(object, i < SHELLS ? i : 2 * SHELLS - 1 - i);
            inside += i < SHELLS ? 1 : -1u;
            worst_length = fmax(worst_length, fabs(v3_length(dir) - 1));
        }
        assert_int_equal(inside, 0);
        struct ray ray = {.tmax = VEC_INFINITY};
        v3_put(ray.org, org);
        v3_put(ray.dir, dir);
        assert_false(accel_occluded(rs->accel, &ray));
        double out = v3_length(v3_cross(org, dir)) / rs->scale;
        worst = fmax(worst, fabs(out - miss));
    }
    printf("  T17: after 1,000 refractions the line is off by %.2g radii, |w| by %.2g\n", worst,
           worst_length);
    assert_true(worst_length <= 1e-12);
    assert_true(worst <= 1e-11);
    render_scene_free(rs);
    scene_release(&s);
}

/* Glass and water that share their faces: slabs stacked without a gap, each plane listed once,
 * with the index of its two sides. */
static void test_t17_shared_faces(void **state)
{
    (void)state;
    enum { PLANES = 1000 };
    struct scene s;
    struct scene_material *m;
    uint32_t material[3];
    scene_init(&s);
    material[0] = kit_material(&s, SCENE_MATERIAL_REFRACTION, &m); /* seen from +z: air, glass */
    m->eta = 1.5;
    material[1] = kit_material(&s, SCENE_MATERIAL_REFRACTION, &m); /* glass, water */
    m->eta = 1.33 / 1.5;
    material[2] = kit_material(&s, SCENE_MATERIAL_REFRACTION, &m); /* water, glass */
    m->eta = 1.5 / 1.33;
    for (int i = 0; i < PLANES; i++) {
        double z = -0x1p-10 * i;
        const double q[12] = {-4, -4, z, 4, -4, z, 4, 4, z, -4, 4, z};
        kit_quad(&s, q, i == 0 ? material[0] : i % 2 ? material[1] : material[2]);
    }
    struct render_scene *rs = build(&s);
    vec3 d = v3_unit(v3(0.6, 0.1, -0.7)), dir = d, org = v3(-0.1, 0, 0.4);
    uint32_t object;
    double worst = 0;
    for (int i = 0; i < PLANES; i++) {
        assert_true(light_step(rs, &org, &dir, &object));
        assert_int_equal(object, i);
        double n = i % 2 ? 1.33 : 1.5;
        worst = fmax(worst, fabs(n * dir.x - d.x));
    }
    printf("  T17: Snell's chain over %d shared faces off by %.2g\n", PLANES, worst);
    assert_true(worst <= 1e-13);
    render_scene_free(rs);
    scene_release(&s);
}

/* The blocks of a job cover each half once, whatever the count: against 128-bit arithmetic. */
static void test_t22_blocks(void **state)
{
    (void)state;
    static const uint64_t counts[] = {1,
                                      2,
                                      4097,
                                      (UINT64_C(1) << 31) - 1,
                                      UINT64_C(1) << 32,
                                      (UINT64_C(1) << 33) + 1,
                                      JOB_SPP_MAX - 1,
                                      JOB_SPP_MAX};
    for (size_t i = 0; i < sizeof counts / sizeof *counts; i++) {
        struct job_blocks blocks = job_blocks_of(counts[i]);
        uint64_t next[2] = {0, 0};
        unsigned __int128 sum = 0;
        for (uint32_t b = 0; b < blocks.count; b++) {
            struct job_block block = job_block_at(&blocks, b);
            assert_true(block.begin == next[block.half] && block.count > 0);
            next[block.half] += block.count;
            sum += block.count;
        }
        assert_true(sum == counts[i]);
        uint64_t half = counts[i] - counts[i] / 2;
        assert_true(next[0] == half && next[1] == counts[i] - half);
        assert_true(job_sample_number(0, half - 1) == 2 * (half - 1));
    }
}

/* A pixel of the last block of a job of 2^33 samples: 33 million samples numbered beyond 2^32, in
 * an integrating sphere, where every one must be the same. With --long; else of 2^14. */
static void test_t22_samples(void **state)
{
    (void)state;
    struct scene s;
    struct scene_material *m;
    scene_init(&s);
    uint32_t white = kit_material(&s, SCENE_MATERIAL_DIFFUSE, &m);
    m->color[0] = m->color[1] = m->color[2] = 0.5;
    m->twosided = true;
    kit_sphere(&s, 0, 0, 0, 1, white);
    kit_light(&s, SCENE_LIGHT_POINT);
    struct job_spec spec = kit_spec(1, rows_long ? UINT64_C(1) << 33 : 1 << 14);
    spec.integrator = JOB_INTEGRATOR_DIRECT;
    struct render_scene *rs;
    struct render_scratch *scratch;
    struct grid grid;
    struct render_counters counters;
    float sums[3];
    s.camera.position[2] = 0.5;
    assert_int_equal(scene_build(&s, &spec, NULL, &rs), ERR_OK);
    assert_int_equal(render_scratch_new(&scratch), ERR_OK);
    assert_int_equal(grid_init(&grid, &spec), ERR_OK);
    struct job_blocks blocks = job_blocks_of(spec.spp);
    struct job_block last = job_block_at(&blocks, blocks.count - 1);
    struct unit unit = {0, 1, blocks.count - 1};
    assert_int_equal(render_unit(rs, &grid, unit, scratch, NULL, sums, &counters), ERR_OK);
    assert_int_equal(counters.samples, last.count);
    assert_int_equal(counters.nonfinite, 0);
    double mean = (double)sums[1] / (double)last.count, expected = 0.5 / VEC_PI;
    printf("  T22: %llu samples up to number %llu, their mean off by %.2g\n",
           (unsigned long long)last.count,
           (unsigned long long)job_sample_number(1, last.begin + last.count - 1),
           mean / expected - 1);
    assert_true(fabs(mean / expected - 1) < 1e-6);
    grid_release(&grid);
    render_scratch_free(scratch);
    render_scene_free(rs);
    scene_release(&s);
}

int main(int argc, char **argv)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_t15_slab),
        cmocka_unit_test(test_t15_index_one_is_air),
        cmocka_unit_test(test_t17_nested_dielectrics),
        cmocka_unit_test(test_t17_shared_faces),
        cmocka_unit_test(test_t22_blocks),
        cmocka_unit_test(test_t22_samples),
    };
    return ROWS_RUN(argc, argv, tests);
}
