/* worker/render/trace_kernel.h: the walk in SIMD, written once.
 *
 * Included by one .c file per instruction set, which defines TRACE_KERNEL (the name of
 * its table) and TRACE_NAME. Per node: eight boxes against one ray. Per leaf: a float
 * filter over four triangles; where it leaves any, the decision in double over all
 * four. The bits are those of trace_exact.h, lane by lane.
 *
 * The batch forms keep TRACE_BATCH rays under way and give each one node or leaf in
 * turn, having asked for its next one's memory: what a ray waits for arrives while the
 * others are served. A ray's steps do not depend on its neighbours, so neither do its
 * bits. Nothing here allocates or branches on anything but rays and tree.
 */
#include "worker/render/accel_parts.h"

#include <string.h>

#include "worker/render/trace_exact.h"
#include "worker/render/trace_simd.h"

enum { TRACE_BATCH = 16, STACK_SLACK = BVH_WIDTH };

#ifdef TRACE_COUNT
extern uint64_t trace_count_nodes, trace_count_leaves, trace_count_decisions;
#define COUNT(what) (trace_count_##what++)
#else
#define COUNT(what) ((void)0)
#endif

/* --- Boxes ---------------------------------------------------------------- */

struct slabs {
    f8 inverse[3], near_offset[3], far_offset[3];
};

static inline void slabs_init(struct slabs *s, const struct trace_ray *r)
{
    for (int k = 0; k < 3; k++) {
        s->inverse[k] = f8_splat(r->inverse[k]);
        s->near_offset[k] = f8_splat(r->near_offset[k]);
        s->far_offset[k] = f8_splat(r->far_offset[k]);
    }
}

/* Which children's widened boxes the ray meets within [from, to], and where it enters. */
static inline unsigned node_meet(const struct bvh_node *node, const struct slabs *s,
                                 const uint32_t row[3], f8 from, f8 to, f8 *entry)
{
    f8 x0 = f8_mulsub(f8_load(node->bounds[row[0]]), s->inverse[0], s->near_offset[0]);
    f8 y0 = f8_mulsub(f8_load(node->bounds[row[1]]), s->inverse[1], s->near_offset[1]);
    f8 z0 = f8_mulsub(f8_load(node->bounds[row[2]]), s->inverse[2], s->near_offset[2]);
    f8 x1 = f8_mulsub(f8_load(node->bounds[row[0] ^ 1]), s->inverse[0], s->far_offset[0]);
    f8 y1 = f8_mulsub(f8_load(node->bounds[row[1] ^ 1]), s->inverse[1], s->far_offset[1]);
    f8 z1 = f8_mulsub(f8_load(node->bounds[row[2] ^ 1]), s->inverse[2], s->far_offset[2]);
    f8 near = f8_max(x0, f8_max(y0, f8_max(z0, from)));
    f8 far = f8_min(x1, f8_min(y1, f8_min(z1, to)));
    *entry = near;
    return f8_less_equal(near, far);
}

static inline void prefetch(const unsigned char *arena, uint32_t ref)
{
    const char *p = (const char *)bvh_node_at(arena, ref);
    __builtin_prefetch(p);
    __builtin_prefetch(p + 64);
    __builtin_prefetch(p + 128);
    __builtin_prefetch(p + 192);
}

