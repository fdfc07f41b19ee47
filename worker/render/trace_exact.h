/* worker/render/trace_exact.h: what decides, in double, one primitive at a time.
 *
 * The scalar form of the decision. The SIMD kernels perform the same operations in
 * the same order in each lane, so that their bits are these. Only + - * / sqrt;
 * never contracted. Pure; any thread. Derivations: docs/TRACING.md.
 */
#ifndef WORKER_RENDER_TRACE_EXACT_H
#define WORKER_RENDER_TRACE_EXACT_H

#include "worker/render/trace.h"

static inline double exact_min(double a, double b)
{
    return a < b ? a : b;
}

static inline double exact_max(double a, double b)
{
    return a > b ? a : b;
}

static inline double exact_abs(double a)
{
    return __builtin_fabs(a);
}

/* Woop's edge functions: a triangle relative to the origin and sheared so that the
 * ray is the z axis. */
struct exact_edges {
    double rel[3][3]; /* vertex, then x, y, z of the permuted axes; not sheared */
    double u, v, w;   /* weights of vertices 0, 1, 2 times det */
    double det;
};

/* `v` has its axes permuted as the ray's. */
static inline void exact_edges_permuted(const struct trace_ray *r, const float v[3][3],
                                        struct exact_edges *e)
{
    double x[3], y[3];
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++)
            e->rel[i][k] = (double)v[i][k] - r->porg[k];
        x[i] = e->rel[i][0] - r->shear[0] * e->rel[i][2];
        y[i] = e->rel[i][1] - r->shear[1] * e->rel[i][2];
    }
    e->u = x[2] * y[1] - y[2] * x[1];
    e->v = x[0] * y[2] - y[0] * x[2];
    e->w = x[1] * y[0] - y[1] * x[0];
    e->det = (e->u + e->v) + e->w;
}

static inline void exact_edges_of(const struct trace_ray *r, const float v[3][3],
                                  struct exact_edges *e)
{
    float permuted[3][3];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            permuted[i][k] = v[i][r->axis[k]];
    exact_edges_permuted(r, permuted, e);
}

/* z of the hit, held within its vertices' depths. */
static inline double exact_depth(const struct exact_edges *e)
{
    double zmin = exact_min(exact_min(e->rel[0][2], e->rel[1][2]), e->rel[2][2]);
    double zmax = exact_max(exact_max(e->rel[0][2], e->rel[1][2]), e->rel[2][2]);
    double z = ((e->u * e->rel[0][2] + e->v * e->rel[1][2]) + e->w * e->rel[2][2]) / e->det;
    return exact_min(exact_max(z, zmin), zmax);
}

/* Moves t into the slab [lo, hi] / d; d == 0 leaves it (the slab then holds the origin). */
static inline double exact_slab_clamp(double t, double lo, double hi, double d)
{
    if (d == 0.0)
        return t;
    double a = lo / d, b = hi / d;
    return exact_min(exact_max(t, exact_min(a, b)), exact_max(a, b));
}

/* Is the point at t within the triangle's box across the ray, but for `slack`? */
static inline bool exact_inside(const struct trace_ray *r, const struct exact_edges *e, double t,
                                double slack)
{
    bool inside = true;
    for (int k = 0; k < 2; k++) {
        double lo = exact_min(exact_min(e->rel[0][k], e->rel[1][k]), e->rel[2][k]) - slack;
        double hi = exact_max(exact_max(e->rel[0][k], e->rel[1][k]), e->rel[2][k]) + slack;
        double p = t * r->pdir[k];
        inside = inside && p >= lo && p <= hi;
    }
    return inside;
}

/* The t of a triangle whose edge functions agree: its depth is held within its vertices'
 * depths and, where rounding threw the point out of the triangle's own (padded) box, as
 * it does for needles, t is moved back into the box. So t lies where any box around the
 * triangle says it can lie, whatever the tree. False if the line does not meet the box:
 * edge functions that vanish in rounding agree even where a line passes a degenerate
 * triangle by, in its plane. No closed surface leaks by that: the triangle that the ray
 * does cross is met within its box. */
