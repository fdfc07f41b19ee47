#include "worker/render/first_hit.h"

#include <float.h>

#include "worker/render/shade.h"

/* Appends the components of an AOV that is wanted. */
static void put(uint32_t set, enum aov a, const double *components, double *out, uint32_t *count)
{
    if (!aov_has(set, a))
        return;
    for (uint32_t i = 0; i < aov_table[a].channel_count; i++)
        out[(*count)++] = fabs(components[i]) <= (double)FLT_MAX ? components[i] : 0;
}

static void put_vec(uint32_t set, enum aov a, vec3 v, double *out, uint32_t *count)
{
    put(set, a, (const double[]){v.x, v.y, v.z}, out, count);
}

/* --- Means ---------------------------------------------------------------- */

/* Reflectance of a conductor at normal incidence, in vacuum. */
static double conductor_normal(double eta, double k)
{
    return ((eta - 1) * (eta - 1) + k * k) / ((eta + 1) * (eta + 1) + k * k);
}

/* The colour of a surface: what a denoiser divides by. What sends light on without scattering it
 * has that of its tints. */
static rgb albedo_of(const struct bsdf *b)
{
    const struct material *m = b->material;
    rgb n = m->conductor_eta, k = m->conductor_k;
    switch (m->type) {
    case SCENE_MATERIAL_MIRROR:
        return rgb_mul(b->color, m->R);
    case SCENE_MATERIAL_GLASS:
    case SCENE_MATERIAL_ROUGH_DIELECTRIC:
        return m->T;
    case SCENE_MATERIAL_ROUGH_CONDUCTOR:
        return rgb_mul(b->color, (rgb){conductor_normal(n.r, k.r), conductor_normal(n.g, k.g),
                                       conductor_normal(n.b, k.b)});
    case SCENE_MATERIAL_BLACK:
        return rgb_grey(0);
    case SCENE_MATERIAL_DIFFUSE:
    case SCENE_MATERIAL_REFRACTION:
    case SCENE_MATERIAL_PRINCIPLED:
        break;
    }
    return b->color;
}

void first_hit_means(const struct render_scene *scene, struct render_scratch *w)
{
    uint32_t set = scene->spec.aov;
    for (uint32_t i = 0; i < w->path_count; i++) {
        double *out = w->means[w->active[i]];
        uint32_t count = 0;
        struct shade at = {0};
        rgb albedo = rgb_grey(0);
        if (w->hits[i].object != SCENE_NONE) {
            struct footprint copy, *there = NULL;
            if (scene->has_filtered) {
                copy = w->footprints[w->active[i]];
                there = &copy;
                footprint_arrive(there, w->paths[w->active[i]].org, &w->rays[i], &w->hits[i]);
            }
            wave_shade(scene, w, i, there, &at);
            albedo = albedo_of(&at.bsdf);
        }
        put_vec(set, AOV_NORMAL, at.surface.ns, out, &count);
        put_vec(set, AOV_NG, at.surface.ng, out, &count);
        put(set, AOV_ALBEDO, (const double[]){albedo.r, albedo.g, albedo.b}, out, &count);
    }
}

/* --- Centres -------------------------------------------------------------- */

static void aim(const struct render_scene *scene, struct grid_rect rect, uint64_t pixel,
                struct render_scratch *w, uint32_t slot)
{
    static const double lens[2] = {0.5, 0.5};
    vec3 org, dir;
    camera_ray(&scene->camera, rect.x + (double)(pixel % rect.width) + 0.5,
               rect.y + (double)(pixel / rect.width) + 0.5, lens, &org, &dir);
    wave_continue(w, slot, slot, org, dir);
    w->paths[slot].org = org;
}

/* Goes on through what is less than half opaque. */
static void pass(const struct render_scene *scene, struct render_scratch *w, uint32_t slot)
{
    for (uint32_t passes = 0; passes < WAVE_PASSES_MAX; passes++) {
        vec3 dir = v3_of(w->rays[slot].dir);
        if (w->hits[slot].object == SCENE_NONE || shade_opacity(scene, &w->hits[slot], dir) >= 0.5)
            return;
        struct surface s;
        surface_of_hit(scene, &w->hits[slot], &s);
        v3_put(w->rays[slot].org, surface_offset(s.p, s.ng, s.error, dir));
        accel_closest(scene->accel, &w->rays[slot], &w->hits[slot]);
        w->ray_count++;
    }
}

/* Values of one pixel's middle, in the order of the table. */
static void centre_values(const struct render_scene *scene, const struct hit *hit, vec3 org,
                          double *out)
{
    uint32_t set = scene->spec.aov, count = 0;
    struct surface s = {.material = SCENE_NONE};
    double depth = 0, object = 0, material = 0;
    vec3 world = {0, 0, 0};
    if (hit->object != SCENE_NONE) {
        surface_of_hit(scene, hit, &s);
        depth = v3_length(v3_sub(s.p, org)) / scene->scale;
        world = v3_mad(v3_of(scene->center), s.p, 1 / scene->scale);
        object = hit->object + 1.0;
        /* The last material stands for none. */
        material =
            s.material + 1 < scene->material_count ? scene->materials[s.material].number + 1.0 : 0;
    }
    put(set, AOV_DEPTH, &depth, out, &count);
    put_vec(set, AOV_POSITION, world, out, &count);
    put(set, AOV_UV, (const double[]){s.u, s.v}, out, &count);
    put(set, AOV_OBJECT, &object, out, &count);
    put(set, AOV_MATERIAL, &material, out, &count);
}

void first_hit_centres(const struct render_scene *scene, struct render_scratch *w,
                       struct grid_rect rect, float *planes, uint64_t plane_pixels, uint64_t place)
{
    uint32_t plane_count = aov_planes(scene->spec.aov, AOV_CENTRE);
    uint64_t pixels = (uint64_t)rect.width * rect.height;
    for (uint64_t begin = 0; begin < pixels; begin += WAVE_PATHS) {
        uint32_t count = (uint32_t)(pixels - begin < WAVE_PATHS ? pixels - begin : WAVE_PATHS);
        for (uint32_t i = 0; i < count; i++)
            aim(scene, rect, begin + i, w, i);
        accel_closest_batch(scene->accel, w->rays, count, w->hits);
        w->ray_count += count;
        for (uint32_t i = 0; i < count; i++) {
            double values[AOV_PLANES_MAX];
            if (scene->has_alpha)
                pass(scene, w, i);
            centre_values(scene, &w->hits[i], w->paths[i].org, values);
            for (uint32_t k = 0; k < plane_count; k++)
                planes[k * plane_pixels + place + begin + i] = (float)values[k];
        }
    }
}
