/* worker/render/vec.h: points, directions and colours in double.
 *
 * Small values passed by value, everything inline. Only + - * / and sqrt, so the
 * bits are the same on every CPU and compiler. Any thread.
 */
#ifndef WORKER_RENDER_VEC_H
#define WORKER_RENDER_VEC_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

typedef struct vec3 {
    double x, y, z;
} vec3;

/* Linear Rec.709. */
typedef struct rgb {
    double r, g, b;
} rgb;

/* An orthonormal frame; n is its local +z. */
typedef struct frame {
    vec3 s, t, n;
} frame;

#define VEC_PI     3.14159265358979323846
#define VEC_INV_PI 0.31830988618379067154

/* C has it as a float only. */
#define VEC_INFINITY ((double)INFINITY)

static inline vec3 v3(double x, double y, double z)
{
    return (vec3){x, y, z};
}

static inline vec3 v3_of(const double a[3])
{
    return (vec3){a[0], a[1], a[2]};
}

static inline void v3_put(double out[3], vec3 a)
{
    out[0] = a.x;
    out[1] = a.y;
    out[2] = a.z;
}

static inline vec3 v3_add(vec3 a, vec3 b)
{
    return (vec3){a.x + b.x, a.y + b.y, a.z + b.z};
}

static inline vec3 v3_sub(vec3 a, vec3 b)
{
    return (vec3){a.x - b.x, a.y - b.y, a.z - b.z};
}

static inline vec3 v3_scale(vec3 a, double s)
{
    return (vec3){a.x * s, a.y * s, a.z * s};
}

/* a + b * s */
static inline vec3 v3_mad(vec3 a, vec3 b, double s)
{
    return (vec3){a.x + b.x * s, a.y + b.y * s, a.z + b.z * s};
}

static inline vec3 v3_neg(vec3 a)
{
    return (vec3){-a.x, -a.y, -a.z};
}

static inline double v3_dot(vec3 a, vec3 b)
{
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline vec3 v3_cross(vec3 a, vec3 b)
{
    return (vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static inline double v3_length(vec3 a)
{
    return sqrt(v3_dot(a, a));
}

static inline vec3 v3_unit(vec3 a)
{
    return v3_scale(a, 1.0 / v3_length(a));
}

static inline double v3_abs_max(vec3 a)
{
    double x = fabs(a.x), y = fabs(a.y), z = fabs(a.z);
    double m = x > y ? x : y;
    return m > z ? m : z;
}

static inline double v3_abs_sum(vec3 a)
{
    return fabs(a.x) + fabs(a.y) + fabs(a.z);
}

static inline rgb rgb_of(const double a[3])
{
    return (rgb){a[0], a[1], a[2]};
}

static inline rgb rgb_grey(double v)
{
    return (rgb){v, v, v};
}

static inline rgb rgb_add(rgb a, rgb b)
{
    return (rgb){a.r + b.r, a.g + b.g, a.b + b.b};
}

static inline rgb rgb_mul(rgb a, rgb b)
{
    return (rgb){a.r * b.r, a.g * b.g, a.b * b.b};
}

static inline rgb rgb_scale(rgb a, double s)
{
    return (rgb){a.r * s, a.g * s, a.b * s};
}

static inline rgb rgb_mad(rgb a, rgb b, double s)
{
    return (rgb){a.r + b.r * s, a.g + b.g * s, a.b + b.b * s};
}

static inline rgb rgb_mix(rgb a, rgb b, double t)
{
    return (rgb){a.r + (b.r - a.r) * t, a.g + (b.g - a.g) * t, a.b + (b.b - a.b) * t};
}

static inline double rgb_max(rgb a)
{
    double m = a.r > a.g ? a.r : a.g;
    return m > a.b ? m : a.b;
}

static inline double rgb_luminance(rgb a)
{
    return 0.2126 * a.r + 0.7152 * a.g + 0.0722 * a.b;
}

static inline bool rgb_is_black(rgb a)
{
    return a.r == 0 && a.g == 0 && a.b == 0;
}

/* False for NaN and infinities in any channel. */
static inline bool rgb_is_finite(rgb a)
{
    double sum = a.r * 0 + a.g * 0 + a.b * 0;
    return sum == 0;
}

/* Duff et al. 2017, "Building an Orthonormal Basis, Revisited" (JCGT 6:1). `n` is unit. */
static inline frame frame_of(vec3 n)
{
    double sign = copysign(1.0, n.z);
    double a = -1.0 / (sign + n.z);
    double b = n.x * n.y * a;
    return (frame){
        {1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x}, {b, sign + n.y * n.y * a, -n.y}, n};
}

static inline vec3 frame_to_local(const frame *f, vec3 w)
{
    return (vec3){v3_dot(f->s, w), v3_dot(f->t, w), v3_dot(f->n, w)};
}

static inline vec3 frame_to_world(const frame *f, vec3 l)
{
    return v3_mad(v3_mad(v3_scale(f->s, l.x), f->t, l.y), f->n, l.z);
}

/* 3x4 row-major affine matrix times a point. */
static inline vec3 affine_point(const double m[12], vec3 p)
{
    return (vec3){m[0] * p.x + m[1] * p.y + m[2] * p.z + m[3],
                  m[4] * p.x + m[5] * p.y + m[6] * p.z + m[7],
                  m[8] * p.x + m[9] * p.y + m[10] * p.z + m[11]};
}

/* Its 3x3 part times a direction. */
static inline vec3 affine_vector(const double m[12], vec3 d)
{
    return (vec3){m[0] * d.x + m[1] * d.y + m[2] * d.z, m[4] * d.x + m[5] * d.y + m[6] * d.z,
                  m[8] * d.x + m[9] * d.y + m[10] * d.z};
}

/* The transpose of its 3x3 part times a normal: given the inverse of a transform, the normal
 * that the transform makes. */
static inline vec3 affine_normal(const double inverse[12], vec3 n)
{
    return (vec3){inverse[0] * n.x + inverse[4] * n.y + inverse[8] * n.z,
                  inverse[1] * n.x + inverse[5] * n.y + inverse[9] * n.z,
                  inverse[2] * n.x + inverse[6] * n.y + inverse[10] * n.z};
}

#endif
