/* Extremes that are no row of the matrix: scales that differ by 10^15 in one scene, lenses wider
 * than the world, lights smaller than a bacterium, indices all but 1. Each against a closed form,
 * or against the same scene without the extreme. */
#include "tests/numerics/rows.h"

#include <math.h>

#include "common/mem.h"
#include "tests/numerics/closed_mesh.h"
#include "tests/render/render_kit.h"
#include "worker/render/bsdf.h"
#include "worker/render/sampler.h"
#include "worker/render/warp.h"

static const double pi = 3.14159265358979323846;

static void look(struct scene *s, double px, double py, double pz, double fov)
{
    const double at[3] = {px, py, pz};
    memcpy(s->camera.position, at, sizeof at);
    s->camera.fov = fov;
}

static void look_at(struct scene *s, double x, double y, double z)
{
    const double at[3] = {x, y, z};
    memcpy(s->camera.look_at, at, sizeof at);
}

static size_t values_of(const struct kit_picture *p)
{
    return (size_t)p->width * p->height * 3;
}

static void assert_clean(const struct kit_picture *p)
{
    assert_int_equal(p->counters.nonfinite, 0);
    for (size_t i = 0; i < values_of(p); i++)
        assert_true(isfinite(p->mean[i]) && p->mean[i] >= 0);
}

/* The largest relative difference of two pictures, of values that are not 0. */
static double apart(const struct kit_picture *a, const struct kit_picture *b)
{
    double worst = 0;
    assert_int_equal(values_of(a), values_of(b));
    for (size_t i = 0; i < values_of(a); i++) {
        double d = fabs(a->mean[i] - b->mean[i]);
        worst = d > 0 ? fmax(worst, d / fmax(fabs(a->mean[i]), fabs(b->mean[i]))) : worst;
    }
    return worst;
}

static double off_from(const struct kit_picture *p, double expected)
{
    double worst = 0;
    for (size_t i = 0; i < values_of(p); i++)
        worst = fmax(worst, fabs(p->mean[i] / expected - 1));
    return worst;
}

/* A flat floor at y = 0, seen from above. */
static void floor_scene(struct scene *s, uint32_t material)
{
    static const double ground[12] = {-4, 0, -4, -4, 0, 4, 4, 0, 4, 4, 0, -4};
    scene_init(s);
    kit_quad(s, ground, material == SCENE_NONE ? kit_diffuse(s, 0.5, 0.5, 0.5) : material);
    look(s, 0, 3, 3, 30);
    look_at(s, 0, 0, 0);
}

/* A lamp of a radius of 1e-8 lights as a point does. */
static void test_beyond_tiny_lamp(void **state)
{
    (void)state;
    static const double radii[] = {1e-8, 1e-12, 1e-15};
    struct scene s;
    struct job_spec spec = kit_spec(16, 4);
    spec.max_depth = 2;
    floor_scene(&s, SCENE_NONE);
    struct scene_light *l = kit_light(&s, SCENE_LIGHT_POINT);
    l->position[1] = 2;
    struct kit_picture point = kit_render(&s, &spec, 0);
    scene_release(&s);
    for (int i = 0; i < 3; i++) {
        double r = radii[i], radiance = 1 / (pi * r * r);
        floor_scene(&s, SCENE_NONE);
        kit_emit(&s, kit_sphere(&s, 0, 2, 0, r, SCENE_NONE), radiance, radiance, radiance);
        struct kit_picture lamp = kit_render(&s, &spec, 0);
        assert_clean(&lamp);
        double off = apart(&point, &lamp);
        printf("  a lamp of radius %g: off a point light by %.2g\n", r, off);
        assert_true(off <= 1e-6);
        kit_picture_free(&lamp);
        scene_release(&s);
    }
    kit_picture_free(&point);
}

/* A camera in the middle of solid glass sees the sky all around, whatever the index: n^2 times as
 * bright, as radiance is inside glass; "refraction" leaves radiance alone (docs/SCENE.md). */
