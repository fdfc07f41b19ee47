#include "worker/render/light.h"

#include "worker/render/lanes.h"
#include "worker/render/sky_batch.h"
#include "worker/render/sphere_parts.h"
#include "worker/render/surface.h"
#include "worker/render/warp.h"

_Static_assert((int)LIGHT_POINTS_MAX == (int)SKY_BATCH, "points fill a batch of the sky");

/* So few are done one by one. */
enum { SKY_BATCH_LEAST = 3 };

/* Where picture and vertices say `u`, `v` and `alpha`. */
static rgb emission_at(const struct light *l, double u, double v, double alpha)
{
    const struct light_surface *s = l->surface;
    rgb radiance = l->radiance;
    if (s->emission)
        radiance = rgb_mul(radiance, texture_color(s->emission, u, v));
    if (!s->material)
        return radiance;
    if (s->color)
        alpha *= texture_alpha(s->color, u, v);
    return rgb_scale(radiance, material_opacity(s->material, alpha));
}

/* Of what the corners of a triangle have, each `stride` after the other, at weights b. */
static double corner_mean(const float *corners, int stride, const double b[3])
{
    return b[0] * (double)corners[0] + b[1] * (double)corners[stride] +
           b[2] * (double)corners[2 * stride];
}

rgb light_emission(const struct light *l, double b1, double b2)
{
    const struct light_surface *s = l->surface;
    if (!s)
        return l->radiance;
    const double b[3] = {1 - b1 - b2, b1, b2};
    double alpha = s->has_alphas ? corner_mean(s->alphas, 1, b) : 1;
    rgb sent = emission_at(l, corner_mean(s->uv, 2, b), corner_mean(s->uv + 1, 2, b), alpha);
    if (s->has_colors)
        sent = rgb_mul(sent, (rgb){corner_mean(s->colors, 3, b), corner_mean(s->colors + 1, 3, b),
                                   corner_mean(s->colors + 2, 3, b)});
    return sent;
}

rgb light_sphere_emission(const struct light *l, vec3 n)
{
    double u, v;
    if (!l->surface)
        return l->radiance;
    surface_sphere_uv(n, &u, &v);
    return emission_at(l, u, v, 1);
}

/* What a sphere sends out from a point beside it. */
static rgb sphere_emission_at(const struct light *l, vec3 p)
{
    return l->surface ? light_sphere_emission(l, v3_unit(v3_sub(p, l->v0))) : l->radiance;
}

/* A point of a triangle or parallelogram. */
static bool sample_area(const struct light *l, vec3 p, double u, double v, struct light_sample *s)
{
    double a = u, b = v;
    if (l->type == LIGHT_TRIANGLE)
        warp_triangle(u, v, &a, &b);
    vec3 q = v3_mad(v3_mad(l->v0, l->e1, a), l->e2, b);
    vec3 d = v3_sub(q, p);
    double distance2 = v3_dot(d, d);
    double distance = sqrt(distance2);
    double cosine = -v3_dot(l->n, d); /* times the distance */
    double side = l->twosided && cosine < 0 ? -1 : 1;
    cosine *= side;
    if (!(cosine > 0))
        return false;
    s->wi = v3_scale(d, 1 / distance);
    s->target = v3_mad(q, l->n, l->error * side);
    s->pdf = distance2 * distance / (cosine * l->area);
    s->radiance = light_emission(l, a, b);
    return true;
}

/* 1 - cos of the half angle under which p sees the sphere, without cancellation; 0 if p is not
 * outside, or on it but for roundings. */
static double sphere_cap(const struct light *l, double distance2)
{
    double reach = l->radius + l->error, sin2 = l->radius * l->radius / distance2;
    return reach * reach < distance2 ? sin2 / (1 + sqrt(1 - sin2)) : 0;
}

/* False if p does not see the sphere from outside. */
static bool sphere_view_of(const struct light *l, vec3 p, struct sphere_view *view)
{
    vec3 d = v3_sub(l->v0, p);
    view->distance2 = v3_dot(d, d);
    view->cap = sphere_cap(l, view->distance2);
    view->distance = sqrt(view->distance2);
    view->towards = frame_of(v3_scale(d, 1 / view->distance));
    return view->cap > 0;
}

