#include "tests/numerics/figure_methods.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"
#include "tests/render/render_kit.h"
#include "worker/render/surface.h"
#include "worker/scene/scene_build.h"

typedef __float128 quad;

#define MOLLER_TRUMBORE figure_moller_trumbore
#include "tests/numerics/figure_moller_trumbore.h"

/* --- Other ways --------------------------------------------------------------- */

static bool woop_float(const struct figure_triangle *f, const double org[3], const double dir[3],
                       double *t)
{
    float d[3] = {(float)dir[0], (float)dir[1], (float)dir[2]};
    int z = fabsf(d[0]) > fabsf(d[1]) ? 0 : 1;
    z = fabsf(d[2]) > fabsf(d[z]) ? 2 : z;
    int x = (z + 1) % 3, y = (z + 2) % 3;
    float sx = d[x] / d[z], sy = d[y] / d[z], sz = 1 / d[z], a[3][3];
    for (int i = 0; i < 3; i++) {
        float rel[3];
        for (int k = 0; k < 3; k++)
            rel[k] = (float)f->v[i][k] - (float)org[k];
        a[i][0] = rel[x] - sx * rel[z];
        a[i][1] = rel[y] - sy * rel[z];
        a[i][2] = sz * rel[z];
    }
    float u = a[2][0] * a[1][1] - a[2][1] * a[1][0];
    float v = a[0][0] * a[2][1] - a[0][1] * a[2][0];
    float w = a[1][0] * a[0][1] - a[1][1] * a[0][0];
    if ((u < 0 || v < 0 || w < 0) && (u > 0 || v > 0 || w > 0))
        return false;
    float det = u + v + w;
    if (det == 0)
        return false;
    *t = (double)((u * a[0][2] + v * a[1][2] + w * a[2][2]) / det);
    return *t > 0;
}

const char *const figure_names[METHODS] = {"seed",   "seed, epsilon 0", "Woop, float",
                                           "Embree", "Embree, ROBUST",  "Tilery"};

/* --- A mesh in the world, ready for all of them --------------------------------- */

static void *array_of(size_t count, size_t bytes)
{
    void *out = mem_alloc_array(count, bytes);
    if (!out)
        abort();
    return out;
}

/* Ours: a scene like any other. */
static void build_ours(struct figure_world *w, const double *positions, size_t vertex_count,
                       const uint32_t *indices, size_t triangle_count)
{
    struct scene s;
    struct job_spec spec = kit_spec(1, 1);
    scene_init(&s);
    kit_mesh(&s, positions, (uint32_t)vertex_count, indices, (uint32_t)triangle_count,
             kit_diffuse(&s, 1, 1, 1));
    if (scene_build(&s, &spec, NULL, &w->ours) != ERR_OK)
        abort();
    scene_release(&s);
}

void figure_world_of(struct figure_world *w, const double *positions, size_t vertex_count,
                     const uint32_t *indices, size_t triangle_count)
{
    struct gen_mesh copy;
    *w = (struct figure_world){.scale = 1, .count = triangle_count};
    w->triangles = array_of(w->count, sizeof *w->triangles);
    for (size_t t = 0; t < w->count; t++)
        for (size_t i = 0; i < 3; i++)
            memcpy(w->triangles[t].v[i], positions + 3 * (size_t)indices[3 * t + i],
                   sizeof w->triangles[t].v[i]);
    build_ours(w, positions, vertex_count, indices, triangle_count);
    gen_mesh_init(&copy);
    copy.positions = array_of(vertex_count, 3 * sizeof *copy.positions);
    copy.indices = array_of(triangle_count, 3 * sizeof *copy.indices);
    copy.vertex_count = vertex_count;
    copy.triangle_count = triangle_count;
    for (size_t i = 0; i < 3 * vertex_count; i++)
        copy.positions[i] = (float)positions[i];
    memcpy(copy.indices, indices, 3 * triangle_count * sizeof *copy.indices);
    trace_scene_wrap(&w->floats, &copy);
    for (int robust = 0; robust < 2; robust++) {
        w->peer[robust] = trace_peer_new(NULL, 1);
        if (!w->peer[robust])
            abort();
        trace_peer_build(w->peer[robust], &w->floats, PEER_MEDIUM, robust);
    }
}

void figure_world_make(struct figure_world *w, const struct gen_mesh *m, double scale, double away)
{
    static const double aside[3] = {1, -0.7, 0.4};
    double *positions = array_of(m->vertex_count, 3 * sizeof *positions);
    for (size_t i = 0; i < 3 * m->vertex_count; i++)
        positions[i] = (double)m->positions[i] * scale + aside[i % 3] * away;
    figure_world_of(w, positions, m->vertex_count, m->indices, m->triangle_count);
    w->scale = scale;
    for (int k = 0; k < 3; k++)
        w->offset[k] = aside[k] * away;
    mem_free(positions);
}

void figure_world_free(struct figure_world *w)
{
    mem_free(w->triangles);
    trace_peer_free(w->peer[0]);
    trace_peer_free(w->peer[1]);
    trace_scene_release(&w->floats);
    render_scene_free(w->ours);
}

static struct figure_hit nearest_of_embree(struct trace_peer *peer, const double org[3],
                                           const double dir[3], double tmin)
{
    float form[8] = {(float)org[0], (float)org[1], (float)org[2], (float)tmin,
                     (float)dir[0], (float)dir[1], (float)dir[2], __builtin_inff()};
    struct trace_peer_hit hit;
    trace_peer_closest(peer, form, &hit);
    bool none = hit.object == SCENE_NONE;
    return (struct figure_hit){none ? (double)INFINITY : (double)hit.t,
                               none ? SCENE_NONE : hit.primitive};
}