static void test_beyond_inside_glass(void **state)
{
    (void)state;
    static const double etas[] = {1, 1 + 1e-15, 1 + 1e-7, 1.5, 100};
    static const enum scene_material_type types[] = {SCENE_MATERIAL_REFRACTION,
                                                     SCENE_MATERIAL_GLASS};
    for (int type = 0; type < 2; type++)
        for (int e = 0; e < 5; e++) {
            struct scene s;
            struct scene_material *m;
            scene_init(&s);
            uint32_t glass = kit_material(&s, types[type], &m);
            m->eta = etas[e];
            kit_sphere(&s, 0, 0, 0, 1, glass);
            kit_constant_sky(&s, 1);
            look(&s, 0, 0, 1e-3, 90);
            struct job_spec spec = kit_spec(16, 16);
            spec.max_depth = 4096;
            spec.rr_threshold = 0;
            struct kit_picture p = kit_render(&s, &spec, 0);
            assert_clean(&p);
            double off = off_from(&p, type ? etas[e] * etas[e] : 1);
            printf("  inside %s of index %.9g: off by %.2g\n", type ? "glass" : "refraction",
                   etas[e], off);
            assert_true(off <= 1e-6);
            kit_picture_free(&p);
            scene_release(&s);
        }
}

/* An index of 1 + 1e-15: what is behind is seen as through air. */
static void test_beyond_almost_air(void **state)
{
    (void)state;
    static const enum scene_material_type types[] = {
        SCENE_MATERIAL_REFRACTION, SCENE_MATERIAL_GLASS, SCENE_MATERIAL_ROUGH_DIELECTRIC};
    struct job_spec spec = kit_spec(24, 4);
    spec.integrator = JOB_INTEGRATOR_INTERSECTION_TEST;
    for (int type = 0; type < 3; type++) {
        struct kit_picture p[2];
        for (int k = 0; k < 2; k++) {
            struct scene s;
            struct scene_material *m;
            scene_init(&s);
            kit_cornell(&s, KIT_BOXES);
            uint32_t glass = kit_material(&s, types[type], &m);
            m->eta = k ? 1 + 1e-15 : 1;
            m->alpha_x = m->alpha_y = 0.3;
            kit_sphere(&s, 0, 1, 0.7, 0.4, glass);
            p[k] = kit_render(&s, &spec, 0);
            assert_clean(&p[k]);
            scene_release(&s);
        }
        assert_true(apart(&p[0], &p[1]) <= 1e-9);
        kit_picture_free(&p[0]);
        kit_picture_free(&p[1]);
    }
}

/* Walls of radiance 1e-30 and 1e30 that meet between two pixels: neither is lost in the other. */
static void test_beyond_dim_beside_bright(void **state)
{
    (void)state;
    static const double left[12] = {-9, -9, 0, 0, -9, 0, 0, 9, 0, -9, 9, 0};
    static const double right[12] = {0, -9, 0, 9, -9, 0, 9, 9, 0, 0, 9, 0};
    struct scene s;
    scene_init(&s);
    kit_emit(&s, kit_quad(&s, left, SCENE_NONE), 1e-30, 1e-30, 1e-30);
    kit_emit(&s, kit_quad(&s, right, SCENE_NONE), 1e30, 1e30, 1e30);
    look(&s, 0, 0, 3, 60);
    struct job_spec spec = kit_spec(8, 16);
    struct kit_picture p = kit_render(&s, &spec, 0);
    assert_clean(&p);
    for (size_t i = 0; i < 8 * 8 * 3; i++)
        assert_true(fabs(p.mean[i] / (i % 8 < 4 ? 1e-30 : 1e30) - 1) <= 1e-6);
    kit_picture_free(&p);
    scene_release(&s);
}

