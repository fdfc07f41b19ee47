/* render_self_test: a digest of what decides bits. The numbers mean nothing; that two machines get
 * the same ones does. Inputs come from the independent sampler, which is integers only. */
#include "common/digest.h"
#include "common/dmath.h"
#include "worker/render/bsdf_lobes.h"
#include "worker/render/wave.h"

enum {
    TRIANGLES = 96,
    RAYS = 512,
    POINTS = 64, /* of each sampler, function and bsdf */
};

_Static_assert((int)RAYS <= (int)WAVE_PATHS, "the self-test's rays must fit the scratch memory");

static void inputs(uint32_t stream, uint64_t index, double u[SAMPLER_SET_VALUES])
{
    struct sampler s = sampler_of(JOB_SAMPLER_INDEPENDENT, 1, stream, 0, 0, index);
    sampler_set(&s, 0, u);
}

static void add_double(struct digest_ctx *c, double v)
{
    /* Zeros of both signs and NaNs of all kinds count as one. */
    v = v != v ? 1e300 : v + 0.0;
    digest_add(c, &v, sizeof v);
}

static void add_vec(struct digest_ctx *c, vec3 v)
{
    add_double(c, v.x);
    add_double(c, v.y);
    add_double(c, v.z);
}

static void add_rgb(struct digest_ctx *c, rgb v)
{
    add_double(c, v.r);
    add_double(c, v.g);
    add_double(c, v.b);
}

static void test_math(struct digest_ctx *c)
{
    for (uint64_t i = 0; i < POINTS; i++) {
        double u[SAMPLER_SET_VALUES];
        inputs(1, i, u);
        double x = u[0] * 10 - 5, y = u[1] * 4 + 1e-3;
        double s, k;
        dmath_sincos(x, &s, &k);
        add_double(c, s);
        add_double(c, k);
        add_double(c, dmath_tan(x));
        add_double(c, dmath_exp(x));
        add_double(c, dmath_log(y));
        add_double(c, dmath_pow(y, x));
        add_double(c, dmath_acos(u[2] * 2 - 1));
        add_double(c, dmath_atan2(x, y));
        add_double(c, dmath_erf(x));
        add_double(c, dmath_cospi(x));
    }
}

static void test_samplers(struct digest_ctx *c)
{
    for (uint64_t i = 0; i < POINTS; i++) {
        for (int type = 0; type < JOB_SAMPLER_COUNT; type++) {
            double u[SAMPLER_SET_VALUES];
            struct sampler s =
                sampler_of((enum job_sampler)type, i, 3, 5, i & 1, i * i * i * i * i);
            sampler_set(&s, (uint32_t)i, u);
            for (int k = 0; k < SAMPLER_SET_VALUES; k++)
                add_double(c, u[k]);
        }
    }
}

static struct material test_material(enum scene_material_type type, int variant)
{
    struct material m = {.type = type,
                         .texture = SCENE_NONE,
                         .color = {0.5, 0.6, 0.7},
                         .distribution = variant ? SCENE_GGX : SCENE_BECKMANN,
                         .alpha_x = 0.2,
                         .alpha_y = 0.4,
                         .eta = 1.5,
                         .R = {1, 0.9, 0.8},
                         .T = {0.7, 0.8, 0.9},
                         .conductor_eta = {0.2, 0.9, 1.1},
                         .conductor_k = {3.9, 2.5, 2.1},
                         .metallic = 0.3,
                         .roughness = 0.4,
                         .transmission = variant ? 0.5 : 0,
                         .specular = 1,
                         .clearcoat = variant ? 0 : 0.5,
                         .clearcoat_roughness = 0.2,
                         .specular_color = {1, 0.9, 0.8},
                         .sheen_color = {0.1, 0.2, 0.3},
                         .sheen_alpha = 0.25};
    return m;
}

/* Values of the lobe where principled_prepare puts their means, which take longer to make than all
 * the rest of the test. */
static void put_sheen(struct material *m)
{
    for (int i = 0; i < PRINCIPLED_SHEEN_TABLE; i++) {
        double z = (i + 1.0) / (PRINCIPLED_SHEEN_TABLE + 1);
        m->sheen_albedo[i] =
            principled_sheen_value(m, v3(sqrt(1 - z * z), 0, z), v3(0, sqrt(1 - z * z), z));
    }
}

