/* AOVs against what geometry says; the picture's bits do not know of them, nor they of units. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "tests/render/render_kit.h"
#include "worker/scene/scene_build.h"

enum { SIDE = 24, PLANES_MAX = 3 + AOV_PLANES_MAX };

/* Sums over all blocks, planes of SIDE x SIDE in picture order. */
struct sums {
    double value[PLANES_MAX][SIDE * SIDE];
    double first[PLANES_MAX][SIDE * SIDE]; /* of block 0 alone */
    uint64_t rays;
};

static void add_unit(struct sums *to, const struct grid *grid, struct unit unit,
                     const float *values)
{
    uint64_t pixels = grid_pixels(grid, unit.cell_begin, unit.cell_count), at = 0;
    for (uint32_t i = 0; i < unit.cell_count; i++) {
        struct grid_rect r = grid_cell(grid, unit.cell_begin + i);
        for (uint32_t k = 0; k < r.width * r.height; k++, at++) {
            size_t place = (size_t)(r.y + k / r.width) * SIDE + r.x + k % r.width;
            for (uint32_t plane = 0; plane < grid->plane_count; plane++) {
                double v = (double)values[plane * pixels + at];
                to->value[plane][place] += v;
                to->first[plane][place] += unit.block == 0 ? v : 0;
            }
        }
    }
}

static struct job_spec spec_of(const char *list, uint64_t spp)
{
    struct job_spec spec = kit_spec(SIDE, spp);
    if (list)
        assert_true(aov_parse(list, &spec.aov, NULL));
    return spec;
}

static struct sums *render(const struct scene *s, const struct job_spec *spec, uint32_t cells)
{
    struct render_scene *scene;
    struct render_scratch *scratch;
    struct grid grid;
    assert_int_equal(scene_build(s, spec, NULL, &scene), ERR_OK);
    assert_int_equal(render_scratch_new(&scratch), ERR_OK);
    assert_int_equal(grid_init(&grid, spec), ERR_OK);
    struct sums *sums = mem_calloc(1, sizeof *sums);
    float *values = mem_alloc_array((size_t)SIDE * SIDE * grid.plane_count, sizeof *values);
    assert_true(sums && values);
    struct job_blocks blocks = job_blocks_of(spec->spp);
    for (uint32_t block = 0; block < blocks.count; block++) {
        for (uint32_t begin = 0; begin < grid.cell_count; begin += cells) {
            uint32_t left = grid.cell_count - begin;
            struct unit unit = {begin, left < cells ? left : cells, block};
            struct render_counters counters;
            assert_int_equal(render_unit(scene, &grid, unit, scratch, NULL, values, &counters),
                             ERR_OK);
            add_unit(sums, &grid, unit, values);
            sums->rays += counters.rays;
        }
    }
    mem_free(values);
    grid_release(&grid);
    render_scratch_free(scratch);
    render_scene_free(scene);
    return sums;
}

/* The first plane of an AOV in a payload. */
static uint32_t plane_of(const struct job_spec *spec, enum aov a)
{
    return 3 + aov_planes(spec->aov & ((UINT32_C(1) << a) - 1), AOV_CENTRE) +
           aov_planes(spec->aov & ((UINT32_C(1) << a) - 1), AOV_MEAN);
}

/* A ball of radius 1 about the origin, seen from z = 5, far from the world's origin and large. */
static void ball(struct scene *s, double size, const double at[3])
{
    scene_init(s);
    s->camera.fov = 40;
    for (int k = 0; k < 3; k++) {
        s->camera.position[k] = at[k] + (k == 2 ? 5 * size : 0);
        s->camera.look_at[k] = at[k];
    }
    (void)kit_diffuse(s, 0.9, 0.9, 0.9);
    kit_sphere(s, at[0], at[1], at[2], size, kit_diffuse(s, 0.25, 0.5, 0.75));
    kit_constant_sky(s, 1);
}

/* Where the ray through a pixel's middle meets the unit ball, from (0, 0, 5); false: past it. */
static bool meets(size_t place, double p[3])
{
    double half = tan(20 * 3.14159265358979323846 / 180);
    double d[3] = {(2 * ((double)(place % SIDE) + 0.5) / SIDE - 1) * half,
                   (1 - 2 * ((double)(place / SIDE) + 0.5) / SIDE) * half, -1};
    double dd = d[0] * d[0] + d[1] * d[1] + 1, b = -5 / dd, c = 24 / dd;
    if (b * b < c)
        return false;
    double t = -b - sqrt(b * b - c);
    for (int k = 0; k < 3; k++)
        p[k] = d[k] * t + (k == 2 ? 5 : 0);
    return true;
}

static void geometry_is_exact(void **state)
{
    (void)state;
    static const double places[2][3] = {{0, 0, 0}, {300, -200, 100}};
    static const double sizes[2] = {1, 40};
    for (int variant = 0; variant < 2; variant++) {
        struct scene s;
        double size = sizes[variant];
        ball(&s, size, places[variant]);
        struct job_spec spec = spec_of("object,depth,position,uv,material", 5);
        struct sums *got = render(&s, &spec, 3);
        uint32_t depth = plane_of(&spec, AOV_DEPTH), position = plane_of(&spec, AOV_POSITION);
        uint32_t uv = plane_of(&spec, AOV_UV), object = plane_of(&spec, AOV_OBJECT);
        size_t hits = 0;
        for (size_t i = 0; i < SIDE * SIDE; i++) {
            double p[3] = {0, 0, 0};
            bool hit = meets(i, p);
            hits += hit;
            double far = sqrt(p[0] * p[0] + p[1] * p[1] + (p[2] - 5) * (p[2] - 5));
            assert_true(got->value[object][i] == hit);
            assert_true(got->value[object + 1][i] == (hit ? 2 : 0));
            assert_true(fabs(got->value[depth][i] - (hit ? far * size : 0)) < 1e-6 * size);
            for (uint32_t k = 0; k < 3; k++)
                assert_true(fabs(got->value[position + k][i] -
                                 (hit ? p[k] * size + places[variant][k] : 0)) < 1e-4);
            double u = atan2(p[1], p[0]) / (2 * 3.14159265358979323846);
            assert_true(!hit || fabs(got->value[uv][i] - (u < 0 ? u + 1 : u)) < 1e-5);
            assert_true(!hit || fabs(got->value[uv + 1][i] - acos(p[2]) / 3.14159265358979) < 1e-5);
            assert_memory_equal(got->value[depth], got->first[depth], sizeof got->value[depth]);
        }
        assert_in_range(hits, SIDE, SIDE * SIDE / 2);
        mem_free(got);
        scene_release(&s);
    }
}

