/* intersection_test, the source report's integrator: one point light, direct light on the
 * first diffuse surface behind any number of specular ones. L = flux / r^2 * albedo / pi * cos,
 * without 1 / (4 pi): the report's convention, kept for its files. */
#include "worker/render/shade.h"
#include "worker/render/wave.h"

/* Direct light at a diffuse surface, by a shadow ray. */
static void connect_light(const struct render_scene *scene, struct render_scratch *w,
                          uint32_t index, const struct shade *at)
{
    const struct surface *s = &at->surface;
    vec3 to_light = v3_sub(scene->seed_light_position, s->p);
    double distance2 = v3_dot(to_light, to_light);
    double cosine = v3_dot(s->ns, to_light) / sqrt(distance2);
    if (!(cosine > 0))
        return;
    rgb f = rgb_scale(at->bsdf.color, VEC_INV_PI * cosine / distance2);
    rgb arriving = rgb_mul(rgb_mul(f, scene->seed_light_flux), w->paths[index].beta);
    vec3 org = surface_offset(s->p, s->ng, s->error, to_light);
    wave_shadow(w, index, org, scene->seed_light_position, false, to_light, arriving);
}

/* Ends the path in light or nothing, or turns it at a specular surface: then true. */
static bool advance(const struct render_scene *scene, struct render_scratch *w, uint32_t from,
                    uint32_t depth, uint32_t slot)
{
    const struct hit *hit = &w->hits[from];
    uint32_t index = w->active[from];
    if (hit->object == SCENE_NONE || scene->objects[hit->object].light_begin != SCENE_NONE)
        return false;
    struct path *path = &w->paths[index];
    struct shade at;
    vec3 dir = v3_of(w->rays[from].dir);
    struct footprint *footprint = wave_arrive(scene, w, from);
    wave_shade(scene, w, from, footprint, &at);
    const struct material *m = at.bsdf.material;
    if (m->type == SCENE_MATERIAL_DIFFUSE)
        connect_light(scene, w, index, &at);
    if (!m->is_delta || depth == scene->spec.max_depth)
        return false;
    double u[SAMPLER_SET_VALUES] = {0};
    if (m->type == SCENE_MATERIAL_GLASS)
        sampler_set(&path->sampler, WAVE_SET_CHOICE + (depth - 1) * WAVE_SETS_PER_VERTEX, u);
    const double lobe[3] = {0, 0, u[0]};
    struct bsdf_sample sample;
    if (!bsdf_sample(&at.bsdf, at.wo, lobe, &sample))
        return false;
    path->beta = rgb_mul(path->beta, sample.weight);
    vec3 wi = v3_unit(frame_to_world(&at.frame, sample.wi));
    const struct surface *s = &at.surface;
    if (footprint) {
        wave_leave(scene, &at, hit, dir, wi, &sample, footprint);
        path->org = s->p;
    }
    wave_continue(w, slot, index, surface_offset(s->p, s->ng, s->error, wi), wi);
    return true;
}

void integrate_seed(const struct render_scene *scene, struct render_scratch *w)
{
    for (uint32_t depth = 1; w->active_count > 0 && depth <= scene->spec.max_depth; depth++) {
        if (depth > 1)
            wave_trace(scene, w);
        uint32_t kept = 0;
        for (uint32_t i = 0; i < w->active_count; i++)
            kept += advance(scene, w, i, depth, kept);
        w->active_count = kept;
        wave_gather(scene, w);
    }
}
