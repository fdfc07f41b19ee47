/* Surfaces that are not opaque: lamps, and paths that meet them again and again.
 *
 * Points on lights were once drawn without the opacity of what shines: a lamp of opacity 1/4 was
 * four times too bright wherever light sampling found it, and right where a ray met it by chance.
 *
 * A path that a surface had held was held by each that it met afterwards, as one number decided of
 * all of them. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "tests/render/render_kit.h"
#include "worker/render/render_scene.h"
#include "worker/scene/scene_build.h"

static const double pi = 3.14159265358979323846;

/* Opacity of the lamps, a quarter each: texels of a picture of 2 x 2, bottom row first. */
static const double texel_alphas[4] = {1, 0.2, 0, 0.6};

enum shape { QUAD, FAN, BALL, SHAPES };
enum opacity { PLAIN, CUT_IN, CUT_OUT, PICTURE, PICTURE_CUT, VERTICES, VERTICES_CUT, OPACITIES };

/* A picture of 2 x 2 texels that are looked up one by one. */
static uint32_t add_picture(struct scene *s)
{
    uint32_t index = kit_constant_texture(s, 1);
    struct scene_texture *t = &s->textures[index];
    t->type = SCENE_TEXTURE_IMAGE;
    t->filter = SCENE_FILTER_NEAREST;
    t->image = 0;
    s->images = mem_calloc(1, sizeof *s->images);
    float *pixels = mem_alloc_array(16, sizeof *pixels);
    assert_true(s->images && pixels);
    s->image_count = 1;
    s->images[0] = (struct scene_image){
        .width = 2, .height = 2, .channel_count = 4, .format = SCENE_IMAGE_F32, .pixels = pixels};
    for (int k = 0; k < 4; k++) {
        pixels[4 * k] = pixels[4 * k + 1] = pixels[4 * k + 2] = 0.5f;
        pixels[4 * k + 3] = (float)texel_alphas[k ^ 2]; /* row 0 is the top one */
    }
    return index;
}

/* What a lamp is made of; `alpha` is its factor. */
static uint32_t add_material(struct scene *s, enum opacity opacity, double alpha)
{
    uint32_t picture =
        opacity == PICTURE || opacity == PICTURE_CUT ? add_picture(s) : (uint32_t)SCENE_NONE;
    struct scene_material *m;
    uint32_t index = kit_material(s, SCENE_MATERIAL_PRINCIPLED, &m);
    m->metallic = 0;
    m->texture = picture;
    m->alpha_used = true;
    m->alpha = alpha;
    m->alpha_cutoff = -1;
    m->vertex_colors = opacity == VERTICES || opacity == VERTICES_CUT;
    if (opacity == CUT_IN || opacity == PICTURE_CUT || opacity == VERTICES_CUT)
        m->alpha_cutoff = 0.4 * alpha;
    if (opacity == CUT_OUT)
        m->alpha_cutoff = 1.1 * alpha;
    return index;
}

/* Coordinates of a picture, and opacities, of a mesh about the origin. */
static void add_vertex_values(struct scene_mesh *m, bool alphas)
{
    m->uvs = mem_alloc_array(m->vertex_count, 2 * sizeof *m->uvs);
    m->alphas = alphas ? mem_alloc_array(m->vertex_count, sizeof *m->alphas) : NULL;
    assert_true(m->uvs && (m->alphas || !alphas));
    for (uint32_t k = 0; k < m->vertex_count; k++) {
        const double *p = m->positions + (size_t)3 * k;
        m->uvs[2 * k] = (float)(0.5 + 0.5 * p[0]);
        m->uvs[2 * k + 1] = (float)(0.5 + 0.5 * p[2]);
        if (alphas)
            m->alphas[k] = (float)texel_alphas[k % 4];
    }
}

/* A lamp of radiance 3 about (0, 1, 0), which shines downwards. */
static void add_lamp(struct scene *s, enum shape shape, uint32_t material)
{
    static const double quad[12] = {-0.5, 1, -0.5, 0.5, 1, -0.5, 0.5, 1, 0.5, -0.5, 1, 0.5};
    static const double fan[18] = {0,    0.9, 0,   0.6,  1, -0.3, 0.2, 1.1, 0.7,
                                   -0.5, 1,   0.5, -0.4, 1, -0.4, 0.1, 1.1, -0.7};
    static const uint32_t triangles[15] = {0, 1, 2, 0, 2, 3, 0, 3, 4, 0, 4, 5, 0, 5, 1};
    bool alphas = s->materials[material].vertex_colors;
    uint32_t object;
    if (shape == BALL) {
        object = kit_sphere(s, 0, 1, 0, 0.4, material);
    } else {
        object = shape == QUAD ? kit_quad(s, quad, material)
                               : kit_mesh(s, fan, 6, triangles, 5, material);
        add_vertex_values(&s->meshes[s->mesh_count - 1], alphas);
    }
    kit_emit(s, object, 3, 3, 3);
}

