/* Light by way of glass and mirrors: shadow rays that look through glass (through.h) and ways that
 * a group tries together (replay.h) leave the mean as following directions alone has it, and make
 * it quieter. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "common/mem.h"
#include "tests/render/render_kit.h"

static const double ground[12] = {-2, 0, -2, -2, 0, 2, 2, 0, 2, 2, 0, -2};
static const double wall[12] = {-2, 0, -2, 2, 0, -2, 2, 3, -2, -2, 3, -2};
static const double lamp[12] = {-0.4, 2.4, -0.4, 0.4, 2.4, -0.4, 0.4, 2.4, 0.4, -0.4, 2.4, 0.4};
static const double low_lamp[12] = {0.2, 1.9, 2.6, 0.8, 1.9, 2.6, 0.8, 1.9, 3.2, 0.2, 1.9, 3.2};
static const double pane[12] = {-1.5, 1, -1.5, -1.5, 1, 1.5, 1.5, 1, 1.5, 1.5, 1, -1.5};

/* A floor and a wall, and a camera that sees both. */
static void make_room(struct scene *s)
{
    scene_init(s);
    uint32_t grey = kit_diffuse(s, 0.7, 0.6, 0.5);
    s->materials[grey].twosided = true;
    kit_quad(s, ground, grey);
    kit_quad(s, wall, grey);
    memcpy(s->camera.position, (const double[]){0.3, 2, 6}, sizeof s->camera.position);
    memcpy(s->camera.look_at, (const double[]){0, 0.8, 0}, sizeof s->camera.look_at);
    s->camera.fov = 40;
}

static struct scene_material *add_clear(struct scene *s, enum scene_material_type type,
                                        uint32_t *index)
{
    struct scene_material *m;
    *index = kit_material(s, type, &m);
    for (int k = 0; k < 3; k++) {
        m->R[k] = 0.9 - 0.1 * k;
        m->T[k] = 0.7 + 0.1 * k;
    }
    m->eta = 1.4;
    return m;
}

/* A block from its lower to its upper corner, its normals outwards. */
static void add_block(struct scene *s, const double a[3], const double b[3], uint32_t material)
{
    static const uint32_t triangles[36] = {0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4,
                                           2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5};
    double corners[24];
    for (uint32_t i = 0; i < 8; i++)
        for (uint32_t k = 0; k < 3; k++)
            corners[3 * i + k] = i >> k & 1 ? b[k] : a[k];
    kit_mesh(s, corners, 8, triangles, 12, material);
}

/* A sky of two columns by two rows, of which one is bright. */
static void add_sky(struct scene *s)
{
    uint32_t texture = kit_constant_texture(s, 1);
    float *pixels = mem_alloc_array(12, sizeof *pixels);
    s->images = mem_realloc_array(s->images, 1, sizeof *s->images);
    assert_true(pixels && s->images);
    for (int i = 0; i < 12; i++)
        pixels[i] = i < 3 ? 3 : 0.2F;
    s->images[s->image_count++] = (struct scene_image){2, 2, 3, SCENE_IMAGE_F32, pixels};
    s->textures[texture].type = SCENE_TEXTURE_IMAGE;
    s->textures[texture].image = 0;
    s->envmap.texture = texture;
    s->envmap.scale = 1;
}

enum thing { BLOCK, PANE, BALL, SHEET, MIRROR, THINGS };
enum light { LAMP, TWO_LAMPS, BALL_LAMP, SKY, PLAIN_SKY, LIGHTS };

static void add_thing(struct scene *s, enum thing thing)
{
    uint32_t m;
    (void)add_clear(s,
                    thing == MIRROR  ? SCENE_MATERIAL_MIRROR
                    : thing == SHEET ? SCENE_MATERIAL_REFRACTION
                                     : SCENE_MATERIAL_GLASS,
                    &m);
    if (thing == BLOCK || thing == MIRROR)
        add_block(s, (const double[]){-0.6, 0.02, -0.6}, (const double[]){0.6, 0.7, 0.6}, m);
    else if (thing == BALL)
        kit_sphere(s, 0, 0.6, 0, 0.55, m);
    else if (thing == PANE)
        add_block(s, (const double[]){-1.5, 1, -1.5}, (const double[]){1.5, 1.1, 1.5}, m);
    else
        kit_quad(s, pane, m);
}

static void add_light(struct scene *s, enum light light)
{
    if (light == LAMP || light == TWO_LAMPS)
        kit_emit(s, kit_quad(s, lamp, SCENE_NONE), 9, 7, 5);
    if (light == TWO_LAMPS)
        kit_emit(s, kit_sphere(s, 1.2, 1.6, 0.4, 0.2, SCENE_NONE), 4, 8, 8);
    if (light == BALL_LAMP)
        kit_emit(s, kit_sphere(s, 0, 2, 0.2, 0.3, SCENE_NONE), 9, 7, 5);
    if (light == SKY)
        add_sky(s);
    if (light == PLAIN_SKY)
        kit_constant_sky(s, 1);
}

