/* scene_build: winding, instances, parallelogram lights, alpha, emission, empty scenes, and every
 * allocation failing in turn. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "common/scene_plan.h"
#include "tests/render/render_kit.h"
#include "worker/render/render_scene.h"
#include "worker/scene/scene_build.h"

static struct render_scene *build(const struct scene *s)
{
    struct job_spec spec = kit_spec(8, 4);
    struct render_scene *rs;
    assert_int_equal(scene_build(s, &spec, NULL, &rs), ERR_OK);
    return rs;
}

static const double square[12] = {-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0};

/* Vertex normals that point the other way turn the faces; also under a mirroring transform. */
static void winding_follows_the_normals(void **state)
{
    (void)state;
    for (int turned = 0; turned < 2; turned++) {
        for (int mirrored = 0; mirrored < 2; mirrored++) {
            struct scene s;
            scene_init(&s);
            uint32_t o = kit_quad(&s, square, kit_diffuse(&s, 1, 1, 1));
            struct scene_mesh *m = &s.meshes[0];
            m->normals = mem_calloc(12, sizeof *m->normals);
            for (int v = 0; v < 4; v++)
                m->normals[3 * v + 2] = turned ? -1 : 1;
            if (mirrored)
                s.objects[o].transform[0] = -1;
            struct render_scene *rs = build(&s);
            struct ray ray = {.org = {0.1, 0.2, 3}, .dir = {0, 0, -1}, .tmax = 10};
            struct hit hit;
            accel_closest(rs->accel, &ray, &hit);
            assert_int_equal(hit.object, o);
            assert_true(turned ? hit.ng[2] < 0 : hit.ng[2] > 0);
            render_scene_free(rs);
            scene_release(&s);
        }
    }
}

/* A mesh without normals has the side that shines, or that is outside, where its faces have it; a
 * transform that mirrors moves it along, as it does where vertices have normals. Such faces were
 * turned inside out. */
static void mirrored_faces_keep_their_side(void **state)
{
    (void)state;
    for (int mirrored = 0; mirrored < 2; mirrored++) {
        struct scene s;
        scene_init(&s);
        uint32_t o = kit_quad(&s, square, kit_diffuse(&s, 1, 1, 1));
        kit_emit(&s, o, 1, 1, 1);
        if (mirrored)
            s.objects[o].transform[0] = -1;
        struct render_scene *rs = build(&s);
        struct ray ray = {.org = {0.1, 0.2, 3}, .dir = {0, 0, -1}, .tmax = 10};
        struct hit hit;
        accel_closest(rs->accel, &ray, &hit);
        assert_int_equal(hit.object, o);
        assert_true(hit.ng[2] > 0);
        assert_int_equal(rs->lights.count, 1);
        assert_true(rs->lights.lights[0].n.z > 0);
        render_scene_free(rs);
        scene_release(&s);
    }
}

static void two_triangles_make_one_light(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    kit_emit(&s, kit_quad(&s, square, SCENE_NONE), 1, 2, 3);
    static const double kite[12] = {2, 0, 0, 3, 0, 0, 4, 1.5, 0, 2, 1, 0};
    kit_emit(&s, kit_quad(&s, kite, SCENE_NONE), 1, 2, 3);
    struct render_scene *rs = build(&s);
    assert_int_equal(rs->lights.count, 3);
    assert_int_equal(rs->lights.lights[0].type, LIGHT_QUAD);
    assert_int_equal(rs->object_lights[0], rs->object_lights[1]);
    assert_int_equal(rs->lights.lights[1].type, LIGHT_TRIANGLE);
    double area = 0, scale2 = rs->scale * rs->scale;
    for (int i = 0; i < 3; i++)
        area += rs->lights.lights[i].area / scale2;
    assert_true(fabs(area - (4 + 1.75)) < 1e-5);
    render_scene_free(rs);
    scene_release(&s);
}

