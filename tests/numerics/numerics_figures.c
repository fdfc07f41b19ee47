/* numerics_figures: what other ways to intersect make of the rows of the matrix.
 *
 *   numerics_figures > figures.csv        (some minutes; tests/numerics/plot.py draws it)
 *
 * Lines of "figure,method,x,value". The methods: `seed`, the source report's Moeller-Trumbore in
 * double with its absolute epsilon of 1e-8 on the determinant; the same with epsilon 0; Woop's test
 * in float, without the second look in double; Embree in its default and its ROBUST mode; and ours,
 * through the whole scene build. Each gets the same rays, made in double, rounded where it must.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"
#include "tests/bench/trace_peer.h"
#include "tests/numerics/closed_mesh.h"
#include "tests/render/render_kit.h"
#include "worker/render/render_scene.h"
#include "worker/scene/scene_build.h"

typedef __float128 quad;

struct triangle {
    double v[3][3];
};

/* --- Other ways --------------------------------------------------------------- */

static bool moller_trumbore(const struct triangle *f, const double org[3], const double dir[3],
                            double epsilon, double *t)
{
    double e1[3], e2[3], s[3], p[3], q[3], det = 0, u = 0, v = 0, along = 0;
    for (int k = 0; k < 3; k++) {
        e1[k] = f->v[1][k] - f->v[0][k];
        e2[k] = f->v[2][k] - f->v[0][k];
        s[k] = org[k] - f->v[0][k];
    }
    for (int k = 0; k < 3; k++) {
        int x = (k + 1) % 3, y = (k + 2) % 3;
        p[k] = dir[x] * e2[y] - dir[y] * e2[x];
        q[k] = s[x] * e1[y] - s[y] * e1[x];
    }
    for (int k = 0; k < 3; k++) {
        det += e1[k] * p[k];
        u += s[k] * p[k];
        v += dir[k] * q[k];
        along += e2[k] * q[k];
    }
    if (!(fabs(det) > epsilon))
        return false;
    u /= det;
    v /= det;
    *t = along / det;
    return u >= 0 && v >= 0 && u + v <= 1 && *t > 0;
}

