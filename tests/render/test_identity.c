/* The same bits whatever the units, cells and scale of the scene; and the report's integrator
 * against its own formula. */
#include "tests/numerics/rows.h"

#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "tests/render/render_kit.h"
#include "worker/scene/scene_build.h"

static void assert_same_picture(const struct kit_picture *a, const struct kit_picture *b)
{
    size_t bytes = (size_t)a->width * a->height * 3 * sizeof *a->mean;
    assert_memory_equal(a->half[0], b->half[0], bytes);
    assert_memory_equal(a->half[1], b->half[1], bytes);
}

static const enum job_integrator integrators[] = {JOB_INTEGRATOR_INTERSECTION_TEST,
                                                  JOB_INTEGRATOR_PATH, JOB_INTEGRATOR_DIRECT,
                                                  JOB_INTEGRATOR_AO};

/* Tiles of every size, units of every length. */
static void test_t21_units(void **state)
{
    (void)state;
    static const uint32_t tiles[] = {16, 1, 7, 8, 64}, runs[] = {0, 5, 1, 2, 1};
    struct scene s;
    scene_init(&s);
    kit_cornell(&s, KIT_BOXES | KIT_AREA_LIGHT | KIT_DISC | KIT_GLASS_SPHERE);
    for (size_t i = 0; i < 4; i++) {
        struct job_spec spec = kit_spec(40, 36);
        spec.height = 33;
        spec.crop.height = 33;
        spec.integrator = integrators[i];
        struct kit_picture first = kit_render(&s, &spec, 0);
        for (size_t k = 1; k < 5; k++) {
            spec.tile = tiles[k];
            struct kit_picture p = kit_render(&s, &spec, runs[k]);
            assert_same_picture(&first, &p);
            kit_picture_free(&p);
        }
        kit_picture_free(&first);
    }
    scene_release(&s);
}

/* A crop has the pixels of the whole. */
static void test_t21_crops(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    kit_cornell(&s, KIT_BOXES | KIT_AREA_LIGHT);
    struct job_spec spec = kit_spec(32, 8);
    struct kit_picture whole = kit_render(&s, &spec, 0);
    spec.crop = (struct job_crop){5, 9, 13, 11};
    struct kit_picture part = kit_render(&s, &spec, 2);
    for (size_t k = 0; k < 3; k++)
        for (size_t y = 0; y < 11; y++)
            for (size_t x = 0; x < 13; x++)
                assert_true(part.mean[(k * 11 + y) * 13 + x] ==
                            whole.mean[(k * 32 + y + 9) * 32 + x + 5]);
    kit_picture_free(&whole);
    kit_picture_free(&part);
    scene_release(&s);
}

/* The whole scene, camera and flux included, 2^k times larger (T1). */
static void scale_scene(struct scene *s, double f)
{
    for (size_t i = 0; i < s->mesh_count; i++)
        for (size_t k = 0; k < 3 * (size_t)s->meshes[i].vertex_count; k++)
            s->meshes[i].positions[k] *= f;
    for (size_t i = 0; i < s->object_count; i++) {
        s->objects[i].radius *= f;
        for (size_t k = 0; k < 3; k++)
            s->objects[i].center[k] *= f;
    }
    for (size_t k = 0; k < 3; k++) {
        s->camera.position[k] *= f;
        s->camera.look_at[k] *= f;
        s->seed_light_position[k] *= f;
        s->seed_light_flux[k] *= f * f;
    }
}

static void test_t01_scale(void **state)
{
    (void)state;
    for (size_t i = 0; i < 2; i++) {
        struct job_spec spec = kit_spec(24, 4);
        spec.integrator = integrators[i];
        struct kit_picture first = {0};
        for (int k = -40; k <= 40; k += 4) {
            struct scene s;
            scene_init(&s);
            kit_cornell(&s, KIT_BOXES | KIT_AREA_LIGHT | KIT_DISC | KIT_GLASS_SPHERE);
            scale_scene(&s, ldexp(1, k));
            struct kit_picture p = kit_render(&s, &spec, 0);
            if (k == -40) {
                first = p;
            } else {
                assert_same_picture(&first, &p);
                kit_picture_free(&p);
            }
            scene_release(&s);
        }
        kit_picture_free(&first);
    }
}

