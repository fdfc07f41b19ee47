/* The light tree: drawing and asking agree, what can arrive can be drawn, pictures keep their mean.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>

#include "common/mem.h"
#include "tests/render/render_kit.h"
#include "worker/render/render_scene.h"
#include "worker/render/sampler.h"
#include "worker/render/warp.h"
#include "worker/scene/scene_build.h"

static double random_value(uint64_t *state)
{
    *state += UINT64_C(0x9e3779b97f4a7c15);
    return (double)(sampler_mix(*state) >> 11) / 9007199254740992.0;
}

static vec3 random_place(uint64_t *state, double extent)
{
    double x = random_value(state), y = random_value(state), z = random_value(state);
    return v3((x - 0.5) * extent, (y - 0.5) * extent, (z - 0.5) * extent);
}

/* Lights of every kind with a place, of all sizes and directions, within [-1, 1]^3. */
static void add_lights(struct scene *s, uint32_t count, uint64_t *state)
{
    for (uint32_t i = 0; i < count; i++) {
        vec3 p = random_place(state, 2);
        double strength = random_value(state) + 0.01;
        if (i % 4 == 0) {
            vec3 a = random_place(state, 0.2), b = random_place(state, 0.2);
            const double corners[12] = {p.x,
                                        p.y,
                                        p.z,
                                        p.x + a.x,
                                        p.y + a.y,
                                        p.z + a.z,
                                        p.x + a.x + b.x,
                                        p.y + a.y + b.y,
                                        p.z + a.z + b.z,
                                        p.x + b.x,
                                        p.y + b.y,
                                        p.z + b.z};
            kit_emit(s, kit_quad(s, corners, SCENE_NONE), 90 * strength, 60 * strength, 9);
        } else if (i % 4 == 1) {
            kit_emit(s, kit_sphere(s, p.x, p.y, p.z, 0.05 * strength, SCENE_NONE), 99, 99, 99);
        } else {
            struct scene_light *l = kit_light(s, i % 4 == 2 ? SCENE_LIGHT_POINT : SCENE_LIGHT_SPOT);
            v3_put(l->position, p);
            v3_put(l->direction, v3_unit(random_place(state, 2)));
            l->cos_inner = 0.9;
            l->cos_outer = i % 8 == 3 ? 0.9 : 0.6;
            for (int k = 0; k < 3; k++)
                l->intensity[k] = strength;
        }
    }
}

static struct render_scene *build(const struct scene *s)
{
    struct job_spec spec = kit_spec(4, 1);
    struct render_scene *rs;
    assert_int_equal(scene_build(s, &spec, NULL, &rs), ERR_OK);
    return rs;
}

/* Of all lights the probabilities sum to one, but for what ends at nodes that send nothing. */
static void draws_have_their_probability(void **state)
{
    (void)state;
    struct scene s;
    uint64_t random = 3;
    scene_init(&s);
    add_lights(&s, 203, &random);
    struct render_scene *rs = build(&s);
    const struct light_table *t = &rs->lights;
    assert_non_null(t->tree.nodes);
    for (int i = 0; i < 200; i++) {
        vec3 p = random_place(&random, i % 3 ? 2 : 40);
        vec3 n = i % 4 ? v3_unit(random_place(&random, 2)) : v3(0, 0, 0);
        double sum = 0, dead = 0;
        for (uint32_t k = 0; k < t->count; k++)
            sum += light_tree_probability(&t->tree, k, p, n);
        enum { DRAWS = 4000 };
        for (int k = 0; k < DRAWS; k++) {
            double probability;
            uint32_t light = light_tree_draw(&t->tree, p, n, (k + 0.5) / DRAWS, &probability);
            dead += light == UINT32_MAX;
            if (light == UINT32_MAX)
                continue;
            double asked = light_tree_probability(&t->tree, light, p, n);
            assert_true(fabs(asked / probability - 1) < 1e-12);
        }
        assert_true(sum < 1 + 1e-12 && fabs(sum + dead / DRAWS - 1) < 0.02);
    }
    render_scene_free(rs);
    scene_release(&s);
}

/* How often each light is drawn, against what is asked of it. */
static void draws_are_as_frequent(void **state)
{
    (void)state;
    struct scene s;
    uint64_t random = 8;
    scene_init(&s);
    add_lights(&s, 40, &random);
    struct render_scene *rs = build(&s);
    const struct light_table *t = &rs->lights;
    enum { DRAWS = 100000 };
    for (int i = 0; i < 5; i++) {
        vec3 p = random_place(&random, 2), n = v3_unit(random_place(&random, 2));
        double counts[64] = {0}, probability;
        for (int k = 0; k < DRAWS; k++) {
            uint32_t light = light_tree_draw(&t->tree, p, n, random_value(&random), &probability);
            if (light != UINT32_MAX)
                counts[light]++;
        }
        for (uint32_t k = 0; k < t->count; k++) {
            double expected = DRAWS * light_tree_probability(&t->tree, k, p, n);
            assert_true(fabs(counts[k] - expected) <= 6 * sqrt(expected) + 6);
        }
    }
    render_scene_free(rs);
    scene_release(&s);
}

