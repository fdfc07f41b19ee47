/* worker/render/trace_lane.h: one triangle of a leaf, decided in double.
 *
 * With AVX2 a vector holds an axis of the three vertices, so that the three edge
 * functions come out of one cross product; each lane performs the operations of
 * trace_exact.h in their order, so the bits are the same. Without AVX2, and where rounding
 * decides, trace_exact.h is called. Included by
 * trace_leaf.h alone. Pure; any thread.
 */
#ifndef WORKER_RENDER_TRACE_LANE_H
#define WORKER_RENDER_TRACE_LANE_H

#include "worker/render/trace_exact.h"
#include "worker/render/trace_ready.h"

/* What an accepted lane gave: t, and the edge functions of vertices 1 and 2 and their sum. */
struct leaf_hit {
    __m128d vw;
    double t, det;
};

/* exact_woop, from the vertices as the leaf has them. */
static inline bool lane_woop_scalar(const struct trace_ray *r, const struct bvh_leaf *leaf,
                                    unsigned lane, struct leaf_hit *out)
{
    float v[3][3];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            v[i][k] = leaf->v[i][k][lane];
    struct exact_edges e;
    if (!exact_woop(r, v, &e, &out->t))
        return false;
    out->vw = _mm_setr_pd(e.v, e.w);
    out->det = e.det;
    return true;
}

#ifdef __AVX2__

/* exact_edges: lanes are vertices 0, 1, 2, but for the functions. The fourth is junk. */
struct lane_edges {
    d4 x, y;     /* sheared */
    d4 z;        /* relative */
    d4 wuv;      /* the edge functions of vertices 2, 0, 1 */
    __m128d sum; /* U z0 + V z1 + W z2; det */
};

/* An axis of the vertices, relative to the origin. */
static inline d4 lane_axis(const struct trace_ray *r, const struct bvh_leaf *leaf, unsigned lane,
                           int k)
{
    uint32_t axis = r->axis[k];
    f4 v = ready_three(&leaf->v[0][axis][lane], &leaf->v[1][axis][lane], &leaf->v[2][axis][lane]);
    return d4_sub(_mm256_cvtps_pd(v), d4_splat(r->porg[k]));
}

static inline void lane_edges_of(const struct trace_ray *r, const struct bvh_leaf *leaf,
                                 unsigned lane, struct lane_edges *e)
{
    e->z = lane_axis(r, leaf, lane, 2);
    d4 x = d4_sub(lane_axis(r, leaf, lane, 0), d4_mul(d4_splat(r->shear[0]), e->z));
    d4 y = d4_sub(lane_axis(r, leaf, lane, 1), d4_mul(d4_splat(r->shear[1]), e->z));
    e->x = x;
    e->y = y;
    d4 x_next = _mm256_permute4x64_pd(x, _MM_SHUFFLE(3, 0, 2, 1));
    d4 y_next = _mm256_permute4x64_pd(y, _MM_SHUFFLE(3, 0, 2, 1));
    e->wuv = d4_sub(d4_mul(x_next, y), d4_mul(y_next, x));
    d4 wuv_z = d4_mul(e->wuv, _mm256_permute4x64_pd(e->z, _MM_SHUFFLE(3, 1, 0, 2)));
    d4 first = _mm256_unpacklo_pd(wuv_z, e->wuv); /* of vertex 2 | of vertex 1 */
    __m128d u = _mm_unpackhi_pd(_mm256_castpd256_pd128(wuv_z), _mm256_castpd256_pd128(e->wuv));
    e->sum =
        _mm_add_pd(_mm_add_pd(u, _mm256_extractf128_pd(first, 1)), _mm256_castpd256_pd128(first));
}

/* exact_depth and its t; the functions for the weights. */
static inline void lane_hit(const struct trace_ray *r, const struct lane_edges *e,
                            struct leaf_hit *out)
{
    __m128d z01 = _mm256_castpd256_pd128(e->z), z2 = _mm256_extractf128_pd(e->z, 1);
    __m128d z1 = _mm_unpackhi_pd(z01, z01), det = _mm_unpackhi_pd(e->sum, e->sum);
    __m128d least = _mm_min_sd(_mm_min_sd(z01, z1), z2);
    __m128d most = _mm_max_sd(_mm_max_sd(z01, z1), z2);
    __m128d z = _mm_min_sd(_mm_max_sd(_mm_div_sd(e->sum, det), least), most);
    out->t = _mm_cvtsd_f64(z) * r->shear[2];
    out->vw = _mm_unpacklo_pd(_mm256_extractf128_pd(e->wuv, 1), _mm256_castpd256_pd128(e->wuv));
    out->det = _mm_cvtsd_f64(det);
}

/* exact_near */
static inline bool lane_near(const struct trace_ray *r, const struct lane_edges *e)
{
    d4 x = d4_mul(e->wuv, _mm256_permute4x64_pd(e->x, _MM_SHUFFLE(3, 1, 0, 2)));
    d4 y = d4_mul(e->wuv, _mm256_permute4x64_pd(e->y, _MM_SHUFFLE(3, 1, 0, 2)));
    d4 first = _mm256_unpacklo_pd(x, y); /* of vertex 2 | of vertex 1 */
    __m128d u = _mm_unpackhi_pd(_mm256_castpd256_pd128(x), _mm256_castpd256_pd128(y));
    __m128d sum =
        _mm_add_pd(_mm_add_pd(u, _mm256_extractf128_pd(first, 1)), _mm256_castpd256_pd128(first));
    __m128d size = _mm_mul_pd(_mm_set1_pd(r->slack), _mm_unpackhi_pd(e->sum, e->sum));
    const __m128d sign = _mm_set1_pd(-0.0);
    __m128d less = _mm_cmplt_pd(_mm_andnot_pd(sign, sum), _mm_andnot_pd(sign, size));
    return _mm_movemask_pd(less) == 3;
}

/* exact_woop */
static inline bool lane_woop(const struct trace_ray *r, const struct bvh_leaf *leaf, unsigned lane,
                             struct leaf_hit *out)
{
    struct lane_edges e;
    lane_edges_of(r, leaf, lane, &e);
    d4 zero = _mm256_setzero_pd();
    unsigned negative = d4_mask(d4_less(e.wuv, zero)) & 7;
    unsigned positive = d4_mask(d4_less(zero, e.wuv)) & 7;
    if (negative && positive)
        return false;
    lane_hit(r, &e, out);
    return __builtin_expect(lane_near(r, &e), 1) || lane_woop_scalar(r, leaf, lane, out);
}

#else

static inline bool lane_woop(const struct trace_ray *r, const struct bvh_leaf *leaf, unsigned lane,
                             struct leaf_hit *out)
{
    return lane_woop_scalar(r, leaf, lane, out);
}

#endif

/* The same for a lane that is certain to be accepted, and near if the slack is a whole one. In
 * scalars everywhere: it is what a ray waits for last, and they wait for each other less than
 * vectors do. */
static inline void lane_certain(const struct trace_ray *r, const struct bvh_leaf *leaf,
                                unsigned lane, struct leaf_hit *out)
{
    float v[3][3];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            v[i][k] = leaf->v[i][r->axis[k]][lane];
    struct exact_edges e;
    exact_edges_permuted(r, v, &e);
    out->t = exact_depth(&e) * r->shear[2];
    out->vw = _mm_setr_pd(e.v, e.w);
    out->det = e.det;
}

#endif