static bool woop_float(const struct triangle *f, const double org[3], const double dir[3],
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

enum method { SEED, EPSILON_0, WOOP_FLOAT, EMBREE, EMBREE_ROBUST, OURS, METHODS };
static const char *const names[METHODS] = {"seed",   "seed, epsilon 0", "Woop, float",
                                           "Embree", "Embree, ROBUST",  "Tilery"};

/* --- A mesh in the world, ready for all of them --------------------------------- */

struct world {
    struct triangle *triangles;
    size_t count;
    double scale, offset[3]; /* world = mesh * scale + offset */
    struct trace_scene floats;
    struct trace_peer *peer[2];
    struct render_scene *ours;
};

static void world_make(struct world *w, const struct gen_mesh *m, double scale, double away)
{
    static const double aside[3] = {1, -0.7, 0.4};
    struct gen_mesh copy = {0};
    struct scene s;
    struct job_spec spec = kit_spec(1, 1);
    memset(w, 0, sizeof *w);
    w->scale = scale;
    w->count = m->triangle_count;
    w->triangles = mem_alloc_array(w->count, sizeof *w->triangles);
    double *positions = mem_alloc_array(m->vertex_count, 3 * sizeof *positions);
    if (!w->triangles || !positions || gen_ball(&copy, 1, aside, 1, 0, 1) != ERR_OK)
        abort();
    gen_mesh_release(&copy);
    copy.positions = mem_alloc_array(m->vertex_count, 3 * sizeof *copy.positions);
    copy.indices = mem_alloc_array(m->triangle_count, 3 * sizeof *copy.indices);
    if (!copy.positions || !copy.indices)
        abort();
    copy.vertex_count = m->vertex_count;
    copy.triangle_count = m->triangle_count;
    memcpy(copy.indices, m->indices, 3 * m->triangle_count * sizeof *copy.indices);
    for (size_t i = 0; i < 3 * m->vertex_count; i++) {
        w->offset[i % 3] = aside[i % 3] * away;
        positions[i] = (double)m->positions[i] * scale + w->offset[i % 3];
        copy.positions[i] = (float)positions[i];
    }
    for (size_t t = 0; t < w->count; t++)
        for (size_t i = 0; i < 3; i++)
            memcpy(w->triangles[t].v[i], positions + 3 * (size_t)m->indices[3 * t + i],
                   sizeof w->triangles[t].v[i]);
    /* Ours: a scene like any other. */
    scene_init(&s);
    static const double corners[12] = {0};
    uint32_t object = kit_quad(&s, corners, kit_diffuse(&s, 1, 1, 1));
    struct scene_mesh *mesh = &s.meshes[s.objects[object].mesh];
    mem_free(mesh->positions);
    mem_free(mesh->indices);
    mesh->positions = positions;
    mesh->indices = mem_alloc_array(3 * w->count, sizeof *mesh->indices);
    if (!mesh->indices)
        abort();
    memcpy(mesh->indices, m->indices, 3 * w->count * sizeof *mesh->indices);
    mesh->vertex_count = (uint32_t)m->vertex_count;
    mesh->triangle_count = (uint32_t)w->count;
    if (scene_build(&s, &spec, NULL, &w->ours) != ERR_OK)
        abort();
    scene_release(&s);
    trace_scene_wrap(&w->floats, &copy);
    for (int robust = 0; robust < 2; robust++) {
        w->peer[robust] = trace_peer_new(NULL, 1);
        if (!w->peer[robust])
            abort();
        trace_peer_build(w->peer[robust], &w->floats, PEER_MEDIUM, robust);
    }
}

static void world_release(struct world *w)
{
    mem_free(w->triangles);
    trace_peer_free(w->peer[0]);
    trace_peer_free(w->peer[1]);
    trace_scene_release(&w->floats);
    render_scene_free(w->ours);
}

/* The nearest t by a method, in lengths of dir; infinite: none. */
static double nearest(const struct world *w, enum method method, const double org[3],
                      const double dir[3])
{
    double best = (double)INFINITY, t;
    if (method == EMBREE || method == EMBREE_ROBUST) {
        float form[8] = {(float)org[0], (float)org[1], (float)org[2], 0,
                         (float)dir[0], (float)dir[1], (float)dir[2], __builtin_inff()};
        struct trace_peer_hit hit;
        trace_peer_closest(w->peer[method == EMBREE_ROBUST], form, &hit);
        return hit.object == SCENE_NONE ? best : (double)hit.t;
    }
    if (method == OURS) {
        struct ray ray = {.tmax = (double)INFINITY};
        struct hit hit;
        for (int k = 0; k < 3; k++) {
            ray.org[k] = (org[k] - w->ours->center[k]) * w->ours->scale;
            ray.dir[k] = dir[k] * w->ours->scale;
        }
        accel_closest(w->ours->accel, &ray, &hit);
        return hit.object == SCENE_NONE ? best : hit.t;
    }
    for (size_t i = 0; i < w->count; i++) {
        bool hit = method == WOOP_FLOAT
                       ? woop_float(&w->triangles[i], org, dir, &t)
                       : moller_trumbore(&w->triangles[i], org, dir, method == SEED ? 1e-8 : 0, &t);
        if (hit && t < best)
            best = t;
    }
    return best;
}

/* The truth: the triangles as the file gives them, in quad precision. */
static double truth(const struct world *w, const double org[3], const double dir[3])
{
    quad best = 1e300Q;
    for (size_t i = 0; i < w->count; i++) {
        quad e1[3], e2[3], s[3], p[3], q[3], det = 0, u = 0, v = 0, t = 0;
        const struct triangle *f = &w->triangles[i];
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

/* --- Figures --------------------------------------------------------------------- */

/* Ray i of closed_ray, in the world. */
static void world_ray(const struct world *w, const struct gen_mesh *m, uint64_t *state, size_t i,
                      double org[3], double dir[3])
{
    struct ray ray;
    closed_ray(m, state, i, &ray);
    for (int k = 0; k < 3; k++) {
        org[k] = ray.org[k] * w->scale + w->offset[k];
        dir[k] = ray.dir[k] * w->scale;
    }
    if (i % 3 == 2)
        return;
    /* Aim at the very point in the world, whatever rounding did to it. */
    for (int k = 0; k < 3; k++) {
        double to = (ray.org[k] + ray.dir[k]) * w->scale + w->offset[k];
        dir[k] = to - org[k];
    }
}

/* Share of rays from inside that hit nothing; vertices and edges only. More rays where there is a
 * tree to find so rare a thing. */
static void leaks(const char *figure, double x, const struct world *w, const struct gen_mesh *m)
{
    enum { RAYS_ALL = 6000, RAYS_TREE = 300000 };
    for (int method = 0; method < METHODS; method++) {
        uint64_t state = 41;
        size_t lost = 0, count = 0, rays = method >= EMBREE ? RAYS_TREE : RAYS_ALL;
        for (size_t i = 0; i < rays; i++) {
            double org[3], dir[3];
            world_ray(w, m, &state, i, org, dir);
            if (i % 3 == 2)
                continue;
            count++;
            lost += isinf(nearest(w, (enum method)method, org, dir)) != 0;
        }
        printf("%s,\"%s\",%g,%g\n", figure, names[method], x, (double)lost / (double)count);
    }
}

/* Largest error of the hit's place, in radii of the ball. */
static void errors(const char *figure, double x, const struct world *w, const struct gen_mesh *m)
{
    enum { RAYS = 3000 };
    double worst[METHODS] = {0};
    uint64_t state = 42;
    for (size_t i = 2; i < RAYS; i += 3) {
        double org[3], dir[3], length = 0;
        world_ray(w, m, &state, i, org, dir);
        for (int k = 0; k < 3; k++)
            length += dir[k] * dir[k];
        double t = truth(w, org, dir);
        for (int method = 0; method < METHODS; method++) {
            double found = nearest(w, (enum method)method, org, dir);
            double off = isinf(found) ? 1 : fabs(found - t) * sqrt(length) / w->scale;
            worst[method] = fmax(worst[method], fmin(off, 1));
        }
    }
    for (int method = 0; method < METHODS; method++)
        printf("%s,\"%s\",%g,%g\n", figure, names[method], x, worst[method]);
}

/* A needle of an aspect in any orientation, as floats, and a ray that grazes it. */
static void needle(uint64_t *state, double aspect, double graze, struct gen_mesh *m, double org[3],
                   double dir[3])
{
    double apex = gen_random(state), turn = gen_random(state), tilt = gen_random(state);
    double c = cos(6.28 * turn), s = sin(6.28 * turn), d = cos(6.28 * tilt), e = sin(6.28 * tilt);
    const double axis[3][3] = {{c, s * d, s * e}, {-s, c * d, c * e}, {0, -e, d}};
    double b1 = 0.1 + 0.4 * gen_random(state), b2 = 0.1 + 0.4 * gen_random(state);
    double at[2] = {b1 + b2 * apex, b2 / aspect}, from[3] = {at[0] - 2, at[1], 2 * graze};
    double e1[3], e2[3];
    from[1] -= gen_random(state);
    for (int k = 0; k < 3; k++) {
        e1[k] = axis[0][k];
        e2[k] = (apex - 1) * axis[0][k] + axis[1][k] / aspect;
        org[k] = from[0] * axis[0][k] + from[1] * axis[1][k] + from[2] * axis[2][k];
        dir[k] = at[0] * axis[0][k] + at[1] * axis[1][k] - org[k];
        org[k] = (double)(float)org[k]; /* the same for all */
        dir[k] = (double)(float)dir[k];
    }
    gen_mesh_init(m);
    if (gen_quad(m, (double[3]){0, 0, 0}, e1, e2) != ERR_OK)
        abort();
    m->triangle_count = 1;
}

/* Our kernel on the very floats that Embree gets, without the scene build, which rounds vertices
 * once more and so makes a needle another one. */
static double kernel_nearest(const struct world *w, const double org[3], const double dir[3])
{
    struct accel_options options = {.builder = JOB_BUILDER_SAH};
    struct ray ray = {{org[0], org[1], org[2]}, {dir[0], dir[1], dir[2]}, 0, (double)INFINITY};
    struct accel *a;
    struct hit hit;
    if (accel_new(&w->floats.input, &options, NULL, &a) != ERR_OK)
        abort();
    accel_closest(a, &ray, &hit);
    accel_free(a);
    return hit.object == SCENE_NONE ? (double)INFINITY : hit.t;
}

/* T8: of the rays that truly meet the needle, those that miss it, and the largest error of t. */
static void needles(double aspect, double graze)
{
    enum { COUNT = 1000 };
    size_t missed[METHODS] = {0}, met = 0;
    double worst[METHODS] = {0};
    uint64_t state = 43;
    for (int i = 0; i < COUNT; i++) {
        struct gen_mesh m;
        struct world w;
        double org[3], dir[3];
        needle(&state, aspect, graze, &m, org, dir);
        world_make(&w, &m, 1, 0);
        double t = truth(&w, org, dir);
        for (int method = 0; method < METHODS && t < 1e300; method++) {
            double found = method == OURS ? kernel_nearest(&w, org, dir)
                                          : nearest(&w, (enum method)method, org, dir);
            if (isinf(found))
                missed[method]++;
            else
                worst[method] = fmax(worst[method], fabs(found - t) / t);
        }
        met += t < 1e300;
        world_release(&w);
        gen_mesh_release(&m);
    }
    for (int method = 0; method < METHODS && met > 0; method++) {
        printf("needles missed at %g rad,\"%s\",%g,%g\n", graze, names[method], aspect,
               (double)missed[method] / (double)met);
        printf("needles t error at %g rad,\"%s\",%g,%g\n", graze, names[method], aspect,
               worst[method]);
    }
}

/* --- T7: the slab test alone ------------------------------------------------------ */

/* Of rays parallel to an axis that start on a plane of a box and meet it: lost by the usual forms.
 */
static void slabs(void)
{
    enum { COUNT = 200000 };
    size_t lost[2] = {0}, met = 0;
    uint64_t state = 44;
    for (int i = 0; i < COUNT; i++) {
        int axis = i % 3;
        double org[3], dir[3] = {0, 0, 0}, from[2] = {0, 0}, to[2];
        to[0] = to[1] = (double)INFINITY;
        for (int k = 0; k < 3; k++)
            org[k] = gen_random(&state);
        org[(axis + 1) % 3] = i & 8 ? 1 : 0; /* on a plane of the unit box */
        org[axis] = -1;
        dir[axis] = 1;
        for (int k = 0; k < 3; k++)
            if (dir[k] == 0 && i & 16)
                dir[k] = -0.0;
        met++;
        for (int k = 0; k < 3; k++) {
            double inverse = 1 / dir[k], a = (0 - org[k]) * inverse, b = (1 - org[k]) * inverse;
            from[0] = fmax(from[0], fmin(a, b));
            to[0] = fmin(to[0], fmax(a, b));
            double low = a < b ? a : b, high = a < b ? b : a; /* swap, then compare */
            from[1] = from[1] > low ? from[1] : low;
            to[1] = to[1] < high ? to[1] : high;
        }
        for (int form = 0; form < 2; form++)
            lost[form] += !(from[form] <= to[form]);
    }
    printf("slabs,\"fmin/fmax\",0,%g\nslabs,\"swap and compare\",0,%g\n",
           (double)lost[0] / (double)met, (double)lost[1] / (double)met);
}

int main(void)
{
    struct gen_mesh ball;
    closed_make(CLOSED_ICOSPHERE, &ball);
    for (int k = -12; k <= 12; k++) {
        struct world w;
        world_make(&w, &ball, pow(10, k), 0);
        leaks("leaks by scale", pow(10, k), &w, &ball);
        world_release(&w);
        (void)fflush(stdout);
    }
    for (int k = 0; k <= 10; k++) {
        struct world w;
        world_make(&w, &ball, 0.9, pow(10, k)); /* 0.9: no vertex is a float by chance */
        leaks("leaks by distance", pow(10, k), &w, &ball);
        errors("error by distance", pow(10, k), &w, &ball);
        world_release(&w);
        (void)fflush(stdout);
    }
    for (int k = 0; k <= 6; k += 2) {
        needles(pow(10, k), 1e-2);
        needles(pow(10, k), 1e-4);
    }
    slabs();
    gen_mesh_release(&ball);
    return 0;
}