/* Whatever light_sample could bring from a light alone, the tree draws that light. */
static void what_arrives_is_drawn(void **state)
{
    (void)state;
    struct scene s;
    uint64_t random = 5;
    scene_init(&s);
    add_lights(&s, 100, &random);
    struct render_scene *rs = build(&s);
    const struct light_table *t = &rs->lights;
    int arrived = 0;
    for (int i = 0; i < 20000; i++) {
        vec3 p = random_place(&random, i % 2 ? 2 : 0.5), n = v3_unit(random_place(&random, 2));
        uint32_t k = (uint32_t)(random_value(&random) * (double)t->count);
        /* A table of this light alone. */
        struct light_table alone = {.lights = t->lights + k, .count = 1};
        struct light one = t->lights[k];
        one.probability = 1;
        alone.lights = &one;
        struct light_sample sample;
        if (!light_sample(&alone, p, n, 0, random_value(&random), random_value(&random), &sample) ||
            !(v3_dot(sample.wi, n) > 1e-6) || !(rgb_max(sample.radiance) > 0))
            continue;
        arrived++;
        assert_true(light_tree_probability(&t->tree, k, p, n) > 0);
    }
    assert_true(arrived > 3000);
    render_scene_free(rs);
    scene_release(&s);
}

/* Lights in one place, on a line, and at distances that double. */
static void degenerate_lights_are_drawn(void **state)
{
    (void)state;
    for (int variant = 0; variant < 3; variant++) {
        struct scene s;
        scene_init(&s);
        for (int i = 0; i < 900; i++) {
            struct scene_light *l = kit_light(&s, SCENE_LIGHT_POINT);
            double x = variant == 0 ? 1 : variant == 1 ? i : ldexp(1, i - 450);
            v3_put(l->position, v3(x, 0, 0));
            v3_put(l->intensity, v3(1, 1, 1));
        }
        kit_sphere(&s, 0, 0, 0, 1, kit_diffuse(&s, 1, 1, 1));
        struct render_scene *rs = build(&s);
        double sum = 0;
        vec3 p = v3(0.3, 0.2, 0.1), n = v3(0, 0, 0);
        for (uint32_t k = 0; k < rs->lights.count; k++)
            sum += light_tree_probability(&rs->lights.tree, k, p, n);
        assert_true(fabs(sum - 1) < 1e-9);
        render_scene_free(rs);
        scene_release(&s);
    }
}

/* The tree and an even choice make the same picture, the tree with less noise. */
static void choices_agree(void **state)
{
    (void)state;
    struct scene s;
    uint64_t random = 7;
    scene_init(&s);
    kit_cornell(&s, KIT_BOXES | KIT_AREA_LIGHT);
    add_lights(&s, 120, &random);
    struct scene_light *sun = kit_light(&s, SCENE_LIGHT_DIRECTIONAL);
    v3_put(sun->direction, v3(0, -0.5, -1));
    v3_put(sun->intensity, v3(1, 1, 1));
    struct job_spec spec = kit_spec(24, 256);
    spec.integrator = JOB_INTEGRATOR_DIRECT;
    double mean[2], variance[2] = {0, 0}, noise[2] = {0, 0};
    for (int i = 0; i < 2; i++) {
        spec.light_choice = i ? JOB_LIGHT_CHOICE_UNIFORM : JOB_LIGHT_CHOICE_TREE;
        spec.seed = (uint64_t)i;
        struct kit_picture p = kit_render(&s, &spec, 0);
        size_t values = (size_t)p.width * p.height * 3;
        mean[i] = kit_picture_mean(&p);
        for (size_t k = 0; k < values; k++) {
            double d = (p.half[0][k] - p.half[1][k]) / 2 / (double)values;
            variance[i] += d * d;
            noise[i] += fabs(d);
        }
        kit_picture_free(&p);
    }
    /* Groups of 4 x 4 pixels and three channels go together: the variance counts 48 times. */
    assert_true(fabs(mean[0] - mean[1]) < 4 * sqrt(48 * (variance[0] + variance[1])));
    assert_true(fabs(mean[0] / mean[1] - 1) < 0.05);
    /* One bright sample beside a lamp decides the variance, hardly the mean deviation. */
    print_message("deviation by the tree %g, evenly %g\n", noise[0], noise[1]);
    assert_true(noise[0] < noise[1]);
    scene_release(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(draws_have_their_probability),
        cmocka_unit_test(draws_are_as_frequent),
        cmocka_unit_test(what_arrives_is_drawn),
        cmocka_unit_test(degenerate_lights_are_drawn),
        cmocka_unit_test(choices_agree),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