/* Normals and albedo are means over the samples: 1 within, between at the edge. */
static void means_are_antialiased(void **state)
{
    (void)state;
    struct scene s;
    ball(&s, 1, (const double[]){0, 0, 0});
    struct job_spec spec = spec_of("normal,ng,albedo", 64);
    struct sums *got = render(&s, &spec, 100);
    uint32_t normal = plane_of(&spec, AOV_NORMAL), ng = plane_of(&spec, AOV_NG);
    uint32_t albedo = plane_of(&spec, AOV_ALBEDO);
    size_t edges = 0;
    for (size_t i = 0; i < SIDE * SIDE; i++) {
        double p[3], mean = got->value[albedo][i] / 64, share = mean / 0.25;
        assert_true(share > -1e-9 && share < 1 + 1e-6);
        assert_true(fabs(got->value[albedo + 1][i] / 64 - 0.5 * share) < 1e-6);
        assert_true(fabs(got->value[albedo + 2][i] / 64 - 0.75 * share) < 1e-6);
        edges += share > 0.05 && share < 0.95;
        for (uint32_t k = 0; share > 0.999 && meets(i, p) && k < 3; k++) {
            assert_true(fabs(got->value[normal + k][i] / 64 - p[k]) < 0.05);
            assert_true(got->value[normal + k][i] == got->value[ng + k][i]);
        }
    }
    assert_in_range(edges, 8, 100);
    mem_free(got);
    scene_release(&s);
}

/* The picture's own bits and the AOVs' do not depend on what else is asked for, nor on units. */
static void nothing_else_changes(void **state)
{
    (void)state;
    static const enum job_integrator integrators[] = {JOB_INTEGRATOR_INTERSECTION_TEST,
                                                      JOB_INTEGRATOR_PATH, JOB_INTEGRATOR_AO};
    struct scene s;
    scene_init(&s);
    kit_cornell(&s, KIT_BOXES | KIT_AREA_LIGHT | KIT_DISC | KIT_GLASS_SPHERE);
    struct job_spec all = spec_of("depth,position,uv,object,material,normal,ng,albedo", 36);
    struct job_spec none = spec_of(NULL, 36), some = spec_of("albedo,object,samples,error", 36);
    all.filter = none.filter = some.filter = JOB_FILTER_MITCHELL;
    all.filter_radius = none.filter_radius = some.filter_radius = 2;
    some.tile = 5;
    for (size_t i = 0; i < sizeof integrators / sizeof *integrators; i++) {
        all.integrator = none.integrator = some.integrator = integrators[i];
        struct sums *a = render(&s, &all, 100), *b = render(&s, &none, 1),
                    *c = render(&s, &some, 2);
        size_t bytes = sizeof a->value[0];
        assert_memory_equal(a->value, b->value, 3 * bytes);
        assert_memory_equal(a->value, c->value, 3 * bytes);
        assert_memory_equal(a->value[plane_of(&all, AOV_OBJECT)],
                            c->value[plane_of(&some, AOV_OBJECT)], bytes);
        assert_memory_equal(a->value[plane_of(&all, AOV_ALBEDO)],
                            c->value[plane_of(&some, AOV_ALBEDO)], 3 * bytes);
        assert_true(a->rays == b->rays + SIDE * SIDE);
        mem_free(a);
        mem_free(b);
        mem_free(c);
    }
    scene_release(&s);
}

/* A pane of which a fifth is there is not the first surface; one of four fifths is. */
static void alpha_decides_the_first_surface(void **state)
{
    (void)state;
    for (int variant = 0; variant < 2; variant++) {
        struct scene s;
        struct scene_material *m;
        ball(&s, 1, (const double[]){0, 0, 0});
        uint32_t pane = kit_material(&s, SCENE_MATERIAL_PRINCIPLED, &m);
        m->alpha = variant ? 0.8 : 0.2;
        m->alpha_used = true;
        kit_quad(&s, (const double[]){-9, -9, 2, 9, -9, 2, 9, 9, 2, -9, 9, 2}, pane);
        struct job_spec spec = spec_of("object,albedo", 64);
        struct sums *got = render(&s, &spec, 1);
        size_t middle = SIDE / 2 * SIDE + SIDE / 2;
        assert_true(got->value[plane_of(&spec, AOV_OBJECT)][middle] == 1 + variant);
        assert_true(got->value[plane_of(&spec, AOV_OBJECT)][0] == 2 * variant);
        mem_free(got);
        scene_release(&s);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(geometry_is_exact),
        cmocka_unit_test(means_are_antialiased),
        cmocka_unit_test(nothing_else_changes),
        cmocka_unit_test(alpha_decides_the_first_surface),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