/* A bumpy sheet of enough triangles to be instanced. */
static void add_sheet(struct scene *s, uint32_t material, bool again)
{
    enum { SIDE = 49 };
    static const double corner[12] = {0};
    uint32_t o = kit_quad(s, corner, material);
    struct scene_mesh *m = &s->meshes[s->mesh_count - 1];
    mem_free(m->positions);
    mem_free(m->indices);
    m->vertex_count = SIDE * SIDE;
    m->triangle_count = 2 * (SIDE - 1) * (SIDE - 1);
    m->positions = mem_alloc_array(m->vertex_count, 3 * sizeof *m->positions);
    m->indices = mem_alloc_array(m->triangle_count, 3 * sizeof *m->indices);
    assert_non_null(m->positions);
    assert_non_null(m->indices);
    for (uint32_t i = 0; i < m->vertex_count; i++) {
        double x = (double)(i % SIDE) / (SIDE - 1), y = (double)(i / SIDE) / (SIDE - 1);
        double p[3] = {2 * x - 1, 2 * y - 1, x * y * (1 - x) * (i % 3)};
        memcpy(m->positions + 3 * (size_t)i, p, sizeof p);
    }
    uint32_t *t = m->indices;
    for (uint32_t i = 0; i < (SIDE - 1) * (SIDE - 1); i++) {
        uint32_t v = i / (SIDE - 1) * SIDE + i % (SIDE - 1);
        const uint32_t two[6] = {v, v + 1, v + SIDE, v + 1, v + SIDE + 1, v + SIDE};
        memcpy(t + 6 * (size_t)i, two, sizeof two);
    }
    if (!again)
        return;
    uint32_t second = kit_sphere(s, 0, 0, 0, 1, material);
    struct scene_object *copy = &s->objects[second];
    copy->type = SCENE_OBJECT_MESH;
    copy->mesh = s->objects[o].mesh;
    static const double transform[16] = {0.6, 0, 0, 0.3, 0, 0, -0.5, 0.2, 0, 0.7, 0, 1, 0, 0, 0, 1};
    memcpy(copy->transform, transform, sizeof transform);
}

/* The same picture whether a mesh is instanced or written out. */
static void instances_look_like_copies(void **state)
{
    (void)state;
    struct kit_picture pictures[2];
    for (int apart = 0; apart < 2; apart++) {
        struct scene s;
        scene_init(&s);
        struct scene_material *m;
        uint32_t material = kit_material(&s, SCENE_MATERIAL_DIFFUSE, &m);
        m->twosided = true;
        add_sheet(&s, material, true);
        if (apart) {
            add_sheet(&s, material, false);
            s.objects[1].mesh = (uint32_t)(s.mesh_count - 1);
            s.object_count--;
        }
        kit_constant_sky(&s, 1);
        s.camera.position[2] = 4;
        struct render_scene *rs = build(&s);
        assert_int_equal(rs->objects[0].type, apart ? ACCEL_TRIANGLES : ACCEL_INSTANCE);
        render_scene_free(rs);
        struct job_spec spec = kit_spec(32, 16);
        pictures[apart] = kit_render(&s, &spec, 0);
        scene_release(&s);
    }
    double difference = 0;
    for (size_t i = 0; i < 32 * 32 * 3; i++)
        difference += fabs(pictures[0].mean[i] - pictures[1].mean[i]) / (32 * 32 * 3);
    assert_true(difference < 5e-3);
    kit_picture_free(&pictures[0]);
    kit_picture_free(&pictures[1]);
}

