/* Surfaces that are not opaque, and paths that meet them again and again.
 *
 * A path that a surface had held was held by each that it met afterwards, as one number decided of
 * all of them. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>

#include "tests/render/render_kit.h"

/* Of several hundred comparisons, none is off by so many standard deviations by chance. */
static const double z_max = 5;

/* A mirror that lets half of the light through before a lamp, a mirror that lets none through
 * behind the camera: of what comes back every time half goes on to the lamp. */
static void every_surface_is_asked_anew(void **state)
{
    (void)state;
    enum { MEETINGS = 4 };
    static const double sheet[12] = {-9, -9, 0, 9, -9, 0, 9, 9, 0, -9, 9, 0};
    for (int profile = 0; profile < 3; profile++) {
        struct scene s;
        struct scene_material *m;
        scene_init(&s);
        kit_emit(&s, kit_quad(&s, sheet, SCENE_NONE), 1, 1, 1);
        kit_quad(&s, sheet, kit_material(&s, SCENE_MATERIAL_MIRROR, &m));
        m->alpha_used = true;
        m->alpha = 0.5;
        m->alpha_cutoff = -1;
        m->R[0] = m->R[1] = m->R[2] = 1;
        kit_quad(&s, sheet, kit_material(&s, SCENE_MATERIAL_MIRROR, &m));
        m->R[0] = m->R[1] = m->R[2] = 1;
        static const double at[3] = {0, 1, 2}; /* of the lamp, and of the mirrors before it */
        for (size_t i = 0; i < 3; i++)
            s.objects[i].transform[11] = at[i];
        s.camera.type = SCENE_CAMERA_ORTHOGRAPHIC;
        s.camera.ortho_height = 1;
        s.camera.position[2] = 1.5;
        s.camera.look_at[2] = 0;
        struct job_spec spec = kit_spec(16, 64);
        spec.profile = (enum job_profile)profile;
        spec.rr_threshold = 0;
        spec.max_depth = 2 * MEETINGS - 1;
        struct kit_picture p = kit_render(&s, &spec, 0);
        double mean = kit_picture_mean(&p), expected = 1 - pow(0.5, MEETINGS);
        print_message("  %s: %g for %g\n", job_profile_names[profile], mean, expected);
        /* As many coins were thrown. */
        assert_true(fabs(mean - expected) <
                    z_max * sqrt(expected * (1 - expected) / (16 * 16 * 64)));
        kit_picture_free(&p);
        scene_release(&s);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_surface_is_asked_anew),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