static struct figure_hit found_by_ours(const struct hit *hit)
{
    bool none = hit->object == SCENE_NONE;
    return (struct figure_hit){none ? (double)INFINITY : hit->t,
                               none ? SCENE_NONE : hit->primitive};
}

static struct ray ray_of_ours(const struct render_scene *rs, const double org[3],
                              const double dir[3], double tmin)
{
    struct ray ray = {.tmin = tmin, .tmax = (double)INFINITY};
    for (int k = 0; k < 3; k++) {
        ray.org[k] = (org[k] - rs->center[k]) * rs->scale;
        ray.dir[k] = dir[k] * rs->scale;
    }
    return ray;
}

struct figure_hit figure_nearest(const struct figure_world *w, enum figure_method method,
                                 const double org[3], const double dir[3], double tmin)
{
    struct figure_hit best = {(double)INFINITY, SCENE_NONE};
    if (method == EMBREE || method == EMBREE_ROBUST)
        return nearest_of_embree(w->peer[method == EMBREE_ROBUST], org, dir, tmin);
    if (method == OURS) {
        struct ray ray = ray_of_ours(w->ours, org, dir, tmin);
        struct hit hit;
        accel_closest(w->ours->accel, &ray, &hit);
        return found_by_ours(&hit);
    }
    for (size_t i = 0; i < w->count; i++) {
        const struct figure_triangle *f = &w->triangles[i];
        double t;
        bool hit = method == WOOP_FLOAT
                       ? woop_float(f, org, dir, &t)
                       : figure_moller_trumbore(f, org, dir, method == SEED ? 1e-8 : 0, &t);
        if (hit && t > tmin && t < best.t)
            best = (struct figure_hit){t, (uint32_t)i};
    }
    return best;
}

/* --- Paths ------------------------------------------------------------------ */

void figure_path_begin(struct figure_path *p, const struct figure_world *w,
                       enum figure_method method, double beyond, const double org[3],
                       const double dir[3])
{
    *p = (struct figure_path){.method = method, .beyond = beyond};
    struct ray ray = ray_of_ours(w->ours, org, dir, 0);
    memcpy(p->org, method == OURS ? ray.org : org, sizeof p->org);
    memcpy(p->dir, method == OURS ? ray.dir : dir, sizeof p->dir);
}

static struct figure_hit step_of_ours(struct figure_path *p, const struct render_scene *rs,
                                      const double to[3])
{
    struct ray ray = {.tmax = (double)INFINITY};
    struct hit hit;
    struct surface at;
    memcpy(ray.org, p->org, sizeof ray.org);
    memcpy(ray.dir, p->dir, sizeof ray.dir);
    accel_closest(rs->accel, &ray, &hit);
    for (int k = 0; k < 3; k++)
        p->dir[k] = to[k] * rs->scale;
    if (hit.object != SCENE_NONE) {
        surface_of_hit(rs, &hit, &at);
        v3_put(p->org, surface_offset(at.p, at.ng, at.error, v3_of(to)));
    }
    return found_by_ours(&hit);
}

struct figure_hit figure_path_step(struct figure_path *p, const struct figure_world *w,
                                   const double to[3])
{
    if (p->method == OURS)
        return step_of_ours(p, w->ours, to);
    bool exact = p->method == SEED || p->method == EPSILON_0;
    double length = sqrt(p->dir[0] * p->dir[0] + p->dir[1] * p->dir[1] + p->dir[2] * p->dir[2]);
    struct figure_hit hit =
        figure_nearest(w, p->method, p->org, p->dir, p->started ? p->beyond / length : 0);
    for (int k = 0; k < 3 && !isinf(hit.t); k++) {
        double at = exact ? p->org[k] + hit.t * p->dir[k]
                          : (double)((float)p->org[k] + (float)hit.t * (float)p->dir[k]);
        p->org[k] = at;
    }
    memcpy(p->dir, to, sizeof p->dir);
    p->started = true;
    return hit;
}

void figure_path_at(const struct figure_path *p, const struct figure_world *w, double out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = p->method == OURS ? p->org[k] / w->ours->scale + w->ours->center[k] : p->org[k];
}

/* --- The truth -------------------------------------------------------------- */

/* The truth: the triangles as the file gives them, in quad precision. */
double figure_truth(const struct figure_world *w, const double org[3], const double dir[3])
{
    quad best = 1e300Q;
    for (size_t i = 0; i < w->count; i++) {
        quad e1[3], e2[3], s[3], p[3], q[3], det = 0, u = 0, v = 0, t = 0;
        const struct figure_triangle *f = &w->triangles[i];
        for (int k = 0; k < 3; k++) {
            e1[k] = (quad)f->v[1][k] - (quad)f->v[0][k];
            e2[k] = (quad)f->v[2][k] - (quad)f->v[0][k];
            s[k] = (quad)org[k] - (quad)f->v[0][k];
        }
        for (int k = 0; k < 3; k++) {
            int x = (k + 1) % 3, y = (k + 2) % 3;
            p[k] = (quad)dir[x] * e2[y] - (quad)dir[y] * e2[x];
            q[k] = s[x] * e1[y] - s[y] * e1[x];
        }
        for (int k = 0; k < 3; k++) {
            det += e1[k] * p[k];
            u += s[k] * p[k];
            v += (quad)dir[k] * q[k];
            t += e2[k] * q[k];
        }
        if (det == 0)
            continue;
        u /= det;
        v /= det;
        t /= det;
        if (u >= 0 && v >= 0 && u + v <= 1 && t > 0 && t < best)
            best = t;
    }
    return (double)best;
}

void figure_put(const char *figure, enum figure_method method, double x, double value)
{
    printf("%s,\"%s\",%g,%g\n", figure, figure_names[method], x, value);
}