/* A pane of opacity 1/4 that reflects nothing leaves 3/4 of the sky behind it and of a light. */
static void alpha_lets_light_through(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    struct scene_material *m;
    uint32_t pane = kit_material(&s, SCENE_MATERIAL_PRINCIPLED, &m);
    memset(m->color, 0, sizeof m->color);
    m->specular = 0;
    m->metallic = 0;
    m->alpha = 0.25;
    m->alpha_used = true;
    m->alpha_cutoff = -1;
    kit_quad(&s, square, pane);
    kit_constant_sky(&s, 2);
    s.camera.position[2] = 3;
    s.camera.fov = 20;
    struct job_spec spec = kit_spec(16, 64);
    struct kit_picture p = kit_render(&s, &spec, 0);
    assert_true(fabs(kit_picture_mean(&p) - 1.5) < 0.02);
    kit_picture_free(&p);
    /* A wall behind the pane, lit through it by a point light at the camera: 3/4 twice. */
    static const double wall[12] = {-9, -9, -1, 9, -9, -1, 9, 9, -1, -9, 9, -1};
    s.envmap.texture = SCENE_NONE;
    kit_quad(&s, wall, kit_diffuse(&s, 1, 1, 1));
    struct scene_light *light = kit_light(&s, SCENE_LIGHT_POINT);
    light->position[2] = 2.9;
    spec.max_depth = 2;
    spec.spp = 256;
    p = kit_render(&s, &spec, 0);
    s.objects[0].material = kit_material(&s, SCENE_MATERIAL_PRINCIPLED, &m);
    m->alpha = 0;
    m->alpha_used = true;
    m->alpha_cutoff = -1;
    struct kit_picture clear = kit_render(&s, &spec, 0);
    double ratio = kit_picture_mean(&p) / kit_picture_mean(&clear);
    assert_true(fabs(ratio - 0.5625) < 0.01);
    kit_picture_free(&p);
    kit_picture_free(&clear);
    scene_release(&s);
}

/* A wall lit by a panel whose emission is a texture, found by light sampling and by chance. */
static uint32_t kit_pane(struct scene *s, double alpha)
{
    struct scene_material *m;
    uint32_t pane = kit_material(s, SCENE_MATERIAL_PRINCIPLED, &m);
    m->metallic = m->specular = 0;
    m->alpha = alpha;
    m->alpha_used = true;
    m->alpha_cutoff = -1;
    return pane;
}

/* Behind two panes a path asks whether the third holds it. Dimensions were counted in 32 bits: that
 * number was the one that drew the direction from there, so of all directions only a half was
 * taken, under the samplers that count dimensions. */
static void opacity_draws_no_direction(void **state)
{
    (void)state;
    static const enum job_sampler types[] = {JOB_SAMPLER_SOBOL, JOB_SAMPLER_HALTON,
                                             JOB_SAMPLER_INDEPENDENT};
    static const double lamp[12] = {1, 5, 0, 5, 1, 0, 5, 1, 4, 1, 5, 4};
    double means[3];
    struct scene s;
    scene_init(&s);
    for (int z = 0; z < 3; z++) {
        const double pane[12] = {-9, -9, z, 9, -9, z, 9, 9, z, -9, 9, z};
        kit_quad(&s, pane, kit_pane(&s, z == 0 ? 0.5 : 1e-4));
    }
    kit_emit(&s, kit_quad(&s, lamp, kit_diffuse(&s, 0, 0, 0)), 1, 1, 1);
    s.camera.position[2] = 3.5;
    s.camera.fov = 5;
    for (size_t i = 0; i < 3; i++) {
        struct job_spec spec = kit_spec(16, 256);
        spec.profile = JOB_PROFILE_RW;
        spec.sampler = types[i];
        spec.max_depth = 2;
        struct kit_picture p = kit_render(&s, &spec, 0);
        means[i] = kit_picture_mean(&p);
        kit_picture_free(&p);
    }
    assert_true(means[0] > 0.01);
    assert_true(fabs(means[1] / means[0] - 1) < 0.05);
    assert_true(fabs(means[2] / means[0] - 1) < 0.05);
    scene_release(&s);
}

/* A panel whose vertices are red at its bottom and blue at its top shines in what lies between, at
 * the camera and onto a wall behind that; with a radiance of its own it shines in that alone. */
