/* Scenes that nobody has thought of: RW, NEE and MIS find the same light in them, but for noise.
 *
 * usage: test_random_scenes [FIRST COUNT]. A scene is made of its number alone, and pictures are
 * the same on every machine, so a number that fails always does.
 *
 * Facets are kept rough: under NEE the light of smoother ones is in few samples, of which the
 * spread between so few seeds tells nothing. Textures are looked up at points, since footprints
 * shrink with samples, of which RW gets more. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"
#include "tests/render/render_kit.h"
#include "worker/render/sampler.h"

enum { SIDE = 16, SEEDS = 16, SPP = 32, SCENES = 32 };

static uint64_t random_state;

static double draw(double low, double high)
{
    random_state += UINT64_C(0x9e3779b97f4a7c15);
    double u = (double)(sampler_mix(random_state) >> 11) / 9007199254740992.0;
    return low + (high - low) * u;
}

static uint32_t draw_below(uint32_t count)
{
    return (uint32_t)draw(0, count);
}

static bool one_of(uint32_t count)
{
    return draw_below(count) == 0;
}

/* A small picture of any colours, or of normals that lean. */
static uint32_t add_picture(struct scene *s, uint32_t channels, bool normals)
{
    uint32_t width = 1 + draw_below(9), height = 1 + draw_below(9);
    size_t count = (size_t)width * height * channels;
    float *pixels = mem_alloc_array(count, sizeof *pixels);
    s->images = mem_realloc_array(s->images, s->image_count + 1, sizeof *s->images);
    assert_true(pixels && s->images);
    for (size_t i = 0; i < count; i++)
        pixels[i] = (float)(!normals ? draw(0, 1) : i % 3 == 2 ? 0.9 : draw(0.1, 0.9));
    s->images[s->image_count] =
        (struct scene_image){width, height, channels, SCENE_IMAGE_F32, pixels};
    uint32_t index = kit_constant_texture(s, 1);
    struct scene_texture *t = &s->textures[index];
    t->type = SCENE_TEXTURE_IMAGE;
    t->image = (uint32_t)s->image_count++;
    t->filter = (enum scene_texture_filter)draw_below(SCENE_FILTER_MIPMAP);
    for (int k = 0; k < 2; k++)
        t->wrap[k] = (enum scene_wrap)draw_below(SCENE_WRAP_MIRROR + 1);
    for (int k = 0; k < 6; k++)
        t->uv_matrix[k] = draw(-2, 2);
    return index;
}

static void set_layers(struct scene_material *m)
{
    m->metallic = one_of(2) ? draw(0, 1) : 0;
    m->roughness = draw(0.6, 1);
    m->transmission = one_of(3) ? draw(0, 1) : 0;
    m->clearcoat = one_of(3) ? draw(0, 1) : 0;
    m->clearcoat_roughness = draw(0.6, 1);
    m->sheen_roughness = draw(0.3, 1);
    for (int k = 0; k < 3; k++)
        m->sheen_color[k] = one_of(3) ? draw(0, 1) : 0;
}

static void set_opacity(struct scene_material *m)
{
    m->alpha_used = one_of(2);
    if (!m->alpha_used)
        return;
    m->alpha = draw(0.2, 1);
    m->alpha_cutoff = one_of(2) ? -1 : draw(0.1, 0.7);
}

static uint32_t add_material(struct scene *s)
{
    static const enum scene_material_type types[] = {
        SCENE_MATERIAL_DIFFUSE,         SCENE_MATERIAL_DIFFUSE,
        SCENE_MATERIAL_ROUGH_CONDUCTOR, SCENE_MATERIAL_ROUGH_DIELECTRIC,
        SCENE_MATERIAL_PRINCIPLED,      SCENE_MATERIAL_PRINCIPLED,
        SCENE_MATERIAL_GLASS,           SCENE_MATERIAL_MIRROR};
    uint32_t texture = one_of(3) ? add_picture(s, one_of(2) ? 4 : 3, false) : (uint32_t)SCENE_NONE;
    uint32_t normals = one_of(4) ? add_picture(s, 3, true) : (uint32_t)SCENE_NONE;
    uint32_t heights = one_of(6) ? add_picture(s, 3, false) : (uint32_t)SCENE_NONE;
    struct scene_material *m;
    uint32_t index = kit_material(s, types[draw_below(8)], &m);
    m->texture = texture;
    m->twosided = one_of(2);
    m->distribution = one_of(2) ? SCENE_GGX : SCENE_BECKMANN;
    m->alpha_x = draw(0.3, 0.6);
    m->alpha_y = one_of(2) ? draw(0.3, 0.6) : m->alpha_x;
    m->eta = one_of(3) ? 1 / draw(1.1, 1.8) : draw(1.1, 1.8);
    for (int k = 0; k < 3; k++) {
        m->color[k] = draw(0.1, 0.9);
        m->etaT[k] = draw(0.2, 2);
        m->k[k] = draw(0, 4);
        m->R[k] = draw(0.5, 1);
        m->T[k] = draw(0.5, 1);
    }
    set_layers(m);
    set_opacity(m);
    bool principled = m->type == SCENE_MATERIAL_PRINCIPLED;
    m->vertex_colors = one_of(2) && (principled || m->type == SCENE_MATERIAL_DIFFUSE);
    m->normal_texture = principled ? normals : (uint32_t)SCENE_NONE;
    m->bump_texture = heights;
    m->bump_scale = draw(0, 0.2);
    m->backface_culling = principled && one_of(2);
    return index;
}