static void add_floor(struct scene *s, uint32_t material)
{
    static const double corners[12] = {-2, 0, -2, -2, 0, 2, 2, 0, 2, 2, 0, -2};
    kit_quad(s, corners, material);
}

static void look(struct scene *s)
{
    memcpy(s->camera.position, (const double[]){0, 1.2, 4}, sizeof s->camera.position);
    memcpy(s->camera.look_at, (const double[]){0, 0.5, 0}, sizeof s->camera.look_at);
    s->camera.fov = 45;
}

/* Of several hundred such comparisons, none is off by as much by chance. */
static const double z_max = 5;

static void assert_profiles_agree(const struct scene *s, const char *what)
{
    static const enum job_profile profiles[3] = {JOB_PROFILE_RW, JOB_PROFILE_NEE, JOB_PROFILE_MIS};
    double mean[3], variance[3];
    for (int k = 0; k < 3; k++) {
        struct job_spec spec = kit_spec(16, k == 0 ? 512 : 64);
        spec.profile = profiles[k];
        assert_int_equal(kit_estimate(s, spec, &mean[k], &variance[k]), 0);
    }
    for (int k = 1; k < 3; k++) {
        double z = (mean[k] - mean[0]) / sqrt(variance[k] + variance[0] + 1e-30);
        print_message("  %s: RW %.5f, %s %.5f, z %.1f\n", what, mean[0], k == 1 ? "NEE" : "MIS",
                      mean[k], z);
        assert_true(fabs(z) < z_max);
    }
}

/* Each shape with each opacity, on a diffuse floor. */
static void profiles_agree(void **state)
{
    (void)state;
    static const char *const shapes[] = {"quad", "fan", "sphere"};
    static const char *const opacities[] = {"plain",       "cut in",   "cut out",     "picture",
                                            "picture cut", "vertices", "vertices cut"};
    for (int shape = 0; shape < SHAPES; shape++) {
        for (int opacity = 0; opacity < OPACITIES; opacity++) {
            if (shape == BALL && opacity >= VERTICES)
                continue;
            struct scene s;
            char what[64];
            scene_init(&s);
            add_lamp(&s, (enum shape)shape,
                     add_material(&s, (enum opacity)opacity,
                                  opacity == PLAIN || opacity == CUT_IN ? 0.25 : 0.9));
            add_floor(&s, kit_diffuse(&s, 0.6, 0.6, 0.6));
            look(&s);
            snprintf(what, sizeof what, "%s, %s", shapes[shape], opacities[opacity]);
            assert_profiles_agree(&s, what);
            scene_release(&s);
        }
    }
}

/* Several lamps above metal, which draws candidates among them; one is opaque and another clear. */
static void candidates_agree(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    uint32_t picture = add_material(&s, PICTURE, 1);
    add_lamp(&s, FAN, picture);
    kit_emit(&s, kit_sphere(&s, -1.2, 0.7, 0, 0.3, picture), 4, 2, 1);
    kit_emit(&s, kit_sphere(&s, 1.2, 0.7, 0, 0.2, add_material(&s, PLAIN, 0.5)), 4, 5, 6);
    kit_emit(&s, kit_sphere(&s, 1.2, 0.7, 0.8, 0.1, SCENE_NONE), 1, 2, 3);
    kit_emit(&s, kit_sphere(&s, -1.2, 0.7, 0.8, 0.1, add_material(&s, PLAIN, 0)), 90, 90, 90);
    struct scene_material *m;
    uint32_t metal = kit_material(&s, SCENE_MATERIAL_ROUGH_CONDUCTOR, &m);
    m->alpha_x = m->alpha_y = 0.3;
    for (int k = 0; k < 3; k++) {
        m->etaT[k] = 0.5;
        m->k[k] = 3;
    }
    add_floor(&s, metal);
    look(&s);
    assert_profiles_agree(&s, "candidates");
    scene_release(&s);
}

/* A point of the floor, as big as nothing, seen from straight above it. */
static double floor_radiance(const struct scene *s, enum job_profile profile, uint64_t spp)
{
    struct job_spec spec = kit_spec(16, spp);
    spec.profile = profile;
    spec.max_depth = 2;
    struct kit_picture p = kit_render(s, &spec, 0);
    double mean = kit_picture_mean(&p);
    kit_picture_free(&p);
    return mean;
}

