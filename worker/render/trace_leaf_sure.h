/* worker/render/trace_leaf_sure.h: what float is sure of, exactly.
 *
 * Intervals around t in float decide what they can: they settle any-hit, and for closest
 * hit leave one decision in double for the end. Included by trace_leaf.h alone. Pure; any
 * thread. Bounds: docs/TRACING.md.
 */
#ifndef WORKER_RENDER_TRACE_LEAF_SURE_H
#define WORKER_RENDER_TRACE_LEAF_SURE_H

/* An open interval of t, and floats on both sides of its ends. `to` comes down as hits are
 * found, the others stay. */
struct leaf_span {
    double tmin;
    float from, to;             /* not inside it */
    float from_inner, to_inner; /* not outside it */
};

static inline struct leaf_span leaf_span_of(double tmin, double tmax)
{
    return (struct leaf_span){tmin, round_down(tmin), round_up(tmax), round_up(tmin),
                              round_down(tmax)};
}

/* What is certain of the filter's lanes without a decision in double: all t lie in [low,
 * high] and those in `inside` are hits of the span. */
struct leaf_sure {
    f4 low, high;
    unsigned inside;
};

/* Drops lanes whose t is certainly outside the span. With m = 3 error, edge functions are
 * off by less than m where vertex 0 lies within 2 edges of the ray, and t by less than
 * 4.5 m / |det| of the depths' range where |det| > 9 m. */
static inline unsigned leaf_be_sure(const struct trace_ray *r, const struct leaf_edges *e,
                                    const struct leaf_span *s, unsigned lanes,
                                    struct leaf_sure *out)
{
    const f4 sign = _mm_set1_ps(-0.0f);
    f4 det = _mm_add_ps(_mm_add_ps(e->u, e->v), e->w), size = _mm_andnot_ps(sign, det);
    f4 inverse = _mm_div_ps(_mm_set1_ps(1.0f), det);
    /* The second term keeps what follows from underflow. */
    f4 m = f4_muladd(_mm_set1_ps(3.0f), e->error, _mm_set1_ps(0x1p-104f));
    f4 sz = _mm_set1_ps(r->filter_shear[2]), depth = _mm_set1_ps(r->filter_depth);
    f4 d0 = _mm_mul_ps(sz, e->z[0]), d1 = _mm_mul_ps(sz, e->z[1]), d2 = _mm_mul_ps(sz, e->z[2]);
    f4 t = f4_muladd(e->u, d0, f4_muladd(e->v, d1, _mm_mul_ps(e->w, d2)));
    t = _mm_mul_ps(t, inverse);
    /* Whatever det is, t in double lies within its vertices' depths. */
    f4 first = _mm_min_ps(d0, _mm_min_ps(d1, d2)), last = _mm_max_ps(d0, _mm_max_ps(d1, d2));
    f4 apart = _mm_or_ps(f4_less_mask(_mm_add_ps(last, depth), _mm_set1_ps(s->from)),
                         f4_less_mask(_mm_set1_ps(s->to), _mm_sub_ps(first, depth)));
    f4 spread = _mm_mul_ps(_mm_set1_ps(4.5f), _mm_mul_ps(m, _mm_sub_ps(last, first)));
    f4 off = f4_muladd(spread, _mm_andnot_ps(sign, inverse), _mm_add_ps(depth, depth));
    out->low = _mm_sub_ps(t, off);
    out->high = _mm_add_ps(t, off);
    f4 sound = f4_less_mask(_mm_mul_ps(_mm_set1_ps(9.0f), m), size);
    f4 outside = _mm_or_ps(f4_less_mask(out->high, _mm_set1_ps(s->from)),
                           f4_less_mask(_mm_set1_ps(s->to), out->low));
    f4 within = _mm_and_ps(f4_less_mask(_mm_set1_ps(s->from_inner), out->low),
                           f4_less_mask(out->high, _mm_set1_ps(s->to_inner)));
    f4 agree = _mm_or_ps(f4_less_mask(m, e->least),
                         f4_less_mask(e->most, _mm_sub_ps(_mm_setzero_ps(), m)));
    f4 beside = _mm_max_ps(_mm_andnot_ps(sign, e->x), _mm_andnot_ps(sign, e->y));
    f4 near = f4_less_mask(beside, _mm_set1_ps(2.0f * e->edge));
    f4 accept = _mm_and_ps(_mm_and_ps(sound, within), _mm_and_ps(agree, near));
    lanes &= ~(unsigned)_mm_movemask_ps(_mm_or_ps(apart, _mm_and_ps(sound, outside)));
    out->inside = lanes & (unsigned)_mm_movemask_ps(accept);
    return lanes;
}

