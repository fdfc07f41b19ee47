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
    double rel[3][3];  /* vertex, then x, y, z of the permuted axes; not sheared */
    double x[3], y[3]; /* sheared */
    double u, v, w;    /* weights of vertices 0, 1, 2 times det */
    double det;
};

/* `v` has its axes permuted as the ray's. */
static inline void exact_edges_permuted(const struct trace_ray *r, const float v[3][3],
                                        struct exact_edges *e)
{
    double *x = e->x, *y = e->y;
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

static inline bool exact_mixed(const struct exact_edges *e)
{
    bool negative = e->u < 0.0 || e->v < 0.0 || e->w < 0.0;
    bool positive = e->u > 0.0 || e->v > 0.0 || e->w > 0.0;
    return negative && positive;
}

/* Is the point of the triangle that the weights make less than the slack beside the ray? It would
 * be upon it if nothing were rounded. Not if det is 0. */
static inline bool exact_near(const struct trace_ray *r, const struct exact_edges *e)
{
    double size = r->slack * exact_abs(e->det);
    double x = (e->u * e->x[0] + e->v * e->x[1]) + e->w * e->x[2];
    double y = (e->u * e->y[0] + e->v * e->y[1]) + e->w * e->y[2];
    return exact_abs(x) < size && exact_abs(y) < size;
}

/* a + b, and what rounding took from it. */
static inline double exact_sum(double a, double b, double *rest)
{
    double sum = a + b, of_b = sum - a;
    *rest = (a - (sum - of_b)) + (b - of_b);
    return sum;
}

/* a * b, and what rounding took from it (Dekker, Numer. Math. 18, 1971). */
static inline double exact_product(double a, double b, double *rest)
{
    const double half = 0x1p27 + 1.0;
    double product = a * b, ca = half * a, cb = half * b;
    double ah = ca - (ca - a), bh = cb - (cb - b), al = a - ah, bl = b - bh;
    *rest = al * bl - (((product - ah * bh) - al * bh) - ah * bl);
    return product;
}

/* a b - c d as a sum of four without error (Shewchuk, Discrete Comput. Geom. 18, 1997), rounded at
 * last: the sign is right, and all but the last bits. */
static inline double exact_cross(double a, double b, double c, double d)
{
    double ab_rest, cd_rest, rest, parts[4];
    double ab = exact_product(a, b, &ab_rest), cd = exact_product(c, d, &cd_rest);
    double middle = exact_sum(ab_rest, -cd_rest, &parts[0]);
    double high = exact_sum(ab, middle, &rest);
    middle = exact_sum(rest, -cd, &parts[1]);
    parts[3] = exact_sum(high, middle, &parts[2]);
    return ((parts[0] + parts[1]) + parts[2]) + parts[3];
}

/* Scales an axis by a power of two, which is in all three functions alike, so that no product of
 * its coordinates loses bits for being small: a ray in a plane of the mesh, but for 2^-1050, sees
 * such triangles. */
static inline void exact_enlarge(double x[3])
{
    for (int step = 0; step < 2; step++) {
        double most = exact_max(exact_max(exact_abs(x[0]), exact_abs(x[1])), exact_abs(x[2]));
        for (int i = 0; i < 3 && most < 0x1p-400; i++)
            x[i] *= 0x1p500;
    }
}

/* The same edge functions without their rounding, for where it decides: a ray all but in the plane
 * of the triangle, or a needle. False if the line misses the sheared triangle, or sees it as a
 * line. What is not a number misses. */
static inline __attribute__((cold)) bool exact_weigh(struct exact_edges *e)
{
    double *x = e->x, *y = e->y;
    exact_enlarge(x);
    exact_enlarge(y);
    e->u = exact_cross(x[2], y[1], y[2], x[1]);
    e->v = exact_cross(x[0], y[2], y[0], x[2]);
    e->w = exact_cross(x[1], y[0], y[1], x[0]);
    e->det = (e->u + e->v) + e->w;
    return !exact_mixed(e) && exact_abs(e->det) > 0.0;
}

/* t belongs to a point of the triangle within the slack: any box around any piece of the triangle
 * that holds the point is met there, whatever the tree. No closed surface leaks by what is weighed
 * again: the triangle that the ray does cross is one of those that are hit. */
static inline bool exact_woop(const struct trace_ray *r, const float v[3][3], struct exact_edges *e,
                              double *t)
{
    exact_edges_of(r, v, e);
    if (exact_mixed(e) || (!exact_near(r, e) && !exact_weigh(e)))
        return false;
    *t = exact_depth(e) * r->shear[2];
    return true;
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
