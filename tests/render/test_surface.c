/* Rays that leave a surface do not meet it again (T9), at any size and place, for triangles,
 * needles, spheres and instances; textures and cameras look where they should. */
#include "tests/numerics/rows.h"

#include <math.h>
#include <string.h>

#include "common/dmath.h"
#include "common/mem.h"
#include "tests/render/render_kit.h"
#include "worker/render/sampler.h"
#include "common/srgb_table.h"
#include "worker/render/surface.h"
#include "worker/render/warp.h"
#include "worker/scene/scene_build.h"

static double random_value(uint64_t *state)
{
    *state += UINT64_C(0x9e3779b97f4a7c15);
    return (double)(sampler_mix(*state) >> 11) / 9007199254740992.0;
}

static vec3 random_direction(uint64_t *state)
{
    double u = random_value(state);
    return warp_sphere(u, random_value(state));
}

/* Triangles with corners anywhere in 10^-8 to 10^8, one scene each. */
static void add_wild_triangle(struct scene *s, uint64_t *random)
{
    double corners[12], size = dmath_pow(10, 16 * random_value(random) - 8);
    vec3 at = v3_scale(random_direction(random), dmath_pow(10, 8 * random_value(random)) * size);
    for (int k = 0; k < 4; k++) {
        vec3 p = v3_mad(at, random_direction(random), size);
        v3_put(corners + 3 * k, p);
    }
    memcpy(corners + 9, corners, 3 * sizeof *corners); /* the second triangle has no area */
    kit_quad(s, corners, kit_diffuse(s, 1, 1, 1));
}

static uint64_t count_self_hits(const struct scene *s, uint64_t *random, uint64_t *spawned)
{
    struct job_spec spec = kit_spec(1, 1);
    struct render_scene *rs;
    assert_int_equal(scene_build(s, &spec, NULL, &rs), ERR_OK);
    uint64_t hits = 0;
    for (int k = 0; k < (rows_long ? 2 : 20); k++) {
        struct ray ray = {.tmax = VEC_INFINITY};
        struct hit hit;
        /* Aim at a point of the object from outside. */
        vec3 target = v3(0, 0, 0);
        if (rs->objects[0].type == ACCEL_TRIANGLES) {
            const float *p = rs->meshes[0].positions;
            double b = random_value(random), c = random_value(random);
            warp_triangle(b, c, &b, &c);
            for (size_t d = 0; d < 3; d++) {
                double v = (1 - b - c) * (double)p[d] + b * (double)p[3 + d] + c * (double)p[6 + d];
                *(d == 0 ? &target.x : d == 1 ? &target.y : &target.z) = v;
            }
        } else {
            target = v3_mad(rs->objects[0].center, random_direction(random),
                            rs->objects[0].radius * random_value(random));
        }
        vec3 org = v3_scale(random_direction(random), 4);
        v3_put(ray.org, org);
        v3_put(ray.dir, v3_unit(v3_sub(target, org)));
        accel_closest(rs->accel, &ray, &hit);
        if (hit.object == SCENE_NONE)
            continue;
        struct surface at;
        surface_of_hit(rs, &hit, &at);
        for (int j = 0; j < 50; j++) {
            /* Half of them almost along the surface. */
            vec3 w = random_direction(random);
            if (j & 1)
                w = v3_unit(v3_mad(w, at.ng, -v3_dot(w, at.ng) * (1 - 1e-6)));
            if (rs->objects[0].type == ACCEL_SPHERE && v3_dot(w, at.ng) < 0)
                continue; /* goes through the ball: a true hit */
            vec3 from = surface_offset(at.p, at.ng, at.error, w);
            v3_put(ray.org, from);
            v3_put(ray.dir, w);
            hits += accel_occluded(rs->accel, &ray);
            (*spawned)++;
        }
    }
    render_scene_free(rs);
    return hits;
}

static void test_t09_triangles(void **state)
{
    (void)state;
    uint64_t random = 42, spawned = 0, hits = 0;
    for (int i = 0; i < (rows_long ? 1000000 : 3000); i++) {
        struct scene s;
        scene_init(&s);
        add_wild_triangle(&s, &random);
        hits += count_self_hits(&s, &random, &spawned);
        scene_release(&s);
    }
    printf("  T9: %llu of %llu rays that left triangles hit them again\n", (unsigned long long)hits,
           (unsigned long long)spawned);
    assert_true(spawned > 500000);
    assert_int_equal(hits, 0);
}

static void test_t09_spheres(void **state)
{
    (void)state;
    uint64_t random = 43, spawned = 0, hits = 0;
    for (int i = 0; i < (rows_long ? 100000 : 1000); i++) {
        struct scene s;
        scene_init(&s);
        double size = dmath_pow(10, 16 * random_value(&random) - 8);
        vec3 at = v3_scale(random_direction(&random), size * 1e4 * random_value(&random));
        uint32_t material = kit_diffuse(&s, 1, 1, 1);
        kit_sphere(&s, at.x, at.y, at.z, size, material);
        kit_sphere(&s, -at.x, -at.y, -at.z, size * 1e-3, material);
        hits += count_self_hits(&s, &random, &spawned);
        scene_release(&s);
    }
    printf("  T9: %llu of %llu rays that left spheres hit them again\n", (unsigned long long)hits,
           (unsigned long long)spawned);
    assert_true(spawned > 100000);
    assert_int_equal(hits, 0);
}

