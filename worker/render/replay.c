#include "worker/render/replay.h"

#include "worker/render/wave.h"

bool replay_passes(const struct material *m)
{
    return m->is_delta && m->texture == SCENE_NONE && m->normal_texture == SCENE_NONE &&
           m->bump_texture == SCENE_NONE && !m->vertex_colors;
}

bool replay_lamp(const struct render_scene *scene, const struct surface *s, vec3 dir, rgb *radiance)
{
    const struct render_object *object = &scene->objects[s->object];
    if (object->light_begin == SCENE_NONE || object->emission_texture != SCENE_NONE ||
        object->emission_colors)
        return false;
    double cosine = -v3_dot(s->ng, dir);
    *radiance = object->radiance;
    return (object->emission_twosided ? fabs(cosine) : cosine) > 0;
}

bool replay_take(const struct shade *at, bool through, vec3 *dir, rgb *value, double *density)
{
    const double last = 1.0 - 1.0 / 9007199254740992.0;
    const double u[3] = {0, 0, through ? last : 0};
    struct bsdf_sample sample;
    if (!replay_passes(at->bsdf.material) || !bsdf_sample(&at->bsdf, at->wo, u, &sample) ||
        ((sample.flags & BSDF_TRANSMIT) != 0) != through)
        return false;
    vec3 wi = v3_unit(frame_to_world(&at->frame, sample.wi));
    if (!shade_is_consistent(at, wi, sample.wi.z))
        return false;
    *dir = wi;
    *value = rgb_scale(rgb_mul(*value, sample.weight), sample.pdf);
    *density *= sample.pdf;
    return *density > 0;
}

void replay_turn(struct reuse *r, const struct bsdf_sample *sample, double survival)
{
    struct replay *way = &r->way;
    if (way->count == REPLAY_TURNS_MAX) {
        r->state = REUSE_ALONE;
        return;
    }
    way->turns |= (uint32_t)((sample->flags & BSDF_TRANSMIT) != 0) << way->count++;
    way->density *= sample->pdf;
    way->survival *= survival;
}

/* True if the way leads through surfaces alone, as through_gather goes. */
static bool goes_through(const struct replay *way)
{
    return way->turns == (uint32_t)((UINT64_C(1) << way->count) - 1);
}

bool replay_arrive(const struct render_scene *scene, struct render_scratch *w, uint32_t index,
                   const struct shade *at, vec3 dir)
{
    struct reuse *r = &w->reuse[index];
    const struct path *path = &w->paths[index];
    rgb light;
    if (replay_lamp(scene, &at->surface, dir, &light)) {
        double weight = through_weight(scene, &path->through, through_light(scene, &at->surface));
        r->way.found = rgb_scale(rgb_mul(path->beta, light), weight);
        r->state = REUSE_LAMP;
        return true;
    }
    if (!replay_passes(at->bsdf.material))
        r->state = REUSE_ALONE;
    return false;
}

/* The ray of a lane, into slot `slot`. */
static void cast(struct render_scratch *w, uint32_t slot, uint32_t lane, const struct surface *s)
{
    vec3 dir = w->lanes[lane].dir;
    wave_continue(w, slot, lane, surface_offset(s->p, s->ng, s->error, dir), dir);
}

/* Adds the way of path `way` as path `from` would go it, unless that would never draw it. */
static void add_lane(struct render_scratch *w, uint32_t from, uint32_t way)
{
    const struct reuse *a = &w->reuse[from];
    const struct shade *x = &a->x;
    vec3 wi = w->reuse[way].way.wi, local = frame_to_local(&x->frame, wi);
    double pdf;
    if (!shade_is_consistent(x, wi, local.z))
        return;
    rgb f = bsdf_eval(&x->bsdf, x->wo, local, &pdf);
    if (!(pdf > 0))
        return;
    double left = shade_tilt_shadowing(x, wi, local.z);
    uint32_t lane = w->lane_count++;
    w->lanes[lane] = (struct replay_lane){.from = from,
                                          .way = way,
                                          .dir = wi,
                                          .density = pdf,
                                          .value = rgb_scale(rgb_mul(a->beta_x, f), left)};
    cast(w, lane, lane, &x->surface);
}

/* A lane at the end of its way. */
static void end_lane(const struct render_scene *scene, const struct render_scratch *w,
                     struct replay_lane *l, const struct surface *s)
{
    const struct reuse *r = &w->reuse[l->from];
    struct through through = {.points = 0};
    rgb light;
    l->there = replay_lamp(scene, s, l->dir, &light);
    if (!l->there)
        return;
    if (goes_through(&w->reuse[l->way].way))
        through = through_of(scene, &r->x, r->depth == 1, w->reuse[l->way].way.wi, l->density);
    through.first = l->first;
    through.count = w->reuse[l->way].way.count;
    double weight = through_weight(scene, &through, through_light(scene, s));
    l->value = rgb_scale(rgb_mul(l->value, light), weight);
}

