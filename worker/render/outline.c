#include "worker/render/outline.h"

#include "worker/render/wave.h"

/* Corners that shine alike but for this part of the brighter one have no outline between them. */
static const double ALIKE = 0.1;

enum { CORNERS = (WAVE_GROUP_SIDE + 1) * (WAVE_GROUP_SIDE + 1) };

/* What a lamp sends along the ray that hit it. */
static double light_at(const struct render_scene *scene, const struct ray *ray,
                       const struct hit *hit)
{
    if (hit->object == SCENE_NONE || scene->objects[hit->object].light_begin == SCENE_NONE)
        return 0;
    const struct render_object *object = &scene->objects[hit->object];
    struct surface s;
    surface_of_hit(scene, hit, &s);
    bool faces = object->emission_twosided || v3_dot(s.ng, v3_of(ray->dir)) < 0;
    return faces ? rgb_luminance(object->radiance) : 0;
}

static bool differ(const double corners[4])
{
    double least = corners[0], most = corners[0];
    for (int k = 1; k < 4; k++) {
        least = corners[k] < least ? corners[k] : least;
        most = corners[k] > most ? corners[k] : most;
    }
    return most - least > ALIKE * most;
}

uint32_t outline_pixels(const struct render_scene *scene, struct render_scratch *w,
                        struct grid_rect group)
{
    static const double lens[2] = {0.5, 0.5};
    uint32_t across = group.width + 1, count = across * (group.height + 1), out = 0;
    double light[CORNERS];
    for (uint32_t i = 0; i < count; i++) {
        vec3 org, dir;
        camera_ray(&scene->camera, group.x + (double)(i % across), group.y + (double)(i / across),
                   lens, &org, &dir);
        wave_continue(w, i, 0, org, dir);
    }
    accel_closest_batch(scene->accel, w->rays, count, w->hits);
    w->ray_count += count;
    for (uint32_t i = 0; i < count; i++)
        light[i] = light_at(scene, &w->rays[i], &w->hits[i]);
    for (uint32_t y = 0; y < group.height; y++) {
        for (uint32_t x = 0; x < group.width; x++) {
            const double *at = light + y * across + x;
            const double corners[4] = {at[0], at[1], at[across], at[across + 1]};
            out |= (uint32_t)differ(corners) << (y * group.width + x);
        }
    }
    return out;
}