/* One pixel of 2^20 samples (--long: 2^26), half of it lit; float sums would have drifted. */
static void test_beyond_many_samples(void **state)
{
    (void)state;
    static const double right[12] = {0, -9, 0, 9, -9, 0, 9, 9, 0, 0, 9, 0};
    static const enum job_sampler samplers[] = {JOB_SAMPLER_SOBOL, JOB_SAMPLER_HALTON,
                                                JOB_SAMPLER_INDEPENDENT};
    struct scene s;
    scene_init(&s);
    kit_emit(&s, kit_quad(&s, right, SCENE_NONE), 1, 0.1, 1e-20);
    look(&s, 0, 0, 3, 60);
    for (int k = 0; k < 3; k++) {
        struct job_spec spec = kit_spec(1, UINT64_C(1) << (rows_long ? 26 : 20));
        spec.sampler = samplers[k];
        struct kit_picture p = kit_render(&s, &spec, 0);
        assert_clean(&p);
        double noise = k < 2 ? 1e-5 : 6 / sqrt((double)spec.spp);
        printf("  %s: %llu samples of a pixel half lit: off by %.2g\n", job_sampler_names[k],
               (unsigned long long)spec.spp, p.mean[0] / 0.5 - 1);
        assert_true(fabs(p.mean[0] / 0.5 - 1) <= noise);
        assert_true(fabs(p.mean[1] / (0.1 * p.mean[0]) - 1) <= 1e-6);
        assert_true(fabs(p.mean[2] / (1e-20 * p.mean[0]) - 1) <= 1e-6);
        kit_picture_free(&p);
    }
    scene_release(&s);
}

/* A panorama in the integrating sphere: the rows at the poles are as right as all others. */
static void test_beyond_panorama_poles(void **state)
{
    (void)state;
    struct scene s;
    struct scene_material *m;
    scene_init(&s);
    uint32_t material = kit_material(&s, SCENE_MATERIAL_DIFFUSE, &m);
    m->color[0] = m->color[1] = m->color[2] = 0.7;
    m->twosided = true;
    kit_sphere(&s, 0, 0, 0, 2, material);
    kit_light(&s, SCENE_LIGHT_POINT);
    look(&s, 0.3, 0.4, 0.5, 45);
    s.camera.type = SCENE_CAMERA_PANORAMA;
    struct job_spec spec = kit_spec(32, 4);
    spec.max_depth = 3;
    spec.rr_threshold = 0;
    struct kit_picture p = kit_render(&s, &spec, 0);
    assert_clean(&p);
    double off = off_from(&p, 0.7 / (pi * 4) * 1.7);
    printf("  panorama: off by %.2g\n", off);
    assert_true(off <= 1e-6);
    kit_picture_free(&p);
    scene_release(&s);
}

/* A sky, all black but for one texel. Radiance of the floor: albedo / pi * L cos * solid angle,
 * both over the texel. */
static void test_beyond_one_bright_texel(void **state)
{
    (void)state;
    enum { WIDTH = 512, HEIGHT = 256, COLUMN = 100, ROW = 90 };
    struct scene s;
    floor_scene(&s, SCENE_NONE);
    float *pixels = mem_calloc((size_t)WIDTH * HEIGHT * 3, sizeof *pixels);
    s.images = mem_calloc(1, sizeof *s.images);
    assert_non_null(pixels);
    assert_non_null(s.images);
    s.image_count = 1;
    s.images[0] = (struct scene_image){WIDTH, HEIGHT, 3, SCENE_IMAGE_F32, pixels};
    for (int k = 0; k < 3; k++)
        pixels[3 * (ROW * WIDTH + COLUMN) + k] = 1e6f;
    uint32_t texture = kit_constant_texture(&s, 1);
    scene_image_texture_init(&s.textures[texture]);
    s.textures[texture].name =
        s.textures[texture].name ? s.textures[texture].name : mem_strdup("sky");
    s.textures[texture].image = 0;
    s.textures[texture].filter = SCENE_FILTER_NEAREST;
    s.envmap.texture = texture;
    s.envmap.scale = 1;
    double top = pi * ROW / HEIGHT, low = pi * (ROW + 1) / HEIGHT;
    /* The integral of cos(theta) sin(theta), times the turn. */
    double cosine = 0.5 * (sin(low) * sin(low) - sin(top) * sin(top)) * 2 * pi / WIDTH;
    double expected = 0.5 / pi * 1e6 * cosine;
    for (int profile = 0; profile < 2; profile++) {
        struct job_spec spec = kit_spec(16, 1024);
        spec.max_depth = 2;
        spec.profile = profile ? JOB_PROFILE_NEE : JOB_PROFILE_MIS;
        struct kit_picture p = kit_render(&s, &spec, 0);
        assert_clean(&p);
        double mean = kit_picture_mean(&p);
        printf("  a texel of 1e6: %s off by %.2g, worst pixel %.2g\n",
               job_profile_names[spec.profile], mean / expected - 1, off_from(&p, expected));
        /* Part of the samples are drawn without looking at the sky: 4 % of them miss the texel. */
        assert_true(fabs(mean / expected - 1) <= 4 * 0.2 / sqrt(16.0 * 16 * 1024));
        assert_true(off_from(&p, expected) <= 5 * 0.2 / sqrt(1024));
        kit_picture_free(&p);
    }
    scene_release(&s);
}