static void textures_look_where_they_should(void **state)
{
    (void)state;
    /* 2 x 2, rows from the top: 0 1 / 2 3. */
    static const float pixels[4] = {0, 1, 2, 3};
    struct texture_image image = {.channel_count = 1, .level_count = 1};
    texture_level_init(&image.levels[0], 2, 2);
    image.levels[0].texels = pixels;
    struct texture t = {.type = SCENE_TEXTURE_IMAGE,
                        .filter = SCENE_FILTER_BILINEAR,
                        .color = {{1, 1, 1}},
                        .uv_matrix = {1, 0, 0, 0, 1, 0},
                        .image = &image};
    assert_true(fabs(texture_color(&t, 0.25, 0.75).r - 0) < 1e-12);
    assert_true(fabs(texture_color(&t, 0.75, 0.75).r - 1) < 1e-12);
    assert_true(fabs(texture_color(&t, 0.25, 0.25).r - 2) < 1e-12);
    assert_true(fabs(texture_color(&t, 0.5, 0.5).r - 1.5) < 1e-12);
    assert_true(fabs(texture_color(&t, -5.75, 7.25).r - 2) < 1e-9);
    assert_true(fabs(texture_color(&t, 0, 0.25).r - 2.5) < 1e-9); /* between both ends */
    t.wrap[0] = SCENE_WRAP_CLAMP;
    assert_true(fabs(texture_color(&t, -3, 0.25).r - 2) < 1e-12);
    t.wrap[0] = SCENE_WRAP_MIRROR;
    assert_true(fabs(texture_color(&t, 1.25, 0.25).r - 3) < 1e-9);
    struct texture checker = {.type = SCENE_TEXTURE_CHECKERBOARD,
                              .color = {{1, 1, 1}, {2, 2, 2}},
                              .uv_matrix = {1, 0, 0, 0, 1, 0}};
    assert_true(texture_color(&checker, 0.1, 0.1).r == 1);
    assert_true(texture_color(&checker, 0.6, 0.1).r == 2);
    assert_true(texture_color(&checker, -0.1, 0.1).r == 2);
    assert_true(texture_color(&checker, -0.1, -0.1).r == 1);
    for (int i = 0; i < 256; i++)
        assert_true(fabs(srgb_table[i] - dmath_srgb_decode(i / 255.0)) < 1e-15);
}

/* The middle of the film looks at the point looked at; edges lie at the angle of view. */
static void cameras_look_where_they_should(void **state)
{
    (void)state;
    static const double center[3] = {0, 0, 0}, lens[2] = {0.3, 0.8};
    struct scene s;
    scene_init(&s);
    struct scene_camera from = s.camera;
    from.position[0] = 1;
    from.position[1] = 2;
    from.position[2] = 3;
    from.fov = 60;
    from.focal_length = 2;
    from.aperture_radius = 0.1;
    from.ortho_height = 3;
    vec3 forward = v3_unit(v3(-1, -2, -3));
    for (int type = 0; type <= SCENE_CAMERA_PANORAMA; type++) {
        struct camera c;
        vec3 org, dir;
        from.type = (enum scene_camera_type)type;
        camera_init(&c, &from, 200, 100, center, 1);
        camera_ray(&c, 100, 50, lens, &org, &dir);
        assert_true(fabs(v3_length(dir) - 1) < 1e-12);
        if (type == SCENE_CAMERA_THIN_LENS) {
            /* All of the lens meets in the plane of focus. */
            vec3 focus = v3_mad(v3_of(from.position), forward, 2);
            vec3 to = v3_sub(focus, org);
            assert_true(v3_length(v3_sub(v3_unit(to), dir)) < 1e-12);
            assert_true(v3_length(v3_sub(org, v3_of(from.position))) <= 0.1);
        } else {
            assert_true(v3_length(v3_sub(dir, forward)) < 1e-12);
        }
        if (type == SCENE_CAMERA_PINHOLE) {
            camera_ray(&c, 100, 0, lens, &org, &dir);
            assert_true(fabs(v3_dot(dir, forward) - sqrt(0.75)) < 1e-12);
            assert_true(dir.y > forward.y); /* row 0 is the top */
        }
    }
    scene_release(&s);
}

int main(int argc, char **argv)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_t09_triangles),
        cmocka_unit_test(test_t09_spheres),
        cmocka_unit_test(textures_look_where_they_should),
        cmocka_unit_test(cameras_look_where_they_should),
    };
    return ROWS_RUN(argc, argv, tests);
}
