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
            shade_of_hit(built, &hit, v3(0, 0, -1), NULL, NULL, &at);
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
            shade_of_hit(built, &hit, v3(0, 0, -1), NULL, NULL, &at);
            assert_true(at.bsdf.color.r == 0.5 && at.bsdf.color.b == 0.75);
        }
        render_scene_free(built);
        scene_release(&s);
    }
}

/* Opacity at a hit is that of the corners, weighed, times the material's; a mask cuts it. */
static void vertex_alphas_are_interpolated(void **state)
{
    (void)state;
    static const double corners[12] = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0};
    static const float alphas[4] = {1, 0, 0.5f, 0.25f};
    for (int i = 0; i < 8; i++) {
        struct scene s;
        struct scene_material *m;
        struct render_scene *built;
        scene_init(&s);
        uint32_t material = kit_material(&s, SCENE_MATERIAL_PRINCIPLED, &m);
        m->vertex_colors = i & 1;
        m->alpha_used = i & 2;
        m->alpha_cutoff = i & 4 ? 0.3 : -1;
        m->alpha = 0.8;
        uint32_t ball = kit_sphere(&s, 9, 0, 0, 1, material);
        uint32_t quad = kit_quad(&s, corners, material);
        struct scene_mesh *mesh = &s.meshes[s.objects[quad].mesh];
        mesh->alphas = mem_alloc_array(4, sizeof *alphas);
        memcpy(mesh->alphas, alphas, sizeof alphas);
        struct job_spec spec = kit_spec(8, 1);
        assert_int_equal(scene_build(&s, &spec, NULL, &built), ERR_OK);
        for (double b1 = 0; b1 <= 1; b1 += 0.125) {
            double b2 = (1 - b1) / 4, b0 = 1 - b1 - b2;
            struct hit hit = {.object = quad, .b1 = b1, .b2 = b2, .ng = {0, 0, 1}};
            const uint32_t *k = mesh->indices;
            double of_mesh =
                b0 * (double)alphas[k[0]] + b1 * (double)alphas[k[1]] + b2 * (double)alphas[k[2]];
            double opacity = 0.8 * (i & 1 ? of_mesh : 1);
            opacity = i & 4 ? opacity >= 0.3 : opacity;
            opacity = i & 2 ? opacity : 1;
            assert_true(fabs(shade_opacity(built, &hit, v3(0, 0, -1)) - opacity) < 1e-15);
            hit.object = ball; /* has none */
            assert_true(shade_opacity(built, &hit, v3(0, 0, -1)) == (i & 2 ? i & 4 ? 1 : 0.8 : 1));
        }
        render_scene_free(built);
        scene_release(&s);
    }
}

/* A veil by its corners is that by its material, bit for bit, in light and in shadow. */
static void veils_are_the_same(void **state)
{
    (void)state;
    static const double veil[12] = {-2, -2, 1.5, 2, -2, 1.5, 2, 2, 1.5, -2, 2, 1.5};
    struct kit_picture p[2];
    for (int i = 0; i < 2; i++) {
        struct scene s;
        struct scene_material *m;
        struct job_spec spec = kit_spec(16, 8);
        bumpy(&s, SCENE_MATERIAL_PRINCIPLED, (const double[]){0.5, 0.5, 1});
        uint32_t material = kit_material(&s, SCENE_MATERIAL_PRINCIPLED, &m);
        m->alpha_used = true;
        m->vertex_colors = i;
        m->alpha = i ? 1 : 0.25;
        uint32_t quad = kit_quad(&s, veil, material);
        struct scene_mesh *mesh = &s.meshes[s.objects[quad].mesh];
        mesh->alphas = mem_alloc_array(4, sizeof *mesh->alphas);
        for (int k = 0; k < 4; k++)
            mesh->alphas[k] = 0.25f;
        p[i] = kit_render(&s, &spec, 0);
        scene_release(&s);
    }
    assert_memory_equal(p[0].mean, p[1].mean, 16 * 16 * 3 * sizeof(double));
    kit_picture_free(&p[0]);
    kit_picture_free(&p[1]);
}

/* Heights of a sheet over [0,2] x [0,2], uv = 2 xy by the texture's matrix; world units. */
static double height_at(double x, double y, double slope[2])
{
    double sx, cx, sy, cy;
    dmath_sincos(VEC_PI * x, &sx, &cx);
    dmath_sincos(2 * VEC_PI * y, &sy, &cy);
    slope[0] = 0.05 * VEC_PI * cx * cy;
    slope[1] = -0.05 * 2 * VEC_PI * sx * sy;
    return 0.05 * sx * cy;
}