static void look_at_floor(struct scene *s)
{
    struct scene_camera *c = &s->camera;
    c->type = SCENE_CAMERA_ORTHOGRAPHIC;
    c->ortho_height = 1e-7;
    memcpy(c->position, (const double[]){0, 0.5, 0}, sizeof c->position);
    memcpy(c->look_at, (const double[]){0, 0, 0}, sizeof c->look_at);
    memcpy(c->ref_up, (const double[]){0, 0, -1}, sizeof c->ref_up);
}

/* A sphere of radius r at height h lights what is below it by pi L (r / h)^2. Every other one is
 * cut by a mask. */
static void spheres_in_closed_form(void **state)
{
    (void)state;
    static const double alphas[] = {0, 0.25, 0.5, 1};
    for (int i = 0; i < 8; i++) {
        struct scene s;
        struct scene_material *m;
        scene_init(&s);
        uint32_t material = kit_material(&s, SCENE_MATERIAL_PRINCIPLED, &m);
        m->alpha_used = true;
        m->alpha = alphas[i / 2];
        m->alpha_cutoff = i % 2 ? 0.5 : -1;
        kit_emit(&s, kit_sphere(&s, 0, 1, 0, 0.3, material), 3, 3, 3);
        add_floor(&s, kit_diffuse(&s, 0.6, 0.6, 0.6));
        look_at_floor(&s);
        double opacity = i % 2 ? alphas[i / 2] >= 0.5 : alphas[i / 2];
        double expected = 0.6 * 3 * opacity * 0.3 * 0.3;
        for (int p = 0; p < 3; p++) {
            double found = floor_radiance(&s, (enum job_profile)p, 256);
            print_message("  opacity %g, %s: %g for %g\n", opacity, job_profile_names[p], found,
                          expected);
            assert_true(fabs(found - expected) <= 0.02 * expected);
        }
        scene_release(&s);
    }
}

/* The light of a quad with a picture for its opacity, summed over its points. */
static void pictures_in_closed_form(void **state)
{
    (void)state;
    enum { N = 400 };
    for (int cut = 0; cut < 2; cut++) {
        struct scene s;
        scene_init(&s);
        add_lamp(&s, QUAD, add_material(&s, cut ? PICTURE_CUT : PICTURE, 1));
        add_floor(&s, kit_diffuse(&s, 0.6, 0.6, 0.6));
        look_at_floor(&s);
        double sum = 0;
        for (int i = 0; i < N * N; i++) {
            double x = (i % N + 0.5) / N - 0.5, z = (i / N + 0.5) / N - 0.5;
            double alpha = texel_alphas[(x > 0) + 2 * (z > 0)], r2 = 1 + x * x + z * z;
            if (cut)
                alpha = alpha >= 0.4;
            sum += alpha / (r2 * r2 * N * N);
        }
        double expected = 0.6 / pi * 3 * sum;
        for (int p = 0; p < 3; p++) {
            double found = floor_radiance(&s, (enum job_profile)p, 1024);
            print_message("  picture, %s: %g for %g\n", job_profile_names[p], found, expected);
            assert_true(fabs(found - expected) <= 0.01 * expected);
        }
        scene_release(&s);
    }
}

/* What is clear everywhere is no light, and does not draw samples from those that are. */
static void clear_lamps_are_none(void **state)
{
    (void)state;
    for (int alpha = 0; alpha < 2; alpha++) {
        struct scene s;
        scene_init(&s);
        add_lamp(&s, QUAD, add_material(&s, PLAIN, alpha));
        struct job_spec spec = kit_spec(4, 1);
        struct render_scene *rs;
        assert_int_equal(scene_build(&s, &spec, NULL, &rs), ERR_OK);
        assert_int_equal(rs->lights.count, alpha);
        assert_true(rs->lights.any_hittable == alpha);
        render_scene_free(rs);
        scene_release(&s);
    }
}

/* A mirror that lets half of the light through before a lamp, a mirror that lets none through
 * behind the camera: of what comes back every time half goes on to the lamp. */