/* A float not below x >= 0, and close to it. */
static inline float round_up(double x)
{
    return (float)(x * (1.0 + 0x1p-22) + 0x1p-148);
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

/* --- Triangles ------------------------------------------------------------ */

/* What the edge functions of a block may be wrong by in float, from the code in its ids. */
static inline float leaf_error(const struct trace_ray *r, const struct bvh_leaf *leaf,
                               uint32_t edge_bits)
{
    __m128i id = _mm_load_si128((const __m128i *)leaf->id);
    uint32_t low = (uint32_t)_mm_movemask_ps(_mm_castsi128_ps(id));
    uint32_t high = (uint32_t)_mm_movemask_ps(_mm_castsi128_ps(_mm_slli_epi32(id, 1)));
    uint32_t bits = edge_bits + ((low | high << 4) << 20);
    float edge;
    memcpy(&edge, &bits, sizeof edge);
    return r->filter_slope * edge + r->filter_floor;
}

/* The lanes that Woop's test in double could accept: those whose edge functions are not
 * certainly of both signs. */
static inline unsigned leaf_filter(const struct trace_ray *r, const struct bvh_leaf *leaf,
                                   uint32_t edge_bits, float from, float to)
{
    f4 org[3], x[3], y[3], t[3];
    for (int k = 0; k < 3; k++)
        org[k] = _mm_set1_ps(r->filter_org[k]);
    f4 sx = _mm_set1_ps(r->filter_shear[0]), sy = _mm_set1_ps(r->filter_shear[1]);
    f4 sz = _mm_set1_ps(r->filter_shear[2]);
    for (int i = 0; i < 3; i++) {
        f4 z = _mm_sub_ps(_mm_load_ps(leaf->v[i][r->axis[2]]), org[2]);
        x[i] = f4_nmuladd(sx, z, _mm_sub_ps(_mm_load_ps(leaf->v[i][r->axis[0]]), org[0]));
        y[i] = f4_nmuladd(sy, z, _mm_sub_ps(_mm_load_ps(leaf->v[i][r->axis[1]]), org[1]));
        t[i] = _mm_mul_ps(sz, z);
    }
    f4 u = f4_mulsub(x[2], y[1], _mm_mul_ps(y[2], x[1]));
    f4 v = f4_mulsub(x[0], y[2], _mm_mul_ps(y[0], x[2]));
    f4 w = f4_mulsub(x[1], y[0], _mm_mul_ps(y[1], x[0]));
    f4 error = _mm_set1_ps(leaf_error(r, leaf, edge_bits));
    f4 least = _mm_min_ps(u, _mm_min_ps(v, w)), most = _mm_max_ps(u, _mm_max_ps(v, w));
    f4 both = _mm_and_ps(f4_less_mask(least, _mm_sub_ps(_mm_setzero_ps(), error)),
                         f4_less_mask(error, most));
    /* Woop's t lies within its vertices' depths. */
    f4 first = _mm_min_ps(t[0], _mm_min_ps(t[1], t[2])),
       last = _mm_max_ps(t[0], _mm_max_ps(t[1], t[2]));
    f4 apart = _mm_or_ps(f4_less_mask(last, _mm_set1_ps(from - r->filter_depth)),
                         f4_less_mask(_mm_set1_ps(to + r->filter_depth), first));
    return ~(unsigned)_mm_movemask_ps(_mm_or_ps(both, apart)) & 0xf;
}

/* What the test in double found, by lane. */
struct decision {
    double t[4], v[4], w[4], det[4];
    unsigned outside; /* lanes that need exact_t's careful branch */
} __attribute__((aligned(32)));

/* exact_edges_of, exact_woop and exact_t for four triangles. Returns the accepted lanes. */
static inline unsigned woop_four(const struct trace_ray *r, const struct bvh_leaf *leaf,
                                 struct decision *out)
{
    d4 rel[3][3], x[3], y[3], zero = d4_splat(0.0);
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++)
            rel[i][k] = d4_sub(d4_widen(leaf->v[i][r->axis[k]]), d4_splat(r->org[r->axis[k]]));
        x[i] = d4_sub(rel[i][0], d4_mul(d4_splat(r->shear[0]), rel[i][2]));
        y[i] = d4_sub(rel[i][1], d4_mul(d4_splat(r->shear[1]), rel[i][2]));
    }
    d4 u = d4_sub(d4_mul(x[2], y[1]), d4_mul(y[2], x[1]));
    d4 v = d4_sub(d4_mul(x[0], y[2]), d4_mul(y[0], x[2]));
    d4 w = d4_sub(d4_mul(x[1], y[0]), d4_mul(y[1], x[0]));
    d4 det = d4_add(d4_add(u, v), w);
    unsigned negative = d4_mask(d4_or(d4_or(d4_less(u, zero), d4_less(v, zero)), d4_less(w, zero)));
    unsigned positive = d4_mask(d4_or(d4_or(d4_less(zero, u), d4_less(zero, v)), d4_less(zero, w)));
    unsigned flat = d4_mask(d4_and(d4_less_equal(det, zero), d4_less_equal(zero, det)));
    unsigned accepted = ~(negative & positive) & ~flat & 0xf;
    if (!accepted)
        return 0;
    d4 zmin = d4_min(d4_min(rel[0][2], rel[1][2]), rel[2][2]);
    d4 zmax = d4_max(d4_max(rel[0][2], rel[1][2]), rel[2][2]);
    d4 z = d4_add(d4_add(d4_mul(u, rel[0][2]), d4_mul(v, rel[1][2])), d4_mul(w, rel[2][2]));
    z = d4_div(z, det);
    d4 t = d4_mul(d4_min(d4_max(z, zmin), zmax), d4_splat(r->shear[2]));
    unsigned inside = 0xf;
    for (int k = 0; k < 2; k++) {
        d4 slack = d4_splat(r->slack), p = d4_mul(t, d4_splat(r->dir[r->axis[k]]));
        d4 lo = d4_sub(d4_min(d4_min(rel[0][k], rel[1][k]), rel[2][k]), slack);
        d4 hi = d4_add(d4_max(d4_max(rel[0][k], rel[1][k]), rel[2][k]), slack);
        inside &= d4_mask(d4_and(d4_less_equal(lo, p), d4_less_equal(p, hi)));
    }
    d4_store(out->t, t);
    d4_store(out->v, v);
    d4_store(out->w, w);
    d4_store(out->det, det);
    out->outside = accepted & ~inside;
    return accepted;
}

