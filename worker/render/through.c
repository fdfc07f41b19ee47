#include "worker/render/through.h"

#include "worker/render/wave.h"

/* Glass is in front of a light if it is nearer by this much, told alike from both ends. */
static const double IN_FRONT = 0.999;

bool through_wanted(const struct render_scene *scene)
{
    const struct job_spec *spec = &scene->spec;
    return scene->has_glass && !scene->has_alpha && spec->integrator == JOB_INTEGRATOR_PATH &&
           spec->profile == JOB_PROFILE_MIS;
}

struct through through_of(const struct render_scene *scene, const struct shade *at, bool first,
                          vec3 wi, double density)
{
    bool looks = through_wanted(scene) && next_event_count(scene, at->bsdf.material) == 1;
    return (struct through){.org = at->surface.p,
                            .n = next_event_side(at),
                            .wi = wi,
                            .density = density,
                            .points = looks ? next_event_points(scene, first) : 0};
}

void through_turn(struct through *t, const struct material *m, const struct bsdf_sample *sample,
                  double distance)
{
    if (!(sample->flags & BSDF_TRANSMIT) || !replay_passes(m))
        t->points = 0;
    if (t->count++ == 0)
        t->first = distance;
    t->density *= sample->pdf;
}

uint32_t through_light(const struct render_scene *scene, const struct surface *s)
{
    return scene->object_lights[scene->objects[s->object].light_begin + s->primitive];
}

double through_weight(const struct render_scene *scene, const struct through *t, uint32_t light)
{
    if (t->points == 0 || t->count == 0 || light == SCENE_NONE)
        return 1;
    double pdf = light_pdf_towards(&scene->lights, light, t->org, t->n, t->wi, t->first / IN_FRONT);
    return next_event_balance(t->density, t->points * pdf);
}

void through_note(const struct render_scene *scene, struct render_scratch *w, uint32_t depth,
                  uint32_t points, const struct light_sample *light,
                  const struct next_event_view *view)
{
    /* Through a surface and to the light: two edges more. */
    if (light->delta || depth + 2 > scene->spec.max_depth)
        return;
    uint32_t shadow = w->shadow_count - 1;
    const struct path *path = &w->paths[w->shadow_path[shadow]];
    rgb beta = rgb_scale(path->beta, path->share);
    w->looks[shadow] = (struct through_look){.light = light->light,
                                             .depth = depth,
                                             .dir = light->wi,
                                             .value = rgb_mul(beta, view->f),
                                             .density = view->pdf,
                                             .light_rate = points * light->pdf};
}

/* Adds what the light of shadow ray i brings through the glass. */
static void add_light(struct render_scratch *w, uint32_t i, rgb radiance)
{
    const struct through_look *l = &w->looks[i];
    struct path *path = &w->paths[w->shadow_path[i]];
    rgb found = rgb_mul(l->value, radiance);
    path->radiance = rgb_add(path->radiance, rgb_scale(found, 1 / (l->light_rate + l->density)));
}

/* Shadow ray i, after `turn` surfaces, at the next: true if it goes on through it. */
static bool look_on(const struct render_scene *scene, struct render_scratch *w, uint32_t i,
                    uint32_t turn)
{
    struct through_look *l = &w->looks[i];
    const struct hit *hit = &w->shadow_hits[i];
    struct ray *ray = &w->shadow_rays[i];
    bool at_sky = l->light == scene->lights.environment_light;
    rgb light;
    if (hit->object == SCENE_NONE) {
        double pdf;
        if (turn > 0 && at_sky)
            add_light(w, i, environment_radiance(&scene->lights, l->dir, l->dir, &pdf));
        return false;
    }
    if (turn == 0 && !at_sky && !(hit->t < IN_FRONT))
        return false;
    struct shade at;
    shade_of_hit(scene, hit, l->dir, NULL, &w->lacks, &at);
    if (turn > 0 && replay_lamp(scene, &at.surface, l->dir, &light)) {
        if (through_light(scene, &at.surface) == l->light)
            add_light(w, i, light);
        return false;
    }
    if (l->depth + turn + 2 > scene->spec.max_depth ||
        !replay_take(&at, true, &l->dir, &l->value, &l->density))
        return false;
    const struct surface *s = &at.surface;
    v3_put(ray->org, surface_offset(s->p, s->ng, s->error, l->dir));
    v3_put(ray->dir, l->dir);
    ray->tmax = VEC_INFINITY;
    return true;
}

void through_gather(const struct render_scene *scene, struct render_scratch *w)
{
    uint32_t going = 0;
    for (uint32_t i = 0; i < w->shadow_count; i++) {
        w->passing[i] = w->occluded[i] && w->looks[i].light != SCENE_NONE;
        going += w->passing[i];
    }
    for (uint32_t turn = 0; going > 0; turn++) {
        accel_closest_masked(scene->accel, w->shadow_rays, w->passing, w->shadow_count,
                             w->shadow_hits);
        w->ray_count += going;
        going = 0;
        for (uint32_t i = 0; i < w->shadow_count; i++) {
            w->passing[i] = w->passing[i] && look_on(scene, w, i, turn);
            going += w->passing[i];
        }
    }
}