static void every_surface_is_asked_anew(void **state)
{
    (void)state;
    enum { MEETINGS = 4 };
    static const double sheet[12] = {-9, -9, 0, 9, -9, 0, 9, 9, 0, -9, 9, 0};
    for (int profile = 0; profile < 3; profile++) {
        struct scene s;
        struct scene_material *m;
        scene_init(&s);
        kit_emit(&s, kit_quad(&s, sheet, SCENE_NONE), 1, 1, 1);
        kit_quad(&s, sheet, kit_material(&s, SCENE_MATERIAL_MIRROR, &m));
        m->alpha_used = true;
        m->alpha = 0.5;
        m->alpha_cutoff = -1;
        m->R[0] = m->R[1] = m->R[2] = 1;
        kit_quad(&s, sheet, kit_material(&s, SCENE_MATERIAL_MIRROR, &m));
        m->R[0] = m->R[1] = m->R[2] = 1;
        static const double at[3] = {0, 1, 2}; /* of the lamp, and of the mirrors before it */
        for (size_t i = 0; i < 3; i++)
            s.objects[i].transform[11] = at[i];
        s.camera.type = SCENE_CAMERA_ORTHOGRAPHIC;
        s.camera.ortho_height = 1;
        s.camera.position[2] = 1.5;
        s.camera.look_at[2] = 0;
        struct job_spec spec = kit_spec(16, 64);
        spec.profile = (enum job_profile)profile;
        spec.rr_threshold = 0;
        spec.max_depth = 2 * MEETINGS - 1;
        struct kit_picture p = kit_render(&s, &spec, 0);
        double mean = kit_picture_mean(&p), expected = 1 - pow(0.5, MEETINGS);
        print_message("  %s: %g for %g\n", job_profile_names[profile], mean, expected);
        /* As many coins were thrown. */
        assert_true(fabs(mean - expected) <
                    z_max * sqrt(expected * (1 - expected) / (16 * 16 * 64)));
        kit_picture_free(&p);
        scene_release(&s);
    }
}

/* A black sheet that is not there from behind, its front up or down. */
static void add_sheet(struct scene *s, double y, bool front_up)
{
    static const double up[12] = {-9, 0, -9, -9, 0, 9, 9, 0, 9, 9, 0, -9};
    static const double down[12] = {-9, 0, -9, 9, 0, -9, 9, 0, 9, -9, 0, 9};
    struct scene_material *m;
    uint32_t material = kit_material(s, SCENE_MATERIAL_PRINCIPLED, &m);
    m->backface_culling = true;
    m->specular = m->metallic = 0;
    m->color[0] = m->color[1] = m->color[2] = 0;
    uint32_t sheet = kit_quad(s, front_up ? up : down, material);
    s->objects[sheet].transform[7] = y;
}

/* Rays from below go through the back of a sheet whose front is up, shadow rays too. */
static void backs_throw_no_shadow(void **state)
{
    (void)state;
    for (int front_up = 0; front_up < 2; front_up++) {
        struct scene s;
        scene_init(&s);
        kit_emit(&s, kit_sphere(&s, 0, 1, 0, 0.2, SCENE_NONE), 3, 3, 3);
        add_sheet(&s, 0.75, front_up);
        add_floor(&s, kit_diffuse(&s, 0.6, 0.6, 0.6));
        look_at_floor(&s);
        double expected = front_up ? 0.6 * 3 * 0.2 * 0.2 : 0;
        for (int p = 0; p < 3; p++) {
            double found = floor_radiance(&s, (enum job_profile)p, 256);
            print_message("  front %s, %s: %g for %g\n", front_up ? "up" : "down",
                          job_profile_names[p], found, expected);
            assert_true(fabs(found - expected) <= 0.02 * expected);
        }
        scene_release(&s);
    }
}

/* The camera above sees the sky below through it, or black; so do the planes of first hits. */
static void backs_are_not_seen(void **state)
{
    (void)state;
    for (int front_up = 0; front_up < 2; front_up++) {
        struct scene s;
        scene_init(&s);
        kit_constant_sky(&s, 2);
        add_sheet(&s, 0.25, front_up);
        look_at_floor(&s);
        struct job_spec spec = kit_spec(8, 4);
        struct kit_picture p = kit_render(&s, &spec, 0);
        assert_true(fabs(kit_picture_mean(&p) - (front_up ? 0 : 2)) < 1e-6);
        kit_picture_free(&p);
        scene_release(&s);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(backs_throw_no_shadow),
        cmocka_unit_test(backs_are_not_seen),
        cmocka_unit_test(every_surface_is_asked_anew),
        cmocka_unit_test(profiles_agree),
        cmocka_unit_test(candidates_agree),
        cmocka_unit_test(spheres_in_closed_form),
        cmocka_unit_test(pictures_in_closed_form),
        cmocka_unit_test(clear_lamps_are_none),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
