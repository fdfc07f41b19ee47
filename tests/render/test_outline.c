/* Twigs of pixels that a lamp's outline crosses (outline.h): the part of a pixel that the lamp
 * covers is right, quiet, and the same however the picture is cut. */
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

enum { SIDE = 10 }; /* not a multiple of a group's */

/* A lamp that ends at x = `right` pixels and covers the rest of the picture up to there, seen by a
 * camera whose pixels are 1 wide. */
static void make_scene(struct scene *s, double right)
{
    const double end = right - SIDE / 2.0;
    const double lamp[12] = {-9, -9, -1, end, -9, -1, end, 9, -1, -9, 9, -1};
    scene_init(s);
    kit_emit(s, kit_quad(s, lamp, SCENE_NONE), 1, 2, 3);
    s->camera.type = SCENE_CAMERA_ORTHOGRAPHIC;
    s->camera.ortho_height = SIDE;
    memcpy(s->camera.position, (const double[]){0, 0, 3}, sizeof s->camera.position);
    memcpy(s->camera.look_at, (const double[]){0, 0, 0}, sizeof s->camera.look_at);
}

static void coverage_is_right(void **state)
{
    (void)state;
    static const double rights[] = {3.25, 4.8, 9.05};
    for (size_t i = 0; i < sizeof rights / sizeof *rights; i++) {
        struct scene s;
        make_scene(&s, rights[i]);
        struct job_spec spec = kit_spec(SIDE, 64);
        struct kit_picture p = kit_render(&s, &spec, 0);
        size_t edge = (size_t)rights[i];
        double sum = 0;
        for (size_t y = 0; y < SIDE; y++) {
            for (size_t x = 0; x < SIDE; x++) {
                double v = p.mean[y * SIDE + x];
                if (x == edge)
                    sum += v / SIDE;
                else
                    assert_true(fabs(v - (x < edge)) < 1e-6);
            }
        }
        /* Without twigs the pixels scatter by 0.01, and their mean by 0.003. */
        printf("  %g covered, %g found\n", rights[i] - (double)edge, sum);
        assert_true(fabs(sum - (rights[i] - (double)edge)) < 0.004);
        kit_picture_free(&p);
        scene_release(&s);
    }
}

/* Mean square of the difference of the halves along the edge. */
static double edge_noise(const struct kit_picture *p, size_t edge)
{
    double sum = 0;
    for (size_t y = 0; y < SIDE; y++) {
        double d = p->half[0][y * SIDE + edge] - p->half[1][y * SIDE + edge];
        sum += d * d / SIDE;
    }
    return sum;
}

/* A white card in the sun has the same outline as the lamp, but no twigs. */
static void outlines_are_quiet(void **state)
{
    (void)state;
    struct scene lamp, card;
    make_scene(&lamp, 4.4);
    make_scene(&card, 4.4);
    card.objects[0].emits = false;
    card.objects[0].material = kit_diffuse(&card, 1, 1, 1);
    struct scene_light *sun = kit_light(&card, SCENE_LIGHT_DIRECTIONAL);
    memcpy(sun->direction, (const double[]){0, 0, -1}, sizeof sun->direction);
    for (int k = 0; k < 3; k++)
        sun->intensity[k] = 3.14159265;
    struct job_spec spec = kit_spec(SIDE, 32);
    struct kit_picture quiet = kit_render(&lamp, &spec, 0), plain = kit_render(&card, &spec, 0);
    double quiet_noise = edge_noise(&quiet, 4), plain_noise = edge_noise(&plain, 4);
    printf("  noise %g with twigs, %g without\n", quiet_noise, plain_noise);
    assert_true(quiet_noise * 4 < plain_noise);
    kit_picture_free(&quiet);
    kit_picture_free(&plain);
    scene_release(&lamp);
    scene_release(&card);
}

/* Twigs belong to pixels of the full picture, whatever the cells. */
static void cutting_changes_nothing(void **state)
{
    (void)state;
    struct scene s;
    make_scene(&s, 4.4);
    struct job_spec spec = kit_spec(SIDE, 16);
    spec.tile = 16;
    struct kit_picture whole = kit_render(&s, &spec, 0);
    spec.tile = 3;
    struct kit_picture cut = kit_render(&s, &spec, 1);
    assert_memory_equal(whole.mean, cut.mean, sizeof *cut.mean * 3 * SIDE * SIDE);
    kit_picture_free(&whole);
    kit_picture_free(&cut);
    scene_release(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(coverage_is_right),
                                       cmocka_unit_test(outlines_are_quiet),
                                       cmocka_unit_test(cutting_changes_nothing)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
