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

#ifdef __AVX2__

static inline struct leaf_span leaf_span_of(double tmin, double tmax)
{
    const double less = 1.0 - 0x1p-22, more = 1.0 + 0x1p-22, tiny = 0x1p-120;
    d4 t = _mm256_setr_pd(tmin, tmax, tmin, tmax);
    d4 moved = d4_add(d4_mul(t, _mm256_setr_pd(less, more, more, less)),
                      _mm256_setr_pd(0.0, tiny, tiny, 0.0));
    f4 f = _mm256_cvtpd_ps(moved);
    struct leaf_span s = {.tmin = tmin};
    _mm_storeu_ps(&s.from, f);
    _Static_assert(offsetof(struct leaf_span, to_inner) ==
                       offsetof(struct leaf_span, from) + 3 * sizeof(float),
                   "four floats in one store");
    /* What was beyond the floats is not above their largest. */
    if (__builtin_expect((d4_mask(d4_less_equal(_mm256_cvtps_pd(f), t)) & 9) != 9, 0)) {
        s.from = round_down(tmin);
        s.to_inner = round_down(tmax);
    }
    return s;
}

#else

static inline struct leaf_span leaf_span_of(double tmin, double tmax)
{
    return (struct leaf_span){tmin, round_down(tmin), round_up(tmax), round_up(tmin),
                              round_down(tmax)};
}

#endif

/* The same of what is left of a ray. */
static inline struct leaf_span leaf_span_left(double tmin, const struct trace_best *best)
{
    return leaf_span_of(tmin, best->t);
}

/* The interval in which t of a lane lies whose edge functions are off by less than m and add up
 * to over 9 m, given 4.6 m times the range of its depths. */
struct leaf_times {
    f4 low, high;
};

static inline struct leaf_times leaf_times_of(const struct trace_ray *r, const struct leaf_edges *e,
                                              f4 det, f4 spread)
{
    f4 inverse = _mm_div_ps(_mm_set1_ps(1.0f), det);
    f4 z = f4_muladd(e->u, e->z[0], f4_muladd(e->v, e->z[1], _mm_mul_ps(e->w, e->z[2])));
    f4 t = _mm_mul_ps(z, _mm_mul_ps(inverse, _mm_set1_ps(r->filter_shear[3])));
    f4 off = f4_muladd(spread, f4_abs(inverse), _mm_set1_ps(r->filter_depth));
    return (struct leaf_times){_mm_sub_ps(t, off), _mm_add_ps(t, off)};
}

static inline f4 leaf_det(const struct leaf_edges *e)
{
    return _mm_add_ps(_mm_add_ps(e->u, e->v), e->w);
}

/* What is certain of the filter's lanes without a decision in double. With m = 3 error, edge
 * functions are off by less than m where vertex 0 lies within 2 edges of the ray: there, all three
 * over m in one sign are accepted; and t is known well enough where |det| > 9 m. Lanes neither
 * accepted nor dropped are open. */
struct leaf_sure {
    struct leaf_times times;
    unsigned inside, open;
};

static inline struct leaf_sure leaf_be_sure(const struct trace_ray *r, const struct leaf_edges *e,
                                            const struct leaf_span *s, unsigned lanes)
{
    struct leaf_sure out;
    f4 det = leaf_det(e);
    /* The depths of a block's triangles range over an edge at most. */
    float spread = e->error * (e->edge * r->filter_spread);
    out.times = leaf_times_of(r, e, det, _mm_set1_ps(spread));
    f4 low = out.times.low, high = out.times.high;
    float m = 3.0f * e->error;
    m4 sound = f4_less(_mm_set1_ps(9.0f * m), f4_abs(det));
    m4 before = f4_and_less(sound, high, _mm_set1_ps(s->from));
    m4 behind = f4_and_less(sound, _mm_set1_ps(s->to), low);
    m4 inside = f4_and_less(sound, _mm_set1_ps(m), e->agree);
    inside =
        f4_and_less(inside, _mm_max_ps(f4_abs(e->x), f4_abs(e->y)), _mm_set1_ps(2.0f * e->edge));
    inside = f4_and_less(inside, _mm_set1_ps(s->from_inner), low);
    inside = f4_and_less(inside, high, _mm_set1_ps(s->to_inner));
    lanes &= ~(m4_bits(before) | m4_bits(behind));
    out.inside = lanes & m4_bits(inside);
    out.open = lanes & ~out.inside;
    return out;
}

