#include "worker/render/next_event.h"

_Static_assert((int)NEXT_EVENT_CANDIDATES_MAX <= (int)LIGHT_TREE_DRAWS_MAX,
               "light_sample_many draws them all");
_Static_assert((int)NEXT_EVENT_CANDIDATES_MAX == (int)BSDF_MANY, "bsdf_eval_many takes them all");

uint32_t next_event_count(const struct render_scene *scene, const struct material *m)
{
    size_t lights = scene->lights.count;
    if (lights < 2 || m->type == SCENE_MATERIAL_DIFFUSE)
        return 1;
    return lights < NEXT_EVENT_CANDIDATES_MAX / 2 ? 2 * (uint32_t)lights
                                                  : NEXT_EVENT_CANDIDATES_MAX;
}

uint32_t next_event_points(const struct render_scene *scene, bool first)
{
    return first && scene->lights.environment.present ? NEXT_EVENT_POINTS_MAX : 1;
}

vec3 next_event_side(const struct shade *at)
{
    if (at->bsdf.material->transmits)
        return v3(0, 0, 0);
    return at->wo.z < 0 ? v3_neg(at->frame.n) : at->frame.n;
}

/* What a candidate, one of `count`, sends back along the path from wi with that local z. */
static rgb arriving_from(const struct render_scene *scene, const struct shade *at, uint32_t count,
                         const struct light_sample *light, double wi_z, rgb f, double pdf)
{
    double weight = shade_tilt_shadowing(at, light->wi, wi_z) / light->pdf;
    if (!light->delta && scene->spec.profile == JOB_PROFILE_MIS)
        weight *= light->distant ? next_event_sky_weight(at->bsdf.material, count * light->pdf, pdf)
                                 : next_event_weight(count * light->pdf, pdf);
    return rgb_scale(rgb_mul(f, light->radiance), weight);
}

bool next_event_weigh(const struct render_scene *scene, const struct shade *at, uint32_t points,
                      const struct light_sample *light, struct next_event_view *view)
{
    double wi_z = v3_dot(at->frame.n, light->wi), pdf;
    if (!shade_is_consistent(at, light->wi, wi_z))
        return false;
    rgb f = at->bsdf.material->type == SCENE_MATERIAL_DIFFUSE
                ? bsdf_diffuse_eval(&at->bsdf, at->wo.z, wi_z, &pdf)
                : bsdf_eval(&at->bsdf, at->wo, frame_to_local(&at->frame, light->wi), &pdf);
    view->arriving = rgb_scale(arriving_from(scene, at, points, light, wi_z, f, pdf), 1.0 / points);
    view->f = rgb_scale(f, shade_tilt_shadowing(at, light->wi, wi_z));
    view->pdf = pdf;
    return !rgb_is_black(f);
}

/* The only candidate. */
static bool draw_one(const struct render_scene *scene, const struct shade *at, double choose,
                     const double u[2], struct next_event *out)
{
    struct next_event_view view;
    if (!light_sample(&scene->lights, at->surface.p, next_event_side(at), choose, u[0], u[1],
                      &out->light) ||
        !next_event_weigh(scene, at, 1, &out->light, &view))
        return false;
    out->arriving = view.arriving;
    return true;
}

/* What the candidates in `there`, of `count`, send back along the path; black: nothing. */
static void weigh(const struct render_scene *scene, const struct shade *at, uint32_t count,
                  uint32_t there, const struct light_sample lights[], rgb arriving[])
{
    vec3 wi[BSDF_MANY] = {{0}};
    double pdf[BSDF_MANY];
    for (uint32_t k = 0; k < count; k++) {
        if (there >> k & 1)
            wi[k] = frame_to_local(&at->frame, lights[k].wi);
        if (!(there >> k & 1) || !shade_is_consistent(at, lights[k].wi, wi[k].z))
            there &= ~(1u << k);
    }
    rgb f[BSDF_MANY];
    bsdf_eval_many(&at->bsdf, at->wo, there, wi, f, pdf);
    for (uint32_t k = 0; k < count; k++)
        arriving[k] = !(there >> k & 1) || rgb_is_black(f[k])
                          ? rgb_grey(0)
                          : arriving_from(scene, at, count, &lights[k], wi[k].z, f[k], pdf[k]);
}

/* x + k a, wrapped into [0,1). */
static double turned(double x, uint32_t k, double a)
{
    double sum = x + k * a;
    return sum - (double)(uint32_t)sum;
}

/* `count` samples of lights; bit k of the result: sample k is there. */
static uint32_t draw_lights(const struct render_scene *scene, const struct shade *at,
                            uint32_t count, double choose, const double u[2],
                            struct light_sample lights[])
{
    /* The powers of 1 / 1.3247..., whose multiples spread evenly over the square (Roberts 2018). */
    static const double TURN_U = 0.7548776662466927, TURN_V = 0.5698402909980532;
    double chooses[NEXT_EVENT_CANDIDATES_MAX], us[NEXT_EVENT_CANDIDATES_MAX],
        vs[NEXT_EVENT_CANDIDATES_MAX];
    for (uint32_t k = 0; k < count; k++) {
        chooses[k] = (choose + k) / count;
        us[k] = turned(u[0], k, TURN_U);
        vs[k] = turned(u[1], k, TURN_V);
    }
    return light_sample_many(&scene->lights, at->surface.p, next_event_side(at), count, chooses, us,
                             vs, lights);
}

bool next_event_draw(const struct render_scene *scene, const struct shade *at, uint32_t count,
                     double choose, double keep, const double u[2], struct next_event *out)
{
    if (count == 1)
        return draw_one(scene, at, choose, u, out);
    struct light_sample lights[NEXT_EVENT_CANDIDATES_MAX];
    uint32_t there = draw_lights(scene, at, count, choose, u, lights), kept = 0;
    double sum = 0, kept_brings = 0;
    rgb arriving[NEXT_EVENT_CANDIDATES_MAX];
    weigh(scene, at, count, there, lights, arriving);
    for (uint32_t k = 0; k < count; k++) {
        double brings = rgb_luminance(arriving[k]);
        if (brings == 0)
            continue;
        sum += brings;
        /* What is no number is kept, to be counted. Within either part `keep` is uniform again. */
        double share = brings / sum;
        bool takes = !(keep >= share);
        keep = takes ? keep / share : (keep - share) / (1 - share);
        if (takes) {
            kept = k;
            kept_brings = brings;
        }
    }
    if (kept_brings == 0)
        return false;
    out->light = lights[kept];
    out->arriving = rgb_scale(arriving[kept], sum / (kept_brings * count));
    return true;
}