static void emission_takes_the_colors_of_vertices(void **state)
{
    (void)state;
    static const double wall[12] = {-3, -3, 4, -3, 3, 4, 3, 3, 4, 3, -3, 4};
    static const float colors[12] = {1, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 1};
    double seen[3] = {0}, means[JOB_PROFILE_COUNT][3] = {{0}};
    for (int i = 0; i < 2 + JOB_PROFILE_COUNT; i++) {
        struct scene s;
        struct scene_material *m;
        scene_init(&s);
        uint32_t glow = kit_material(&s, SCENE_MATERIAL_PRINCIPLED, &m);
        m->emission_vertex_colors = true;
        m->metallic = m->specular = 0;
        for (int k = 0; k < 3; k++) {
            m->color[k] = 0;
            m->emission[k] = i == 1 ? 0 : 2;
        }
        uint32_t panel = kit_quad(&s, square, glow);
        s.meshes[0].colors = mem_alloc_array(4, 3 * sizeof(float));
        assert_non_null(s.meshes[0].colors);
        memcpy(s.meshes[0].colors, colors, sizeof colors);
        if (i == 1)
            kit_emit(&s, panel, 2, 2, 2);
        kit_quad(&s, wall, kit_diffuse(&s, 0.5, 0.5, 0.5));
        s.camera.type = SCENE_CAMERA_ORTHOGRAPHIC;
        s.camera.ortho_height = 2;
        s.camera.position[2] = 2;
        s.camera.look_at[2] = i < 2 ? 0 : 4;
        struct job_spec spec = kit_spec(16, i < 4 ? 64 : 1024);
        spec.max_depth = 2;
        spec.profile = i < 2 ? JOB_PROFILE_MIS : (enum job_profile)(i - 2);
        struct kit_picture p = kit_render(&s, &spec, 0);
        double *mean = i < 2 ? seen : means[i - 2];
        for (size_t k = 0; k < 3 * 16 * 16; k++)
            mean[k / 256] += p.mean[k] / 256;
        for (int k = 0; k < 3 && i < 2; k++)
            assert_true(fabs(seen[k] - (i == 1 ? 2 : k == 1 ? 0 : 1)) < 1e-3);
        memset(seen, 0, sizeof seen);
        kit_picture_free(&p);
        scene_release(&s);
    }
    for (int i = 0; i < JOB_PROFILE_COUNT; i++) {
        print_message("  %s: %g %g %g\n", job_profile_names[i], means[i][0], means[i][1],
                      means[i][2]);
        for (int k = 0; k < 3; k++)
            assert_true(k == 1 ? means[i][k] == 0
                               : means[i][k] > 0.01 && fabs(means[i][k] / means[0][0] - 1) < 0.02);
    }
}

/* A leaning panel that shines on both sides lights the walls before and behind it, alone and beside
 * a lamp on one side. What the three techniques find is the same. */
static void both_sides_shine(void **state)
{
    (void)state;
    static const double front[12] = {-3, -3, -2, 3, -3, -2, 3, 3, -2, -3, 3, -2};
    static const double back[12] = {-3, -3, 2, -3, 3, 2, 3, 3, 2, 3, -3, 2};
    for (int i = 0; i < 8; i++) {
        double means[JOB_PROFILE_COUNT];
        for (int p = 0; p < JOB_PROFILE_COUNT; p++) {
            struct scene s;
            struct scene_material *m;
            scene_init(&s);
            uint32_t glow = kit_material(&s, SCENE_MATERIAL_PRINCIPLED, &m);
            m->emission_twosided = true;
            m->metallic = m->specular = 0;
            for (int k = 0; k < 3; k++) {
                m->color[k] = 0.3;
                m->emission[k] = 2;
            }
            uint32_t panel = kit_quad(&s, square, glow);
            s.objects[panel].transform[6] = 0.3;
            kit_quad(&s, i & 1 ? front : back, kit_diffuse(&s, 0.5, 0.5, 0.5));
            if (i & 2)
                kit_emit(&s, kit_sphere(&s, 2, 0, i & 1 ? -1 : 1, 0.3, SCENE_NONE), 3, 3, 3);
            s.camera.type = SCENE_CAMERA_ORTHOGRAPHIC;
            s.camera.ortho_height = i & 4 ? 4 : 2;
            s.camera.position[2] = i & 4 ? (i & 1 ? -1.9 : 1.9) : 0;
            s.camera.look_at[2] = i & 4 ? 0 : i & 1 ? -2 : 2;
            struct job_spec spec = kit_spec(16, p == JOB_PROFILE_RW ? 1024 : 128);
            spec.max_depth = 3;
            spec.profile = (enum job_profile)p;
            struct kit_picture picture = kit_render(&s, &spec, 0);
            means[p] = kit_picture_mean(&picture);
            if (i & 4) /* the panel itself */
                assert_true(picture.mean[8 * 16 + 8] > 1.99);
            kit_picture_free(&picture);
            scene_release(&s);
        }
        print_message("  MIS %g, NEE %g, RW %g\n", means[0], means[1], means[2]);
        assert_true(means[0] > 0.05);
        assert_true(fabs(means[1] / means[0] - 1) < 0.01 && fabs(means[2] / means[0] - 1) < 0.02);
    }
}

