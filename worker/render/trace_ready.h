/* worker/render/trace_ready.h: a ray's way into and out of a kernel, in SIMD.
 *
 * What accel_ray, accel_instance_ray and accel_hit do, with a vector for the three axes:
 * the same operations in each lane, so the same bits in all that decides; the float side
 * is within the same bounds (trace.h). Without AVX2 those three are called. Included by
 * trace_kernel.h alone. Pure; any thread.
 */
#ifndef WORKER_RENDER_TRACE_READY_H
#define WORKER_RENDER_TRACE_READY_H

#include "worker/render/accel_parts.h"
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "worker/render/trace_simd.h"

#ifdef __AVX2__

#ifdef TRACE_FAST
#define READY_PAD TRACE_PAD_FAST
#else
#define READY_PAD TRACE_PAD
#endif

/* By the axis of the largest component: the axes x, y, z of the permuted space. */
static const uint32_t ready_axis[3][4]
    __attribute__((aligned(16))) = {{1, 2, 0, 0}, {2, 0, 1, 0}, {0, 1, 2, 0}};

static inline d4 ready_abs(d4 a)
{
    return _mm256_andnot_pd(_mm256_set1_pd(-0.0), a);
}

/* The largest lane, in all of them. */
static inline d4 ready_largest(d4 a)
{
    d4 b = d4_max(a, _mm256_permute2f128_pd(a, a, 1));
    return d4_max(b, _mm256_permute_pd(b, 5));
}

static inline uint64_t ready_size(const double *x)
{
    uint64_t bits;
    memcpy(&bits, x, sizeof bits);
    return bits & INT64_MAX;
}

/* The axis of the largest component, the last of equal ones, and the bits of its size: as integers,
 * sizes order like the numbers, and what is not finite is largest. From memory and in scalars,
 * since all that triangles need waits for it; without a branch, since nobody could guess it. */
static inline uint32_t ready_main_axis(const double dir[3], uint64_t *bits)
{
    uint64_t x = ready_size(&dir[0]), y = ready_size(&dir[1]), z = ready_size(&dir[2]);
    uint32_t y_first = y >= x;
    uint64_t most = y >= x ? y : x;
    uint32_t z_first = z >= most;
    *bits = z >= most ? z : most;
    return z_first << 1 | (y_first & ~z_first);
}

