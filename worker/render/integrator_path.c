/* Path tracing with next-event estimation and multiple importance sampling, a wave of paths at a
 * time. Profiles: RW finds lights by bsdf sampling alone, NEE by light sampling wherever that can,
 * MIS weighs both. */
#include "worker/render/next_event.h"
#include "worker/render/warp.h"
#include "worker/render/wave.h"

/* The numbers of a vertex that choose: drawn with all others of the wave, or made when the first is
 * asked for. */
struct choices {
    const double *drawn; /* WAVE_PATHS apart; NULL: not drawn */
    uint32_t set;
    bool made;
    double u[SAMPLER_SET_VALUES];
};

/* A vertex of a path, between the ray that has arrived there and what leaves. */
struct vertex {
    uint32_t from; /* the ray */
    vec3 dir;      /* and its direction */
    struct footprint *footprint;
    struct shade at;
    struct choices choices;
    uint32_t candidates; /* on lights, of which one is kept; 0: it looks for none */
    uint32_t points;     /* of the only candidate: that each have a shadow ray */
    uint32_t lit;        /* bit k: point k is there */
    struct light_sample lights[NEXT_EVENT_POINTS_MAX];
};

/* Points on lights that are drawn side by side, and whose they are. */
struct looks {
    uint32_t count;
    struct light_point points[LIGHT_POINTS_MAX];
    uint32_t vertices[LIGHT_POINTS_MAX], numbers[LIGHT_POINTS_MAX];
};

enum choice { CHOICE_LOBE, CHOICE_ROULETTE, CHOICE_LIGHT, CHOICE_CANDIDATE };

static double choose(struct choices *c, const struct path *path, enum choice which)
{
    if (c->drawn)
        return c->drawn[(size_t)which * WAVE_PATHS];
    if (!c->made)
        sampler_set(&path->sampler, c->set, c->u);
    c->made = true;
    return c->u[which];
}

/* True if light found by following a direction counts in whole, or not at all: `weight` is 1 or 0.
 * Else light sampling might have found it, too. */
static bool is_found_alone(const struct render_scene *scene, const struct path *path,
                           double pdf_light, double *weight)
{
    bool alone = path->pdf == 0 || scene->spec.profile == JOB_PROFILE_RW || pdf_light == 0;
    *weight = alone;
    return alone || scene->spec.profile == JOB_PROFILE_NEE;
}

/* Light of the sky in the directions of rays that met nothing. */
static void add_environments(const struct render_scene *scene, struct render_scratch *w,
                             uint32_t count, const uint32_t rays[])
{
    vec3 n[LIGHT_POINTS_MAX] = {{0}}, dir[LIGHT_POINTS_MAX] = {{0}};
    rgb sky[LIGHT_POINTS_MAX];
    double pdf[LIGHT_POINTS_MAX];
    for (uint32_t k = 0; k < count; k++) {
        n[k] = w->paths[w->active[rays[k]]].n;
        dir[k] = v3_of(w->rays[rays[k]].dir);
    }
    environment_radiances(&scene->lights, count, n, dir, sky, pdf);
    for (uint32_t k = 0; k < count; k++) {
        struct path *path = &w->paths[w->active[rays[k]]];
        double weight;
        if (path->pdf == 0)
            weight = through_weight(scene, &path->through, scene->lights.environment_light);
        else if (!is_found_alone(scene, path, pdf[k], &weight))
            weight = next_event_sky_weight(path->last, path->pdf, path->candidates * pdf[k]);
        weight *= path->share;
        path->radiance = rgb_add(path->radiance, rgb_scale(rgb_mul(path->beta, sky[k]), weight));
    }
}

/* True if ray `from` arrives where the first vertex of its path, which shares, has sent it. */
static bool arrives_shared(const struct render_scene *scene, const struct render_scratch *w,
                           uint32_t from)
{
    return wave_group_side(scene) > 1 && w->reuse[w->active[from]].state == REUSE_LEFT;
}

/* Ends the paths whose rays met nothing. */
static void leave_scene(const struct render_scene *scene, struct render_scratch *w)
{
    uint32_t rays[LIGHT_POINTS_MAX], count = 0;
    for (uint32_t from = 0; from < w->active_count; from++) {
        if (w->hits[from].object != SCENE_NONE)
            continue;
        if (arrives_shared(scene, w, from))
            reuse_land(w, w->active[from]);
        if (!scene->lights.environment.present)
            continue;
        rays[count++] = from;
        if (count == LIGHT_POINTS_MAX) {
            add_environments(scene, w, count, rays);
            count = 0;
        }
    }
    if (count > 0)
        add_environments(scene, w, count, rays);
}