/* A rough dielectric whose index is that of its surroundings becomes smooth glass, whose only lobe
 * is a direction. It was still taken for rough: NEE sampled lights there in vain and gave up the
 * last edge, on which only light that is hit counts. A lamp behind it was dark. */
static void what_bends_nothing_hides_nothing(void **state)
{
    (void)state;
    static const enum job_profile profiles[] = {JOB_PROFILE_RW, JOB_PROFILE_NEE, JOB_PROFILE_MIS};
    static const double corners[12] = {-9, -9, -5, 9, -9, -5, 9, 9, -5, -9, 9, -5};
    struct scene s;
    struct scene_material *m;
    scene_init(&s);
    uint32_t clear = kit_material(&s, SCENE_MATERIAL_ROUGH_DIELECTRIC, &m);
    m->eta = 1;
    (void)kit_sphere(&s, 0, 0, -2, 1.5, clear);
    kit_emit(&s, kit_quad(&s, corners, kit_diffuse(&s, 0, 0, 0)), 1, 1, 1);
    for (size_t i = 0; i < sizeof profiles / sizeof *profiles; i++) {
        struct job_spec spec = kit_spec(8, 4);
        spec.profile = profiles[i];
        spec.max_depth = 3;
        struct kit_picture p = kit_render(&s, &spec, 0);
        assert_true(fabs(kit_picture_mean(&p) - 1) < 1e-6);
        kit_picture_free(&p);
    }
    scene_release(&s);
}

static void textured_emission_is_found_both_ways(void **state)
{
    (void)state;
    static const double panel[12] = {-1, -1, 1, -1, 1, 1, 1, 1, 1, 1, -1, 1};
    static const float uvs[8] = {0, 0, 0, 1, 1, 1, 1, 0};
    struct scene s;
    scene_init(&s);
    kit_quad(&s, square, kit_diffuse(&s, 0.8, 0.8, 0.8));
    struct scene_material *m;
    uint32_t glow = kit_material(&s, SCENE_MATERIAL_PRINCIPLED, &m);
    m->emission[0] = m->emission[1] = m->emission[2] = 3;
    m->emission_texture = kit_constant_texture(&s, 0);
    s.textures[0].type = SCENE_TEXTURE_CHECKERBOARD;
    s.textures[0].color[0][0] = 1;
    s.textures[0].color[1][1] = 1;
    uint32_t o = kit_quad(&s, panel, glow);
    s.meshes[s.objects[o].mesh].uvs = mem_alloc_array(8, sizeof *uvs);
    memcpy(s.meshes[s.objects[o].mesh].uvs, uvs, sizeof uvs);
    s.camera.position[0] = 3;
    s.camera.position[2] = 3;
    double mean[3];
    for (int k = 0; k < 3; k++) {
        struct job_spec spec = kit_spec(32, 256);
        spec.profile = (enum job_profile)k;
        spec.max_depth = 2;
        struct kit_picture p = kit_render(&s, &spec, 0);
        mean[k] = kit_picture_mean(&p);
        kit_picture_free(&p);
    }
    assert_true(mean[0] > 0.01);
    assert_true(fabs(mean[1] / mean[0] - 1) < 0.01);
    assert_true(fabs(mean[2] / mean[0] - 1) < 0.02);
    scene_release(&s);
}

/* A ball once shone all over as brightly as its emission texture is white. Here half of it is
 * dark. */
