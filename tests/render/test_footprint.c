/* Footprints against the rays that they stand for: through lenses, mirrors and glass; and pictures
 * that are filtered by them. */
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
#include "worker/render/shade.h"
#include "worker/render/wave.h"
#include "worker/scene/scene_build.h"

static const double lens[2] = {0.3, 0.6};

/* A ray on its way, and its footprint or none. */
struct traced {
    struct hit hit;
    struct surface surface;
    int turns;
};

/* Follows the ray of a film point through what is specular to what is not; false if it leaves. */
static bool follow(const struct render_scene *rs, double x, double y, struct footprint *f,
                   struct traced *out)
{
    vec3 org, dir;
    struct ray ray = {.tmax = VEC_INFINITY};
    camera_ray(&rs->camera, x, y, lens, &org, &dir);
    v3_put(ray.org, org);
    for (out->turns = 0; out->turns < 8; out->turns++) {
        v3_put(ray.dir, dir);
        accel_closest(rs->accel, &ray, &out->hit);
        if (out->hit.object == SCENE_NONE)
            return false;
        if (f)
            footprint_arrive(f, org, &ray, &out->hit);
        struct shade at;
        struct bsdf_sample sample;
        shade_of_hit(rs, &out->hit, dir, NULL, NULL, &at);
        out->surface = at.surface;
        if (!at.bsdf.material->is_delta)
            return true;
        static const double u[3] = {0.5, 0.5, 0.99};
        if (!bsdf_sample(&at.bsdf, at.wo, u, &sample))
            return false;
        vec3 wi = v3_unit(frame_to_world(&at.frame, sample.wi));
        if (f)
            wave_leave(rs, &at, &out->hit, dir, wi, &sample, f);
        org = at.surface.p;
        v3_put(ray.org, surface_offset(org, at.surface.ng, at.surface.error, wi));
        dir = wi;
    }
    return false;
}

/* The largest error of footprints over the film, of their size, where a ray takes `turns`. */
static double worst_error(const struct scene *s, int turns, int *count)
{
    static const double step = 1e-5;
    struct render_scene *rs;
    struct job_spec spec = kit_spec(32, 1);
    double worst = 0;
    *count = 0;
    scene_check(s);
    assert_int_equal(scene_build(s, &spec, NULL, &rs), ERR_OK);
    for (int i = 0; i < 32 * 32; i++) {
        double x = i % 32 + 0.37, y = i / 32 + 0.61; /* NOLINT(bugprone-integer-division): rows */
        struct footprint f;
        struct traced at, beside[2];
        camera_footprint(&rs->camera, x, y, lens, step, &f);
        if (!follow(rs, x, y, &f, &at) || at.turns != turns ||
            !follow(rs, x + step, y, NULL, &beside[0]) ||
            !follow(rs, x, y + step, NULL, &beside[1]))
            continue;
        for (int k = 0; k < 2; k++) {
            if (beside[k].hit.object != at.hit.object ||
                beside[k].hit.primitive != at.hit.primitive || beside[k].turns != turns)
                continue;
            vec3 truth = v3_sub(beside[k].surface.p, at.surface.p);
            double error = v3_length(v3_sub(f.org[k], truth)) / v3_length(truth);
            worst = error > worst ? error : worst;
            struct texture_footprint uv;
            footprint_uv(rs, &at.hit, &f, &uv);
            double du = beside[k].surface.u - at.surface.u, dv = beside[k].surface.v - at.surface.v;
            error = (fabs(uv.u[k] - du) + fabs(uv.v[k] - dv)) / (fabs(du) + fabs(dv));
            worst = error > worst ? error : worst;
            (*count)++;
        }
    }
    render_scene_free(rs);
    return worst;
}

static void set_uvs(struct scene *s, uint32_t object)
{
    static const float uvs[8] = {0.1f, 0.2f, 1.3f, 0.1f, 1.2f, 1.5f, -0.1f, 1.1f};
    struct scene_mesh *mesh = &s->meshes[s->objects[object].mesh];
    mesh->uvs = mem_alloc_array(8, sizeof *uvs);
    memcpy(mesh->uvs, uvs, sizeof uvs);
}

static uint32_t checkered(struct scene *s)
{
    struct scene_material *m;
    uint32_t material = kit_material(s, SCENE_MATERIAL_DIFFUSE, &m);
    uint32_t texture = kit_constant_texture(s, 1);
    s->materials[material].texture = texture;
    s->textures[texture].type = SCENE_TEXTURE_CHECKERBOARD;
    s->textures[texture].filter = SCENE_FILTER_MIPMAP;
    return material;
}

/* A slanted floor behind and a checkered ball. */
static void add_ground(struct scene *s)
{
    static const double floor_at[12] = {-40, -40, -9, 40, -40, -3, 40, 40, -3, -40, 40, -9};
    set_uvs(s, kit_quad(s, floor_at, checkered(s)));
    kit_sphere(s, 1.5, 1, -2, 0.7, checkered(s));
}

static void every_camera_has_footprints(void **state)
{
    (void)state;
    for (int type = 0; type <= SCENE_CAMERA_PANORAMA; type++) {
        struct scene s;
        int count;
        scene_init(&s);
        add_ground(&s);
        s.camera.type = (enum scene_camera_type)type;
        memcpy(s.camera.position, (double[3]){0.3, 0.2, 4}, sizeof s.camera.position);
        s.camera.focal_length = 3;
        s.camera.aperture_radius = type == SCENE_CAMERA_THIN_LENS ? 0.2 : 0;
        s.camera.ortho_height = 6;
        double worst = worst_error(&s, 0, &count);
        printf("  camera %d: error of %d footprints at most %.1e of them\n", type, count, worst);
        assert_true(count > 100 && worst < 2e-3);
        scene_release(&s);
    }
}