/* exact_t's careful branch. */
static __attribute__((noinline)) bool lane_t(const struct trace_ray *r, const struct bvh_leaf *leaf,
                                             unsigned lane, double *t)
{
    float v[3][3];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            v[i][k] = leaf->v[i][k][lane];
    return exact_woop(r, v, t);
}

static __attribute__((noinline)) void leaf_decide(const struct accel *a, const struct trace_ray *r,
                                                  const struct bvh_leaf *leaf, double tmin,
                                                  uint32_t object, struct trace_best *best)
{
    struct decision d;
    COUNT(decisions);
    for (unsigned lanes = woop_four(r, leaf, &d); lanes; lanes &= lanes - 1) {
        unsigned lane = (unsigned)__builtin_ctz(lanes);
        if ((d.outside >> lane & 1) && !lane_t(r, leaf, lane, &d.t[lane]))
            continue;
        uint32_t primitive = leaf->id[lane] & (BVH_PRIMITIVES_MAX - 1);
        if (accel_offer(a, d.t[lane], tmin, object, primitive, leaf, lane, best)) {
            best->v = d.v[lane];
            best->w = d.w[lane];
            best->det = d.det[lane];
        }
    }
}

static __attribute__((noinline)) bool
leaf_blocks(const struct trace_ray *r, const struct bvh_leaf *leaf, double tmin, double tmax)
{
    struct decision d;
    COUNT(decisions);
    for (unsigned lanes = woop_four(r, leaf, &d); lanes; lanes &= lanes - 1) {
        unsigned lane = (unsigned)__builtin_ctz(lanes);
        if ((d.outside >> lane & 1) && !lane_t(r, leaf, lane, &d.t[lane]))
            continue;
        if (d.t[lane] > tmin && d.t[lane] < tmax)
            return true;
    }
    return false;
}

/* --- Spheres and instances ------------------------------------------------ */

