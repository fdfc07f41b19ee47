/* worker/render/sphere_parts.h: points on a sphere that shines, one and eight, the same bits.
 *
 * The loop over eight is compiled for each instruction set (sphere_loop.h). Any thread. Tests:
 * test_light.
 */
#ifndef WORKER_RENDER_SPHERE_PARTS_H
#define WORKER_RENDER_SPHERE_PARTS_H

#include "worker/render/light_tree.h"
#include "worker/render/warp.h"

enum { SPHERE_MANY = 8 };

_Static_assert((int)SPHERE_MANY == (int)LIGHT_TREE_DRAWS_MAX, "all draws of a vertex in one batch");

/* A sphere as a point sees it. */
struct sphere_view {
    double cap; /* 1 - cos of the half angle under which it is seen; > 0 */
    double distance2, distance;
    frame towards; /* n is the direction of its centre */
};

/* What is seen of the sphere in lane k of a batch; in lanes that nobody reads zeros do. */
struct sphere_batch {
    double u[SPHERE_MANY], v[SPHERE_MANY];
    double cap[SPHERE_MANY], distance2[SPHERE_MANY], distance[SPHERE_MANY];
    double s[3][SPHERE_MANY], t[3][SPHERE_MANY], n[3][SPHERE_MANY]; /* the frame */
    double center[3][SPHERE_MANY], radius[SPHERE_MANY], error[SPHERE_MANY];
    double wi[3][SPHERE_MANY], target[3][SPHERE_MANY], pdf[SPHERE_MANY];
};

/* Draws from `p` by u and v into wi, target and pdf. */
typedef void sphere_loop(vec3 p, struct sphere_batch *b);
sphere_loop sphere_loop_sse2, sphere_loop_avx2, sphere_loop_avx512;

/* A direction from p in the cone of the sphere, uniform in solid angle, and where it meets it. */
static inline void sphere_draw(const struct sphere_view *view, vec3 p, vec3 center, double radius,
                               double error, double u, double v, vec3 *wi, vec3 *target,
                               double *pdf)
{
    double x, y, cap = view->cap;
    warp_disk(u, v, &x, &y);
    double below = (x * x + y * y) * cap; /* 1 - cos of the drawn angle */
    double wide = sqrt(cap * (2 - below));
    double sin2 = below * (2 - below);
    /* Of length 1: x^2 + y^2 times wide^2 is sin2. */
    *wi = frame_to_world(&view->towards, v3(x * wide, y * wide, 1 - below));
    /* Where it meets the sphere, brought back onto it. */
    double half2 = radius * radius - view->distance2 * sin2;
    double t = view->distance * (1 - below) - sqrt(half2 > 0 ? half2 : 0);
    vec3 n = v3_unit(v3_sub(v3_mad(p, *wi, t), center));
    *target = v3_mad(center, n, radius + error);
    *pdf = 1 / (2 * VEC_PI * cap);
}

#endif