static void test_bsdf(struct digest_ctx *c, const struct material *m)
{
    struct bsdf b = {.material = m,
                     .color = m->color,
                     .metallic = m->metallic,
                     .roughness = m->roughness,
                     .transmission = m->transmission};
    for (uint64_t i = 0; i < POINTS; i++) {
        double u[SAMPLER_SET_VALUES], v[SAMPLER_SET_VALUES], pdf;
        inputs(2, i, u);
        inputs(3, i, v);
        vec3 wo = v3_unit(v3(u[0] - 0.5, u[1] - 0.5, u[2] - 0.3));
        struct bsdf_sample s;
        if (!bsdf_sample(&b, wo, v, &s))
            continue;
        add_vec(c, s.wi);
        add_rgb(c, s.weight);
        add_double(c, s.pdf);
        add_rgb(c, bsdf_eval(&b, wo, s.wi, &pdf));
        add_double(c, pdf);
    }
}

/* The tree borrows these. */
struct test_mesh {
    float positions[9 * TRIANGLES];
    uint32_t indices[3 * TRIANGLES];
};

/* Triangles about the origin, once as they are and once as an instance, and a sphere. */
static enum err test_accel_new(struct test_mesh *m, struct accel **out)
{
    for (uint32_t i = 0; i < 3 * TRIANGLES; i++) {
        double u[SAMPLER_SET_VALUES];
        inputs(4, i, u);
        double spread = i % 3 ? 0.4 : 1.4;
        const float *first = m->positions + 9 * (i / 3);
        for (uint32_t k = 0; k < 3; k++) {
            double base = i % 3 ? (double)first[k] : 0;
            m->positions[3 * i + k] = (float)(base + (u[k] - 0.5) * spread);
        }
        m->indices[i] = i;
    }
    struct accel_mesh mesh = {m->positions, m->indices, 3 * TRIANGLES, TRIANGLES};
    struct accel_object objects[3] = {
        {.type = ACCEL_TRIANGLES},
        {.type = ACCEL_SPHERE, .center = {0.3, -0.2, 0.1}, .radius = 0.35},
        {.type = ACCEL_INSTANCE,
         .to_scene = {0.5, 0, 0, 0.25, 0, 0, -0.5, 0.1, 0, 0.5, 0, -0.1},
         .from_scene = {2, 0, 0, -0.5, 0, 0, 2, 0.2, 0, -2, 0, 0.2}},
    };
    struct accel_input input = {&mesh, 1, objects, 3};
    struct accel_options options = {.builder = JOB_BUILDER_SAH};
    return accel_new(&input, &options, NULL, out);
}

static enum err test_accel(struct digest_ctx *c, struct render_scratch *w)
{
    struct test_mesh mesh;
    struct accel *accel;
    TL_TRY(test_accel_new(&mesh, &accel));
    for (uint32_t i = 0; i < RAYS; i++) {
        double u[SAMPLER_SET_VALUES], v[SAMPLER_SET_VALUES];
        inputs(5, i, u);
        inputs(6, i, v);
        wave_continue(w, i, i, v3((u[0] - 0.5) * 4, (u[1] - 0.5) * 4, (u[2] - 0.5) * 4),
                      v3(0, 0, 0));
        for (int k = 0; k < 3; k++)
            w->rays[i].dir[k] = (v[k] - 0.5) - w->rays[i].org[k];
    }
    accel_closest_batch(accel, w->rays, RAYS, w->hits);
    accel_occluded_batch(accel, w->rays, RAYS, w->occluded);
    accel_free(accel);
    for (uint32_t i = 0; i < RAYS; i++) {
        const struct hit *hit = &w->hits[i];
        digest_add(c, &hit->object, sizeof hit->object);
        digest_add(c, &w->occluded[i], 1);
        if (hit->object == SCENE_NONE)
            continue;
        digest_add(c, &hit->primitive, sizeof hit->primitive);
        add_double(c, hit->t);
        add_double(c, hit->b1);
        add_double(c, hit->b2);
        add_vec(c, v3_of(hit->ng));
    }
    return ERR_OK;
}

enum err render_self_test(struct render_scratch *scratch, unsigned char out[32])
{
    _Static_assert(DIGEST_BYTES == 32, "the self-test's bits are one digest");
    struct digest_ctx c;
    TL_TRY(digest_begin(&c));
    test_math(&c);
    test_samplers(&c);
    for (int type = 0; type <= SCENE_MATERIAL_BLACK; type++) {
        for (int variant = 0; variant < 2; variant++) {
            struct material m = test_material((enum scene_material_type)type, variant);
            put_sheen(&m);
            test_bsdf(&c, &m);
        }
    }
    enum err e = test_accel(&c, scratch);
    digest d = digest_end(&c);
    if (e == ERR_OK)
        memcpy(out, d.bytes, sizeof d.bytes);
    return e;
}
