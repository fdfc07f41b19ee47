/* The factor that a normal map's tilt brings: its shape, and that every technique has it. */
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
#include "worker/render/shade.h"
#include "worker/scene/scene_build.h"

/* A surface of normal +z whose map tilts it by `tilt` radians towards +x. */
static struct shade tilted(double tilt)
{
    double s, c;
    dmath_sincos(tilt, &s, &c);
    double cos2 = c * c, alpha2 = 0.125 * (1 - cos2) / cos2;
    return (struct shade){.surface = {.ng = {0, 0, 1}, .ns = {s, 0, c}},
                          .smooth = {0, 0, 1},
                          .frame = frame_of(v3(s, 0, c)),
                          .wo = {0, 0, 1},
                          .tilt_alpha2 = alpha2 < 1 ? alpha2 : 1};
}

static void grazing_light_fades(void **state)
{
    (void)state;
    double before_tilt = 1;
    for (int t = 0; t <= 8; t++) {
        struct shade at = tilted(t * 0.15);
        double before = 1;
        for (int k = 0; k <= 100; k++) {
            double s, c;
            dmath_sincos(k * VEC_PI / 200, &s, &c);
            double left = shade_tilt_shadowing(&at, v3(s, 0, c), 1);
            assert_true(left >= 0 && left <= before + 1e-12);
            assert_true(k > 0 || left == 1);
            assert_true(t > 0 || left == 1);
            before = left;
        }
        /* At the horizon a tilted surface is dark: no edge is left there. */
        assert_true(t == 0 || before < 1e-6);
        double at_45 = shade_tilt_shadowing(&at, v3(sqrt(0.5), 0, sqrt(0.5)), 1);
        assert_true(at_45 <= before_tilt);
        before_tilt = at_45;
        /* What is refracted does not graze this side. */
        assert_true(shade_tilt_shadowing(&at, v3(1, 0, 0), -1) == 1);
    }
}

/* A ball whose map tilts every normal. Lit by a lamp beside it that shines on the floor alone, so
 * that what is seen came by two edges or more, and by a lamp before it. */
static void bumpy(struct scene *s, enum scene_material_type type, const double normal[3])
{
    static const double lamp[12] = {1.2, -0.5, -1, 3, -0.5, -1, 3, -0.5, 1, 1.2, -0.5, 1};
    static const double front[12] = {-0.5, 2, 3, 0.5, 2, 3, 0.5, 2.5, 2.5, -0.5, 2.5, 2.5};
    static const double floor_quad[12] = {-4, -1.1, -4, -4, -1.1, 4, 4, -1.1, 4, 4, -1.1, -4};
    struct scene_material *m;
    scene_init(s);
    s->camera.position[2] = 4;
    s->camera.fov = 22;
    uint32_t map = kit_constant_texture(s, 0);
    for (int k = 0; k < 3; k++)
        s->textures[map].color[0][k] = normal[k];
    uint32_t material = kit_material(s, type, &m);
    m->color[0] = m->color[1] = m->color[2] = 0.8;
    m->normal_texture = map;
    m->roughness = 0.5;
    kit_sphere(s, 0, 0, 0, 1, material);
    kit_quad(s, floor_quad, kit_diffuse(s, 0.95, 0.95, 0.95));
    kit_emit(s, kit_quad(s, lamp, SCENE_NONE), 4, 4, 4);
    kit_emit(s, kit_quad(s, front, SCENE_NONE), 1, 1, 1);
}

/* Light sampling, direction sampling, both, and shared paths: one mean. */
static void profiles_agree_on_bumps(void **state)
{
    (void)state;
    static const enum scene_material_type types[] = {SCENE_MATERIAL_DIFFUSE,
                                                     SCENE_MATERIAL_PRINCIPLED};
    for (int type = 0; type < 2; type++) {
        struct scene s;
        bumpy(&s, types[type], (const double[]){0.95, 0.3, 0.6});
        double mean[JOB_PROFILE_COUNT], error[JOB_PROFILE_COUNT];
        for (int profile = 0; profile < JOB_PROFILE_COUNT; profile++) {
            struct job_spec spec = kit_spec(32, 256);
            spec.profile = (enum job_profile)profile;
            spec.seed = (uint64_t)profile;
            struct kit_picture p = kit_render(&s, &spec, 0);
            mean[profile] = kit_picture_mean(&p);
            double sum = 0, values = 32.0 * 32 * 3;
            for (size_t k = 0; k < 32 * 32 * 3; k++)
                sum += (p.half[0][k] - p.half[1][k]) * (p.half[0][k] - p.half[1][k]) / 4;
            /* Channels go together, and under MIS the pixels of a group that shares. */
            error[profile] = sqrt(sum * (profile == JOB_PROFILE_MIS ? 48 : 3)) / values;
            kit_picture_free(&p);
        }
        for (int profile = 1; profile < JOB_PROFILE_COUNT; profile++) {
            double apart = fabs(mean[profile] - mean[0]);
            printf("  %g +- %g against %g +- %g\n", mean[profile], error[profile], mean[0],
                   error[0]);
            assert_true(apart <= 4 * hypot(error[profile], error[0]));
        }
        scene_release(&s);
    }
}

