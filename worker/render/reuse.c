#include "worker/render/reuse.h"

#include "worker/render/wave.h"

/* Normals further apart than this (cosine) do not share: their pdfs have little in common. */
static const double SIMILAR_COSINE = 0.5;

/* Roulette behind a y that may be shared takes this for the throughput up to there, whoever found
 * it: what is shared depends on the light that the y sends, and that must not depend on the path.
 */
static const double CARRIED = 0.5;

/* A part of the mean radiance of a group's shared y below which they play roulette. */
static const double WORTH_SHARING = 0.5;

/* Light that is less than this, beside the direct light, is not shared. */
static const double WORTH_BESIDE_DIRECT = 1;

bool reuse_wanted(const struct render_scene *scene)
{
    const struct job_spec *spec = &scene->spec;
    return spec->integrator == JOB_INTEGRATOR_PATH && spec->profile == JOB_PROFILE_MIS &&
           spec->max_depth > 2 && !scene->has_alpha;
}

void reuse_leave(struct render_scratch *w, uint32_t index, const struct shade *x, uint32_t depth)
{
    struct reuse *r = &w->reuse[index];
    r->state = REUSE_LEFT;
    r->depth = depth;
    r->x = *x;
    r->beta_x = w->paths[index].beta;
    r->landed = false;
}

void reuse_land(struct render_scratch *w, uint32_t index)
{
    w->reuse[index].landed = true;
    w->reuse[index].direct = w->paths[index].radiance;
}

/* True if light going out from y along `w` is what was found there: on the same side of both
 * normals. */
static bool goes_out(const struct reuse *r, vec3 w)
{
    return v3_dot(r->ng, w) > 0 && v3_dot(r->ns, w) > 0;
}

void reuse_arrive(struct render_scratch *w, uint32_t index, const struct shade *y, vec3 dir)
{
    struct reuse *r = &w->reuse[index];
    struct path *path = &w->paths[index];
    const struct material *m = y->bsdf.material;
    r->state = REUSE_ALONE;
    if (replay_passes(m)) {
        r->state = REUSE_WAY;
        r->way = (struct replay){.wi = dir, .density = path->pdf, .survival = 1};
        return;
    }
    if (m->type != SCENE_MATERIAL_DIFFUSE || y->bent || !(y->wo.z > 0 || m->twosided))
        return;
    double side = y->wo.z > 0 ? 1 : -1;
    r->y = y->surface.p;
    r->ng = v3_scale(y->surface.ng, side);
    r->ns = v3_scale(y->surface.ns, side);
    r->error = y->surface.error;
    vec3 d = v3_sub(r->y, r->x.surface.p);
    double cosine = -v3_dot(r->ng, dir);
    if (!goes_out(r, v3_neg(dir)))
        return;
    r->state = REUSE_FOUND;
    r->pdf = path->pdf * cosine / v3_dot(d, d);
    r->beta = path->beta;
    r->radiance = path->radiance;
    path->carried = CARRIED;
    path->beta = rgb_grey(1);
    path->radiance = rgb_grey(0);
}

static bool similar(const struct reuse *a, const struct reuse *b)
{
    return a->depth == b->depth && a->x.surface.object == b->x.surface.object &&
           v3_dot(a->x.surface.ns, b->x.surface.ns) > SIMILAR_COSINE;
}

/* Each joins the first cluster whose first member is similar. */
void reuse_cluster(const struct reuse *r, uint32_t count, uint32_t cluster[])
{
    for (uint32_t i = 0; i < count; i++) {
        cluster[i] = i;
        for (uint32_t k = 0; k < i && r[i].state != REUSE_NONE; k++) {
            if (cluster[k] == k && r[k].state != REUSE_NONE && similar(&r[k], &r[i])) {
                cluster[i] = k;
                break;
            }
        }
    }
}

/* Adds the connection from the x of path `from` to the y of path `to`, if it could bring light or
 * had a density. */
static void connect(struct reuse_connections *c, const struct reuse *reuse, uint32_t from,
                    uint32_t to)
{
    const struct reuse *a = &reuse[from], *b = &reuse[to];
    const struct surface *x = &a->x.surface;
    vec3 d = v3_sub(b->y, x->p);
    double distance2 = v3_dot(d, d);
    if (!(distance2 > 0))
        return;
    vec3 wi = v3_scale(d, 1 / sqrt(distance2));
    vec3 local = frame_to_local(&a->x.frame, wi);
    if (!goes_out(b, v3_neg(wi)) || !shade_is_consistent(&a->x, wi, local.z))
        return;
    double pdf;
    rgb f = bsdf_eval(&a->x.bsdf, a->x.wo, local, &pdf);
    if (!(pdf > 0))
        return;
    double geometry = -v3_dot(b->ng, wi) / distance2;
    uint32_t at = c->count++;
    c->from[at] = from;
    c->to[at] = to;
    c->pdf[at] = pdf * geometry;
    double left = shade_tilt_shadowing(&a->x, wi, local.z);
    c->factor[at] = rgb_scale(rgb_mul(f, a->beta_x), geometry * left);
    struct ray *ray = &c->rays[at];
    vec3 org = surface_offset(x->p, x->ng, x->error, wi);
    v3_put(ray->org, org);
    v3_put(ray->dir, v3_sub(v3_mad(b->y, b->ng, b->error), org));
    ray->tmin = 0;
    ray->tmax = 1;
}