/* L = flux / r^2 * albedo / pi * cos at a plane under the light; nothing behind it. */
static void seed_formula(void **state)
{
    (void)state;
    static const double plane[12] = {-50, -50, 0, 50, -50, 0, 50, 50, 0, -50, 50, 0};
    static const double light[3] = {0.5, -0.25, 2}, flux[3] = {3, 2, 1};
    struct scene s;
    scene_init(&s);
    kit_quad(&s, plane, kit_diffuse(&s, 0.8, 0.5, 0.2));
    memcpy(s.seed_light_position, light, sizeof light);
    memcpy(s.seed_light_flux, flux, sizeof flux);
    s.camera.position[2] = 1;
    s.camera.fov = 0.01;
    struct job_spec spec = kit_spec(3, 64);
    spec.integrator = JOB_INTEGRATOR_INTERSECTION_TEST;
    struct kit_picture p = kit_render(&s, &spec, 0);
    double r2 = 0.25 + 0.0625 + 4, albedo[3] = {0.8, 0.5, 0.2};
    for (size_t k = 0; k < 3; k++) {
        double expected = flux[k] / r2 * albedo[k] / 3.14159265358979323846 * 2 / sqrt(r2);
        assert_true(fabs(p.mean[k * 9 + 4] / expected - 1) < 1e-4);
    }
    kit_picture_free(&p);
    s.seed_light_position[2] = -2;
    p = kit_render(&s, &spec, 0);
    assert_true(kit_picture_mean(&p) == 0);
    kit_picture_free(&p);
    scene_release(&s);
}

/* A sample that is no number, or too large for the film, counts as zero and is reported. */
static void nonfinite_samples_are_counted(void **state)
{
    (void)state;
    static const double radiances[] = {1e308, 1e38};
    for (int i = 0; i < 2; i++) {
        struct scene s;
        scene_init(&s);
        kit_constant_sky(&s, radiances[i]);
        s.envmap.scale = 1e4;
        struct job_spec spec = kit_spec(6, 8);
        spec.crop = (struct job_crop){2, 3, 3, 2};
        struct kit_picture p = kit_render(&s, &spec, 0);
        assert_int_equal(p.counters.nonfinite, 3 * 2 * 8);
        assert_int_equal(p.counters.nonfinite_pixel, 3 * 6 + 2);
        assert_int_equal(p.counters.nonfinite_sample, 0);
        assert_true(kit_picture_mean(&p) == 0);
        kit_picture_free(&p);
        scene_release(&s);
    }
}

/* A unit that is told to stop does, and says so. */
static void stop_is_obeyed(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    kit_cornell(&s, KIT_BOXES | KIT_AREA_LIGHT);
    struct job_spec spec = kit_spec(64, 32);
    struct render_scene *rs;
    struct render_scratch *scratch;
    struct grid grid;
    static float rgb[64 * 64 * 3];
    atomic_bool stop = true;
    struct render_counters counters;
    assert_int_equal(scene_build(&s, &spec, NULL, &rs), ERR_OK);
    assert_int_equal(render_scratch_new(&scratch), ERR_OK);
    assert_int_equal(grid_init(&grid, &spec), ERR_OK);
    struct unit unit = {0, grid.cell_count, 1};
    assert_int_equal(render_unit(rs, &grid, unit, scratch, &stop, rgb, &counters), ERR_CANCELLED);
    assert_int_equal(counters.rays, 0);
    atomic_store(&stop, false);
    assert_int_equal(render_unit(rs, &grid, unit, scratch, &stop, rgb, &counters), ERR_OK);
    assert_int_equal(counters.samples, 64 * 64 * 16);
    grid_release(&grid);
    render_scratch_free(scratch);
    render_scene_free(rs);
    scene_release(&s);
}

int main(int argc, char **argv)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_t21_units),
        cmocka_unit_test(test_t21_crops),
        cmocka_unit_test(test_t01_scale),
        cmocka_unit_test(seed_formula),
        cmocka_unit_test(nonfinite_samples_are_counted),
        cmocka_unit_test(stop_is_obeyed),
    };
    return ROWS_RUN(argc, argv, tests);
}