/* A map that tilts nothing changes no bit. */
static void flat_maps_change_nothing(void **state)
{
    (void)state;
    struct scene s;
    struct job_spec spec = kit_spec(16, 8);
    bumpy(&s, SCENE_MATERIAL_PRINCIPLED, (const double[]){0.5, 0.5, 1});
    struct kit_picture flat = kit_render(&s, &spec, 0);
    s.materials[0].normal_texture = SCENE_NONE;
    struct kit_picture none = kit_render(&s, &spec, 0);
    for (size_t k = 0; k < 16 * 16 * 3; k++)
        assert_true(fabs(flat.mean[k] - none.mean[k]) <= 1e-6 * fabs(none.mean[k]) + 1e-9);
    kit_picture_free(&flat);
    kit_picture_free(&none);
    scene_release(&s);
}

/* Twice: once with the key, once without. Weights of corners against the sum by hand. */
static void vertex_colors_are_interpolated(void **state)
{
    (void)state;
    static const double corners[12] = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0};
    static const float colors[12] = {1, 0, 0.25f, 0, 1, 0.5f, 0.5f, 0.5f, 1, 0, 0, 0};
    static const enum scene_material_type types[] = {SCENE_MATERIAL_DIFFUSE,
                                                     SCENE_MATERIAL_PRINCIPLED};
    for (int i = 0; i < 4; i++) {
        struct scene s;
        struct scene_material *m;
        struct render_scene *built;
        scene_init(&s);
        uint32_t material = kit_material(&s, types[i / 2], &m);
        m->vertex_colors = i % 2;
        m->color[0] = m->color[1] = 0.5;
        m->color[2] = 0.75;
        uint32_t ball = kit_sphere(&s, 9, 0, 0, 1, material);
        uint32_t quad = kit_quad(&s, corners, material);
        struct scene_mesh *mesh = &s.meshes[s.objects[quad].mesh];
        mesh->colors = mem_alloc_array(12, sizeof *colors);
        memcpy(mesh->colors, colors, sizeof colors);
        struct job_spec spec = kit_spec(8, 1);
        assert_int_equal(scene_build(&s, &spec, NULL, &built), ERR_OK);
        for (double b1 = 0; b1 <= 1; b1 += 0.125) {
            double b2 = (1 - b1) / 4;
            struct hit hit = {.object = quad, .b1 = b1, .b2 = b2, .ng = {0, 0, 1}};
            struct shade at;
            shade_of_hit(built, &hit, v3(0, 0, -1), NULL, &at);
            const uint32_t *k = mesh->indices;
            double c[3];
            for (int j = 0; j < 3; j++)
                c[j] = (1 - b1 - b2) * (double)colors[3 * k[0] + (uint32_t)j] +
                       b1 * (double)colors[3 * k[1] + (uint32_t)j] +
                       b2 * (double)colors[3 * k[2] + (uint32_t)j];
            for (int j = 0; j < 3 && i % 2 == 0; j++)
                c[j] = 1;
            assert_true(fabs(at.bsdf.color.r - 0.5 * c[0]) < 1e-15);
            assert_true(fabs(at.bsdf.color.g - 0.5 * c[1]) < 1e-15);
            assert_true(fabs(at.bsdf.color.b - 0.75 * c[2]) < 1e-15);
            hit.object = ball; /* has none: white */
            shade_of_hit(built, &hit, v3(0, 0, -1), NULL, &at);
            assert_true(at.bsdf.color.r == 0.5 && at.bsdf.color.b == 0.75);
        }
        render_scene_free(built);
        scene_release(&s);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(vertex_colors_are_interpolated),
        cmocka_unit_test(grazing_light_fades),
        cmocka_unit_test(profiles_agree_on_bumps),
        cmocka_unit_test(flat_maps_change_nothing),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