/* Light that the surface itself emits towards where the path came from. */
static void add_emission(const struct render_scene *scene, struct path *path, const struct hit *hit,
                         const struct surface *s, vec3 dir, const struct footprint *footprint)
{
    const struct render_object *object = &scene->objects[s->object];
    double cosine = -v3_dot(s->ng, dir);
    cosine = object->emission_twosided ? fabs(cosine) : cosine;
    if (!(cosine > 0))
        return;
    uint32_t light = scene->object_lights[object->light_begin + s->primitive];
    double weight = 1;
    rgb light_in;
    if (path->pdf > 0 && light != SCENE_NONE) {
        vec3 d = v3_sub(s->p, path->org);
        double pdf = light_pdf(&scene->lights, light, path->org, path->n, v3_dot(d, d), cosine);
        if (!is_found_alone(scene, path, pdf, &weight))
            weight = next_event_weight(path->pdf, path->candidates * pdf);
    } else if (replay_lamp(scene, s, dir, &light_in)) {
        weight = through_weight(scene, &path->through, light);
    }
    light_in = rgb_mul(path->beta, object->radiance);
    /* What light sampling finds too must be the same there: at points. */
    if (object->emission_texture != SCENE_NONE || object->emission_colors)
        light_in =
            rgb_mul(light_in, shade_emission(scene, hit, s, path->pdf == 0 ? footprint : NULL));
    weight *= path->share;
    path->radiance = rgb_add(path->radiance, rgb_scale(light_in, weight));
}

/* Draws the points that are gathered, and forgets them. */
static void look(const struct render_scene *scene, struct looks *l, struct vertex vertices[])
{
    struct light_sample lights[LIGHT_POINTS_MAX];
    uint32_t there = light_sample_points(&scene->lights, l->count, l->points, lights);
    for (uint32_t i = 0; i < l->count; i++) {
        if (!(there >> i & 1))
            continue;
        vertices[l->vertices[i]].lit |= 1u << l->numbers[i];
        vertices[l->vertices[i]].lights[l->numbers[i]] = lights[i];
    }
    l->count = 0;
}

/* How many points on lights a path's vertex draws: a twig's one, since there are more of them. */
static uint32_t points_of(const struct render_scene *scene, const struct path *path, uint32_t depth)
{
    return next_event_points(scene, depth == 1 && !path->twig);
}

/* The numbers of the points of vertices that draw several: point k of one is u[..][its number times
 * NEXT_EVENT_POINTS_MAX, plus k]. Those of a pixel's samples follow each other in one sequence. */
static void draw_points(const struct render_scratch *w, uint32_t count,
                        const struct vertex vertices[],
                        double u[SAMPLER_SET_VALUES][LIGHT_POINTS_MAX * NEXT_EVENT_POINTS_MAX])
{
    struct sampler samplers[LIGHT_POINTS_MAX * NEXT_EVENT_POINTS_MAX];
    for (uint32_t k = 0; k < count; k++) {
        for (uint32_t i = 0; i < NEXT_EVENT_POINTS_MAX; i++) {
            struct sampler *s = &samplers[k * NEXT_EVENT_POINTS_MAX + i];
            *s = w->paths[w->active[vertices[k].from]].own;
            s->index = s->index * NEXT_EVENT_POINTS_MAX + i;
        }
    }
    double *const values[SAMPLER_SET_VALUES] = {u[0], u[1], u[2], u[3]};
    sampler_sets(samplers, count * NEXT_EVENT_POINTS_MAX, WAVE_SET_POINTS, 2, values);
}

/* Draws points on lights for vertices that take the first they get: side by side, since a sky that
 * is a picture is drawn many directions at once. */