static void spheres_shine_in_their_texture(void **state)
{
    (void)state;
    double mean[2][3];
    for (int dark = 0; dark < 2; dark++) {
        struct scene s;
        scene_init(&s);
        kit_quad(&s, square, kit_diffuse(&s, 0.8, 0.8, 0.8));
        struct scene_material *m;
        uint32_t glow = kit_material(&s, SCENE_MATERIAL_PRINCIPLED, &m);
        m->emission[0] = m->emission[1] = m->emission[2] = 3;
        m->emission_texture = kit_constant_texture(&s, 0);
        struct scene_texture *t = &s.textures[m->emission_texture];
        t->type = SCENE_TEXTURE_CHECKERBOARD;
        t->uv_matrix[4] = 0; /* squares are the halves of u */
        for (int k = 0; k < 3; k++) {
            t->color[0][k] = 1;
            t->color[1][k] = !dark;
        }
        kit_sphere(&s, 0, 0, 1.5, 0.5, glow);
        s.camera.position[0] = 3;
        s.camera.position[2] = 0.5;
        for (int k = 0; k < 3; k++) {
            struct job_spec spec = kit_spec(32, 256);
            spec.profile = (enum job_profile)k;
            spec.max_depth = 2;
            struct kit_picture p = kit_render(&s, &spec, 0);
            mean[dark][k] = kit_picture_mean(&p);
            kit_picture_free(&p);
        }
        scene_release(&s);
    }
    for (int k = 0; k < 3; k++) {
        assert_true(mean[1][k] > 0.3 * mean[0][k] && mean[1][k] < 0.7 * mean[0][k]);
        assert_true(fabs(mean[1][k] / mean[1][0] - 1) < 0.02);
    }
}