/* What vertices may have, where they have it. */
static float *vertex_values(uint32_t count, double low, double high)
{
    float *out = mem_alloc_array(count, sizeof *out);
    assert_non_null(out);
    for (uint32_t i = 0; i < count; i++)
        out[i] = (float)draw(low, high);
    return out;
}

static void set_vertices(struct scene_mesh *m)
{
    m->uvs = one_of(2) ? vertex_values(2 * m->vertex_count, -1, 2) : NULL;
    m->colors = one_of(2) ? vertex_values(3 * m->vertex_count, 0, 1) : NULL;
    m->alphas = one_of(3) ? vertex_values(m->vertex_count, 0, 1) : NULL;
    m->normals = one_of(2) ? vertex_values(3 * m->vertex_count, -0.3, 0.3) : NULL;
    for (uint32_t i = 0; m->normals && i < m->vertex_count; i++) {
        float *n = m->normals + (size_t)3 * i;
        float length = sqrtf(n[0] * n[0] + n[2] * n[2] + 1);
        n[0] /= length;
        n[1] = 1 / length;
        n[2] /= length;
    }
}

/* Turned about two axes and now and then mirrored; somewhere about (0, 1, 0). */
static void place(double t[16], double size)
{
    double a = draw(0, 6.28), b = draw(0, 6.28), side = one_of(3) ? -size : size;
    const double rows[12] = {side * cos(a),
                             -size * sin(a) * cos(b),
                             size * sin(a) * sin(b),
                             draw(-1.2, 1.2),
                             side * sin(a),
                             size * cos(a) * cos(b),
                             -size * cos(a) * sin(b),
                             draw(0.3, 2),
                             0,
                             size * sin(b),
                             size * cos(b),
                             draw(-1.2, 1.2)};
    memcpy(t, rows, sizeof rows);
}

/* A sphere, a square, or a tent of five triangles. */
static uint32_t add_thing(struct scene *s, uint32_t material)
{
    static const double square[12] = {-1, 0, -1, -1, 0, 1, 1, 0, 1, 1, 0, -1};
    static const uint32_t triangles[15] = {0, 1, 2, 0, 2, 3, 0, 3, 4, 0, 4, 5, 0, 5, 1};
    uint32_t shape = draw_below(3), object;
    if (shape == 0)
        return kit_sphere(s, draw(-1.2, 1.2), draw(0.4, 2), draw(-1.2, 1.2), draw(0.2, 0.6),
                          material);
    double tent[18] = {0, 0.4, 0};
    for (int k = 0; k < 5; k++) {
        tent[3 + 3 * k] = cos(k * 1.2566);
        tent[4 + 3 * k] = draw(-0.2, 0.2);
        tent[5 + 3 * k] = -sin(k * 1.2566);
    }
    object =
        shape == 1 ? kit_quad(s, square, material) : kit_mesh(s, tent, 6, triangles, 5, material);
    set_vertices(&s->meshes[s->mesh_count - 1]);
    place(s->objects[object].transform, draw(0.3, 0.9));
    return object;
}

static void add_sky(struct scene *s)
{
    if (one_of(2)) {
        kit_constant_sky(s, draw(0.2, 1));
        return;
    }
    uint32_t texture = add_picture(s, 3, false);
    static const double whole[6] = {1, 0, 0, 0, 1, 0};
    memcpy(s->textures[texture].uv_matrix, whole, sizeof whole);
    s->textures[texture].wrap[0] = SCENE_WRAP_REPEAT;
    s->envmap.texture = texture;
    s->envmap.scale = 1;
    place(s->envmap.transform, 1);
}

/* One of the materials shines. */
static void add_glow(struct scene *s)
{
    uint32_t texture = one_of(2) ? add_picture(s, 3, false) : (uint32_t)SCENE_NONE;
    struct scene_material *m = &s->materials[draw_below((uint32_t)s->material_count)];
    for (int k = 0; k < 3; k++)
        m->emission[k] = draw(0, 2);
    m->emission_texture = texture;
    m->emission_twosided = one_of(2);
    m->emission_vertex_colors = one_of(2);
}