/* A direction in the cone of the sphere, uniform in solid angle. */
static bool sample_sphere(const struct light *l, vec3 p, double u, double v, struct light_sample *s)
{
    struct sphere_view view;
    if (!sphere_view_of(l, p, &view))
        return false;
    sphere_draw(&view, p, l->v0, l->radius, l->error, u, v, &s->wi, &s->target, &s->pdf);
    s->radiance = sphere_emission_at(l, s->target);
    return true;
}

/* KHR_lights_punctual's fall-off between the two angles. */
static double spot_falloff(const struct light *l, vec3 wi)
{
    double cosine = -v3_dot(wi, l->n);
    if (cosine <= l->cos_outer)
        return 0;
    if (cosine >= l->cos_inner)
        return 1;
    double t = (cosine - l->cos_outer) / (l->cos_inner - l->cos_outer);
    return t * t;
}

static bool sample_point(const struct light *l, vec3 p, struct light_sample *s)
{
    vec3 d = v3_sub(l->v0, p);
    double distance2 = v3_dot(d, d);
    s->wi = v3_scale(d, 1 / sqrt(distance2));
    double falloff = l->type == LIGHT_SPOT ? spot_falloff(l, s->wi) : 1;
    s->target = l->v0;
    s->radiance = rgb_scale(l->radiance, falloff / distance2);
    s->pdf = 1;
    s->delta = true;
    return falloff > 0;
}

vec3 environment_to_scene(const struct environment *e, vec3 l)
{
    const double *m = e->to_local;
    return v3(m[0] * l.x + m[3] * l.y + m[6] * l.z, m[1] * l.x + m[4] * l.y + m[7] * l.z,
              m[2] * l.x + m[5] * l.y + m[8] * l.z);
}

/* SCENE-FORMAT's map: u = phi / 2 pi with phi = atan2(x, -z), v = theta / pi from +y. */
vec3 environment_direction(const struct environment *e, double u, double v, double *sine)
{
    double sp, cp, ct;
    warp_sincos_turn(u, &sp, &cp);
    warp_sincos_turn(v * 0.5, sine, &ct);
    return environment_to_scene(e, v3(*sine * sp, ct, -*sine * cp));
}

rgb environment_lookup(const struct environment *e, double u, double v)
{
    if (!e->texture)
        return e->factor;
    bool image = e->texture->type == SCENE_TEXTURE_IMAGE;
    return rgb_mul(e->factor, texture_color(e->texture, u, image ? 1 - v : v));
}

/* Of a density over the square of the map, that over directions. */
static double per_steradian(double density, double sine)
{
    return density / (2 * VEC_PI * VEC_PI * sine);
}

/* Density of directions to a sky of one colour, as sample_environment draws them. */
static double constant_sky_pdf(vec3 n, vec3 w)
{
    if (v3_abs_max(n) == 0)
        return 1 / (4 * VEC_PI);
    double cosine = v3_dot(n, w);
    return cosine > 0 ? cosine * VEC_INV_PI : 0;
}

static double sky_probability(const struct light_table *t)
{
    return t->environment_light == SCENE_NONE ? 0 : t->lights[t->environment_light].probability;
}

rgb environment_radiance(const struct light_table *t, vec3 n, vec3 w, double *pdf)
{
    const struct environment *e = &t->environment;
    *pdf = 0;
    if (!e->present)
        return rgb_grey(0);
    double probability = sky_probability(t);
    if (!e->texture) {
        *pdf = probability * constant_sky_pdf(n, w);
        return e->factor;
    }
    const double *m = e->to_local;
    vec3 l = v3(m[0] * w.x + m[1] * w.y + m[2] * w.z, m[3] * w.x + m[4] * w.y + m[5] * w.z,
                m[6] * w.x + m[7] * w.y + m[8] * w.z);
    double sine = sqrt(l.x * l.x + l.z * l.z);
    double u = warp_turn_of(l.x, -l.z), v = 2 * warp_turn_of(sine, l.y);
    if (sine > 0)
        *pdf = probability * per_steradian(sky_density(&e->map, sky_table(n), u, v), sine);
    return environment_lookup(e, u, v);
}