enum { SHEET = 200 };

/* A flat sheet with a map of these heights as values from 0 to 1, or the sheet itself, finely. */
static uint32_t add_sheet(struct scene *s, enum scene_texture_filter filter)
{
    static const double corners[12] = {0, 0, 0, 2, 0, 0, 2, 2, 0, 0, 2, 0};
    static const float uvs[8] = {0, 0, 1, 0, 1, 1, 0, 1};
    struct scene_material *m;
    double slope[2];
    float *pixels = mem_alloc_array((size_t)SHEET * SHEET, sizeof *pixels);
    for (int i = 0; i < SHEET * SHEET; i++) /* row 0 on top */
        pixels[i] = (float)(0.5 + height_at((i % SHEET + 0.5) * 2 / SHEET,
                                            (SHEET - 0.5 - i / SHEET) * 2 / SHEET, slope));
    uint32_t texture = kit_constant_texture(s, 1);
    char *name = s->textures[texture].name;
    scene_image_texture_init(&s->textures[texture]);
    s->textures[texture].name = name;
    s->textures[texture].filter = filter;
    s->textures[texture].image = 0;
    /* The surface's coordinates run along y and x; the matrix undoes it. */
    memcpy(s->textures[texture].uv_matrix, (double[6]){0, 1, 0, 1, 0, 0}, 6 * sizeof(double));
    s->images = mem_alloc(sizeof *s->images);
    s->images[0] = (struct scene_image){SHEET, SHEET, 1, SCENE_IMAGE_F32, pixels};
    s->image_count = 1;
    uint32_t material = kit_material(s, SCENE_MATERIAL_DIFFUSE, &m);
    m->bump_texture = texture;
    uint32_t quad = kit_quad(s, corners, material);
    struct scene_mesh *mesh = &s->meshes[s->objects[quad].mesh];
    mesh->uvs = mem_alloc_array(8, sizeof *uvs);
    for (int i = 0; i < 4; i++) {
        mesh->uvs[2 * i] = uvs[2 * i + 1];
        mesh->uvs[2 * i + 1] = uvs[2 * i];
    }
    return quad;
}

/* Against the normal of the heights, anywhere on the sheet; moved, turned and scaled, heights go
 * with the world, not with the object. */
static void bumps_are_normals_of_heights(void **state)
{
    (void)state;
    static const double from_above[3] = {0, 0, -1};
    for (int kind = 0; kind < 4; kind++) {
        struct scene s;
        struct render_scene *built;
        scene_init(&s);
        uint32_t quad = add_sheet(&s, kind == 1 ? SCENE_FILTER_BILINEAR : SCENE_FILTER_MIPMAP);
        double size = kind == 2 ? 3 : 1, scale = kind == 3 ? -2 : 1;
        s.materials[0].bump_scale = scale * size;
        s.objects[quad].transform[0] = s.objects[quad].transform[5] = size;
        /* Something far away, so that the scene's own scale is not 1. */
        kit_sphere(&s, 30, 0, 0, 1, kit_diffuse(&s, 1, 1, 1));
        struct job_spec spec = kit_spec(8, 1);
        assert_int_equal(scene_build(&s, &spec, NULL, &built), ERR_OK);
        double worst = 0;
        for (int i = 0; i < 2000; i++) {
            struct hit hit;
            struct ray ray = {.tmax = VEC_INFINITY};
            double x = (i % 50 + 0.51) * 2 / 50, y = (i / 50 + 0.37) * 2 / 40, slope[2];
            vec3 org = v3_sub(v3(x * size, y * size, 5), v3_of(built->center));
            v3_put(ray.org, v3_scale(org, built->scale));
            memcpy(ray.dir, from_above, sizeof ray.dir);
            accel_closest(built->accel, &ray, &hit);
            assert_int_equal(hit.object, quad);
            struct footprint fine = {.org = {{0.001, 0, 0}, {0, 0.001, 0}}};
            struct shade at;
            shade_of_hit(built, &hit, v3(0, 0, -1), kind ? NULL : &fine, NULL, &at);
            (void)height_at(x, y, slope);
            vec3 truth = v3_unit(v3(-scale * slope[0], -scale * slope[1], 1));
            double apart = v3_length(v3_sub(truth, at.surface.ns));
            worst = apart > worst ? apart : worst;
            assert_true(at.surface.ng.z == 1 && at.tilt_alpha2 >= 0);
        }
        printf("  bumps %d: normals within %.1e of those of the heights\n", kind, worst);
        assert_true(worst < 0.01);
        render_scene_free(built);
        scene_release(&s);
    }
}

