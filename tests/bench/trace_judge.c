#include "tests/bench/trace_judge.h"

#include <math.h>

#include "common/scene.h"

struct verdict {
    __float128 least_weight; /* of the three, as parts of 1; inside when >= 0 */
    __float128 t;
    __float128 margin, t_margin; /* by which least_weight and t may be wrong in double */
    bool flat;
};

static __float128 size_of(__float128 x)
{
    return x < 0 ? -x : x;
}

/* The largest of three sizes, as a measure of a vector. */
static __float128 extent(const __float128 v[3])
{
    __float128 x = size_of(v[0]), y = size_of(v[1]), z = size_of(v[2]);
    return x > y ? (x > z ? x : z) : (y > z ? y : z);
}

/* What double may be wrong by: coordinates by 2^-50 of the largest, an edge function by that times
 * the edges. */
static void judge_margins(const __float128 p[3][3], const __float128 d[3], __float128 det,
                          __float128 reach, struct verdict *out)
{
    __float128 edge = 0;
    for (int i = 0; i < 3; i++) {
        __float128 e[3];
        for (int k = 0; k < 3; k++)
            e[k] = p[i][k] - p[(i + 1) % 3][k];
        edge = extent(e) > edge ? extent(e) : edge;
    }
    __float128 off = 0x1p-50Q * reach;
    out->margin = 1e-9Q + off * edge * extent(d) / size_of(det);
    out->t_margin = 1e-9Q * size_of(out->t) + (off + out->margin * edge) / extent(d);
}

/* The line through a triangle by triple products, which floats make all but exact. */
static void judge(const struct ray *ray, const float *positions, const uint32_t *index,
                  struct verdict *out)
{
    __float128 p[3][3], w[3], d[3], n[3], reach = 0;
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++)
            p[i][k] =
                (__float128)positions[3 * (size_t)index[i] + (size_t)k] - (__float128)ray->org[k];
        reach = extent(p[i]) > reach ? extent(p[i]) : reach;
    }
    for (int k = 0; k < 3; k++)
        d[k] = (__float128)ray->dir[k];
    for (int i = 0; i < 3; i++) {
        const __float128 *a = p[(i + 1) % 3], *b = p[(i + 2) % 3];
        w[i] = d[0] * (a[1] * b[2] - a[2] * b[1]) + d[1] * (a[2] * b[0] - a[0] * b[2]) +
               d[2] * (a[0] * b[1] - a[1] * b[0]);
    }
    __float128 det = w[0] + w[1] + w[2], least = 1;
    for (int k = 0; k < 3; k++) {
        int x = (k + 1) % 3, y = (k + 2) % 3;
        n[k] =
            (p[1][x] - p[0][x]) * (p[2][y] - p[0][y]) - (p[1][y] - p[0][y]) * (p[2][x] - p[0][x]);
    }
    __float128 along = n[0] * d[0] + n[1] * d[1] + n[2] * d[2];
    out->flat = det == 0 || along == 0;
    if (out->flat)
        return;
    for (int i = 0; i < 3; i++)
        least = w[i] / det < least ? w[i] / det : least;
    out->least_weight = least;
    out->t = (n[0] * p[0][0] + n[1] * p[0][1] + n[2] * p[0][2]) / along;
    judge_margins(p, d, det, reach, out);
}

/* Could the ray meet the triangle's box, widened by a thousand times what double is wrong by? */
static bool may_meet(const struct ray *ray, const float *positions, const uint32_t *index)
{
    double enter = -INFINITY, leave = INFINITY;
    for (size_t k = 0; k < 3; k++) {
        double low = INFINITY, high = -INFINITY;
        for (int i = 0; i < 3; i++) {
            double x = (double)positions[3 * (size_t)index[i] + k];
            low = fmin(low, x);
            high = fmax(high, x);
        }
        double off = 0x1p-40 * (fabs(ray->org[k]) + fabs(low) + fabs(high));
        double first = (low - off - ray->org[k]) / ray->dir[k];
        double last = (high + off - ray->org[k]) / ray->dir[k];
        enter = fmax(enter, fmin(first, last)); /* what is not a number culls nothing */
        leave = fmin(leave, fmax(first, last));
    }
    return !(enter > leave);
}

/* Does anything certain lie between the ray's start and t? */
static bool certain_before(const struct trace_scene *s, const struct ray *ray, __float128 end)
{
    const struct accel_mesh *m = &s->views[0];
    struct verdict v;
    for (uint32_t i = 0; i < m->triangle_count; i++) {
        const uint32_t *index = &m->indices[3 * (size_t)i];
        if (!may_meet(ray, m->positions, index))
            continue;
        judge(ray, m->positions, index, &v);
        if (!v.flat && v.least_weight > v.margin && v.t > (__float128)ray->tmin + v.t_margin &&
            v.t < end - v.t_margin)
            return true;
    }
    return false;
}

/* Is the triangle met, but for its margins? */
static bool met(const struct trace_scene *s, const struct ray *ray, uint32_t primitive,
                struct verdict *v)
{
    const struct accel_mesh *m = &s->views[0];
    judge(ray, m->positions, &m->indices[3 * (size_t)primitive], v);
    return !v->flat && v->least_weight >= -v->margin &&
           v->t > (__float128)ray->tmin - v->t_margin && v->t < (__float128)ray->tmax + v->t_margin;
}

bool trace_judge_closest(const struct trace_scene *s, const struct ray *ray, uint32_t primitive)
{
    struct verdict hit;
    if (primitive == SCENE_NONE)
        return !certain_before(s, ray, (__float128)ray->tmax);
    return met(s, ray, primitive, &hit) && !certain_before(s, ray, hit.t - hit.t_margin);
}

bool trace_judge_occluded(const struct trace_scene *s, const struct ray *ray, bool occluded)
{
    const struct accel_mesh *m = &s->views[0];
    struct verdict hit;
    if (!occluded)
        return !certain_before(s, ray, (__float128)ray->tmax);
    for (uint32_t i = 0; i < m->triangle_count; i++)
        if (may_meet(ray, m->positions, &m->indices[3 * (size_t)i]) && met(s, ray, i, &hit))
            return true;
    return false;
}