void environment_radiances(const struct light_table *t, uint32_t count, const vec3 n[],
                           const vec3 w[], rgb radiance[], double pdf[])
{
    const struct environment *e = &t->environment;
    if (!e->present || !e->texture || count < SKY_BATCH_LEAST) {
        for (uint32_t k = 0; k < count; k++)
            radiance[k] = environment_radiance(t, n[k], w[k], &pdf[k]);
        return;
    }
    struct sky_batch b = {0};
    for (uint32_t k = 0; k < count; k++) {
        const double normal[3] = {n[k].x, n[k].y, n[k].z}, dir[3] = {w[k].x, w[k].y, w[k].z};
        for (int axis = 0; axis < 3; axis++) {
            b.n[axis][k] = normal[axis];
            b.w[axis][k] = dir[axis];
        }
    }
    sky_batch_look(e, &b);
    double probability = sky_probability(t);
    for (uint32_t k = 0; k < count; k++) {
        pdf[k] = probability * b.pdf[k];
        radiance[k] = environment_lookup(e, b.x[k], b.y[k]);
    }
}

static bool sample_constant_sky(const struct environment *e, vec3 n, double u, double v,
                                struct light_sample *s)
{
    s->wi = warp_sphere(u, v);
    if (v3_abs_max(n) > 0) {
        frame f = frame_of(n);
        s->wi = frame_to_world(&f, warp_cosine_hemisphere(u, v));
    }
    s->pdf = constant_sky_pdf(n, s->wi);
    s->radiance = e->factor;
    return s->pdf > 0;
}

static bool sample_environment(const struct environment *e, vec3 n, double u, double v,
                               struct light_sample *s)
{
    s->distant = true;
    if (!e->texture)
        return sample_constant_sky(e, n, u, v, s);
    double x, y, sine;
    double density = sky_draw(&e->map, sky_table(n), u, v, &x, &y);
    s->wi = environment_direction(e, x, y, &sine);
    if (!(sine > 0) || (v3_abs_max(n) > 0 && !(v3_dot(n, s->wi) > 0)))
        return false;
    s->pdf = per_steradian(density, sine);
    s->radiance = environment_lookup(e, x, y);
    return true;
}

/* Draws lights by ascending choose[]; SCENE_NONE if none sends anything to p. */
static void choose_lights(const struct light_table *t, vec3 p, vec3 n, uint32_t count,
                          const double choose[], uint32_t lights[], double probabilities[])
{
    double rest[LIGHT_TREE_DRAWS_MAX];
    uint32_t in_tree = 0; /* the first so many fall on it */
    for (uint32_t k = 0; k < count; k++) {
        rest[k] = choose[k];
        size_t which = 0;
        if (t->tree.nodes ? t->placeless_count > 0 : t->count > 1)
            which = distribution_1d_sample(&t->choice, choose[k], &rest[k]);
        if (t->tree.nodes && which == 0) {
            in_tree++;
            continue;
        }
        lights[k] = t->tree.nodes ? t->placeless[which - 1] : (uint32_t)which;
        probabilities[k] = t->lights[lights[k]].probability;
    }
    if (in_tree > 0)
        light_tree_draw_many(&t->tree, p, n, in_tree, rest, lights, probabilities);
    for (uint32_t k = 0; k < in_tree; k++)
        probabilities[k] *= t->tree.probability;
}

static bool sample_light(const struct light_table *t, uint32_t index, vec3 p, vec3 n, double u,
                         double v, struct light_sample *s)
{
    const struct light *l = &t->lights[index];
    s->distant = s->delta = false;
    switch (l->type) {
    case LIGHT_TRIANGLE:
    case LIGHT_QUAD:
        return sample_area(l, p, u, v, s);
    case LIGHT_SPHERE:
        return sample_sphere(l, p, u, v, s);
    case LIGHT_POINT:
    case LIGHT_SPOT:
        return sample_point(l, p, s);
    case LIGHT_DISTANT:
        s->wi = v3_neg(l->n);
        s->radiance = l->radiance;
        s->pdf = 1;
        return s->distant = s->delta = true;
    case LIGHT_ENVIRONMENT:
        return sample_environment(&t->environment, n, u, v, s);
    }
    return false;
}

static void put_lane(double lanes[][SPHERE_MANY], uint32_t k, vec3 a)
{
    lanes[0][k] = a.x;
    lanes[1][k] = a.y;
    lanes[2][k] = a.z;
}

static vec3 lane_of(double lanes[][SPHERE_MANY], uint32_t k)
{
    return v3(lanes[0][k], lanes[1][k], lanes[2][k]);
}

