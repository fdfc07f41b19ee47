/* worker/render/trace_leaf_fast.h: what float decides for --precision fast.
 *
 * Woop's test in float, nothing fused, so that its bits are the same in every kernel:
 * watertight by the same argument as in double. z is held within the vertices' depths; a
 * lane whose weights make a point farther from the ray than its slack, or whose det is 0, is
 * decided in double. What is not within the segment by more than the error bound of its t is not
 * met: neither the surface a ray starts on nor the lamp it is aimed at. Where that bound is coarse,
 * for needles and along a surface, double decides. So hits are a function of ray, segment, triangle
 * and reach alone here too. A hit's weights are float's: its point is on its triangle as closely as
 * in double, but beside the ray. A ray whose filter_slack is not a number comes from far away, or
 * is in an instance that would stretch float's errors: of it all that the filter leaves is decided
 * in double.
 *
 * Included by trace_leaf.h alone. Pure; any thread. Bounds: docs/TRACING.md. Tests: test_accel.
 */
#ifndef WORKER_RENDER_TRACE_LEAF_FAST_H
#define WORKER_RENDER_TRACE_LEAF_FAST_H

#include <math.h>

/* An open interval of t, and floats around it for boxes; `to` comes down with hits. */
struct leaf_span {
    double tmin;
    float from, to;
    float first, last; /* the interval in float, rounded alike at every scale of t */
};

static inline struct leaf_span leaf_span_of(double tmin, double tmax)
{
    float last = (float)tmax;
    last = (double)last > tmax ? last * (1.0f - 0x1p-23f) : last;
    return (struct leaf_span){tmin, round_down(tmin), round_up(tmax), (float)tmin, last};
}

/* The same where some t is found already: that stops the walk, but which ends float can place is a
 * matter of the segment alone, or an instance's answer would hang on what was met before it. */
static inline struct leaf_span leaf_span_left(double tmin, const struct trace_best *best)
{
    struct leaf_span s = leaf_span_of(tmin, best->tmax);
    s.to = round_up(best->t);
    return s;
}

struct leaf_float {
    f4 t, v, w, det;   /* as leaf_hit has them */
    unsigned accepted; /* lanes */
    unsigned open;     /* lanes for double to decide */
};

static inline f4 leaf_least(f4 a, f4 b, f4 c)
{
    return _mm_min_ps(_mm_min_ps(a, b), c);
}

static inline f4 leaf_most(f4 a, f4 b, f4 c)
{
    return _mm_max_ps(_mm_max_ps(a, b), c);
}

/* Is the point that the weights make within a slack of the ray? Not if det is 0. */
static inline f4 leaf_near(const struct trace_ray *r, const struct leaf_edges *e, f4 det)
{
    f4 size = _mm_mul_ps(_mm_set1_ps(r->filter_slack), f4_abs(det));
    f4 x = _mm_add_ps(_mm_mul_ps(e->u, e->x), _mm_mul_ps(e->v, e->next_x[0]));
    f4 y = _mm_add_ps(_mm_mul_ps(e->u, e->y), _mm_mul_ps(e->v, e->next_y[0]));
    x = _mm_add_ps(x, _mm_mul_ps(e->w, e->next_x[1]));
    y = _mm_add_ps(y, _mm_mul_ps(e->w, e->next_y[1]));
    return _mm_and_ps(f4_less_mask(f4_abs(x), size), f4_less_mask(f4_abs(y), size));
}

/* A bound of more slacks than this is coarse: 2^-16 R, for a depth. */
#define FAST_SLACKS 16.0f

/* By how much z may be wrong. With edge functions off by at most m and z* the true depth, z - z*
 * is the sum of (error of weight i) (z_i - z*) / det: at most 3 m spread / |det|, whatever det is;
 * and both lie within the vertices' depths. With X the largest sheared coordinate, m = 50 u R X and
 * the floor; two slacks cover what rounds in z and t themselves. */
static inline f4 leaf_depth_error(const struct trace_ray *r, const struct leaf_edges *e, f4 spread,
                                  f4 inverse)
{
    f4 size = _mm_andnot_ps(_mm_set1_ps(-0.0f), inverse);
    f4 m = _mm_mul_ps(e->beside, _mm_set1_ps(1.5f * r->filter_slope));
    m = _mm_add_ps(m, _mm_set1_ps(3.0f * r->filter_floor));
    /* What is not a number gives the spread. */
    f4 error = _mm_min_ps(_mm_mul_ps(_mm_mul_ps(m, spread), size), spread);
    return _mm_add_ps(error, _mm_set1_ps(2.0f * r->filter_slack));
}

/* The lanes that double could accept. */
static __attribute__((noinline)) unsigned
leaf_doubtful(const struct trace_ray *r, const struct bvh_leaf *leaf, uint32_t edge_bits)
{
    struct leaf_edges e;
    return leaf_filter(r, leaf, edge_bits, &e);
}

