/* The integrators direct and ao against closed forms. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "tests/render/render_kit.h"
#include "worker/render/vec.h"

static const double pi = 3.14159265358979323846;

enum { SIDE = 16, VALUES = SIDE * SIDE * 3 };

/* A patch of the plane y = 0 of that size about (x, 0, 0), seen from above without perspective. */
static void look_down(struct scene *s, double x, double size)
{
    struct scene_camera *c = &s->camera;
    c->type = SCENE_CAMERA_ORTHOGRAPHIC;
    c->ortho_height = size;
    memcpy(c->position, (const double[]){x, 0.5, 0}, sizeof c->position);
    memcpy(c->look_at, (const double[]){x, 0, 0}, sizeof c->look_at);
    memcpy(c->ref_up, (const double[]){0, 0, -1}, sizeof c->ref_up);
}

static void add_floor(struct scene *s, double albedo)
{
    static const double corners[12] = {-1e4, 0, -1e4, -1e4, 0, 1e4, 1e4, 0, 1e4, 1e4, 0, -1e4};
    kit_quad(s, corners, kit_diffuse(s, albedo, albedo, albedo));
}

static void assert_all(const struct scene *s, const struct job_spec *spec, double value,
                       double tolerance)
{
    struct kit_picture p = kit_render(s, spec, 0);
    for (size_t i = 0; i < VALUES; i++)
        assert_true(fabs(p.mean[i] - value) <= tolerance);
    kit_picture_free(&p);
}

static struct job_spec spec_of(enum job_integrator integrator, uint64_t spp)
{
    struct job_spec spec = kit_spec(SIDE, spp);
    spec.integrator = integrator;
    return spec;
}

/* Open to the sky: 1. In a closed ball: 0. Past the edge of things: 0. */
static void ao_of_open_and_closed(void **state)
{
    (void)state;
    struct scene s;
    struct job_spec spec = spec_of(JOB_INTEGRATOR_AO, 16);
    scene_init(&s);
    add_floor(&s, 0.3);
    look_down(&s, 0, 1);
    assert_all(&s, &spec, 1, 0);
    kit_sphere(&s, 0, 0, 0, 2, kit_diffuse(&s, 0.3, 0.3, 0.3));
    assert_all(&s, &spec, 0, 0);
    scene_release(&s);
    scene_init(&s);
    kit_sphere(&s, 0, 9, 0, 1, kit_diffuse(&s, 0.3, 0.3, 0.3));
    look_down(&s, 0, 1);
    assert_all(&s, &spec, 0, 0);
    scene_release(&s);
}

/* Beside a long wall of height h at distance x the cosine-weighted part of the sky that it hides is
 * (1 - x / sqrt(x^2 + h^2)) / 2. */
static void ao_beside_a_wall(void **state)
{
    (void)state;
    static const double wall[12] = {0, 0, -1e4, 0, 2, -1e4, 0, 2, 1e4, 0, 0, 1e4};
    static const double distances[] = {0.1, 1, 3};
    for (int i = 0; i < 3; i++) {
        double x = distances[i];
        struct scene s;
        scene_init(&s);
        add_floor(&s, 0.3);
        kit_quad(&s, wall, kit_diffuse(&s, 0.5, 0.5, 0.5));
        look_down(&s, x, 1e-6);
        struct job_spec spec = spec_of(JOB_INTEGRATOR_AO, 256);
        struct kit_picture p = kit_render(&s, &spec, 0);
        double open = 1 - (1 - x / sqrt(x * x + 4)) / 2, n = SIDE * SIDE * 256.0;
        /* Of a coin's throws the spread is known; stratified ones have less. */
        assert_true(fabs(kit_picture_mean(&p) - open) < 5 * sqrt(open * (1 - open) / n));
        kit_picture_free(&p);
        scene_release(&s);
    }
}

/* Directions above the shading normal's horizon but below the surface were counted as open. Of
 * those about a normal that leans by a the cosine-weighted part (1 + cos a) / 2 is above the
 * surface. */