/* Open lanes whose t is not certainly outside the span after a closer look: t in double lies within
 * its vertices' depths whatever det is, and the sum alone has to be large. */
static inline unsigned leaf_look(const struct trace_ray *r, const struct leaf_edges *e,
                                 const struct leaf_span *s, unsigned lanes)
{
    f4 sz = _mm_set1_ps(r->filter_shear[3]), depth = _mm_set1_ps(r->filter_depth);
    f4 from = _mm_set1_ps(s->from), to = _mm_set1_ps(s->to);
    f4 d0 = _mm_mul_ps(sz, e->z[0]), d1 = _mm_mul_ps(sz, e->z[1]), d2 = _mm_mul_ps(sz, e->z[2]);
    f4 first = _mm_min_ps(d0, _mm_min_ps(d1, d2)), last = _mm_max_ps(d0, _mm_max_ps(d1, d2));
    lanes &= ~m4_bits(f4_less(_mm_add_ps(last, depth), from));
    lanes &= ~m4_bits(f4_less(to, _mm_sub_ps(first, depth)));
    f4 m = _mm_set1_ps(3.0f * e->error), det = leaf_det(e);
    f4 spread = _mm_mul_ps(_mm_set1_ps(4.6f), _mm_mul_ps(m, _mm_sub_ps(last, first)));
    struct leaf_times times = leaf_times_of(r, e, det, spread);
    m4 sound = f4_less(_mm_mul_ps(_mm_set1_ps(9.0f), m), f4_abs(det));
    lanes &= ~m4_bits(f4_and_less(sound, times.high, from));
    return lanes & ~m4_bits(f4_and_less(sound, to, times.low));
}

/* What is left open, decided. */
static __attribute__((noinline)) bool
leaf_open_any(const struct trace_ray *r, const struct bvh_leaf *leaf, const struct leaf_edges *e,
              const struct leaf_span *s, unsigned lanes, double tmax)
{
    return leaf_decide_any(r, leaf, leaf_look(r, e, s, lanes), s->tmin, tmax);
}

static __attribute__((noinline)) void
leaf_open_closest(const struct accel *a, const struct trace_ray *r, const struct bvh_leaf *leaf,
                  const struct leaf_edges *e, const struct leaf_span *s, unsigned lanes,
                  uint32_t object, struct trace_best *best)
{
    leaf_decide(a, r, leaf, leaf_look(r, e, s, lanes), s->tmin, object, best);
}

/* Does any of the four triangles block the span, which ends at tmax? */
static inline bool leaf_blocks(const struct trace_ray *r, const struct bvh_leaf *leaf,
                               uint32_t edge_bits, const struct leaf_span *s, double tmax)
{
    struct leaf_edges e;
    unsigned lanes = leaf_filter(r, leaf, edge_bits, &e);
    if (!lanes)
        return false;
    struct leaf_sure sure = leaf_be_sure(r, &e, s, lanes);
    if (sure.inside || !sure.open)
        return sure.inside;
    struct leaf_edges copy = e; /* so that e itself stays in registers */
    struct leaf_span span = *s;
    return leaf_open_any(r, leaf, &copy, &span, sure.open, tmax);
}

/* Decisions in double that wait until the ray is done, when most of them are no longer wanted and
 * those left overlap: of a hit that is certain and nearest so far, but for what best may hold,
 * which gives its t; and of one lane left open, most often of the surface that the ray starts on.
 */
struct leaf_pending {
    const struct bvh_leaf *leaf; /* NULL: none */
    const struct bvh_leaf *open; /* NULL: none */
    uint32_t lane, open_lane;
    float low, high; /* around the certain one's t */
};

/* Puts off one open lane whose t may be that of the start, since it would cull nothing; false if
 * something has to be decided now. */