static void nothing_at_all_is_black(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    for (int i = 0; i < JOB_INTEGRATOR_COUNT; i++) {
        struct job_spec spec = kit_spec(8, 2);
        spec.integrator = (enum job_integrator)i;
        struct kit_picture p = kit_render(&s, &spec, 0);
        assert_true(kit_picture_mean(&p) == 0);
        kit_picture_free(&p);
    }
    /* Only triangles without area, and all in one point. */
    static const double point[12] = {1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
    kit_emit(&s, kit_quad(&s, point, kit_diffuse(&s, 1, 1, 1)), 1, 1, 1);
    struct job_spec spec = kit_spec(8, 2);
    struct kit_picture p = kit_render(&s, &spec, 0);
    assert_true(kit_picture_mean(&p) == 0);
    assert_int_equal(p.counters.nonfinite, 0);
    kit_picture_free(&p);
    scene_release(&s);
}

static void an_extent_beyond_double_is_refused(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    kit_sphere(&s, 1e308, 0, 0, 1.7e308, kit_diffuse(&s, 1, 1, 1));
    struct job_spec spec = kit_spec(8, 2);
    struct render_scene *rs = NULL;
    assert_int_equal(scene_build(&s, &spec, NULL, &rs), ERR_LIMIT);
    scene_release(&s);
}

static void every_allocation_may_fail(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    kit_cornell(&s, KIT_BOXES | KIT_AREA_LIGHT | KIT_GLASS_SPHERE);
    struct job_spec spec = kit_spec(8, 2);
    enum err e = ERR_NOMEM;
    uint64_t tries = 0;
    while (e == ERR_NOMEM) {
        struct render_scene *rs = NULL;
        mem_fail_after(tries++);
        e = scene_build(&s, &spec, NULL, &rs);
        mem_fail_after(UINT64_MAX);
        assert_true((e == ERR_OK) == (rs != NULL));
        render_scene_free(rs);
    }
    assert_int_equal(e, ERR_OK);
    assert_true(tries > 4);
    scene_release(&s);
}

/* What another job may change and still share: each in turn. */
static void change(struct job_spec *spec, int what)
{
    switch (what) {
    case 0:
        spec->width = spec->crop.width = 20;
        break;
    case 1:
        spec->spp = 3;
        spec->seed = 7;
        break;
    case 2:
        spec->max_depth = 2;
        spec->rr_threshold = 0;
        break;
    case 3:
        spec->integrator = JOB_INTEGRATOR_AO;
        break;
    case 4:
        spec->filter = JOB_FILTER_GAUSSIAN;
        spec->filter_radius = 1.5;
        break;
    case 5:
        spec->sampler = JOB_SAMPLER_HALTON;
        break;
    default:
        spec->profile = JOB_PROFILE_NEE;
    }
}

/* A job that shares has the picture it would have alone, also when the first job is gone. */
static void shared_scenes_change_no_bit(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    kit_cornell(&s, KIT_BOXES | KIT_AREA_LIGHT | KIT_GLASS_SPHERE);
    for (int what = 0; what < 7; what++) {
        struct job_spec spec = kit_spec(16, 4), other = spec;
        struct render_scene *first, *second, *third;
        change(&other, what);
        assert_int_equal(scene_build(&s, &spec, NULL, &first), ERR_OK);
        assert_int_equal(render_scene_share(first, &other, &second), ERR_OK);
        assert_false(render_scene_free(first));
        assert_int_equal(render_scene_share(second, &other, &third), ERR_OK);
        assert_false(render_scene_free(second));
        struct kit_picture alone = kit_render(&s, &other, 0);
        struct kit_picture shared = kit_render_built(third, &other, 0);
        assert_memory_equal(alone.mean, shared.mean,
                            (size_t)alone.width * alone.height * 3 * sizeof *alone.mean);
        other.builder = JOB_BUILDER_MEDIAN;
        assert_int_equal(render_scene_share(third, &other, &first), ERR_VERSION);
        assert_true(render_scene_free(third));
        kit_picture_free(&alone);
        kit_picture_free(&shared);
    }
    scene_release(&s);
}

/* A sky that is a picture has other tables for MIS. */
static void skies_are_not_shared_with_other_profiles(void **state)
{
    (void)state;
    for (int picture = 0; picture < 2; picture++) {
        struct scene s;
        scene_init(&s);
        kit_cornell(&s, KIT_AREA_LIGHT);
        kit_constant_sky(&s, 1);
        if (picture)
            s.textures[s.envmap.texture].type = SCENE_TEXTURE_CHECKERBOARD;
        struct job_spec spec = kit_spec(16, 4), other = spec;
        struct render_scene *first, *second;
        assert_int_equal(scene_build(&s, &spec, NULL, &first), ERR_OK);
        other.profile = JOB_PROFILE_NEE;
        enum err e = render_scene_share(first, &other, &second);
        assert_int_equal(e, picture ? ERR_VERSION : ERR_OK);
        if (!picture)
            assert_false(render_scene_free(second));
        other = spec;
        other.max_depth = 3;
        assert_int_equal(render_scene_share(first, &other, &second), ERR_OK);
        assert_false(render_scene_free(second));
        assert_true(render_scene_free(first));
        scene_release(&s);
    }
}

/* Trees of objects that are built when a ray first meets them: the same picture. */
static void waiting_trees_change_no_bit(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    kit_cornell(&s, KIT_AREA_LIGHT);
    for (int i = 0; i < 20; i++) { /* small steps up to the light */
        double x = -0.9 + 0.09 * i, y = -0.8 + 0.07 * i;
        const double corners[12] = {x, y, -0.5, x + 0.1, y, -0.5, x + 0.1, y, 0.5, x, y, 0.5};
        (void)kit_quad(&s, corners, kit_diffuse(&s, 0.7, 0.5, 0.3));
    }
    struct job_spec spec = kit_spec(24, 4);
    struct scene_building how = {.lazy_triangles_min = 1};
    struct render_scene *rs;
    assert_int_equal(scene_build_as(&s, &spec, &how, &rs), ERR_OK);
    struct accel_stats before, after;
    render_scene_stats(rs, &before);
    assert_true(before.lazy_count >= 8);
    assert_int_equal(before.lazy_built, 0);
    struct kit_picture eager = kit_render(&s, &spec, 0), lazy = kit_render_built(rs, &spec, 0);
    assert_memory_equal(lazy.mean, eager.mean, 3 * 24 * 24 * sizeof *eager.mean);
    render_scene_stats(rs, &after);
    assert_true(after.lazy_built > 0 && after.bytes > before.bytes);
    kit_picture_free(&eager);
    kit_picture_free(&lazy);
    render_scene_free(rs);
    scene_release(&s);
}

/* A sheet of 2,048 triangles around (x, 0, 0) in place of a quad. */
static void add_fine_sheet(struct scene *s, double x)
{
    enum { SIDE = 32, ROW = SIDE + 1 };
    uint32_t o = kit_quad(s, square, kit_diffuse(s, 0.5, 0.5, 0.5));
    struct scene_mesh *m = &s->meshes[s->objects[o].mesh];
    mem_free(m->positions);
    mem_free(m->indices);
    m->vertex_count = ROW * ROW;
    m->triangle_count = 2 * SIDE * SIDE;
    m->positions = mem_calloc(m->vertex_count, 3 * sizeof *m->positions);
    m->indices = mem_calloc(m->triangle_count, 3 * sizeof *m->indices);
    assert_true(m->positions && m->indices);
    for (uint32_t v = 0; v < m->vertex_count; v++) {
        m->positions[3 * v] = x + (double)(v % ROW) / SIDE;
        m->positions[3 * v + 1] = (double)(v / ROW) / SIDE;
        m->positions[3 * v + 2] = (double)(v % 3) * 0.01;
    }
    for (uint32_t t = 0; t < m->triangle_count; t++) {
        uint32_t v = t / 2 / SIDE * ROW + t / 2 % SIDE;
        uint32_t corners[3] = {v, v + 1 + t % 2 * ROW, v + ROW + (t + 1) % 2};
        memcpy(&m->indices[3 * (size_t)t], corners, sizeof corners);
    }
}

/* What `explain` says of trees that wait is what a worker does. */
static void the_plan_knows_which_trees_wait(void **state)
{
    (void)state;
    for (int sheets = 7; sheets < 11; sheets++) {
        struct scene s;
        struct scene_plan plan;
        scene_init(&s);
        for (int i = 0; i < sheets; i++)
            add_fine_sheet(&s, 1.5 * i);
        (void)kit_quad(&s, square, kit_diffuse(&s, 1, 1, 1));
        struct job_spec spec = kit_spec(8, 4);
        struct scene_building how = {.lazy_triangles_min = SCENE_LAZY_TRIANGLES_MIN};
        struct render_scene *rs;
        struct accel_stats stats;
        assert_int_equal(scene_build_as(&s, &spec, &how, &rs), ERR_OK);
        render_scene_stats(rs, &stats);
        assert_int_equal(scene_plan_make(&s, 0, &plan), ERR_OK);
        struct scene_plan_lazy lazy = scene_plan_lazy(&s, &plan);
        assert_int_equal(lazy.objects, stats.lazy_count);
        assert_int_equal(stats.lazy_count, sheets < 8 ? 0 : sheets);
        assert_int_equal(lazy.triangles, 2048 * lazy.objects);
        scene_plan_release(&plan);
        render_scene_free(rs);
        scene_release(&s);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(winding_follows_the_normals),
        cmocka_unit_test(mirrored_faces_keep_their_side),
        cmocka_unit_test(emission_takes_the_colors_of_vertices),
        cmocka_unit_test(both_sides_shine),
        cmocka_unit_test(two_triangles_make_one_light),
        cmocka_unit_test(instances_look_like_copies),
        cmocka_unit_test(alpha_lets_light_through),
        cmocka_unit_test(opacity_draws_no_direction),
        cmocka_unit_test(what_bends_nothing_hides_nothing),
        cmocka_unit_test(textured_emission_is_found_both_ways),
        cmocka_unit_test(spheres_shine_in_their_texture),
        cmocka_unit_test(nothing_at_all_is_black),
        cmocka_unit_test(an_extent_beyond_double_is_refused),
        cmocka_unit_test(every_allocation_may_fail),
        cmocka_unit_test(shared_scenes_change_no_bit),
        cmocka_unit_test(skies_are_not_shared_with_other_profiles),
        cmocka_unit_test(waiting_trees_change_no_bit),
        cmocka_unit_test(the_plan_knows_which_trees_wait),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
