/* tests/numerics/light_step.h: one light path, surface by surface, as the integrators walk it.
 *
 * For tests of what bends light. In scene space; materials of `refraction` always go on. Tests
 * only.
 */
#ifndef TESTS_NUMERICS_LIGHT_STEP_H
#define TESTS_NUMERICS_LIGHT_STEP_H

#include "worker/render/shade.h"

/* One surface on: false when nothing is hit or nothing goes on. *object is what was hit, if
 * anything was. The direction is made unit as the integrators make it. */
static inline bool light_step(const struct render_scene *rs, vec3 *org, vec3 *dir, uint32_t *object)
{
    struct ray ray = {.tmax = VEC_INFINITY};
    struct hit hit;
    struct shade at;
    struct bsdf_sample sample;
    static const double u[3] = {0, 0, 0.999999};
    v3_put(ray.org, *org);
    v3_put(ray.dir, *dir);
    accel_closest(rs->accel, &ray, &hit);
    if (hit.object == SCENE_NONE)
        return false;
    *object = hit.object;
    shade_of_hit(rs, &hit, *dir, NULL, NULL, &at);
    if (!bsdf_sample(&at.bsdf, at.wo, u, &sample))
        return false;
    *dir = v3_unit(frame_to_world(&at.frame, sample.wi));
    *org = surface_offset(at.surface.p, at.surface.ng, at.surface.error, *dir);
    return true;
}

#endif