/* A lane at what ray `i` has hit, after `turn` turns. True if it goes on, with a ray in `slot`. */
static bool advance_lane(const struct render_scene *scene, struct render_scratch *w, uint32_t i,
                         uint32_t turn, uint32_t slot)
{
    uint32_t lane = w->active[i];
    struct replay_lane *l = &w->lanes[lane];
    const struct replay *way = &w->reuse[l->way].way;
    if (w->hits[i].object == SCENE_NONE)
        return false;
    struct shade at;
    rgb light;
    /* Where the way ends nothing is read of what pictures say. */
    shade_of_hit(scene, &w->hits[i], l->dir, NULL, turn < way->count ? &w->lacks : NULL, &at);
    if (turn == way->count) {
        end_lane(scene, w, l, &at.surface);
        return false;
    }
    /* A way ends at the first lamp. */
    if (turn > 0 && replay_lamp(scene, &at.surface, l->dir, &light))
        return false;
    if (turn == 0)
        l->first = w->hits[i].t;
    if (!replay_take(&at, way->turns >> turn & 1, &l->dir, &l->value, &l->density))
        return false;
    cast(w, slot, lane, &at.surface);
    return true;
}

/* Shares what path `way` has found between it and its lanes begin..end. */
static void share(struct render_scratch *w, uint32_t way, uint32_t begin, uint32_t end)
{
    const struct replay *own = &w->reuse[way].way;
    double sum = own->density;
    uint32_t there = 0;
    for (uint32_t k = begin; k < end; k++) {
        sum += w->lanes[k].there ? w->lanes[k].density : 0;
        there += w->lanes[k].there;
    }
    struct path *path = &w->paths[way];
    path->radiance =
        rgb_add(path->radiance, rgb_scale(own->found, there > 0 ? own->density / sum : 1));
    for (uint32_t k = begin; k < end; k++) {
        const struct replay_lane *l = &w->lanes[k];
        struct path *other = &w->paths[l->from];
        if (l->there)
            other->radiance =
                rgb_add(other->radiance, rgb_scale(l->value, 1 / (sum * own->survival)));
    }
}

/* Goes the ways of the lanes, and shares what the paths begin..end have found. */
static void run_lanes(const struct render_scene *scene, struct render_scratch *w, uint32_t begin,
                      uint32_t end)
{
    w->active_count = w->lane_count;
    for (uint32_t turn = 0; w->active_count > 0; turn++) {
        uint32_t kept = 0;
        accel_closest_batch(scene->accel, w->rays, w->active_count, w->hits);
        w->ray_count += w->active_count;
        for (uint32_t i = 0; i < w->active_count; i++)
            kept += advance_lane(scene, w, i, turn, kept);
        w->active_count = kept;
    }
    uint32_t at = 0;
    for (uint32_t way = begin; way < end; way++) {
        uint32_t first = at;
        if (w->reuse[way].state != REUSE_LAMP)
            continue;
        while (at < w->lane_count && w->lanes[at].way == way)
            at++;
        share(w, way, first, at);
    }
    w->lane_count = 0;
}

/* The lanes of a group. */
static void add_lanes(struct render_scratch *w, uint32_t begin, uint32_t end)
{
    uint32_t cluster[WAVE_GROUP_PATHS];
    reuse_cluster(w->reuse + begin, end - begin, cluster);
    for (uint32_t way = begin; way < end; way++) {
        const struct reuse *r = &w->reuse[way];
        /* What is no number is for the path alone, to be counted. */
        if (r->state != REUSE_LAMP || !rgb_is_finite(r->way.found))
            continue;
        for (uint32_t from = begin; from < end; from++)
            if (from != way && cluster[from - begin] == cluster[way - begin])
                add_lane(w, from, way);
    }
}

void replay_combine(const struct render_scene *scene, struct render_scratch *w)
{
    uint32_t first = 0;
    w->lane_count = 0;
    for (uint32_t g = 0; g < w->group_count; g++) {
        uint32_t begin = w->groups[g], end = w->groups[g + 1], found = 0;
        for (uint32_t i = begin; i < end; i++)
            found += w->reuse[i].state == REUSE_LAMP;
        if (found == 0)
            continue;
        if (w->lane_count + found * (WAVE_GROUP_PATHS - 1) > WAVE_PATHS) {
            run_lanes(scene, w, first, begin);
            first = begin;
        }
        add_lanes(w, begin, end);
    }
    run_lanes(scene, w, first, w->path_count);
}