static void mesh_closest(const struct accel *a, const struct bvh *tree, const struct trace_ray *r,
                         double tmin, uint32_t object, struct trace_best *best);
static bool mesh_any(const struct accel *a, const struct bvh *tree, const struct trace_ray *r,
                     double tmin, double tmax);

static __attribute__((noinline)) void object_closest(const struct accel *a,
                                                     const struct trace_ray *r, double tmin,
                                                     uint32_t number, struct trace_best *best)
{
    const struct accel_object *o = &a->objects[number];
    if (o->type == ACCEL_SPHERE) {
        double t, tmax = best->found ? __builtin_inf() : best->t;
        if (exact_sphere(r, o->center, o->radius, tmin, tmax, &t))
            accel_offer(a, t, tmin, number, 0, NULL, 0, best);
        return;
    }
    struct trace_ray inner;
    double rescale;
    if (!accel_instance_ray(a, number, r, &inner, &rescale))
        return;
    struct trace_best moved = *best;
    moved.t /= rescale;
    mesh_closest(a, &a->mesh_trees[o->mesh], &inner, tmin / rescale, number, &moved);
    if (moved.found && moved.object == number) {
        moved.t *= rescale;
        *best = moved;
    }
}

static __attribute__((noinline)) bool object_any(const struct accel *a, const struct trace_ray *r,
                                                 double tmin, double tmax, uint32_t number)
{
    const struct accel_object *o = &a->objects[number];
    if (o->type == ACCEL_SPHERE) {
        double t;
        return exact_sphere(r, o->center, o->radius, tmin, tmax, &t);
    }
    struct trace_ray inner;
    double rescale;
    if (!accel_instance_ray(a, number, r, &inner, &rescale))
        return false;
    return mesh_any(a, &a->mesh_trees[o->mesh], &inner, tmin / rescale, tmax / rescale);
}

/* --- One ray -------------------------------------------------------------- */

static inline void walk_closest(const struct accel *a, const struct bvh *tree,
                                const struct trace_ray *r, double tmin, uint32_t object,
                                struct trace_best *best)
{
    uint32_t keys[BVH_STACK + STACK_SLACK], refs[BVH_STACK + STACK_SLACK];
    const unsigned char *arena = tree->arena;
    const uint32_t row[3] = {r->row[0], r->row[1], r->row[2]};
    uint32_t edge_bits = float_bits(tree->edge_unit), ref = tree->root, top = 0;
    struct slabs slabs;
    slabs_init(&slabs, r);
    float from_f = round_down(tmin);
    f8 from = f8_splat(from_f), entry;
    float to = round_up(best->t);
    for (;;) {
        switch ((enum bvh_kind)(ref & 3)) {
        case BVH_NODE: {
            const struct bvh_node *node = bvh_node_at(arena, ref);
            COUNT(nodes);
            unsigned mask = node_meet(node, &slabs, row, from, f8_splat(to), &entry);
            if (!mask)
                break;
            if ((mask & (mask - 1)) == 0) {
                ref = node->child[__builtin_ctz(mask)];
                prefetch(arena, ref);
                continue;
            }
            unsigned count = (unsigned)__builtin_popcount(mask);
            unsigned nearest =
                children_sort(entry, mask, count, node->child, keys + top, refs + top);
            top += count - 1;
            ref = node->child[nearest];
            prefetch(arena, ref);
            prefetch(arena, refs[top - 1]);
            continue;
        }
        case BVH_LEAF: {
            const struct bvh_leaf *leaf = bvh_leaf_at(arena, ref);
            COUNT(leaves);
            if (leaf_filter(r, leaf, edge_bits, from_f, to)) {
                leaf_decide(a, r, leaf, tmin, object, best);
                to = round_up(best->t);
            }
            break;
        }
        case BVH_OBJECT:
            object_closest(a, r, tmin, ref >> BVH_KIND_BITS, best);
            to = round_up(best->t);
            break;
        case BVH_EMPTY:
            break;
        }
        /* The next entry that does not start behind the best hit. */
        uint32_t limit = float_bits(to);
        do {
            if (top == 0)
                return;
            top--;
        } while ((keys[top] & ~(uint32_t)KEY_SLOT_MASK) > limit);
        ref = refs[top];
    }
}