/* A field of view of all but 180 degrees over a shining plane without end: half of the picture. */
static void test_beyond_wide_view(void **state)
{
    (void)state;
    static const double ground[12] = {-1e9, 0, -1e9, -1e9, 0, 1e9, 1e9, 0, 1e9, 1e9, 0, -1e9};
    static const double fovs[] = {1e-6, 90, 179, 179.9999, 179.9999999};
    for (int i = 0; i < 5; i++) {
        struct scene s;
        scene_init(&s);
        kit_emit(&s, kit_quad(&s, ground, SCENE_NONE), 2, 2, 2);
        /* The ground ends at 1e9: nearer to it for a view that hardly opens, so that the end is
         * within a ten-thousandth of a pixel from the horizon. */
        double height = i == 0 ? 1e-4 : 1;
        look(&s, 0, height, 0, fovs[i]);
        look_at(&s, 0, height, -1);
        struct job_spec spec = kit_spec(16, 4);
        struct kit_picture p = kit_render(&s, &spec, 0);
        assert_clean(&p);
        for (size_t k = 0; k < values_of(&p); k++)
            assert_true(p.mean[k] == (k / 16 % 16 < 8 ? 0 : 2));
        kit_picture_free(&p);
        scene_release(&s);
    }
}

/* A lens wider than the scene: what is in focus is as sharp as through a pinhole. */
static void test_beyond_wide_lens(void **state)
{
    (void)state;
    static const double square[12] = {-0.5, -0.5, 0, 0.5, -0.5, 0, 0.5, 0.5, 0, -0.5, 0.5, 0};
    static const double radii[] = {0.1, 1e3, 1e9};
    struct job_spec spec = kit_spec(16, 16);
    struct kit_picture pinhole = {0};
    for (int i = -1; i < 3; i++) {
        struct scene s;
        scene_init(&s);
        kit_emit(&s, kit_quad(&s, square, SCENE_NONE), 2, 2, 2);
        look(&s, 0, 0, 3, 40);
        if (i >= 0) {
            s.camera.type = SCENE_CAMERA_THIN_LENS;
            s.camera.focal_length = 3;
            s.camera.aperture_radius = radii[i];
        }
        struct kit_picture p = kit_render(&s, &spec, 0);
        assert_clean(&p);
        if (i < 0) {
            pinhole = p;
            continue;
        }
        double differ = 0, mean = kit_picture_mean(&pinhole);
        for (size_t k = 0; k < values_of(&p); k++)
            differ = fmax(differ, fabs(p.mean[k] - pinhole.mean[k]));
        printf("  a lens of radius %g: worst pixel off by %.2g, mean by %.2g\n", radii[i], differ,
               kit_picture_mean(&p) / mean - 1);
        assert_true(differ <= 2.0 / 16 + 1e-9); /* a sample on the edge */
        kit_picture_free(&p);
        scene_release(&s);
    }
    kit_picture_free(&pinhole);
}

/* The mean of a ball under a sky of 1, by 64 samples; fails on those that are no numbers. */
static double shine(const struct scene *s, enum job_profile profile, const double index[3])
{
    struct job_spec spec = kit_spec(4, 4);
    spec.profile = profile;
    struct kit_picture p = kit_render(s, &spec, 0);
    if (p.counters.nonfinite)
        fail_msg("etaI %g, etaT %g, k %g: %llu samples are no numbers", index[0], index[1],
                 index[2], (unsigned long long)p.counters.nonfinite);
    double mean = kit_picture_mean(&p);
    kit_picture_free(&p);
    return mean;
}

/* A conductor's indices may be anything: it reflects between nothing and all. No path of a random
 * walk brings more than the sky; looking at the sky besides makes noise about that. */