static void find_lights(const struct render_scene *scene, struct render_scratch *w, uint32_t depth,
                        uint32_t count, struct vertex vertices[])
{
    double u[SAMPLER_SET_VALUES][LIGHT_POINTS_MAX * NEXT_EVENT_POINTS_MAX];
    uint32_t points = next_event_points(scene, depth == 1);
    struct looks looks = {.count = 0};
    if (points > 1)
        draw_points(w, count, vertices, u);
    for (uint32_t k = 0; k < count; k++) {
        struct vertex *v = &vertices[k];
        const struct path *path = &w->paths[w->active[v->from]];
        const struct material *m = v->at.bsdf.material;
        bool wanted = !m->is_delta && scene->spec.profile != JOB_PROFILE_RW;
        v->candidates = wanted ? next_event_count(scene, m) : 0;
        v->points = v->candidates == 1 ? points_of(scene, path, depth) : 0;
        v->lit = 0;
        if (v->candidates != 1)
            continue;
        double light = scene->lights.count > 1 ? choose(&v->choices, path, CHOICE_LIGHT) : 0;
        for (uint32_t i = 0; i < v->points; i++) {
            const uint32_t number = k * NEXT_EVENT_POINTS_MAX + i;
            struct light_point *p = &looks.points[looks.count];
            *p = (struct light_point){v->at.surface.p, next_event_side(&v->at), light,
                                      path->light_u[0], path->light_u[1]};
            if (v->points > 1) {
                p->choose = (light + i) / v->points;
                p->u = u[0][number];
                p->v = u[1][number];
            }
            looks.vertices[looks.count] = k;
            looks.numbers[looks.count++] = i;
            if (looks.count == LIGHT_POINTS_MAX)
                look(scene, &looks, vertices);
        }
    }
    look(scene, &looks, vertices);
}

/* A shadow ray to a point on a light. */
static void cast_shadow(struct render_scratch *w, const struct vertex *v,
                        const struct light_sample *light, rgb arriving)
{
    const struct surface *s = &v->at.surface;
    uint32_t index = w->active[v->from];
    vec3 org = surface_offset(s->p, s->ng, s->error, light->wi);
    const struct path *path = &w->paths[index];
    wave_shadow(w, index, org, light->target, light->distant, light->wi,
                rgb_scale(rgb_mul(arriving, path->beta), path->share));
}

/* Next-event estimation: shadow rays to points drawn on lights. */
static void connect_lights(const struct render_scene *scene, struct render_scratch *w,
                           struct vertex *v, uint32_t depth)
{
    const struct path *path = &w->paths[w->active[v->from]];
    if (v->candidates > 1) {
        struct next_event event;
        double light = choose(&v->choices, path, CHOICE_LIGHT);
        double keep = choose(&v->choices, path, CHOICE_CANDIDATE);
        if (next_event_draw(scene, &v->at, v->candidates, light, keep, path->light_u, &event))
            cast_shadow(w, v, &event.light, event.arriving);
        return;
    }
    for (uint32_t i = 0; i < v->points; i++) {
        struct next_event_view view;
        const struct light_sample *light = &v->lights[i];
        if (!(v->lit >> i & 1) || !next_event_weigh(scene, &v->at, v->points, light, &view))
            continue;
        cast_shadow(w, v, light, view.arriving);
        if (through_wanted(scene))
            through_note(scene, w, depth, v->points, light, &view);
    }
}

/* Below the threshold a path survives in proportion to what it carries, and then carries the
 * threshold again. */
static bool survives(const struct render_scene *scene, struct path *path, struct choices *choices,
                     double *probability)
{
    double carried = rgb_max(path->beta) * path->eta2 * path->carried;
    double threshold = scene->spec.rr_threshold;
    if (!(carried < threshold))
        return true;
    *probability = carried / threshold;
    if (!(choose(choices, path, CHOICE_ROULETTE) < *probability))
        return false;
    path->beta = rgb_scale(path->beta, 1 / *probability);
    return true;
}

/* True if the ray that leaves a vertex could add something: not at the last edge, where only light
 * that it hits counts, if light sampling has counted all of that. */
static bool last_edge_counts(const struct render_scene *scene, bool delta)
{
    if (delta)
        return true;
    return scene->spec.profile == JOB_PROFILE_RW ||
           (scene->spec.profile == JOB_PROFILE_MIS && scene->lights.any_hittable);
}

/* Draws where the path goes on; false if it ends. *survival: the probability that roulette left
 * it, 1 from the caller. */