static inline double ready_double(uint64_t bits)
{
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* Three numbers that the caller may just have stored one by one: a wider load would wait for
 * the stores to reach the cache. The fourth lane is 0. */
static inline d4 ready_load(const double *x, const double *y, const double *z)
{
    __m128d xy = _mm_loadh_pd(_mm_load_sd(x), y);
    return _mm256_insertf128_pd(_mm256_castpd128_pd256(xy), _mm_load_sd(z), 1);
}

/* Three floats of a leaf as a vector. Reads 16 bytes from each, of which the leaf has enough: a
 * load of one float alone would not become part of the insertion. */
static inline f4 ready_three(const float *x, const float *y, const float *z)
{
    f4 xy = _mm_insert_ps(_mm_load_ss(x), _mm_loadu_ps(y), 0x10);
    return _mm_insert_ps(xy, _mm_loadu_ps(z), 0x20);
}

/* The planes of boxes: near and far constants, and their rows. */
static inline void ready_slabs(struct trace_ray *out, f4 org, f4 dir, f4 pad_size)
{
    const f4 sign = _mm_set1_ps(-0.0f);
    f4 signs = _mm_and_ps(dir, sign);
    f4 size = _mm_max_ps(_mm_andnot_ps(sign, dir), _mm_set1_ps(0x1p-80f));
    f4 inverse = _mm_div_ps(_mm_set1_ps(1.0f), _mm_or_ps(size, signs));
    f4 pad = _mm_or_ps(pad_size, signs);
    _mm_store_ps(out->inverse, inverse);
    _mm_store_ps(out->near_offset, _mm_mul_ps(_mm_add_ps(org, pad), inverse));
    _mm_store_ps(out->far_offset, _mm_mul_ps(_mm_sub_ps(org, pad), inverse));
    __m128i back =
        _mm_and_si128(_mm_srai_epi32(_mm_castps_si128(dir), 31), _mm_set1_epi32(TRACE_ROW));
    const __m128i low = _mm_setr_epi32(0, 2 * TRACE_ROW, 4 * TRACE_ROW, 0);
    _mm_store_si128((__m128i *)out->row, _mm_add_epi32(back, low));
}

/* What the parts of trace_ray_init hand on. */
struct ready_way {
    d4 org, dir;            /* as in trace_ray */
    const double *from_org; /* where they are in memory, and are there first */
    const double *from_dir;
    d4 far;     /* R */
    f4 bounds;  /* slack in double's place, pad, filter_slope, filter_slack */
    uint32_t z; /* the axis of dir's largest component */
};

/* What boxes and triangles both need, of org and dir as vectors and in memory; the fourth lanes are
 * 0. */
static inline __attribute__((always_inline)) bool
ready_begin(d4 org, d4 dir, const double *from_org, const double *from_dir, double outer,
            double reach, struct trace_ray *out, struct ready_way *way)
{
    const uint64_t infinite = UINT64_C(0x7ff) << 52;
    uint64_t bits;
    way->z = ready_main_axis(from_dir, &bits);
    d4 size = ready_abs(org);
    if (bits == 0 || bits >= infinite || d4_mask(d4_less(size, d4_splat(__builtin_inf()))) != 15)
        return false;
    /* Scaling changes no bit but where numbers get too large or small: most need none. */
    uint64_t exponent = bits >> 52;
    way->org = org;
    way->dir = dir;
    way->from_org = from_org;
    way->from_dir = from_dir;
    out->rescale = out->unscale = 1.0;
    out->scale = outer;
    if (__builtin_expect(exponent - (1023 - 20) > 40, 0)) {
        /* 2^(1023 - e) and its inverse are to be normal. */
        exponent = exponent < 23 ? 23 : exponent > 2023 ? 2023 : exponent;
        out->rescale = ready_double((2046 - exponent) << 52);
        out->unscale = ready_double(exponent << 52);
        out->scale = outer * out->rescale;
        way->dir = d4_mul(dir, d4_splat(out->rescale));
        way->from_dir = out->dir;
    }
    _mm256_store_pd(out->org, org);
    _mm256_store_pd(out->dir, way->dir);
    way->far = d4_add(ready_largest(size), d4_splat(reach));
    d4 bounds =
        d4_mul(way->far, _mm256_setr_pd(0x1p-30, READY_PAD * 0x1p-24, 100.0 * 0x1p-24, 0x1p-20));
    way->bounds = _mm256_cvtpd_ps(bounds);
    out->slack = _mm256_cvtsd_f64(bounds);
    return true;
}

static inline void ready_boxes(const struct ready_way *way, struct trace_ray *out)
{
    ready_slabs(out, _mm256_cvtpd_ps(way->org), _mm256_cvtpd_ps(way->dir),
                _mm_shuffle_ps(way->bounds, way->bounds, _MM_SHUFFLE(1, 1, 1, 1)));
}

/* What triangles need; `sure`: what float decides by itself as well. */
static inline __attribute__((always_inline)) void
ready_triangles(const struct ready_way *way, double reach, bool sure, struct trace_ray *out)
{
    _Static_assert(offsetof(struct trace_ray, filter_slack) ==
                       offsetof(struct trace_ray, filter_slope) + sizeof(float),
                   "slope and slack in one store");
    const uint32_t x = ready_axis[way->z][0], y = ready_axis[way->z][1], z = way->z;
    const double *from = way->from_org, *dir = way->from_dir;
    d4 porg = ready_load(&from[x], &from[y], &from[z]);
    __m128d xy = _mm_loadh_pd(_mm_load_sd(&dir[x]), &dir[y]);
    d4 top = _mm256_insertf128_pd(_mm256_castpd128_pd256(xy), _mm_setr_pd(1.0, -1.0), 1);
    d4 shear = d4_div(top, _mm256_broadcast_sd(&dir[z]));
    _mm256_store_pd(out->porg, porg);
    _mm256_store_pd(out->shear, shear);
    _mm_store_si128((__m128i *)out->axis, _mm_load_si128((const __m128i *)ready_axis[way->z]));
    _mm_storeh_pi((__m64 *)&out->filter_slope, way->bounds);
    f4 slack = _mm_shuffle_ps(way->bounds, way->bounds, 0xff);
    out->filter_floor = _mm_cvtss_f32(_mm_mul_ss(slack, slack)) + 0x1p-105f;
    _mm_store_ps(out->filter_org, _mm256_cvtpd_ps(porg));
    f4 filter_shear = _mm256_cvtpd_ps(shear), sz = _mm_movehl_ps(filter_shear, filter_shear);
    _mm_store_ps(out->filter_shear, filter_shear);
    if (!sure)
        return;
    float steep = __builtin_fabsf(_mm_cvtss_f32(sz));
    out->filter_spread = 13.8f * steep;
    out->filter_depth = 2.0f * steep * _mm_cvtss_f32(slack);
#ifdef TRACE_FAST
    if (__builtin_expect(_mm256_cvtsd_f64(way->far) > TRACE_FAR_FAST * reach, 0))
        out->filter_slack = NAN;
#else
    (void)reach;
#endif
}

/* trace_ray_init. Without boxes: nothing that they, or what float is sure of, need. */
static inline __attribute__((always_inline)) bool ready_ray(const struct ray *ray, double reach,
                                                            bool boxes, struct trace_ray *out)
{
    struct ready_way way;
    d4 org = ready_load(&ray->org[0], &ray->org[1], &ray->org[2]);
    d4 dir = ready_load(&ray->dir[0], &ray->dir[1], &ray->dir[2]);
    if (!ready_begin(org, dir, ray->org, ray->dir, 1.0, reach, out, &way))
        return false;
    ready_triangles(&way, reach, boxes, out);
    if (boxes)
        ready_boxes(&way, out);
    return true;
}

static inline bool ready_scene_ray(const struct accel *a, const struct ray *ray,
                                   struct trace_ray *out, double *tmin, double *tmax)
{
    if (!(ray->tmin < ray->tmax) || !ready_ray(ray, a->scene_tree.reach, true, out))
        return false;
    *tmin = ray->tmin * out->unscale;
    *tmax = ray->tmax * out->unscale;
    return true;
}

/* The same without what boxes are tested with. */
static inline bool ready_boxless_ray(const struct accel *a, const struct ray *ray,
                                     struct trace_ray *out, double *tmin, double *tmax)
{
    if (!(ray->tmin < ray->tmax) || !ready_ray(ray, a->scene_tree.reach, false, out))
        return false;
    *tmin = ray->tmin * out->unscale;
    *tmax = ray->tmax * out->unscale;
    return true;
}

/* accel_instance_ray, in two parts: first what boxes need. */
static inline bool ready_instance_boxes(const struct accel *a, uint32_t object,
                                        const struct trace_ray *r, struct trace_ray *out,
                                        struct ready_way *way)
{
    const struct accel_motion *m = &a->motions[object];
    const double(*from)[4] = m->from_scene;
    const double *p = r->org, *v = r->dir;
    d4 x = _mm256_load_pd(from[0]), y = _mm256_load_pd(from[1]), z = _mm256_load_pd(from[2]);
    d4 org = d4_add(d4_mul(x, d4_splat(p[0])), d4_mul(y, d4_splat(p[1])));
    org = d4_add(d4_add(org, d4_mul(z, d4_splat(p[2]))), _mm256_load_pd(from[3]));
    d4 dir = d4_add(d4_mul(x, d4_splat(v[0])), d4_mul(y, d4_splat(v[1])));
    dir = d4_add(dir, d4_mul(z, d4_splat(v[2])));
    _mm256_store_pd(out->org, org);
    _mm256_store_pd(out->dir, dir);
    if (!ready_begin(org, dir, out->org, out->dir, r->scale, m->tree->reach, out, way))
        return false;
    ready_boxes(way, out);
    return true;
}

/* Then, for a ray that meets some box, the rest. */
static inline void ready_instance_triangles(const struct accel *a, uint32_t object,
                                            const struct ready_way *way, struct trace_ray *out)
{
    const struct accel_motion *m = &a->motions[object];
    ready_triangles(way, m->tree->reach, true, out);
    out->slack *= m->slack_share;
    out->filter_slack *= m->filter_share;
}

static inline d4 ready_turn(const double to[3][4], d4 v)
{
    d4 x = d4_mul(_mm256_load_pd(to[0]), _mm256_permute4x64_pd(v, 0x00));
    d4 y = d4_mul(_mm256_load_pd(to[1]), _mm256_permute4x64_pd(v, 0x55));
    return d4_add(d4_add(x, y), d4_mul(_mm256_load_pd(to[2]), _mm256_permute4x64_pd(v, 0xaa)));
}

static inline d4 ready_cross(d4 a, d4 b)
{
    d4 c = d4_sub(d4_mul(a, _mm256_permute4x64_pd(b, _MM_SHUFFLE(3, 0, 2, 1))),
                  d4_mul(_mm256_permute4x64_pd(a, _MM_SHUFFLE(3, 0, 2, 1)), b));
    return _mm256_permute4x64_pd(c, _MM_SHUFFLE(3, 0, 2, 1));
}

/* accel_hit */
static inline void ready_hit(const struct accel *a, const struct trace_ray *r,
                             const struct trace_best *best, struct hit *out)
{
    const struct bvh_leaf *leaf = best->leaf;
    if (!leaf) {
        accel_hit(a, r, best, out);
        return;
    }
    d4 v[3];
    for (int i = 0; i < 3; i++)
        v[i] = _mm256_cvtps_pd(ready_three(&leaf->v[i][0][best->lane], &leaf->v[i][1][best->lane],
                                           &leaf->v[i][2][best->lane]));
    d4 e1 = d4_sub(v[1], v[0]), e2 = d4_sub(v[2], v[0]);
    uint32_t object = best->object, primitive = best->primitive;
    if (object == SCENE_NONE) {
        object = accel_triangle_object(a, primitive);
        primitive -= a->triangle_first[object];
    } else {
        e1 = ready_turn(a->motions[object].to_scene, e1);
        e2 = ready_turn(a->motions[object].to_scene, e2);
    }
    out->t = best->t * r->scale;
    _mm_storeu_pd(&out->b1, _mm_div_pd(_mm_loadu_pd(&best->v), _mm_set1_pd(best->det)));
    _Static_assert(offsetof(struct hit, b2) == offsetof(struct hit, b1) + sizeof(double) &&
                       offsetof(struct hit, object) == offsetof(struct hit, ng) + 24,
                   "b1 and b2 in one store; the normal's fourth lane falls on what comes after");
    _mm256_storeu_pd(out->ng, ready_cross(e1, e2));
    out->object = object;
    out->primitive = primitive;
}

#else

struct ready_way {
    uint32_t unused;
};

static inline bool ready_instance_boxes(const struct accel *a, uint32_t object,
                                        const struct trace_ray *r, struct trace_ray *out,
                                        struct ready_way *way)
{
    double rescale;
    way->unused = 0;
    return accel_instance_ray(a, object, r, out, &rescale);
}

static inline void ready_instance_triangles(const struct accel *a, uint32_t object,
                                            const struct ready_way *way, struct trace_ray *out)
{
    (void)a, (void)object, (void)way, (void)out;
}

static inline void ready_hit(const struct accel *a, const struct trace_ray *r,
                             const struct trace_best *best, struct hit *out)
{
    accel_hit(a, r, best, out);
}

static inline bool ready_scene_ray(const struct accel *a, const struct ray *ray,
                                   struct trace_ray *out, double *tmin, double *tmax)
{
    return accel_ray(a, ray, out, tmin, tmax);
}

#endif

#endif
