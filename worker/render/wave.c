#include "worker/render/wave.h"

#include "worker/render/shade.h"

#include <string.h>

uint32_t wave_group_side(const struct render_scene *scene)
{
    return reuse_wanted(scene) ? WAVE_GROUP_SIDE : 1;
}

/* Sets a ray to go on behind the surface that it hit. `end` is where a shadow ray ends, or NULL. */
static void pass_through(const struct render_scene *scene, const struct hit *hit, struct ray *ray,
                         const double *end)
{
    struct surface s;
    surface_of_hit(scene, hit, &s);
    vec3 dir = v3_of(ray->dir);
    vec3 org = surface_offset(s.p, s.ng, s.error, dir);
    v3_put(ray->org, org);
    if (end)
        v3_put(ray->dir, v3_sub(v3_of(end), org));
}

/* Draws by opacity whether ray i goes through what it hit, and sets it to go on behind. */
static bool pass_ray(const struct render_scene *scene, struct render_scratch *w, uint32_t i)
{
    struct path *path = &w->paths[w->active[i]];
    if (w->hits[i].object == SCENE_NONE)
        return false;
    double opacity = shade_opacity(scene, &w->hits[i], v3_of(w->rays[i].dir));
    if (!(opacity < 1) || path->asked >= WAVE_PASSES_MAX)
        return false;
    double u[SAMPLER_SET_VALUES] = {0};
    /* Every surface has a number of its own, whether it lets the path through or not. */
    if (opacity > 0)
        sampler_set(&path->sampler, WAVE_SET_PASS + path->asked, u);
    path->asked++;
    if (u[0] < opacity)
        return false;
    pass_through(scene, &w->hits[i], &w->rays[i], NULL);
    return true;
}

/* Rays that alpha lets through, in rounds: each casts those that the last one let through. */
static void pass_rays(const struct render_scene *scene, struct render_scratch *w)
{
    uint32_t passed;
    memset(w->passing, 1, w->active_count);
    do {
        passed = 0;
        for (uint32_t i = 0; i < w->active_count; i++) {
            w->passing[i] = w->passing[i] && pass_ray(scene, w, i);
            passed += w->passing[i];
        }
        accel_closest_masked(scene->accel, w->rays, w->passing, w->active_count, w->hits);
        w->ray_count += passed;
    } while (passed > 0);
}

void wave_trace(const struct render_scene *scene, struct render_scratch *w)
{
    accel_closest_batch(scene->accel, w->rays, w->active_count, w->hits);
    w->ray_count += w->active_count;
    if (scene->has_alpha)
        pass_rays(scene, w);
}

void wave_shade(const struct render_scene *scene, struct render_scratch *w, uint32_t i,
                const struct footprint *footprint, struct shade *out)
{
    shade_of_hit(scene, &w->hits[i], v3_of(w->rays[i].dir), footprint, &w->lacks, out);
}

struct footprint *wave_arrive(const struct render_scene *scene, struct render_scratch *w,
                              uint32_t i)
{
    if (!scene->has_filtered || w->hits[i].object == SCENE_NONE)
        return NULL;
    struct footprint *f = &w->footprints[w->active[i]];
    footprint_arrive(f, w->paths[w->active[i]].org, &w->rays[i], &w->hits[i]);
    return f;
}

void wave_leave(const struct render_scene *scene, const struct shade *at, const struct hit *hit,
                vec3 dir, vec3 wi, const struct bsdf_sample *sample, struct footprint *f)
{
    if (!(sample->flags & BSDF_DELTA))
        footprint_scatter(wi, sample->pdf, scene->footprint_step, f);
    else if (sample->flags & BSDF_TRANSMIT)
        footprint_refract(scene, hit, at->surface.ns, dir, wi, at->bsdf.material->eta, f);
    else
        footprint_mirror(scene, hit, at->surface.ns, dir, f);
}

void wave_draw(struct render_scratch *w, uint32_t set, double u[][WAVE_PATHS])
{
    for (uint32_t i = 0; i < w->active_count; i++)
        w->samplers[i] = w->paths[w->active[i]].sampler;
    double *const values[SAMPLER_SET_VALUES] = {u[0], u[1], u[2], u[3]};
    sampler_sets(w->samplers, w->active_count, set, SAMPLER_SET_VALUES, values);
}

void wave_shadow(struct render_scratch *w, uint32_t path, vec3 org, vec3 target, bool distant,
                 vec3 wi, rgb radiance)
{
    struct ray *ray = &w->shadow_rays[w->shadow_count];
    v3_put(ray->org, org);
    v3_put(ray->dir, distant ? wi : v3_sub(target, org));
    ray->tmin = 0;
    ray->tmax = distant ? VEC_INFINITY : 1;
    w->shadow_path[w->shadow_count] = path;
    w->shadow_radiance[w->shadow_count] = radiance;
    w->looks[w->shadow_count].light = SCENE_NONE;
    w->shadow_count++;
}

/* Takes what shadow ray i has hit from its light; true if some is left and the ray goes on. */
static bool dim_shadow(const struct render_scene *scene, struct render_scratch *w, uint32_t i)
{
    const struct hit *hit = &w->shadow_hits[i];
    struct ray *ray = &w->shadow_rays[i];
    if (hit->object == SCENE_NONE) {
        w->occluded[i] = 0;
        return false;
    }
    w->shadow_left[i] *= 1 - shade_opacity(scene, hit, v3_of(ray->dir));
    if (!(w->shadow_left[i] > 0))
        return false;
    pass_through(scene, hit, ray, isinf(ray->tmax) ? NULL : w->shadow_end[i]);
    return true;
}

/* What alpha leaves of the light along shadow rays that something blocks, all a surface further a
 * round. */
static void look_through(const struct render_scene *scene, struct render_scratch *w)
{
    uint32_t going = 0;
    for (uint32_t i = 0; i < w->shadow_count; i++) {
        const struct ray *ray = &w->shadow_rays[i];
        w->shadow_left[i] = 1;
        for (int k = 0; k < 3; k++)
            w->shadow_end[i][k] = ray->org[k] + ray->dir[k];
        w->passing[i] = w->occluded[i] != 0;
        going += w->passing[i];
    }
    for (int round = 0; round < WAVE_PASSES_MAX && going > 0; round++) {
        accel_closest_masked(scene->accel, w->shadow_rays, w->passing, w->shadow_count,
                             w->shadow_hits);
        w->ray_count += going;
        going = 0;
        for (uint32_t i = 0; i < w->shadow_count; i++) {
            w->passing[i] = w->passing[i] && dim_shadow(scene, w, i);
            going += w->passing[i];
        }
    }
    for (uint32_t i = 0; i < w->shadow_count; i++)
        w->shadow_radiance[i] = rgb_scale(w->shadow_radiance[i], w->shadow_left[i]);
}

void wave_gather(const struct render_scene *scene, struct render_scratch *w)
{
    accel_occluded_batch(scene->accel, w->shadow_rays, w->shadow_count, w->occluded);
    w->ray_count += w->shadow_count;
    if (scene->has_alpha)
        look_through(scene, w);
    for (uint32_t i = 0; i < w->shadow_count; i++) {
        if (w->occluded[i])
            continue;
        struct path *path = &w->paths[w->shadow_path[i]];
        path->radiance = rgb_add(path->radiance, w->shadow_radiance[i]);
    }
    if (through_wanted(scene))
        through_gather(scene, w);
    w->shadow_count = 0;
}