static bool scatter(const struct render_scene *scene, struct path *path, const struct shade *at,
                    const double direction[2], struct choices *choices, bool shares, uint32_t depth,
                    vec3 *wi, struct bsdf_sample *sample, double *survival)
{
    double lobe = at->bsdf.material->one_lobe ? 0 : choose(choices, path, CHOICE_LOBE);
    const double u[3] = {direction[0], direction[1], lobe};
    if (!bsdf_sample(&at->bsdf, at->wo, u, sample))
        return false;
    *wi = frame_to_world(&at->frame, sample->wi);
    bool delta = sample->flags & BSDF_DELTA;
    if (delta)
        *wi = v3_unit(*wi);
    if (!shade_is_consistent(at, *wi, sample->wi.z))
        return false;
    double left = shade_tilt_shadowing(at, *wi, sample->wi.z);
    path->beta = rgb_mul(path->beta, rgb_scale(sample->weight, left));
    path->eta2 *= sample->eta2;
    path->pdf = delta ? 0 : sample->pdf;
    path->last = at->bsdf.material;
    path->org = at->surface.p;
    path->n = next_event_side(at);
    path->candidates = next_event_count(scene, at->bsdf.material);
    if (path->candidates == 1)
        path->candidates = points_of(scene, path, depth);
    /* What leaves a vertex that shares is the others' as well: it ends for no reason of its own. */
    return shares || (rgb_max(path->beta) > 0 && survives(scene, path, choices, survival));
}

/* True if every vertex that samples lights asks for a number that chooses. */
static bool chooses_always(const struct render_scene *scene)
{
    return scene->lights.count > 1 && scene->spec.profile != JOB_PROFILE_RW;
}

/* The vertex where ray `from` has hit: what it emits is added. True if the path may go on there. */
static bool arrive(const struct render_scene *scene, struct render_scratch *w, uint32_t from,
                   uint32_t depth, uint32_t depth_max, struct vertex *v)
{
    uint32_t index = w->active[from];
    const struct hit *hit = &w->hits[from];
    bool shared = arrives_shared(scene, w, from);
    if (shared)
        reuse_land(w, index);
    v->from = from;
    v->dir = v3_of(w->rays[from].dir);
    v->footprint = wave_arrive(scene, w, from);
    /* At its last vertex a path reads nothing of what pictures say, so it lacks none. */
    if (depth < depth_max || shared)
        wave_shade(scene, w, from, v->footprint, &v->at);
    else
        shade_of_hit(scene, hit, v->dir, v->footprint, NULL, &v->at);
    bool ends_way = !shared && w->reuse[index].state == REUSE_WAY &&
                    replay_arrive(scene, w, index, &v->at, v->dir);
    if (scene->objects[hit->object].light_begin != SCENE_NONE && !ends_way)
        add_emission(scene, &w->paths[index], hit, &v->at.surface, v->dir, v->footprint);
    if (w->paths[index].pdf > 0) {
        if (w->paths[index].twig)
            return false;
        w->paths[index].share = 1;
    }
    if (shared)
        reuse_arrive(w, index, &v->at, v->dir);
    v->choices = (struct choices){.drawn = chooses_always(scene) ? &w->choice_u[0][from] : NULL,
                                  .set = WAVE_SET_CHOICE + (depth - 1) * WAVE_SETS_PER_VERTEX};
    return depth < depth_max && v->at.bsdf.material->type != SCENE_MATERIAL_BLACK;
}

/* What leaves a vertex: the shadow ray to its light, and the next ray of the path, into `slot`.
 * True if there is one. */
static bool leave(const struct render_scene *scene, struct render_scratch *w, struct vertex *v,
                  uint32_t depth, uint32_t depth_max, uint32_t slot)
{
    uint32_t index = w->active[v->from];
    struct path *path = &w->paths[index];
    const struct material *m = v->at.bsdf.material;
    const double direction[2] = {w->vertex_u[0][v->from], w->vertex_u[1][v->from]};
    if (v->candidates > 0)
        connect_lights(scene, w, v, depth);
    if (depth + 1 == depth_max && !last_edge_counts(scene, m->is_delta))
        return false;
    path->light_u[0] = w->vertex_u[2][v->from];
    path->light_u[1] = w->vertex_u[3][v->from];
    vec3 wi;
    bool shares = false;
    if (wave_group_side(scene) > 1 && !m->is_delta && w->reuse[index].state == REUSE_NONE) {
        reuse_leave(w, index, &v->at, depth);
        shares = true;
    }
    struct bsdf_sample sample;
    double survival = 1;
    if (!scatter(scene, path, &v->at, direction, &v->choices, shares, depth, &wi, &sample,
                 &survival))
        return false;
    if (w->reuse[index].state == REUSE_WAY)
        replay_turn(&w->reuse[index], &sample, survival);
    if (through_wanted(scene) && m->is_delta)
        through_turn(&path->through, m, &sample, w->hits[v->from].t);
    else if (through_wanted(scene))
        path->through = through_of(scene, &v->at, depth == 1 && !path->twig, wi, sample.pdf);
    if (v->footprint)
        wave_leave(scene, &v->at, &w->hits[v->from], v->dir, wi, &sample, v->footprint);
    const struct surface *s = &v->at.surface;
    wave_continue(w, slot, index, surface_offset(s->p, s->ng, s->error, wi), wi);
    return true;
}