static void make_scene(struct scene *s, uint64_t number)
{
    static const double ground[12] = {-2, 0, -2, -2, 0, 2, 2, 0, 2, 2, 0, -2};
    random_state = sampler_mix(number);
    scene_init(s);
    uint32_t reflects = add_material(s);
    s->materials[reflects].type = SCENE_MATERIAL_DIFFUSE;
    s->materials[reflects].twosided = true;
    s->materials[reflects].normal_texture = SCENE_NONE;
    kit_quad(s, ground, reflects);
    for (uint32_t left = 1 + draw_below(3); left > 0; left--)
        add_thing(s, add_material(s));
    uint32_t lamps = 1 + draw_below(3);
    for (uint32_t k = 0; k < lamps; k++) {
        uint32_t lamp = add_thing(s, one_of(3) ? (uint32_t)SCENE_NONE : add_material(s));
        double red = draw(1, 6);
        kit_emit(s, lamp, red, red * draw(0, 1), red * draw(0, 1));
    }
    if (one_of(3))
        add_sky(s);
    if (one_of(2))
        add_glow(s);
    struct scene_camera *c = &s->camera;
    c->type = (enum scene_camera_type)draw_below(SCENE_CAMERA_PANORAMA + 1);
    memcpy(c->position, (const double[]){draw(-2, 2), draw(1, 3), 4}, sizeof c->position);
    memcpy(c->look_at, (const double[]){0, 0.6, 0}, sizeof c->look_at);
    c->fov = 45;
    c->ortho_height = c->focal_length = 4;
    c->aperture_radius = 0.1;
}

/* Means of a profile's pictures by channel, and the variances of those. */
struct means {
    double mean[3], variance[3];
};

static struct means estimate(const struct scene *s, enum job_profile profile, uint64_t number)
{
    struct means out = {.mean = {0}};
    double squares[3] = {0};
    for (uint64_t seed = 1; seed <= SEEDS; seed++) {
        struct job_spec spec = kit_spec(SIDE, profile == JOB_PROFILE_RW ? 4 * SPP : SPP);
        spec.profile = profile;
        spec.seed = seed + SEEDS * (uint64_t)profile;
        spec.max_depth = (uint32_t)(2 + number % 5);
        spec.light_choice = number % 2 ? JOB_LIGHT_CHOICE_TREE : JOB_LIGHT_CHOICE_POWER;
        spec.rr_threshold = number % 3 ? 0.3 : 0;
        struct kit_picture p = kit_render(s, &spec, 0);
        assert_int_equal(p.counters.nonfinite, 0);
        for (size_t c = 0; c < 3; c++) {
            double sum = 0;
            for (size_t i = 0; i < SIDE * SIDE; i++)
                sum += p.mean[c * SIDE * SIDE + i] / (SIDE * SIDE);
            out.mean[c] += sum / SEEDS;
            squares[c] += sum * sum / SEEDS;
        }
        kit_picture_free(&p);
    }
    for (int c = 0; c < 3; c++)
        out.variance[c] = fmax(squares[c] - out.mean[c] * out.mean[c], 0) / (SEEDS - 1);
    return out;
}

/* The largest difference of a channel in standard deviations; a millionth is none. */
static double apart(const struct means *a, const struct means *b)
{
    double worst = 0;
    for (int c = 0; c < 3; c++) {
        double none = 1e-6 * (a->mean[c] + b->mean[c]);
        double spread = sqrt(a->variance[c] + b->variance[c] + none * none + 1e-30);
        worst = fmax(worst, fabs(a->mean[c] - b->mean[c]) / spread);
    }
    return worst;
}

static uint64_t first = 1, count = SCENES;

/* Sixteen seeds give a spread that is off by a third now and then: 6 where 5 would do. */
static void profiles_agree(void **state)
{
    (void)state;
    int failures = 0;
    for (uint64_t number = first; number < first + count; number++) {
        struct scene s;
        make_scene(&s, number);
        scene_check(&s);
        struct means found[JOB_PROFILE_COUNT];
        for (int k = 0; k < JOB_PROFILE_COUNT; k++)
            found[k] = estimate(&s, (enum job_profile)k, number);
        double nee = apart(&found[JOB_PROFILE_NEE], &found[JOB_PROFILE_RW]);
        double mis = apart(&found[JOB_PROFILE_MIS], &found[JOB_PROFILE_RW]);
        if (nee > 6 || mis > 6) {
            failures++;
            printf("  scene %llu: RW %g, NEE %g (%.1f sigma off), MIS %g (%.1f)\n",
                   (unsigned long long)number, found[JOB_PROFILE_RW].mean[0],
                   found[JOB_PROFILE_NEE].mean[0], nee, found[JOB_PROFILE_MIS].mean[0], mis);
        }
        scene_release(&s);
    }
    assert_int_equal(failures, 0);
}

int main(int argc, char **argv)
{
    if (argc == 3) {
        first = strtoull(argv[1], NULL, 10);
        count = strtoull(argv[2], NULL, 10);
    }
    const struct CMUnitTest tests[] = {cmocka_unit_test(profiles_agree)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
