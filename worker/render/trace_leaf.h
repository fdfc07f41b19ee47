/* worker/render/trace_leaf.h: one ray against four triangles.
 *
 * A float filter drops the lanes that the decision in double could not accept, and lanes
 * are decided in double one at a time, with the bits of trace_exact.h. What float decides
 * by itself in between is trace_leaf_sure.h, or with TRACE_FAST trace_leaf_fast.h.
 * docs/TRACING.md derives the bounds. Included by trace_kernel.h alone. Pure; any thread.
 */
#ifndef WORKER_RENDER_TRACE_LEAF_H
#define WORKER_RENDER_TRACE_LEAF_H

#include "worker/render/trace_lane.h"

#ifdef TRACE_COUNT
extern uint64_t trace_count_nodes, trace_count_leaves, trace_count_decisions;
#define COUNT(what) (trace_count_##what++)
#else
#define COUNT(what) ((void)0)
#endif

/* A float not below x >= 0, and close to it. */
static inline float round_up(double x)
{
    return (float)(x * (1.0 + 0x1p-22) + 0x1p-120);
}

/* A float not above x >= 0. */
static inline float round_down(double x)
{
    float f = (float)(x * (1.0 - 0x1p-22));
    return (double)f <= x ? f : 0.0f; /* or x was beyond the floats */
}

static inline uint32_t float_bits(float f)
{
    uint32_t bits;
    memcpy(&bits, &f, sizeof bits);
    return bits;
}

/* --- In float --------------------------------------------------------------- */

/* Of four triangles. Coordinates are the origin's less the vertices': the leaf's are operands
 * straight from memory then, and no product changes. */
struct leaf_edges {
    f4 u, v, w;    /* edge functions */
    f4 agree;      /* positive: the least of their sizes, all of one sign; negative: mixed */
    f4 z[3], x, y; /* the vertices' depths; vertex 0 as the ray sees it */
#ifdef TRACE_FAST
    f4 next_x[2], next_y[2]; /* vertices 1 and 2 as the ray sees them */
    f4 beside;               /* the largest |x| or |y| of all three */
#endif
    float error; /* by what the functions may be wrong */
    float edge;  /* the largest extent of any of the triangles, rounded up */
};

/* The largest extent, from the code in the ids. */
static inline float leaf_edge(const struct bvh_leaf *leaf, uint32_t edge_bits)
{
    __m128i id = _mm_load_si128((const __m128i *)leaf->id);
    uint32_t low = (uint32_t)_mm_movemask_ps(_mm_castsi128_ps(id));
    uint32_t high = (uint32_t)_mm_movemask_ps(_mm_castsi128_ps(_mm_slli_epi32(id, 1)));
    uint32_t bits = edge_bits + ((low | high << 4) << 20);
    float edge;
    memcpy(&edge, &bits, sizeof edge);
    return edge;
}

/* The lanes that Woop's test in double could accept: those whose edge functions are not
 * certainly of both signs. */
static inline unsigned leaf_filter(const struct trace_ray *r, const struct bvh_leaf *leaf,
                                   uint32_t edge_bits, struct leaf_edges *e)
{
    f4 org[3], x[3], y[3];
    for (int k = 0; k < 3; k++)
        org[k] = _mm_set1_ps(r->filter_org[k]);
    f4 sx = _mm_set1_ps(r->filter_shear[0]), sy = _mm_set1_ps(r->filter_shear[1]);
    const float(*v)[3][BVH_BLOCK] = leaf->v;
    for (int i = 0; i < 3; i++) {
        f4 z = _mm_sub_ps(org[2], _mm_load_ps(v[i][r->axis[2]]));
        x[i] = f4_nmuladd(sx, z, _mm_sub_ps(org[0], _mm_load_ps(v[i][r->axis[0]])));
        y[i] = f4_nmuladd(sy, z, _mm_sub_ps(org[1], _mm_load_ps(v[i][r->axis[1]])));
        e->z[i] = z;
    }
#ifdef TRACE_FAST
    const f4 sign = _mm_set1_ps(-0.0f);
    f4 far[3];
    for (int i = 0; i < 3; i++)
        far[i] = _mm_max_ps(_mm_andnot_ps(sign, x[i]), _mm_andnot_ps(sign, y[i]));
    e->beside = _mm_max_ps(far[0], _mm_max_ps(far[1], far[2]));
    for (int i = 0; i < 2; i++) {
        e->next_x[i] = x[i + 1];
        e->next_y[i] = y[i + 1];
    }
#endif
    e->x = x[0];
    e->y = y[0];
    e->u = f4_mulsub(x[2], y[1], _mm_mul_ps(y[2], x[1]));
    e->v = f4_mulsub(x[0], y[2], _mm_mul_ps(y[0], x[2]));
    e->w = f4_mulsub(x[1], y[0], _mm_mul_ps(y[1], x[0]));
    e->edge = leaf_edge(leaf, edge_bits);
    e->error = r->filter_slope * e->edge + r->filter_floor;
    f4 least = _mm_min_ps(e->u, _mm_min_ps(e->v, e->w));
    f4 most = _mm_max_ps(e->u, _mm_max_ps(e->v, e->w));
    e->agree = _mm_max_ps(f4_negative(most), least);
    return ~m4_bits(f4_less(e->agree, _mm_set1_ps(-e->error))) & 0xf;
}

/* --- In double -------------------------------------------------------------- */

static inline void leaf_offer(const struct accel *a, const struct leaf_hit *hit, double tmin,
                              uint32_t object, const struct bvh_leaf *leaf, uint32_t lane,
                              struct trace_best *best)
{
    uint32_t primitive = leaf->id[lane] & (BVH_PRIMITIVES_MAX - 1);
    if (!accel_offer(a, hit->t, tmin, object, primitive, leaf, lane, best))
        return;
    _Static_assert(offsetof(struct trace_best, w) ==
                       offsetof(struct trace_best, v) + sizeof(double),
                   "one store, since they are loaded together soon");
    _mm_storeu_pd(&best->v, hit->vw);
    best->det = hit->det;
}

/* Offers what the lanes give to the best hit. */
static inline void leaf_decide(const struct accel *a, const struct trace_ray *r,
                               const struct bvh_leaf *leaf, unsigned lanes, double tmin,
                               uint32_t object, struct trace_best *best)
{
    for (; lanes; lanes &= lanes - 1) {
        unsigned lane = (unsigned)__builtin_ctz(lanes);
        struct leaf_hit hit;
        COUNT(decisions);
        if (lane_woop(r, leaf, lane, &hit))
            leaf_offer(a, &hit, tmin, object, leaf, lane, best);
    }
}

static inline bool leaf_decide_any(const struct trace_ray *r, const struct bvh_leaf *leaf,
                                   unsigned lanes, double tmin, double tmax)
{
    for (; lanes; lanes &= lanes - 1) {
        struct leaf_hit hit;
        COUNT(decisions);
        if (lane_woop(r, leaf, (unsigned)__builtin_ctz(lanes), &hit) && hit.t > tmin &&
            hit.t < tmax)
            return true;
    }
    return false;
}

#ifdef TRACE_FAST
#include "worker/render/trace_leaf_fast.h"
#else
#include "worker/render/trace_leaf_sure.h"
#endif

#endif