/* Keeps from the others the y that send little beside the direct light of the group. */
static void keep_small(struct render_scratch *w, uint32_t begin, uint32_t end)
{
    double direct = 0, reflected = 0;
    for (uint32_t i = begin; i < end; i++) {
        const struct reuse *r = &w->reuse[i];
        if (r->state == REUSE_NONE)
            continue;
        /* A path that ended at its x has nothing else. */
        direct += rgb_luminance(r->landed ? r->direct : w->paths[i].radiance);
        reflected += rgb_luminance(rgb_mul(r->beta_x, r->x.bsdf.color));
    }
    for (uint32_t i = begin; i < end; i++) {
        double sent = rgb_luminance(w->paths[i].radiance) * reflected;
        w->reuse[i].kept = !(sent > WORTH_BESIDE_DIRECT * direct);
    }
}

/* True if the y of a path is there for the others. */
static bool is_shared(const struct reuse *r)
{
    return r->state == REUSE_FOUND && !r->kept;
}

/* Roulette among the shared y of a group: one that sends out less than its part of the mean is not
 * worth the shadow rays to it, and makes up for that when it stays. */
static void thin_out(struct render_scratch *w, uint32_t begin, uint32_t end)
{
    double sum = 0;
    uint32_t count = 0;
    for (uint32_t i = begin; i < end; i++) {
        if (!is_shared(&w->reuse[i]))
            continue;
        sum += rgb_luminance(w->paths[i].radiance);
        count++;
    }
    double threshold = WORTH_SHARING * sum / (count > 0 ? count : 1);
    for (uint32_t i = begin; i < end; i++) {
        struct path *path = &w->paths[i];
        double luminance = rgb_luminance(path->radiance);
        if (!is_shared(&w->reuse[i]) || !(luminance < threshold))
            continue;
        double u[SAMPLER_SET_VALUES], stays = luminance / threshold;
        sampler_set(&path->sampler, WAVE_SET_SHARE, u);
        path->radiance = u[0] < stays ? rgb_scale(path->radiance, 1 / stays) : rgb_grey(0);
    }
}

/* All connections between the paths of a group. */
static void connect_group(struct render_scratch *w, uint32_t begin, uint32_t end)
{
    uint32_t cluster[WAVE_GROUP_PATHS];
    reuse_cluster(w->reuse + begin, end - begin, cluster);
    keep_small(w, begin, end);
    if (end - begin > 1)
        thin_out(w, begin, end);
    for (uint32_t to = begin; to < end; to++) {
        if (!is_shared(&w->reuse[to]) || rgb_is_black(w->paths[to].radiance))
            continue;
        for (uint32_t from = begin; from < end; from++) {
            if (from != to && cluster[from - begin] == cluster[to - begin])
                connect(&w->connections, w->reuse, from, to);
        }
    }
}

/* Casts the connections of the groups first..last and gives each path what it gets. */
static void combine_groups(const struct render_scene *scene, struct render_scratch *w,
                           uint32_t begin, uint32_t end)
{
    struct reuse_connections *c = &w->connections;
    accel_occluded_batch(scene->accel, c->rays, c->count, c->occluded);
    w->ray_count += c->count;
    /* The densities of each y, from all that see it. */
    for (uint32_t i = begin; i < end; i++)
        w->reuse[i].pdf_sum = w->reuse[i].pdf;
    for (uint32_t k = 0; k < c->count; k++) {
        if (!c->occluded[k])
            w->reuse[c->to[k]].pdf_sum += c->pdf[k];
    }
    /* The light that leaves each y, over their sum; the path's own share comes first. */
    for (uint32_t i = begin; i < end; i++) {
        struct reuse *r = &w->reuse[i];
        if (r->state != REUSE_FOUND)
            continue;
        rgb leaving = w->paths[i].radiance;
        r->shared = rgb_is_finite(leaving) ? rgb_scale(leaving, 1 / r->pdf_sum) : rgb_grey(0);
        rgb own = rgb_is_finite(leaving) ? rgb_scale(r->shared, r->pdf) : leaving;
        w->paths[i].radiance = rgb_add(r->radiance, rgb_mul(r->beta, own));
    }
    for (uint32_t k = 0; k < c->count; k++) {
        if (c->occluded[k])
            continue;
        struct path *path = &w->paths[c->from[k]];
        rgb found = rgb_mul(c->factor[k], w->reuse[c->to[k]].shared);
        path->radiance = rgb_add(path->radiance, found);
    }
    c->count = 0;
}

void reuse_combine(const struct render_scene *scene, struct render_scratch *w)
{
    enum { GROUP_CONNECTIONS = WAVE_GROUP_PATHS * (WAVE_GROUP_PATHS - 1) };
    uint32_t first = 0;
    w->connections.count = 0;
    for (uint32_t g = 0; g < w->group_count; g++) {
        if (w->connections.count + GROUP_CONNECTIONS > REUSE_CONNECTIONS) {
            combine_groups(scene, w, w->groups[first], w->groups[g]);
            first = g;
        }
        connect_group(w, w->groups[g], w->groups[g + 1]);
    }
    combine_groups(scene, w, w->groups[first], w->path_count);
    replay_combine(scene, w);
}