/* 0: a flat mirror of smoothed normals; 1: a ball; 2: refraction, in and out of a ball. */
static void specular_surfaces_turn_them(void **state)
{
    (void)state;
    static const double glass_at[12] = {-3, -3, 1, 3, -3, 1, 3, 3, 1, -3, 3, 1};
    static const float tilted[12] = {-0.3f, -0.2f, 1, 0.2f,  -0.3f, 1,
                                     0.3f,  0.2f,  1, -0.2f, 0.3f,  1};
    static const double behind[12] = {-90, -90, 9, -90, 90, 9, 90, 90, 9, 90, -90, 9};
    for (int kind = 0; kind < 3; kind++) {
        struct scene s;
        struct scene_material *m;
        int count;
        scene_init(&s);
        add_ground(&s);
        set_uvs(&s, kit_quad(&s, behind, checkered(&s)));
        uint32_t shiny =
            kit_material(&s, kind == 2 ? SCENE_MATERIAL_REFRACTION : SCENE_MATERIAL_MIRROR, &m);
        if (kind == 0) {
            uint32_t quad = kit_quad(&s, glass_at, shiny);
            struct scene_mesh *mesh = &s.meshes[s.objects[quad].mesh];
            mesh->normals = mem_alloc_array(12, sizeof *tilted);
            memcpy(mesh->normals, tilted, sizeof tilted);
        } else {
            kit_sphere(&s, 0.2, 0.1, 1, 1.2, shiny);
        }
        memcpy(s.camera.position, (double[3]){0.3, 0.2, 6}, sizeof s.camera.position);
        double worst = worst_error(&s, kind == 2 ? 2 : 1, &count);
        printf("  specular %d: error of %d footprints at most %.1e of them\n", kind, count, worst);
        assert_true(count > 100 && worst < 5e-3);
        scene_release(&s);
    }
}

/* A floor of fine squares up to the horizon, lit by the sky; filtered or not. */
static struct kit_picture squares(enum scene_texture_filter filter, enum job_integrator integrator,
                                  double repeat, uint64_t spp)
{
    static const double floor_at[12] = {-50, 0, 50, 50, 0, 50, 50, 0, -50, -50, 0, -50};
    struct scene s;
    scene_init(&s);
    uint32_t material = checkered(&s);
    struct scene_texture *t = &s.textures[0];
    t->filter = filter;
    t->uv_matrix[0] = t->uv_matrix[4] = repeat;
    for (int k = 0; k < 3; k++) {
        t->color[0][k] = 0.8;
        t->color[1][k] = 0;
    }
    set_uvs(&s, kit_quad(&s, floor_at, material));
    kit_constant_sky(&s, 1);
    memcpy(s.camera.position, (double[3]){0, 2, 0}, sizeof s.camera.position);
    memcpy(s.camera.look_at, (double[3]){1, 1, -6}, sizeof s.camera.look_at);
    struct job_spec spec = kit_spec(32, spp);
    spec.integrator = integrator;
    spec.max_depth = 2;
    struct kit_picture p = kit_render(&s, &spec, 0);
    scene_release(&s);
    return p;
}

/* Squares far smaller than pixels: one sample each is the mean already. */
static void one_sample_has_no_noise(void **state)
{
    (void)state;
    struct kit_picture p = squares(SCENE_FILTER_MIPMAP, JOB_INTEGRATOR_DIRECT, 1e6, 2);
    struct kit_picture n = squares(SCENE_FILTER_NEAREST, JOB_INTEGRATOR_DIRECT, 1e6, 2);
    double worst = 0, noise = 0;
    for (int i = 20 * 32; i < 32 * 32; i++) {
        worst = fmax(worst, fabs(p.mean[i] - 0.4));
        noise = fmax(noise, fabs(n.mean[i] - 0.4));
    }
    printf("  fine squares: filtered within %.1e of the mean, points within %.2f\n", worst, noise);
    assert_true(worst < 1e-3 && noise > 0.3);
    kit_picture_free(&p);
    kit_picture_free(&n);
}

/* Squares of about a pixel: with samples the filtered picture becomes the other. */
static void many_samples_agree(void **state)
{
    (void)state;
    double bias[2];
    for (int many = 0; many < 2; many++) {
        uint64_t spp = many ? 1024 : 4;
        struct kit_picture a = squares(SCENE_FILTER_MIPMAP, JOB_INTEGRATOR_DIRECT, 60, spp);
        struct kit_picture b = squares(SCENE_FILTER_NEAREST, JOB_INTEGRATOR_DIRECT, 60, 4096);
        double sum = 0;
        for (int i = 0; i < 32 * 32; i++)
            sum += (a.mean[i] - b.mean[i]) * (a.mean[i] - b.mean[i]);
        bias[many] = sqrt(sum / (32 * 32));
        printf("  %d samples: filtered and points differ by %.2e in the mean square\n", (int)spp,
               bias[many]);
        assert_true(fabs(kit_picture_mean(&a) - kit_picture_mean(&b)) < (many ? 1e-3 : 1e-2));
        kit_picture_free(&a);
        kit_picture_free(&b);
    }
    assert_true(bias[1] < 0.005 && bias[1] < bias[0] / 4);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_camera_has_footprints),
        cmocka_unit_test(specular_surfaces_turn_them),
        cmocka_unit_test(one_sample_has_no_noise),
        cmocka_unit_test(many_samples_agree),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