static inline bool walk_any(const struct accel *a, const struct bvh *tree,
                            const struct trace_ray *r, double tmin, double tmax)
{
    uint32_t keys[BVH_STACK + STACK_SLACK], refs[BVH_STACK + STACK_SLACK];
    const unsigned char *arena = tree->arena;
    const uint32_t row[3] = {r->row[0], r->row[1], r->row[2]};
    uint32_t edge_bits = float_bits(tree->edge_unit), ref = tree->root, top = 0;
    struct slabs slabs;
    slabs_init(&slabs, r);
    float from_f = round_down(tmin), to_f = round_up(tmax);
    f8 from = f8_splat(from_f), to = f8_splat(to_f), entry;
    for (;;) {
        switch ((enum bvh_kind)(ref & 3)) {
        case BVH_NODE: {
            const struct bvh_node *node = bvh_node_at(arena, ref);
            COUNT(nodes);
            unsigned mask = node_meet(node, &slabs, row, from, to, &entry);
            if (!mask)
                break;
            if ((mask & (mask - 1)) == 0) {
                ref = node->child[__builtin_ctz(mask)];
                prefetch(arena, ref);
                continue;
            }
            /* What is near blocks more often than what is far: that pays for sorting. */
            unsigned count = (unsigned)__builtin_popcount(mask);
            unsigned nearest =
                children_sort(entry, mask, count, node->child, keys + top, refs + top);
            top += count - 1;
            ref = node->child[nearest];
            prefetch(arena, ref);
            prefetch(arena, refs[top - 1]);
            continue;
        }
        case BVH_LEAF: {
            const struct bvh_leaf *leaf = bvh_leaf_at(arena, ref);
            COUNT(leaves);
            if (leaf_filter(r, leaf, edge_bits, from_f, to_f) && leaf_blocks(r, leaf, tmin, tmax))
                return true;
            break;
        }
        case BVH_OBJECT:
            if (object_any(a, r, tmin, tmax, ref >> BVH_KIND_BITS))
                return true;
            break;
        case BVH_EMPTY:
            break;
        }
        if (top == 0)
            return false;
        ref = refs[--top];
    }
}

static __attribute__((noinline)) void mesh_closest(const struct accel *a, const struct bvh *tree,
                                                   const struct trace_ray *r, double tmin,
                                                   uint32_t object, struct trace_best *best)
{
    walk_closest(a, tree, r, tmin, object, best);
}

static __attribute__((noinline)) bool mesh_any(const struct accel *a, const struct bvh *tree,
                                               const struct trace_ray *r, double tmin, double tmax)
{
    return walk_any(a, tree, r, tmin, tmax);
}

static void kernel_closest(const struct accel *a, const struct ray *ray, struct hit *out)
{
    struct trace_ray ready;
    double tmin;
    struct trace_best best = {.object = SCENE_NONE, .primitive = SCENE_NONE};
    if (!(ray->tmin >= 0.0)) { /* keys cannot be ordered as integers */
        trace_plain.closest(a, ray, out);
        return;
    }
    if (accel_ray(a, ray, &ready, &tmin, &best.t))
        walk_closest(a, &a->scene_tree, &ready, tmin, SCENE_NONE, &best);
    if (best.found)
        accel_hit(a, &ready, &best, out);
    else
        out->object = SCENE_NONE;
}

static bool kernel_occluded(const struct accel *a, const struct ray *ray)
{
    struct trace_ray ready;
    double tmin, tmax;
    if (!(ray->tmin >= 0.0))
        return trace_plain.occluded(a, ray);
    return accel_ray(a, ray, &ready, &tmin, &tmax) &&
           walk_any(a, &a->scene_tree, &ready, tmin, tmax);
}