static void test_beyond_conductor_indices(void **state)
{
    (void)state;
    static const double values[] = {0, 5e-324, 1e-310, 1e-100, 1, 1e9, 1e20, 1e40, 1e100, 1e150};
    enum { COUNT = sizeof values / sizeof *values };
    for (int i = 0; i < COUNT * COUNT * COUNT; i++) {
        double index[3] = {values[i % COUNT], values[i / COUNT % COUNT], values[i / COUNT / COUNT]};
        struct scene s;
        struct scene_material *m;
        scene_init(&s);
        uint32_t metal = kit_material(&s, SCENE_MATERIAL_ROUGH_CONDUCTOR, &m);
        for (int k = 0; k < 3; k++) {
            m->etaI[k] = index[0];
            m->etaT[k] = index[1];
            m->k[k] = index[2];
        }
        kit_sphere(&s, 0, 0, 0, 1, metal);
        kit_constant_sky(&s, 1);
        look(&s, 0, 0, 3, 30);
        assert_true(shine(&s, JOB_PROFILE_RW, index) <= 1 + 1e-9);
        assert_true(shine(&s, JOB_PROFILE_MIS, index) <= 1.2);
        scene_release(&s);
    }
}

/* --- Scales ---------------------------------------------------------------------- */

/* A ball of 1,280 triangles, or of none, of that radius on the ground under `up`, and what looks at
 * it. The ground is a planet or a plate as wide as the view. */
static void screw_scene(struct scene *s, double radius, double planet, bool triangles)
{
    scene_init(s);
    uint32_t grey = kit_diffuse(s, 0.6, 0.5, 0.4);
    if (triangles) {
        struct gen_mesh m;
        closed_make(CLOSED_ICOSPHERE, &m);
        double *positions = mem_alloc_array(m.vertex_count, 3 * sizeof *positions);
        assert_non_null(positions);
        for (size_t i = 0; i < 3 * m.vertex_count; i++)
            positions[i] = radius * ((double)m.positions[i] + (i % 3 == 1));
        kit_mesh(s, positions, (uint32_t)m.vertex_count, m.indices, (uint32_t)m.triangle_count,
                 grey);
        mem_free(positions);
        gen_mesh_release(&m);
    } else {
        kit_sphere(s, 0, radius, 0, radius, grey);
    }
    const double w = 64 * radius;
    const double plate[12] = {-w, 0, -w, -w, 0, w, w, 0, w, w, 0, -w};
    uint32_t ground = kit_diffuse(s, 0.8, 0.8, 0.8);
    if (planet > 0)
        kit_sphere(s, 0, -planet, 0, planet, ground);
    else
        kit_quad(s, plate, ground);
    look(s, 0, 4 * radius, 8 * radius, 30);
    look_at(s, 0, radius, 0);
    for (int k = 0; k < 3; k++) {
        s->seed_light_position[k] = (k + 3) * radius;
        s->seed_light_flux[k] = 50 * radius * radius;
    }
}

/* Something of a micrometre on a planet of 1,000 km looks as on a plate of its own size. The
 * world's doubles come in steps of 1e-10 out there: a ten-thousandth of the thing. */
static void test_beyond_screw_on_a_planet(void **state)
{
    (void)state;
    static const double radii[] = {1e-3, 1e-6}, planets[] = {1e3, 1e6};
    for (int i = 0; i < 8; i++) {
        double radius = radii[i / 2 % 2], planet = planets[i % 2];
        struct job_spec spec = kit_spec(32, 64);
        spec.integrator = JOB_INTEGRATOR_INTERSECTION_TEST;
        struct kit_picture p[2];
        for (int k = 0; k < 2; k++) {
            struct scene s;
            screw_scene(&s, radius, k ? planet : 0, i >= 4);
            p[k] = kit_render(&s, &spec, 0);
            assert_clean(&p[k]);
            scene_release(&s);
        }
        double mean = kit_picture_mean(&p[0]), sum = 0, worst = 0;
        for (size_t k = 0; k < values_of(&p[0]); k++) {
            double d = fabs(p[1].mean[k] - p[0].mean[k]) / mean;
            sum += d / (double)values_of(&p[0]);
            worst = fmax(worst, d);
        }
        printf("  %s of %g on a planet of %g: pixels off by %.2g of the mean, %.2g at most\n",
               i < 4 ? "a sphere" : "triangles", radius, planet, sum, worst);
        assert_true(sum <= 1e-3 && worst <= 0.15);
        kit_picture_free(&p[0]);
        kit_picture_free(&p[1]);
    }
}