/* Green leans to where t grows, on a ball as on a mesh: there t grows away from the pole of +z. On
 * balls it once leant the other way, so that a map of normals dented what its heights raised. */
static void green_leans_to_where_t_grows(void **state)
{
    (void)state;
    struct scene s;
    struct render_scene *built;
    scene_init(&s);
    uint32_t map = kit_constant_texture(&s, 0);
    s.textures[map].color[0][0] = 0.5;
    s.textures[map].color[0][1] = 0.75;
    s.textures[map].color[0][2] = 0.75;
    struct scene_material *m;
    uint32_t leaning = kit_material(&s, SCENE_MATERIAL_PRINCIPLED, &m);
    m->normal_texture = map;
    kit_sphere(&s, 0, 0, 0, 1, leaning);
    struct job_spec spec = kit_spec(8, 1);
    assert_int_equal(scene_build(&s, &spec, NULL, &built), ERR_OK);
    for (int i = 0; i < 100; i++) {
        struct hit hit;
        struct shade at;
        struct ray ray = {.tmax = VEC_INFINITY};
        double side = 1.8 * (i % 10 + 0.5) / 10 - 0.9, up = 0.7 * (i / 10 + 0.5) / 10 - 0.35;
        v3_put(ray.org, v3_scale(v3_sub(v3(side, 5, up), v3_of(built->center)), built->scale));
        v3_put(ray.dir, v3(0, -1, 0));
        accel_closest(built->accel, &ray, &hit);
        if (hit.object == SCENE_NONE)
            continue;
        shade_of_hit(built, &hit, v3(0, -1, 0), NULL, NULL, &at);
        if (at.bent)
            continue;
        vec3 n = at.surface.ng, down = v3_unit(v3(n.x * n.z, n.y * n.z, n.z * n.z - 1));
        vec3 truth = v3_unit(v3_add(n, down));
        assert_true(v3_length(v3_sub(truth, at.surface.ns)) < 1e-6);
    }
    render_scene_free(built);
    scene_release(&s);
}

/* Nothing to go by, nothing bumped: a map of one height, a mesh without coordinates. On a ball,
 * the pole is as good as any place. */
static void bumps_without_direction(void **state)
{
    (void)state;
    struct scene s;
    struct job_spec spec = kit_spec(16, 4);
    bumpy(&s, SCENE_MATERIAL_DIFFUSE, (const double[]){0.5, 0.5, 1});
    s.materials[0].bump_texture = s.materials[0].normal_texture;
    s.materials[0].normal_texture = SCENE_NONE;
    struct kit_picture flat = kit_render(&s, &spec, 0);
    s.textures[0].type = SCENE_TEXTURE_CHECKERBOARD;
    s.textures[0].filter = SCENE_FILTER_MIPMAP;
    memcpy(s.camera.position, (double[3]){0, 0, 4}, sizeof s.camera.position);
    struct kit_picture rough = kit_render(&s, &spec, 0);
    s.materials[0].bump_texture = SCENE_NONE;
    struct kit_picture none = kit_render(&s, &spec, 0);
    double apart = 0;
    for (size_t k = 0; k < 16 * 16 * 3; k++) {
        assert_true(fabs(flat.mean[k] - none.mean[k]) <= 1e-6 * fabs(none.mean[k]) + 1e-9);
        apart += fabs(rough.mean[k] - none.mean[k]);
    }
    assert_true(apart > 0.1 && rough.counters.nonfinite == 0);
    kit_picture_free(&flat);
    kit_picture_free(&rough);
    kit_picture_free(&none);
    scene_release(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(vertex_colors_are_interpolated),
        cmocka_unit_test(grazing_light_fades),
        cmocka_unit_test(profiles_agree_on_bumps),
        cmocka_unit_test(flat_maps_change_nothing),
        cmocka_unit_test(vertex_alphas_are_interpolated),
        cmocka_unit_test(veils_are_the_same),
        cmocka_unit_test(bumps_are_normals_of_heights),
        cmocka_unit_test(green_leans_to_where_t_grows),
        cmocka_unit_test(bumps_without_direction),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