static inline bool leaf_decide_float(const struct trace_ray *r, const struct bvh_leaf *leaf,
                                     uint32_t edge_bits, const struct leaf_span *s,
                                     struct leaf_float *out)
{
    const f4 zero = _mm_setzero_ps();
    struct leaf_edges e;
    leaf_filter(r, leaf, edge_bits, &e);
    unsigned lanes = ~m4_bits(f4_less(e.agree, zero)) & 0xf;
    if (__builtin_expect(isnan(r->filter_slack), 0)) /* then all of them are open */
        lanes = leaf_doubtful(r, leaf, edge_bits);
    if (!lanes)
        return false;
    for (int i = 0; i < 3; i++)
        e.z[i] = f4_negative(e.z[i]);
    f4 det = _mm_add_ps(_mm_add_ps(e.u, e.v), e.w);
    f4 inverse = _mm_div_ps(_mm_set1_ps(1.0f), det);
    f4 sum = _mm_add_ps(_mm_mul_ps(e.u, e.z[0]), _mm_mul_ps(e.v, e.z[1]));
    f4 z = _mm_mul_ps(_mm_add_ps(sum, _mm_mul_ps(e.w, e.z[2])), inverse);
    f4 least = leaf_least(e.z[0], e.z[1], e.z[2]), most = leaf_most(e.z[0], e.z[1], e.z[2]);
    z = _mm_min_ps(_mm_max_ps(z, least), most);
    f4 sound = leaf_near(r, &e, det);
    f4 shear = _mm_set1_ps(r->filter_shear[2]);
    f4 error = leaf_depth_error(r, &e, _mm_sub_ps(most, least), inverse);
    f4 coarse = f4_less_mask(_mm_set1_ps(FAST_SLACKS * r->filter_slack), error);
    error = _mm_mul_ps(error, _mm_andnot_ps(_mm_set1_ps(-0.0f), shear));
    out->t = _mm_mul_ps(z, shear);
    out->v = e.v;
    out->w = e.w;
    out->det = det;
    f4 low = _mm_sub_ps(out->t, error), high = _mm_add_ps(out->t, error);
    f4 first = _mm_set1_ps(s->first), last = _mm_set1_ps(s->last);
    unsigned within =
        (unsigned)_mm_movemask_ps(_mm_and_ps(f4_less_mask(first, low), f4_less_mask(high, last)));
    /* Ends that a coarse bound cannot place are for double. */
    f4 outside = _mm_or_ps(f4_less_mask(high, first), f4_less_mask(last, low));
    unsigned unsure = (unsigned)_mm_movemask_ps(_mm_andnot_ps(outside, coarse)) & ~within;
    unsigned placed = (unsigned)_mm_movemask_ps(sound);
    out->open = lanes & (~placed | unsure);
    out->accepted = lanes & placed & within;
    return (out->open | out->accepted) != 0;
}

/* What is left to double. */
static __attribute__((noinline)) bool leaf_open_any(const struct trace_ray *r,
                                                    const struct bvh_leaf *leaf, unsigned lanes,
                                                    double tmin, double tmax)
{
    return leaf_decide_any(r, leaf, lanes, tmin, tmax);
}

static __attribute__((noinline)) void
leaf_open_closest(const struct accel *a, const struct trace_ray *r, const struct bvh_leaf *leaf,
                  unsigned lanes, double tmin, uint32_t object, struct trace_best *best)
{
    leaf_decide(a, r, leaf, lanes, tmin, object, best);
}

/* Does any of the four triangles block the span, which ends at tmax? */
static inline bool leaf_blocks(const struct trace_ray *r, const struct bvh_leaf *leaf,
                               uint32_t edge_bits, const struct leaf_span *s, double tmax)
{
    struct leaf_float f;
    if (!leaf_decide_float(r, leaf, edge_bits, s, &f))
        return false;
    return f.accepted || leaf_open_any(r, leaf, f.open, s->tmin, tmax);
}

/* Nothing waits here. */
struct leaf_pending {
    const struct bvh_leaf *leaf, *open;
};

static inline void pending_settle(const struct accel *a, const struct trace_ray *r, double tmin,
                                  uint32_t object, struct leaf_pending *p, struct trace_best *best)
{
    (void)a, (void)r, (void)tmin, (void)object, (void)p, (void)best;
}

static inline void pending_settle_early(const struct accel *a, const struct trace_ray *r,
                                        double tmin, uint32_t object, struct leaf_pending *p,
                                        struct trace_best *best)
{
    pending_settle(a, r, tmin, object, p, best);
}

/* Four triangles against the best hit so far. */
static inline void leaf_closest(const struct accel *a, const struct trace_ray *r,
                                const struct bvh_leaf *leaf, uint32_t edge_bits, uint32_t object,
                                struct leaf_span *s, struct leaf_pending *p,
                                struct trace_best *best)
{
    struct leaf_float f;
    (void)p;
    if (!leaf_decide_float(r, leaf, edge_bits, s, &f))
        return;
    float t[4], v[4], w[4], det[4];
    _mm_storeu_ps(t, f.t);
    _mm_storeu_ps(v, f.v);
    _mm_storeu_ps(w, f.w);
    _mm_storeu_ps(det, f.det);
    for (unsigned lanes = f.accepted; lanes; lanes &= lanes - 1) {
        uint32_t lane = (uint32_t)__builtin_ctz(lanes);
        struct leaf_hit hit = {_mm_setr_pd((double)v[lane], (double)w[lane]), (double)t[lane],
                               (double)det[lane]};
        leaf_offer(a, &hit, s->tmin, object, leaf, lane, best);
    }
    if (__builtin_expect(f.open, 0))
        leaf_open_closest(a, r, leaf, f.open, s->tmin, object, best);
    s->to = round_up(best->t);
}

#endif