static inline bool pending_open(struct leaf_pending *p, const struct bvh_leaf *leaf,
                                const struct leaf_span *s, const struct leaf_sure *sure)
{
    unsigned lanes = sure->open;
    m4 start = f4_less(sure->times.low, _mm_set1_ps(s->from_inner));
    if (p->open || (lanes & (lanes - 1)) != 0 || (lanes & ~m4_bits(start)) != 0)
        return false;
    p->open = leaf;
    p->open_lane = (uint32_t)__builtin_ctz(lanes);
    return true;
}

/* A certain lane is near for sure if the slack is a whole one. */
static inline bool pending_hit(const struct accel *a, const struct trace_ray *r, uint32_t object,
                               const struct leaf_pending *p, struct leaf_hit *out)
{
    if (__builtin_expect(object != SCENE_NONE && a->motions[object].slack_share < 1.0, 0))
        return lane_woop(r, p->leaf, p->lane, out);
    lane_certain(r, p->leaf, p->lane, out);
    return true;
}

static inline void pending_settle(const struct accel *a, const struct trace_ray *r, double tmin,
                                  uint32_t object, struct leaf_pending *p, struct trace_best *best)
{
    struct leaf_hit hit;
    if (p->open) {
        COUNT(decisions);
        if (lane_woop(r, p->open, p->open_lane, &hit))
            leaf_offer(a, &hit, tmin, object, p->open, p->open_lane, best);
    }
    p->open = NULL;
    if (!p->leaf)
        return;
    COUNT(decisions);
    if (pending_hit(a, r, object, p, &hit))
        leaf_offer(a, &hit, tmin, object, p->leaf, p->lane, best);
    p->leaf = NULL;
}

static __attribute__((noinline)) void pending_settle_apart(const struct accel *a,
                                                           const struct trace_ray *r, double tmin,
                                                           uint32_t object, struct leaf_pending *p,
                                                           struct trace_best *best)
{
    pending_settle(a, r, tmin, object, p, best);
}

/* The same within the walk, which has better use for its registers. */
static inline void pending_settle_early(const struct accel *a, const struct trace_ray *r,
                                        double tmin, uint32_t object, struct leaf_pending *p,
                                        struct trace_best *best)
{
    if (!p->leaf && !p->open)
        return;
    struct leaf_pending copy = *p;
    pending_settle_apart(a, r, tmin, object, &copy, best);
    p->leaf = p->open = NULL;
}

static inline bool pending_same(const struct leaf_pending *p, const struct bvh_leaf *leaf,
                                uint32_t lane)
{
    return (p->leaf->id[p->lane] ^ leaf->id[lane]) % BVH_PRIMITIVES_MAX == 0;
}

/* Four triangles against the best hit so far. */
static inline void leaf_closest(const struct accel *a, const struct trace_ray *r,
                                const struct bvh_leaf *leaf, uint32_t edge_bits, uint32_t object,
                                struct leaf_span *s, struct leaf_pending *p,
                                struct trace_best *best)
{
    struct leaf_edges e;
    unsigned lanes = leaf_filter(r, leaf, edge_bits, &e);
    if (!lanes)
        return;
    struct leaf_sure sure = leaf_be_sure(r, &e, s, lanes);
    if (sure.open && !pending_open(p, leaf, s, &sure)) {
        struct leaf_edges copy = e; /* so that e itself stays in registers */
        struct leaf_span span = *s;
        leaf_open_closest(a, r, leaf, &copy, &span, sure.open, object, best);
        float to = round_up(best->t);
        s->to = to < s->to ? to : s->to;
    }
    float low[4], high[4];
    _mm_storeu_ps(low, sure.times.low);
    _mm_storeu_ps(high, sure.times.high);
    for (lanes = sure.inside; lanes; lanes &= lanes - 1) {
        unsigned lane = (unsigned)__builtin_ctz(lanes);
        if (p->leaf && !(high[lane] < p->low)) {
            if (pending_same(p, leaf, lane)) /* leaves' last ones repeat, as pieces do */
                continue;
            pending_settle_early(a, r, s->tmin, object, p, best);
        }
        p->leaf = leaf;
        p->lane = lane;
        p->low = low[lane];
        p->high = high[lane];
        s->to = high[lane] < s->to ? high[lane] : s->to;
    }
}

#endif