static void put_sphere(const struct light *l, const struct sphere_view *view, double u, double v,
                       uint32_t k, struct sphere_batch *b)
{
    b->u[k] = u;
    b->v[k] = v;
    b->cap[k] = view->cap;
    b->distance2[k] = view->distance2;
    b->distance[k] = view->distance;
    put_lane(b->s, k, view->towards.s);
    put_lane(b->t, k, view->towards.t);
    put_lane(b->n, k, view->towards.n);
    put_lane(b->center, k, l->v0);
    b->radius[k] = l->radius;
    b->error[k] = l->error;
}

/* Samples on the spheres among lights[]; returns which are there. */
static uint32_t sample_spheres(const struct light_table *t, vec3 p, uint32_t spheres,
                               const uint32_t lights[], const double u[], const double v[],
                               struct light_sample s[])
{
    static sphere_loop *const loops[LANES_LEVELS] = {sphere_loop_sse2, sphere_loop_avx2,
                                                     sphere_loop_avx512};
    struct sphere_batch b;
    struct sphere_view view;
    uint32_t there = 0, seen = SCENE_NONE; /* which the view is of */
    bool outside = false;
    memset(&b, 0, sizeof b);
    for (uint32_t rest = spheres; rest; rest &= rest - 1) {
        uint32_t k = (uint32_t)__builtin_ctz(rest);
        const struct light *l = &t->lights[lights[k]];
        if (lights[k] != seen)
            outside = sphere_view_of(l, p, &view);
        seen = lights[k];
        if (!outside)
            continue;
        put_sphere(l, &view, u[k], v[k], k, &b);
        there |= 1u << k;
    }
    loops[lanes_level()](p, &b);
    for (uint32_t rest = there; rest; rest &= rest - 1) {
        uint32_t k = (uint32_t)__builtin_ctz(rest);
        s[k] = (struct light_sample){
            .wi = lane_of(b.wi, k),
            .target = lane_of(b.target, k),
            .radiance = sphere_emission_at(&t->lights[lights[k]], lane_of(b.target, k)),
            .pdf = b.pdf[k]};
    }
    return there;
}

uint32_t light_sample_many(const struct light_table *t, vec3 p, vec3 n, uint32_t count,
                           const double choose[], const double u[], const double v[],
                           struct light_sample s[])
{
    uint32_t lights[LIGHT_TREE_DRAWS_MAX], there = 0, spheres = 0;
    double probabilities[LIGHT_TREE_DRAWS_MAX];
    if (t->count == 0)
        return 0;
    choose_lights(t, p, n, count, choose, lights, probabilities);
    for (uint32_t k = 0; k < count; k++) {
        if (lights[k] == SCENE_NONE)
            continue;
        if (t->lights[lights[k]].type == LIGHT_SPHERE)
            spheres |= 1u << k;
        else if (sample_light(t, lights[k], p, n, u[k], v[k], &s[k]))
            there |= 1u << k;
    }
    if (spheres)
        there |= sample_spheres(t, p, spheres, lights, u, v, s);
    for (uint32_t k = 0; k < count; k++) {
        if (!(there >> k & 1))
            continue;
        s[k].pdf *= probabilities[k];
        s[k].light = lights[k];
    }
    return there;
}

bool light_sample(const struct light_table *t, vec3 p, vec3 n, double choose, double u, double v,
                  struct light_sample *s)
{
    uint32_t light;
    double probability;
    if (t->count == 0)
        return false;
    choose_lights(t, p, n, 1, &choose, &light, &probability);
    if (light == SCENE_NONE || !sample_light(t, light, p, n, u, v, s))
        return false;
    s->pdf *= probability;
    s->light = light;
    return true;
}

/* Samples of the sky for the points in `wanted`; returns which are there. */
static uint32_t sample_sky_points(const struct environment *e, uint32_t wanted,
                                  const struct light_point points[], struct light_sample s[])
{
    struct sky_batch b = {.x = {0}};
    uint32_t numbers[LIGHT_POINTS_MAX], count = 0, there = 0;
    for (uint32_t rest = wanted; rest; rest &= rest - 1) {
        uint32_t k = (uint32_t)__builtin_ctz(rest);
        const struct light_point *at = &points[k];
        b.n[0][count] = at->n.x;
        b.n[1][count] = at->n.y;
        b.n[2][count] = at->n.z;
        b.x[count] = at->u;
        b.y[count] = at->v;
        numbers[count++] = k;
    }
    sky_batch_draw(e, &b);
    for (uint32_t i = 0; i < count; i++) {
        if (!(b.pdf[i] > 0))
            continue;
        s[numbers[i]] = (struct light_sample){.wi = v3(b.w[0][i], b.w[1][i], b.w[2][i]),
                                              .distant = true,
                                              .radiance = environment_lookup(e, b.x[i], b.y[i]),
                                              .pdf = b.pdf[i]};
        there |= 1u << numbers[i];
    }
    return there;
}