/* T1 of it: the same bits at every scale, whatever has a space of its own. */
static void test_beyond_screws_of_any_size(void **state)
{
    (void)state;
    struct kit_picture first = {0};
    for (int k = -40; k <= 40; k += 20) {
        struct job_spec spec = kit_spec(24, 4);
        struct scene s;
        spec.integrator = JOB_INTEGRATOR_INTERSECTION_TEST;
        screw_scene(&s, ldexp(1e-6, k), ldexp(1e3, k), true);
        struct kit_picture p = kit_render(&s, &spec, 0);
        if (k == -40)
            first = p;
        else
            assert_memory_equal(p.mean, first.mean, values_of(&p) * sizeof *p.mean);
        if (k != -40)
            kit_picture_free(&p);
        scene_release(&s);
    }
    assert_true(kit_picture_mean(&first) > 0);
    kit_picture_free(&first);
}

static double random_value(uint64_t *state)
{
    *state += UINT64_C(0x9e3779b97f4a7c15);
    return (double)(sampler_mix(*state) >> 11) / 9007199254740992.0;
}

/* A value that a factor may have, up to the 1e30 that only scene files ask for. */
static double factor(uint64_t *random)
{
    static const double ends[] = {0, 1e-30, 0.3, 1, 65535, 1e30};
    return ends[(int)(random_value(random) * 6)];
}

/* The same of a share. */
static double share(uint64_t *random)
{
    static const double ends[] = {0, 1e-30, 1e-9, 0.3, 0.999999, 1};
    return ends[(int)(random_value(random) * 6)];
}

static vec3 random_direction(uint64_t *random)
{
    static const double grazing[] = {1, 1e-3, 1e-9, 1e-20, 1e-300};
    double z = random_value(random), s, c;
    z = z < 0.5 ? 2 * z : grazing[(int)(10 * (z - 0.5))];
    warp_sincos_turn(random_value(random), &s, &c);
    double sine = sqrt((1 - z) * (1 + z));
    return v3(sine * c, sine * s, random_value(random) < 0.5 ? -z : z);
}

static void assert_light(rgb f)
{
    assert_true(f.r >= 0 && f.g >= 0 && f.b >= 0 && rgb_is_finite(f));
}

/* The principled material with any factors: no negative light, nothing that is no number. */
static void test_beyond_layers_scatter(void **state)
{
    (void)state;
    uint64_t random = 5;
    for (int i = 0; i < (rows_long ? 100000 : 4000); i++) {
        uint64_t *r = &random;
        struct material m = {.type = SCENE_MATERIAL_PRINCIPLED,
                             .texture = SCENE_NONE,
                             .eta = i % 3   ? 1 + random_value(r)
                                    : i % 2 ? 1e6
                                            : 1e-6,
                             .clearcoat = share(r),
                             .clearcoat_roughness = share(r),
                             .specular = fmin(factor(r), 1e6),
                             .specular_color = {factor(r), factor(r), factor(r)},
                             .sheen_alpha = fmax(share(r), 1e-2)};
        if (i % 8 == 0) {
            m.sheen_color = (rgb){factor(r), factor(r), factor(r)};
            principled_prepare(&m);
        }
        struct bsdf b = {&m, {factor(r), factor(r), factor(r)}, share(r), share(r), share(r)};
        for (int k = 0; k < 16; k++) {
            vec3 wo = random_direction(r), wi = random_direction(r);
            double pdf, u[3] = {k ? random_value(r) : 0, random_value(r), random_value(r)};
            struct bsdf_sample s;
            assert_light(bsdf_eval(&b, wo, wi, &pdf));
            assert_true(pdf >= 0 && isfinite(pdf));
            if (!bsdf_sample(&b, wo, u, &s))
                continue;
            assert_light(s.weight);
            assert_true(s.pdf > 0 && isfinite(s.pdf) && fabs(v3_length(s.wi) - 1) < 1e-6);
        }
    }
}

enum layer { BASE, SHEEN, SPECULAR, SPECULAR_COLOR, COAT, METAL, TRANSMISSION, LAYERS };