/* Means over eight seeds of the picture's quarters, and the variances of those. */
struct quarters {
    double mean[4], variance[4];
};

enum { SIDE = 16, SEEDS = 12 };

static struct quarters estimate(const struct scene *s, enum job_profile profile, uint64_t spp,
                                uint32_t max_depth)
{
    struct quarters out = {{0}, {0}};
    for (uint64_t seed = 1; seed <= SEEDS; seed++) {
        struct job_spec spec = kit_spec(SIDE, spp);
        spec.profile = profile;
        spec.seed = seed + 100 * (uint64_t)profile;
        spec.max_depth = max_depth;
        spec.rr_threshold = 0.2;
        struct kit_picture p = kit_render(s, &spec, 0);
        double sums[4] = {0};
        assert_int_equal(p.counters.nonfinite, 0);
        for (uint32_t i = 0; i < 3 * SIDE * SIDE; i++)
            sums[i % SIDE / (SIDE / 2) + 2 * (i / SIDE % SIDE / (SIDE / 2))] +=
                p.mean[i] / (3 * SIDE * SIDE / 4);
        for (int k = 0; k < 4; k++) {
            out.mean[k] += sums[k] / SEEDS;
            out.variance[k] += sums[k] * sums[k] / SEEDS;
        }
        kit_picture_free(&p);
    }
    for (int k = 0; k < 4; k++)
        out.variance[k] = fmax(out.variance[k] - out.mean[k] * out.mean[k], 0) / (SEEDS - 1);
    return out;
}

/* Twelve seeds tell a spread to a fifth: 6 where 5 would do for the hundred comparisons. */
static void the_mean_stays(void **state)
{
    (void)state;
    int failures = 0;
    for (int thing = 0; thing < THINGS; thing++) {
        for (int light = 0; light < LIGHTS; light++) {
            struct scene s;
            make_room(&s);
            add_thing(&s, (enum thing)thing);
            add_light(&s, (enum light)light);
            scene_check(&s);
            uint32_t depth = 4 + (uint32_t)(thing + light) % 4;
            struct quarters mis = estimate(&s, JOB_PROFILE_MIS, 64, depth);
            struct quarters rw = estimate(&s, JOB_PROFILE_RW, 512, depth);
            for (int k = 0; k < 4; k++) {
                double apart = fabs(mis.mean[k] - rw.mean[k]);
                double sigma = sqrt(mis.variance[k] + rw.variance[k] + 1e-30);
                if (apart < 6 * sigma)
                    continue;
                failures++;
                printf("  thing %d, light %d, quarter %d: MIS %g, RW %g (%.1f sigma)\n", thing,
                       light, k, mis.mean[k], rw.mean[k], apart / sigma);
            }
            scene_release(&s);
        }
    }
    assert_int_equal(failures, 0);
}

/* Mean of the squared differences of a picture's halves. */
static double noise(const struct scene *s, enum job_profile profile, uint32_t max_depth)
{
    struct job_spec spec = kit_spec(32, 64);
    spec.profile = profile;
    spec.max_depth = max_depth;
    struct kit_picture p = kit_render(s, &spec, 0);
    double sum = 0;
    for (int i = 0; i < 3 * 32 * 32; i++)
        sum += (p.half[0][i] - p.half[1][i]) * (p.half[0][i] - p.half[1][i]) / (3 * 32 * 32);
    kit_picture_free(&p);
    return sum;
}

/* Under a pane the lamp is as good as seen: NEE alone, which does not look through, finds it by
 * chance. 5 measured. */
static void a_pane_is_looked_through(void **state)
{
    (void)state;
    struct scene s;
    make_room(&s);
    add_thing(&s, PANE);
    add_light(&s, LAMP);
    double blind = noise(&s, JOB_PROFILE_NEE, 5), looking = noise(&s, JOB_PROFILE_MIS, 5);
    printf("  noise %g under NEE, %g under MIS\n", blind, looking);
    assert_true(looking * 3 < blind);
    scene_release(&s);
}

/* A mirror's caustic on the wall is found by chance, by one of a group for all. */
static void a_caustic_is_shared(void **state)
{
    (void)state;
    struct scene s;
    make_room(&s);
    add_thing(&s, MIRROR);
    kit_emit(&s, kit_quad(&s, low_lamp, SCENE_NONE), 20, 20, 20);
    double alone = noise(&s, JOB_PROFILE_NEE, 3), shared = noise(&s, JOB_PROFILE_MIS, 3);
    printf("  noise %g under NEE, %g under MIS\n", alone, shared);
    assert_true(shared * 3 < alone);
    scene_release(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(the_mean_stays),
                                       cmocka_unit_test(a_pane_is_looked_through),
                                       cmocka_unit_test(a_caustic_is_shared)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