/* Does any of the four triangles block the span, which ends at tmax? */
static inline bool leaf_blocks(const struct trace_ray *r, const struct bvh_leaf *leaf,
                               uint32_t edge_bits, const struct leaf_span *s, double tmax)
{
    struct leaf_edges e;
    struct leaf_sure sure;
    unsigned lanes = leaf_filter(r, leaf, edge_bits, &e);
    if (!lanes)
        return false;
    lanes = leaf_be_sure(r, &e, s, lanes, &sure);
    return sure.inside || (lanes && leaf_decide_any(r, leaf, lanes, s->tmin, tmax));
}

/* A hit that is certain and nearest so far, but for what best may hold; its decision in
 * double, which gives its t, waits until the ray is done or a rival is as near. */
struct leaf_pending {
    const struct bvh_leaf *leaf; /* NULL: none */
    uint32_t lane;
    float low, high; /* around its t */
};

static inline void pending_settle(const struct accel *a, const struct trace_ray *r, double tmin,
                                  uint32_t object, struct leaf_pending *p, struct trace_best *best)
{
    if (!p->leaf)
        return;
    struct leaf_hit hit;
    COUNT(decisions);
    lane_certain(r, p->leaf, p->lane, &hit);
    leaf_offer(a, &hit, tmin, object, p->leaf, p->lane, best);
    p->leaf = NULL;
}

static inline bool pending_same(const struct leaf_pending *p, const struct bvh_leaf *leaf,
                                uint32_t lane)
{
    return p->leaf == leaf && (leaf->id[p->lane] ^ leaf->id[lane]) % BVH_PRIMITIVES_MAX == 0;
}

/* Four triangles against the best hit so far. */
static inline void leaf_closest(const struct accel *a, const struct trace_ray *r,
                                const struct bvh_leaf *leaf, uint32_t edge_bits, uint32_t object,
                                struct leaf_span *s, struct leaf_pending *p,
                                struct trace_best *best)
{
    struct leaf_edges e;
    struct leaf_sure sure;
    unsigned lanes = leaf_filter(r, leaf, edge_bits, &e);
    if (!lanes)
        return;
    lanes = leaf_be_sure(r, &e, s, lanes, &sure);
    if (__builtin_expect(lanes & ~sure.inside, 0)) {
        leaf_decide(a, r, leaf, lanes & ~sure.inside, s->tmin, object, best);
        float to = round_up(best->t);
        s->to = to < s->to ? to : s->to;
    }
    float low[4], high[4];
    _mm_storeu_ps(low, sure.low);
    _mm_storeu_ps(high, sure.high);
    for (lanes &= sure.inside; lanes; lanes &= lanes - 1) {
        unsigned lane = (unsigned)__builtin_ctz(lanes);
        if (p->leaf && !(high[lane] < p->low)) {
            if (pending_same(p, leaf, lane)) /* a leaf's last triangle repeats */
                continue;
            pending_settle(a, r, s->tmin, object, p, best);
        }
        *p = (struct leaf_pending){leaf, lane, low[lane], high[lane]};
        s->to = high[lane] < s->to ? high[lane] : s->to;
    }
}

#endif