static void set_layer(struct scene_material *m, enum layer layer, double value)
{
    double *colors[LAYERS] = {[BASE] = m->color,
                              [SHEEN] = m->sheen_color,
                              [SPECULAR_COLOR] = m->specular_color,
                              [METAL] = m->color,
                              [TRANSMISSION] = m->color};
    m->metallic = layer == METAL ? fmin(value, 1) : 0;
    m->transmission = layer == TRANSMISSION ? fmin(value, 1) : 0;
    m->clearcoat = layer == COAT ? fmin(value, 1) : 0;
    m->clearcoat_roughness = 0.2;
    m->roughness = 0.4;
    m->sheen_roughness = 0.3;
    if (layer == SPECULAR)
        m->specular = fmin(value, 1e6);
    for (int k = 0; k < 3 && colors[layer]; k++)
        colors[layer][k] = k == 1 ? value : 0.5;
}

/* Samples that were beyond the film in a picture of a plate, with a ball on it or without, under a
 * sky, a lamp and a point light. */
static uint64_t beyond_film(enum layer layer, double value, enum job_profile profile, bool ball)
{
    static const double plate[12] = {-2, -1, 2, 2, -1, 2, 2, -1, -2, -2, -1, -2};
    struct scene s;
    struct scene_material *m;
    scene_init(&s);
    uint32_t material = kit_material(&s, SCENE_MATERIAL_PRINCIPLED, &m);
    set_layer(m, layer, value);
    kit_quad(&s, plate, material);
    if (ball)
        kit_sphere(&s, 0, 0, 0, 1, material);
    kit_constant_sky(&s, 0.3);
    kit_emit(&s, kit_sphere(&s, 1.5, 1.5, 0, 0.3, SCENE_NONE), 5, 4, 3);
    kit_light(&s, SCENE_LIGHT_POINT)->position[1] = 3;
    look(&s, 0, 0, 4, 45);
    struct job_spec spec = kit_spec(24, 8);
    spec.profile = profile;
    struct kit_picture p = kit_render(&s, &spec, 0);
    uint64_t beyond = p.counters.nonfinite;
    p.counters.nonfinite = 0;
    assert_clean(&p);
    kit_picture_free(&p);
    scene_release(&s);
    return beyond;
}

/* Tints over 1 make light. All pixels are light, and where it does not come back, all samples are
 * counted; between a ball and a plate it grows with each edge, beyond the film's floats. */
static void test_beyond_layers_in_pictures(void **state)
{
    (void)state;
    static const double ends[] = {0, 1e-30, 1, 65535, 1e30};
    uint64_t beyond = 0;
    for (int i = 0; i < LAYERS * 5 * JOB_PROFILE_COUNT; i++) {
        enum layer layer = (enum layer)(i % LAYERS);
        double value = ends[i / LAYERS % 5];
        enum job_profile profile = (enum job_profile)(i / LAYERS / 5);
        assert_int_equal(beyond_film(layer, value, profile, false), 0);
        uint64_t lost = beyond_film(layer, value, profile, true);
        assert_true(lost == 0 || value > 1);
        beyond += lost;
    }
    assert_true(beyond > 0);
    printf("  %llu of %d samples beyond the film, none below it\n", (unsigned long long)beyond,
           LAYERS * 5 * JOB_PROFILE_COUNT * 24 * 24 * 8);
}

int main(int argc, char **argv)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_beyond_tiny_lamp),
        cmocka_unit_test(test_beyond_inside_glass),
        cmocka_unit_test(test_beyond_almost_air),
        cmocka_unit_test(test_beyond_dim_beside_bright),
        cmocka_unit_test(test_beyond_many_samples),
        cmocka_unit_test(test_beyond_panorama_poles),
        cmocka_unit_test(test_beyond_one_bright_texel),
        cmocka_unit_test(test_beyond_wide_view),
        cmocka_unit_test(test_beyond_wide_lens),
        cmocka_unit_test(test_beyond_conductor_indices),
        cmocka_unit_test(test_beyond_screw_on_a_planet),
        cmocka_unit_test(test_beyond_screws_of_any_size),
        cmocka_unit_test(test_beyond_layers_scatter),
        cmocka_unit_test(test_beyond_layers_in_pictures),
    };
    return ROWS_RUN(argc, argv, tests);
}