uint32_t light_sample_points(const struct light_table *t, uint32_t count,
                             const struct light_point points[], struct light_sample s[])
{
    const struct environment *e = &t->environment;
    uint32_t lights[LIGHT_POINTS_MAX], there = 0, sky = 0;
    double probabilities[LIGHT_POINTS_MAX];
    for (uint32_t k = 0; k < count && t->count > 0; k++) {
        const struct light_point *at = &points[k];
        choose_lights(t, at->p, at->n, 1, &at->choose, &lights[k], &probabilities[k]);
        uint32_t light = lights[k];
        if (light == t->environment_light && light != SCENE_NONE && e->texture)
            sky |= 1u << k;
        else if (light != SCENE_NONE && sample_light(t, light, at->p, at->n, at->u, at->v, &s[k]))
            there |= 1u << k;
    }
    if (__builtin_popcount(sky) >= SKY_BATCH_LEAST) {
        there |= sample_sky_points(e, sky, points, s);
    } else {
        for (uint32_t k = 0; k < count; k++)
            if (sky >> k & 1 && sample_light(t, t->environment_light, points[k].p, points[k].n,
                                             points[k].u, points[k].v, &s[k]))
                there |= 1u << k;
    }
    for (uint32_t k = 0; k < count; k++) {
        if (!(there >> k & 1))
            continue;
        s[k].pdf *= probabilities[k];
        s[k].light = lights[k];
    }
    return there;
}

double light_pdf(const struct light_table *t, uint32_t index, vec3 p, vec3 n, double distance2,
                 double cos_light)
{
    const struct light *l = &t->lights[index];
    double probability = t->tree.nodes
                             ? t->tree.probability * light_tree_probability(&t->tree, index, p, n)
                             : l->probability;
    if (l->type == LIGHT_SPHERE) {
        vec3 d = v3_sub(l->v0, p);
        double cap = sphere_cap(l, v3_dot(d, d));
        return cap > 0 ? probability / (2 * VEC_PI * cap) : 0;
    }
    return probability * distance2 / (cos_light * l->area);
}

/* How far from p in direction w a light with an area is, and the cosine at its normal; false where
 * it is not. */
static bool light_is_towards(const struct light *l, vec3 p, vec3 w, double *distance,
                             double *cosine)
{
    vec3 d = v3_sub(l->v0, p);
    if (l->type == LIGHT_SPHERE) {
        double along = v3_dot(d, w), out = l->radius * l->radius - (v3_dot(d, d) - along * along);
        *distance = along - sqrt(out > 0 ? out : 0);
        *cosine = 1;
        return out > 0;
    }
    double down = v3_dot(l->n, w);
    if (down == 0 || (down > 0 && !l->twosided))
        return false;
    *cosine = fabs(down);
    *distance = v3_dot(d, l->n) / down;
    vec3 q = v3_sub(v3_scale(w, *distance), d), normal = v3_cross(l->e1, l->e2);
    double area2 = v3_dot(normal, normal);
    double a = v3_dot(v3_cross(q, l->e2), normal) / area2;
    double b = v3_dot(v3_cross(l->e1, q), normal) / area2;
    return a >= 0 && b >= 0 && (l->type == LIGHT_QUAD ? a <= 1 && b <= 1 : a + b <= 1);
}

double light_pdf_towards(const struct light_table *t, uint32_t index, vec3 p, vec3 n, vec3 w,
                         double beyond)
{
    const struct light *l = &t->lights[index];
    double pdf, distance, cosine;
    if (l->type == LIGHT_ENVIRONMENT) {
        (void)environment_radiance(t, n, w, &pdf);
        return pdf;
    }
    if (l->type != LIGHT_TRIANGLE && l->type != LIGHT_QUAD && l->type != LIGHT_SPHERE)
        return 0;
    if (!light_is_towards(l, p, w, &distance, &cosine) || !(distance > beyond))
        return 0;
    return light_pdf(t, index, p, n, distance * distance, cosine);
}
