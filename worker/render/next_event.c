#include "worker/render/next_event.h"

uint32_t next_event_count(const struct render_scene *scene, const struct material *m)
{
    size_t lights = scene->lights.count;
    if (lights < 2 || m->type == SCENE_MATERIAL_DIFFUSE)
        return 1;
    return lights < NEXT_EVENT_CANDIDATES_MAX / 2 ? 2 * (uint32_t)lights
                                                  : NEXT_EVENT_CANDIDATES_MAX;
}

vec3 next_event_side(const struct shade *at)
{
    if (at->bsdf.material->transmits)
        return v3(0, 0, 0);
    return at->wo.z < 0 ? v3_neg(at->frame.n) : at->frame.n;
}

/* One candidate of `count`. */
static bool draw_one(const struct render_scene *scene, const struct shade *at, uint32_t count,
                     double choose, double u, double v, struct next_event *out)
{
    struct light_sample *light = &out->light;
    if (!light_sample(&scene->lights, at->surface.p, next_event_side(at), choose, u, v, light))
        return false;
    vec3 wi = frame_to_local(&at->frame, light->wi);
    if (!shade_is_consistent(at, light->wi, wi.z))
        return false;
    double pdf;
    rgb f = bsdf_eval(&at->bsdf, at->wo, wi, &pdf);
    if (rgb_is_black(f))
        return false;
    double weight = shade_tilt_shadowing(at, light->wi, wi.z) / light->pdf;
    if (!light->delta && scene->spec.profile == JOB_PROFILE_MIS)
        weight *= light->distant ? next_event_sky_weight(count * light->pdf, pdf)
                                 : next_event_weight(count * light->pdf, pdf);
    out->arriving = rgb_scale(rgb_mul(f, light->radiance), weight);
    return true;
}

/* x + k a, wrapped into [0,1). */
static double turned(double x, uint32_t k, double a)
{
    double sum = x + k * a;
    return sum - (double)(uint32_t)sum;
}

bool next_event_draw(const struct render_scene *scene, const struct shade *at, uint32_t count,
                     double choose, double keep, const double u[2], struct next_event *out)
{
    /* The powers of 1 / 1.3247..., whose multiples spread evenly over the square (Roberts 2018). */
    static const double TURN_U = 0.7548776662466927, TURN_V = 0.5698402909980532;
    if (count == 1)
        return draw_one(scene, at, 1, choose, u[0], u[1], out);
    double sum = 0, kept = 0;
    for (uint32_t k = 0; k < count; k++) {
        struct next_event one;
        if (!draw_one(scene, at, count, (choose + k) / count, turned(u[0], k, TURN_U),
                      turned(u[1], k, TURN_V), &one))
            continue;
        double brings = rgb_luminance(one.arriving);
        sum += brings;
        double share = brings / sum;
        if (!(share > 0))
            continue;
        /* Within either part `keep` is uniform again. */
        bool takes = keep < share;
        keep = takes ? keep / share : (keep - share) / (1 - share);
        if (takes) {
            *out = one;
            kept = brings;
        }
    }
    if (!(kept > 0))
        return false;
    out->arriving = rgb_scale(out->arriving, sum / (kept * count));
    return true;
}