/* What twigs have found is their owners'. */
static void gather_twigs(struct render_scratch *w)
{
    for (uint32_t i = WAVE_PATHS; i > w->twig_begin; i--) {
        const struct path *twig = &w->paths[i - 1];
        struct path *owner = &w->paths[twig->owner];
        owner->twigs = rgb_add(owner->twigs, rgb_scale(twig->radiance, twig->filter_weight));
    }
}

/* All rays under way go on from what they hit, a few at a time. */
static void advance(const struct render_scene *scene, struct render_scratch *w, uint32_t depth,
                    uint32_t depth_max)
{
    struct vertex vertices[LIGHT_POINTS_MAX];
    uint32_t kept = 0, from = 0;
    leave_scene(scene, w);
    while (from < w->active_count) {
        uint32_t count = 0;
        for (; from < w->active_count && count < LIGHT_POINTS_MAX; from++)
            count += w->hits[from].object != SCENE_NONE &&
                     arrive(scene, w, from, depth, depth_max, &vertices[count]);
        find_lights(scene, w, depth, count, vertices);
        /* So many shadow rays may come. */
        if (w->shadow_count + count * NEXT_EVENT_POINTS_MAX > WAVE_PATHS)
            wave_gather(scene, w);
        for (uint32_t k = 0; k < count; k++)
            kept += leave(scene, w, &vertices[k], depth, depth_max, kept);
    }
    w->active_count = kept;
}

void integrate_path(const struct render_scene *scene, struct render_scratch *w)
{
    uint32_t depth_max = scene->spec.max_depth;
    if (scene->spec.integrator == JOB_INTEGRATOR_DIRECT && depth_max > 2)
        depth_max = 2;
    for (uint32_t depth = 1; w->active_count > 0 && depth <= depth_max; depth++) {
        if (depth > 1)
            wave_trace(scene, w);
        uint32_t set = (depth - 1) * WAVE_SETS_PER_VERTEX;
        if (depth < depth_max)
            wave_draw(w, WAVE_SET_VERTEX + set, w->vertex_u);
        if (depth < depth_max && chooses_always(scene))
            wave_draw(w, WAVE_SET_CHOICE + set, w->choice_u);
        advance(scene, w, depth, depth_max);
        wave_gather(scene, w);
    }
    gather_twigs(w);
    if (wave_group_side(scene) > 1)
        reuse_combine(scene, w);
}

/* Ambient occlusion: 1 where a cosine-weighted direction escapes. */
void integrate_ao(const struct render_scene *scene, struct render_scratch *w)
{
    for (uint32_t i = 0; i < w->active_count; i++) {
        if (w->hits[i].object == SCENE_NONE)
            continue;
        struct shade at;
        wave_shade(scene, w, i, wave_arrive(scene, w, i), &at);
        double u[SAMPLER_SET_VALUES];
        uint32_t index = w->active[i];
        sampler_set(&w->paths[index].sampler, WAVE_SET_VERTEX, u);
        vec3 local = warp_cosine_hemisphere(u[0], u[1]);
        local.z = at.wo.z < 0 ? -local.z : local.z;
        vec3 wi = frame_to_world(&at.frame, local);
        if (!shade_is_consistent(&at, wi, local.z))
            continue;
        vec3 org = surface_offset(at.surface.p, at.surface.ng, at.surface.error, wi);
        wave_shadow(w, index, org, org, true, wi, rgb_grey(1));
    }
    wave_gather(scene, w);
}