/* --- Many rays ------------------------------------------------------------ */

/* A ray under way. */
struct runner {
    struct slabs slabs;
    struct trace_ray ray;
    struct trace_best best; /* any hit: t is tmax */
    double tmin;
    float from, to;
    uint32_t ref, top;
    size_t index; /* in the caller's arrays */
    uint32_t keys[BVH_STACK + STACK_SLACK], refs[BVH_STACK + STACK_SLACK];
};

/* Readies the next ray that needs a walk; false when there is none left. */
static bool runner_start(struct runner *s, const struct accel *a, const struct ray *ray)
{
    s->best = (struct trace_best){.object = SCENE_NONE, .primitive = SCENE_NONE};
    if (!accel_ray(a, ray, &s->ray, &s->tmin, &s->best.t))
        return false;
    slabs_init(&s->slabs, &s->ray);
    s->from = round_down(s->tmin);
    s->to = round_up(s->best.t);
    s->ref = a->scene_tree.root;
    s->top = 0;
    return true;
}

/* One node or leaf; false when the ray is done. */
static inline bool runner_step_closest(struct runner *s, const struct accel *a, uint32_t edge_bits)
{
    const unsigned char *arena = a->scene_tree.arena;
    switch ((enum bvh_kind)(s->ref & 3)) {
    case BVH_NODE: {
        const struct bvh_node *node = bvh_node_at(arena, s->ref);
        f8 entry;
        COUNT(nodes);
        unsigned mask =
            node_meet(node, &s->slabs, s->ray.row, f8_splat(s->from), f8_splat(s->to), &entry);
        if (!mask)
            break;
        unsigned count = (unsigned)__builtin_popcount(mask), nearest;
        if (count == 1)
            nearest = (unsigned)__builtin_ctz(mask);
        else
            nearest =
                children_sort(entry, mask, count, node->child, s->keys + s->top, s->refs + s->top);
        s->top += count - 1;
        s->ref = node->child[nearest];
        prefetch(arena, s->ref);
        return true;
    }
    case BVH_LEAF: {
        const struct bvh_leaf *leaf = bvh_leaf_at(arena, s->ref);
        COUNT(leaves);
        if (leaf_filter(&s->ray, leaf, edge_bits, s->from, s->to)) {
            leaf_decide(a, &s->ray, leaf, s->tmin, SCENE_NONE, &s->best);
            s->to = round_up(s->best.t);
        }
        break;
    }
    case BVH_OBJECT:
        object_closest(a, &s->ray, s->tmin, s->ref >> BVH_KIND_BITS, &s->best);
        s->to = round_up(s->best.t);
        break;
    case BVH_EMPTY:
        break;
    }
    uint32_t limit = float_bits(s->to), top = s->top;
    do {
        if (top == 0)
            return false;
        top--;
    } while ((s->keys[top] & ~(uint32_t)KEY_SLOT_MASK) > limit);
    s->top = top;
    s->ref = s->refs[top];
    prefetch(arena, s->ref);
    return true;
}