static void ao_above_the_surface(void **state)
{
    (void)state;
    const double lean = VEC_PI / 3;
    struct scene s;
    scene_init(&s);
    add_floor(&s, 0.3);
    struct scene_mesh *m = &s.meshes[s.mesh_count - 1];
    m->normals = mem_alloc_array((size_t)3 * m->vertex_count, sizeof *m->normals);
    assert_non_null(m->normals);
    for (uint32_t i = 0; i < m->vertex_count; i++) {
        m->normals[3 * i] = (float)sin(lean);
        m->normals[3 * i + 1] = (float)cos(lean);
        m->normals[3 * i + 2] = 0;
    }
    look_down(&s, 0, 1e-6);
    struct job_spec spec = spec_of(JOB_INTEGRATOR_AO, 256);
    struct kit_picture p = kit_render(&s, &spec, 0);
    double open = (1 + cos(lean)) / 2, n = SIDE * SIDE * 256.0;
    assert_true(fabs(kit_picture_mean(&p) - open) < 5 * sqrt(open * (1 - open) / n));
    kit_picture_free(&p);
    scene_release(&s);
}

/* A point light over a plane: albedo / pi * I cos / r^2. */
static void direct_of_a_point(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    add_floor(&s, 0.6);
    struct scene_light *l = kit_light(&s, SCENE_LIGHT_POINT);
    memcpy(l->position, (const double[]){3, 4, 0}, sizeof l->position);
    for (int k = 0; k < 3; k++)
        l->intensity[k] = 50;
    look_down(&s, 0, 1e-6);
    struct job_spec spec = spec_of(JOB_INTEGRATOR_DIRECT, 4);
    double expected = 0.6 / pi * 50 * 0.8 / 25;
    assert_all(&s, &spec, expected, 1e-5 * expected);
    scene_release(&s);
}

/* Within a ball of albedo rho about a point light direct light is rho / pi * I / r^2 everywhere;
 * the path integrator adds the bounces: 1 / (1 - rho) times that. */
static void direct_adds_no_bounce(void **state)
{
    (void)state;
    struct scene s;
    scene_init(&s);
    uint32_t grey = kit_diffuse(&s, 0.6, 0.6, 0.6);
    s.materials[grey].twosided = true;
    kit_sphere(&s, 0, 0, 0, 2, grey);
    struct scene_light *l = kit_light(&s, SCENE_LIGHT_POINT);
    for (int k = 0; k < 3; k++)
        l->intensity[k] = 8;
    s.camera.position[2] = 0.5;
    s.camera.look_at[2] = -1;
    struct job_spec spec = spec_of(JOB_INTEGRATOR_DIRECT, 4);
    double direct = 0.6 / pi * 8 / 4;
    assert_all(&s, &spec, direct, 1e-5 * direct);
    spec.max_depth = 99;
    assert_all(&s, &spec, direct, 1e-5 * direct);
    spec.integrator = JOB_INTEGRATOR_PATH;
    spec.rr_threshold = 0;
    assert_all(&s, &spec, direct / (1 - 0.6), 1e-4 * direct);
    scene_release(&s);
}

/* A lamp seen directly, and a wide one that a plane sees under half of its cosine. */
static void direct_of_an_area(void **state)
{
    (void)state;
    static const double half_sky[12] = {0,   1e-3, -1e4, 1e4, 1e-3, -1e4,
                                        1e4, 1e-3, 1e4,  0,   1e-3, 1e4};
    struct scene s;
    scene_init(&s);
    kit_emit(&s, kit_quad(&s, half_sky, SCENE_NONE), 3, 3, 3);
    add_floor(&s, 0.5);
    look_down(&s, 0, 1e-7);
    s.camera.position[1] = 5e-4; /* below the lamp's plane */
    struct job_spec spec = spec_of(JOB_INTEGRATOR_DIRECT, 1024);
    struct kit_picture p = kit_render(&s, &spec, 0);
    assert_true(fabs(kit_picture_mean(&p) / (0.5 * 3 / 2) - 1) < 0.01);
    kit_picture_free(&p);
    memcpy(s.camera.look_at, (const double[]){0, 1, 0}, sizeof s.camera.look_at);
    s.camera.position[0] = s.camera.look_at[0] = 5;
    assert_all(&s, &spec, 3, 1e-6);
    scene_release(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(ao_of_open_and_closed), cmocka_unit_test(ao_beside_a_wall),
        cmocka_unit_test(ao_above_the_surface),  cmocka_unit_test(direct_of_a_point),
        cmocka_unit_test(direct_adds_no_bounce), cmocka_unit_test(direct_of_an_area),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
