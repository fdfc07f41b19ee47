/* worker/render/next_event.h: the point on a light that a vertex casts its shadow ray to.
 *
 * A smooth surface is given one drawn by light_sample. At a glossy one the lights that count are
 * those that its lobe sees, of which the choice of a light knows nothing: there several candidates
 * are drawn, and one is kept in proportion to what it would bring (resampled importance sampling,
 * Talbot, Cline and Egbert 2005). The mean is that of one candidate. The weight of multiple
 * importance sampling is a part of what is kept or dropped, so it may be that of the candidates as
 * so many samples, and hangs on light_pdf and bsdf_eval alone.
 *
 * Under a sky most noise is in what hides it. A shadow ray is cheap beside the camera ray that led
 * there and what follows, so the first vertex of a path casts several; those after it carry less.
 *
 * Any thread. Tests: test_next_event, test_mitsuba.
 */
#ifndef WORKER_RENDER_NEXT_EVENT_H
#define WORKER_RENDER_NEXT_EVENT_H

#include "worker/render/shade.h"

enum { NEXT_EVENT_CANDIDATES_MAX = 8, NEXT_EVENT_POINTS_MAX = 4 };

struct next_event {
    struct light_sample light;
    rgb arriving; /* what it sends back along the path when nothing is in the way, over its density
                   */
};

/* How many candidates a surface of this material draws. */
uint32_t next_event_count(const struct render_scene *scene, const struct material *m);

/* The side from which a surface takes light, for light_sample. */
vec3 next_event_side(const struct shade *at);

/* How many points on lights a vertex where one candidate is enough casts shadow rays to, each to
 * one of its own; `first`: of its path. */
uint32_t next_event_points(const struct render_scene *scene, bool first);

/* A light sample as a vertex sees it. */
struct next_event_view {
    rgb arriving; /* as of next_event */
    rgb f;        /* what the surface scatters from there, times its cosine */
    double pdf;   /* with which the surface draws that direction */
};

/* The only candidate of a vertex, for one of `points` shadow rays; false if nothing arrives. */
bool next_event_weigh(const struct render_scene *scene, const struct shade *at, uint32_t points,
                      const struct light_sample *light, struct next_event_view *view);

/* Draws `count` candidates and keeps one. `choose` picks their lights, u and v their points, `keep`
 * which is kept; all uniform in [0,1), `keep` looked at only if there are several. False when
 * nothing arrives from any. */
bool next_event_draw(const struct render_scene *scene, const struct shade *at, uint32_t count,
                     double choose, double keep, const double u[2], struct next_event *out);

/* Weight of a technique with density a beside one with density b (Veach 1997, power heuristic); the
 * larger divides, so that nothing overflows. */
static inline double next_event_weight(double a, double b)
{
    if (a > b) {
        double r = b / a;
        return 1 / (1 + r * r);
    }
    double r = a / b;
    return r * r / (1 + r * r);
}

/* The same by the balance heuristic. */
static inline double next_event_balance(double a, double b)
{
    double r = a > b ? b / a : a / b;
    return (a > b ? 1 : r) / (1 + r);
}

/* True if the surface draws the sky better by itself than the sky's points are: a sharp lobe and
 * none beside it, the same all over. */
static inline bool next_event_is_sharp(const struct material *m)
{
    const double sharp = 0.15, sharp_roughness = 0.22;
    if (m->type == SCENE_MATERIAL_PRINCIPLED)
        return m->metallic == 1 && m->roughness < sharp_roughness &&
               m->metallic_roughness_texture == SCENE_NONE;
    return (m->type == SCENE_MATERIAL_ROUGH_CONDUCTOR ||
            m->type == SCENE_MATERIAL_ROUGH_DIELECTRIC) &&
           m->alpha_x < sharp && m->alpha_y < sharp;
}

/* The weight for light of the sky: a sky that is a picture is drawn so that the balance heuristic
 * gives both techniques together the density of what a diffuse surface reflects
 * (worker/scene/scene_sky.c). */
static inline double next_event_sky_weight(const struct material *m, double a, double b)
{
    return next_event_is_sharp(m) ? next_event_weight(a, b) : next_event_balance(a, b);
}

#endif