static inline bool runner_step_any(struct runner *s, const struct accel *a, uint32_t edge_bits)
{
    const unsigned char *arena = a->scene_tree.arena;
    switch ((enum bvh_kind)(s->ref & 3)) {
    case BVH_NODE: {
        const struct bvh_node *node = bvh_node_at(arena, s->ref);
        f8 entry;
        COUNT(nodes);
        unsigned mask =
            node_meet(node, &s->slabs, s->ray.row, f8_splat(s->from), f8_splat(s->to), &entry);
        if (!mask)
            break;
        /* Sorting, which pays for a single ray, costs more than it saves here: measured. */
        children_list(mask, node->child, s->refs + s->top);
        s->top += (unsigned)__builtin_popcount(mask) - 1;
        s->ref = s->refs[s->top];
        prefetch(arena, s->ref);
        return true;
    }
    case BVH_LEAF: {
        const struct bvh_leaf *leaf = bvh_leaf_at(arena, s->ref);
        COUNT(leaves);
        s->best.found = leaf_filter(&s->ray, leaf, edge_bits, s->from, s->to) &&
                        leaf_blocks(&s->ray, leaf, s->tmin, s->best.t);
        break;
    }
    case BVH_OBJECT:
        s->best.found = object_any(a, &s->ray, s->tmin, s->best.t, s->ref >> BVH_KIND_BITS);
        break;
    case BVH_EMPTY:
        break;
    }
    if (s->best.found || s->top == 0)
        return false;
    s->ref = s->refs[--s->top];
    prefetch(arena, s->ref);
    return true;
}

/* Gives a free runner its next ray; rays that need no walk are answered on the way. */
static bool closest_next(struct runner *s, const struct accel *a, const struct ray *rays,
                         size_t count, size_t *next, struct hit *hits)
{
    while (*next < count) {
        s->index = (*next)++;
        if (!(rays[s->index].tmin >= 0.0))
            trace_plain.closest(a, &rays[s->index], &hits[s->index]);
        else if (runner_start(s, a, &rays[s->index]))
            return true;
        else
            hits[s->index].object = SCENE_NONE;
    }
    return false;
}

static void kernel_closest_batch(const struct accel *a, const struct ray *rays, size_t count,
                                 struct hit *hits)
{
    struct runner runners[TRACE_BATCH];
    uint32_t edge_bits = float_bits(a->scene_tree.edge_unit);
    size_t next = 0, active = 0;
    while (active < TRACE_BATCH && closest_next(&runners[active], a, rays, count, &next, hits))
        active++;
    struct runner *order[TRACE_BATCH];
    for (size_t i = 0; i < active; i++)
        order[i] = &runners[i];
    while (active > 0) {
        for (size_t i = 0; i < active; i++) {
            struct runner *s = order[i];
            if (runner_step_closest(s, a, edge_bits))
                continue;
            if (s->best.found)
                accel_hit(a, &s->ray, &s->best, &hits[s->index]);
            else
                hits[s->index].object = SCENE_NONE;
            if (!closest_next(s, a, rays, count, &next, hits))
                order[i--] = order[--active];
        }
    }
}

static bool occluded_next(struct runner *s, const struct accel *a, const struct ray *rays,
                          size_t count, size_t *next, uint8_t *occluded)
{
    while (*next < count) {
        s->index = (*next)++;
        if (!(rays[s->index].tmin >= 0.0))
            occluded[s->index] = trace_plain.occluded(a, &rays[s->index]);
        else if (runner_start(s, a, &rays[s->index]))
            return true;
        else
            occluded[s->index] = 0;
    }
    return false;
}

static void kernel_occluded_batch(const struct accel *a, const struct ray *rays, size_t count,
                                  uint8_t *occluded)
{
    struct runner runners[TRACE_BATCH];
    uint32_t edge_bits = float_bits(a->scene_tree.edge_unit);
    size_t next = 0, active = 0;
    while (active < TRACE_BATCH && occluded_next(&runners[active], a, rays, count, &next, occluded))
        active++;
    struct runner *order[TRACE_BATCH];
    for (size_t i = 0; i < active; i++)
        order[i] = &runners[i];
    while (active > 0) {
        for (size_t i = 0; i < active; i++) {
            struct runner *s = order[i];
            if (runner_step_any(s, a, edge_bits))
                continue;
            occluded[s->index] = s->best.found;
            if (!occluded_next(s, a, rays, count, &next, occluded))
                order[i--] = order[--active];
        }
    }
}

const struct trace_kernel TRACE_KERNEL = {
    TRACE_NAME, kernel_closest, kernel_occluded, kernel_closest_batch, kernel_occluded_batch,
};