static inline bool exact_t(const struct trace_ray *r, const struct exact_edges *e, double *out)
{
    double t = exact_depth(e) * r->shear[2];
    *out = t;
    if (exact_inside(r, e, t, r->slack))
        return true;
    for (int k = 0; k < 2; k++) {
        double lo = exact_min(exact_min(e->rel[0][k], e->rel[1][k]), e->rel[2][k]) - r->slack;
        double hi = exact_max(exact_max(e->rel[0][k], e->rel[1][k]), e->rel[2][k]) + r->slack;
        t = exact_slab_clamp(t, lo, hi, r->pdir[k]);
    }
    double zmin = exact_min(exact_min(e->rel[0][2], e->rel[1][2]), e->rel[2][2]);
    double zmax = exact_max(exact_max(e->rel[0][2], e->rel[1][2]), e->rel[2][2]);
    t = exact_slab_clamp(t, zmin, zmax, r->pdir[2]);
    *out = t;
    return exact_inside(r, e, t, 2.0 * r->slack);
}

static inline bool exact_woop(const struct trace_ray *r, const float v[3][3], struct exact_edges *e,
                              double *t)
{
    exact_edges_of(r, v, e);
    bool negative = e->u < 0.0 || e->v < 0.0 || e->w < 0.0;
    bool positive = e->u > 0.0 || e->v > 0.0 || e->w > 0.0;
    if ((negative && positive) || e->det == 0.0)
        return false;
    return exact_t(r, e, t);
}

/* The source report's test, as it stands: Moeller and Trumbore in double with an
 * absolute epsilon on the determinant, in the ray's own lengths. */
static inline bool exact_moller_trumbore(const struct trace_ray *r, const float v[3][3], double *t,
                                         double *b1, double *b2)
{
    const double epsilon = 1e-8;
    double d[3], e1[3], e2[3], s[3];
    for (int k = 0; k < 3; k++) {
        d[k] = r->dir[k] / r->scale;
        e1[k] = (double)v[1][k] - (double)v[0][k];
        e2[k] = (double)v[2][k] - (double)v[0][k];
        s[k] = r->org[k] - (double)v[0][k];
    }
    double p[3] = {d[1] * e2[2] - d[2] * e2[1], d[2] * e2[0] - d[0] * e2[2],
                   d[0] * e2[1] - d[1] * e2[0]};
    double det = (e1[0] * p[0] + e1[1] * p[1]) + e1[2] * p[2];
    if (!(exact_abs(det) >= epsilon))
        return false;
    *b1 = ((s[0] * p[0] + s[1] * p[1]) + s[2] * p[2]) / det;
    if (!(*b1 >= 0.0 && *b1 <= 1.0))
        return false;
    double q[3] = {s[1] * e1[2] - s[2] * e1[1], s[2] * e1[0] - s[0] * e1[2],
                   s[0] * e1[1] - s[1] * e1[0]};
    *b2 = ((d[0] * q[0] + d[1] * q[1]) + d[2] * q[2]) / det;
    if (!(*b2 >= 0.0 && *b1 + *b2 <= 1.0))
        return false;
    *t = ((e2[0] * q[0] + e2[1] * q[1]) + e2[2] * q[2]) / det / r->scale;
    return true;
}

/* The nearest of the two intersections with a sphere that lies in (tmin, tmax). The
 * discriminant comes from the distance of the line to the centre, so that it does not
 * cancel for small or far spheres (Haines et al., Ray Tracing Gems, chapter 7). */
static inline bool exact_sphere(const struct trace_ray *r, const double center[3], double radius,
                                double tmin, double tmax, double *t)
{
    double v[3], a = 0.0, b = 0.0, vv = 0.0, pp = 0.0;
    for (int k = 0; k < 3; k++) {
        v[k] = r->org[k] - center[k];
        a += r->dir[k] * r->dir[k];
        b += r->dir[k] * v[k];
        vv += v[k] * v[k];
    }
    double foot = b / a;
    for (int k = 0; k < 3; k++) {
        double perpendicular = v[k] - foot * r->dir[k];
        pp += perpendicular * perpendicular;
    }
    double distance = __builtin_sqrt(pp), outside = __builtin_sqrt(vv);
    double discriminant = a * ((radius + distance) * (radius - distance));
    if (!(discriminant >= 0.0))
        return false;
    double root = __builtin_sqrt(discriminant);
    double q = b < 0.0 ? root - b : -b - root;
    double t0 = q / a;
    double t1 = q == 0.0 ? t0 : (outside + radius) * (outside - radius) / q;
    double first = exact_min(t0, t1), second = exact_max(t0, t1);
    if (first > tmin && first < tmax)
        *t = first;
    else if (second > tmin && second < tmax)
        *t = second;
    else
        return false;
    return true;
}

#endif
