/* worker/render/trace_kernel.h: the walk in SIMD, written once.
 *
 * Included by one .c file per instruction set, which defines TRACE_KERNEL (the name of
 * its table) and TRACE_NAME. Per node: eight boxes against one ray. Per leaf: four
 * triangles in float, and in double what float leaves open (trace_leaf.h); the nearest
 * hit that float is sure of waits for its decision in double until the ray is done. The
 * bits are those of trace_exact.h.
 *
 * The batch forms keep TRACE_BATCH rays under way and give each one node or leaf in
 * turn, having asked for its next one's memory: what a ray waits for arrives while the
 * others are served. A ray's steps do not depend on its neighbours, so neither do its
 * bits. Nothing here allocates or branches on anything but rays and tree.
 */
#include "worker/render/accel_parts.h"

#include <string.h>

#include "worker/render/trace_leaf.h"
#include "worker/render/trace_wait.h"

enum {
    TRACE_BATCH = 16,
    STACK_SLACK = BVH_WIDTH + PUT_OFF_MAX,
    INTERLEAVE_MIN = 1 << 23,     /* bytes of a tree that does not stay in a core's own caches */
    INTERLEAVE_ANY_MIN = 1 << 16, /* the same where no order of visits is kept up */
    AHEAD_MIN = 1 << 17,          /* bytes of a tree that does not stay in the innermost cache */
    AHEAD_LINES = 20,             /* of 64 bytes: a node's leaves, and some of the next node's */
};

/* The kernel for few triangles that goes with this one. */
#ifndef TRACE_FLAT
#define TRACE_FLAT NULL
#endif

/* --- Boxes ---------------------------------------------------------------- */

/* The same ray, but to the compiler: so that it reads the slabs' constants where they are used, one
 * load each, rather than make vectors of them for all of a walk, for which it has no registers. */
static inline const struct trace_ray *ray_in_memory(const struct trace_ray *r)
{
#ifdef __AVX2__
    __asm__("" : "+r"(r));
#endif
    return r;
}

/* The boxes' planes that a row's bytes lead to. */
static inline f8 node_planes(const struct bvh_node *node, uint32_t row)
{
    return f8_load((const float *)((const char *)node + row));
}

/* Which children's widened boxes the ray meets within [from, to], and where it enters. */
static inline m8 node_meet(const struct bvh_node *node, const struct trace_ray *r, f8 from, f8 to,
                           f8 *entry)
{
    f8 near[3], far[3];
    for (int k = 0; k < 3; k++) {
        f8 inverse = f8_splat(r->inverse[k]);
        near[k] = f8_mulsub(node_planes(node, r->row[k]), inverse, f8_splat(r->near_offset[k]));
        far[k] = f8_mulsub(node_planes(node, r->row[k] ^ TRACE_ROW), inverse,
                           f8_splat(r->far_offset[k]));
    }
    /* In pairs, which takes less time; what is not a number is ignored, and what it met with it. */
    *entry = f8_max(f8_max(near[0], near[1]), f8_max(near[2], from));
    return f8_less_equal(*entry, f8_min(f8_min(far[0], far[1]), f8_min(far[2], to)));
}

static inline void prefetch(const unsigned char *arena, uint32_t ref)
{
    const char *p = (const char *)bvh_node_at(arena, ref);
    __builtin_prefetch(p);
    __builtin_prefetch(p + 64);
    __builtin_prefetch(p + 128);
    __builtin_prefetch(p + 192);
}

/* Asks for what lies behind a node while its boxes are tested: its leaves, and what is next in
 * order. Before it is known which of them are met; but nothing else is waited for meanwhile. */
static inline void prefetch_behind(const struct bvh_node *node)
{
    const char *p = (const char *)node + 4 * 64;
#pragma GCC unroll 20
    for (int i = 0; i < AHEAD_LINES; i++)
        __builtin_prefetch(p + 64 * i);
}

/* --- Packed leaves -------------------------------------------------------- */

#ifdef TRACE_COMPACT

/* A leaf that neither the best hit nor a pending one is in. */
static inline struct bvh_leaf *leaf_room(const struct trace_best *best,
                                         const struct leaf_pending *pending)
{
    struct bvh_leaf *room = best->room;
    while (room == best->leaf || room == pending->leaf || room == pending->open)
        room++;
    return room;
}

static inline const struct bvh_leaf *leaf_of(const struct accel *a, const struct bvh *tree,
                                             uint32_t ref, struct bvh_leaf *room)
{
    accel_unpack(a, tree, bvh_packed_at(tree->arena, ref), room);
    return room;
}

#define LEAF_ROOM(name, count) struct bvh_leaf name[count]

#else

static inline struct bvh_leaf *leaf_room(const struct trace_best *best,
                                         const struct leaf_pending *pending)
{
    (void)pending;
    return best->room;
}

static inline const struct bvh_leaf *leaf_of(const struct accel *a, const struct bvh *tree,
                                             uint32_t ref, struct bvh_leaf *room)
{
    (void)a, (void)room;
    return bvh_leaf_at(tree->arena, ref);
}

#define LEAF_ROOM(name, count) struct bvh_leaf *const name = NULL

#endif

/* --- Spheres and instances ------------------------------------------------ */

static void mesh_closest(const struct accel *a, const struct bvh *tree, uint32_t start,
                         const struct trace_ray *r, double tmin, uint32_t object,
                         struct trace_best *best);
static bool mesh_any(const struct accel *a, const struct bvh *tree, const struct trace_ray *r,
                     double tmin, double tmax);

/* Moves a ray to an instance. Returns where in the mesh's tree to start: at the root, at the only
 * child of it that the ray meets, or nowhere, which is so of most whose own box it meets. */
static inline uint32_t instance_enter(const struct accel *a, const struct bvh *tree,
                                      uint32_t number, const struct trace_ray *r, double tmin,
                                      double tmax, struct trace_ray *inner)
{
    struct ready_way way;
    f8 entry;
    if (!ready_instance_boxes(a, number, r, inner, &way))
        return BVH_EMPTY;
    struct leaf_span span = leaf_span_of(tmin * inner->unscale, tmax * inner->unscale);
    const struct bvh_node *root = bvh_node_at(tree->arena, tree->root);
    unsigned mask = m8_bits(node_meet(root, inner, f8_splat(span.from), f8_splat(span.to), &entry));
    if (!mask)
        return BVH_EMPTY;
    ready_instance_triangles(a, number, &way, inner);
    return mask & (mask - 1) ? tree->root : root->child[__builtin_ctz(mask)];
}

static __attribute__((noinline)) void object_closest(const struct accel *a,
                                                     const struct trace_ray *r, double tmin,
                                                     uint32_t number, struct trace_best *best)
{
    const struct bvh *tree = a->motions ? a->motions[number].tree : NULL;
    if (!tree) {
        const struct accel_object *o = &a->objects[number];
        double t, tmax = best->found ? __builtin_inf() : best->t;
        if (exact_sphere(r, o->center, o->radius, tmin, tmax, &t))
            accel_offer(a, t, tmin, number, 0, NULL, 0, best);
        return;
    }
    struct trace_ray inner;
    double t = best->t, tmax = best->tmax;
    uint32_t start = instance_enter(a, tree, number, r, tmin, t, &inner);
    if (start == BVH_EMPTY)
        return;
    best->t = t * inner.unscale;
    best->tmax = tmax * inner.unscale;
    mesh_closest(a, tree, start, &inner, tmin * inner.unscale, number, best);
    best->tmax = tmax;
    best->t = best->found && best->object == number ? best->t * inner.rescale : t;
}

static __attribute__((noinline)) bool object_any(const struct accel *a, const struct trace_ray *r,
                                                 double tmin, double tmax, uint32_t number)
{
    const struct bvh *tree = a->motions ? a->motions[number].tree : NULL;
    if (!tree) {
        const struct accel_object *o = &a->objects[number];
        double t;
        return exact_sphere(r, o->center, o->radius, tmin, tmax, &t);
    }
    struct trace_ray inner;
    struct ready_way way;
    if (!ready_instance_boxes(a, number, r, &inner, &way))
        return false;
    ready_instance_triangles(a, number, &way, &inner);
    return mesh_any(a, tree, &inner, tmin * inner.unscale, tmax * inner.unscale);
}

/* --- One ray -------------------------------------------------------------- */

/* From `start` down. Leaves the nearest certain hit in `out`, to be settled. */
static inline void walk_closest(const struct accel *a, const struct bvh *tree, uint32_t start,
                                const struct trace_ray *r, double tmin, uint32_t object,
                                struct leaf_pending *out, struct trace_best *best)
{
    uint32_t keys[BVH_STACK + STACK_SLACK] __attribute__((aligned(64)));
    uint32_t refs[BVH_STACK + STACK_SLACK] __attribute__((aligned(64)));
    const unsigned char *arena = tree->arena;
    uint32_t edge_bits = float_bits(tree->edge_unit), ref = start, top = 0, put_off = 0;
    const bool ahead = tree->bytes > AHEAD_MIN;
    struct leaf_span span = leaf_span_left(tmin, best);
    struct leaf_pending pending = {.leaf = NULL, .open = NULL};
    f8 from = f8_splat(span.from), entry;
    enum waiting waits;
    for (;;) {
        switch ((enum bvh_kind)(ref & 3)) {
        case BVH_NODE: {
            const struct bvh_node *node = bvh_node_at(arena, ref);
            COUNT(nodes);
            m8 met = node_meet(node, ray_in_memory(r), from, f8_splat(span.to), &entry);
            unsigned mask = m8_bits(met);
            if (ahead)
                prefetch_behind(node);
            if (!mask)
                break;
            if ((mask & (mask - 1)) == 0) {
                ref = node->child[__builtin_ctz(mask)];
                continue;
            }
            unsigned count = (unsigned)__builtin_popcount(mask);
            ref = children_sort(entry, met, count, node->child, keys + top, refs + top);
            top += count - 1;
            prefetch(arena, refs[top - 1]);
            continue;
        }
        case BVH_LEAF: {
            const struct bvh_leaf *leaf = leaf_of(a, tree, ref, leaf_room(best, &pending));
            COUNT(leaves);
            leaf_closest(a, r, leaf, edge_bits, object, &span, &pending, best);
            break;
        }
        case BVH_OBJECT:
            waits = object_waits(a, r, span.from, &ref, keys, refs, &top, &put_off);
            if (waits == WAITING_READY)
                continue;
            if (waits == WAITING_PUT_OFF)
                break;
            pending_settle_early(a, r, tmin, object, &pending, best);
            object_closest(a, r, tmin, ref >> BVH_KIND_BITS, best);
            span.to = round_up(best->t);
            break;
        case BVH_EMPTY:
            break;
        }
        /* The next entry that does not start behind the best hit. */
        uint32_t limit = float_bits(span.to);
        do {
            if (top == 0) {
                *out = pending;
                return;
            }
            top--;
        } while ((keys[top] & ~(uint32_t)KEY_SLOT_MASK) > limit);
        ref = refs[top];
    }
}

static inline __attribute__((always_inline)) bool walk_any(const struct accel *a,
                                                           const struct bvh *tree,
                                                           const struct trace_ray *r, double tmin,
                                                           double tmax)
{
    uint32_t keys[BVH_STACK + STACK_SLACK] __attribute__((aligned(64)));
    uint32_t refs[BVH_STACK + STACK_SLACK] __attribute__((aligned(64)));
    const unsigned char *arena = tree->arena;
    uint32_t edge_bits = float_bits(tree->edge_unit), ref = tree->root, top = 0, put_off = 0;
    LEAF_ROOM(room, 1);
    const bool ahead = tree->bytes > AHEAD_MIN;
    const struct leaf_span span = leaf_span_of(tmin, tmax);
    f8 from = f8_splat(span.from), to = f8_splat(span.to), entry;
    const bool sorted = a->motions != NULL || a->lazy != NULL;
    enum waiting waits;
    for (;;) {
        switch ((enum bvh_kind)(ref & 3)) {
        case BVH_NODE: {
            const struct bvh_node *node = bvh_node_at(arena, ref);
            COUNT(nodes);
            m8 met = node_meet(node, ray_in_memory(r), from, to, &entry);
            unsigned mask = m8_bits(met);
            if (ahead)
                prefetch_behind(node);
            if (!mask)
                break;
            if ((mask & (mask - 1)) == 0) {
                ref = node->child[__builtin_ctz(mask)];
                continue;
            }
            /* Shadow rays leave a surface, which is near and blocks nothing: sorting costs more
             * than it saves, but for what is dear to enter: instances, and trees yet to be built.
             */
            unsigned count = (unsigned)__builtin_popcount(mask);
            if (sorted) {
                ref = children_sort(entry, met, count, node->child, keys + top, refs + top);
            } else {
                ref = children_list(mask, node->child, refs + top);
            }
            top += count - 1;
            prefetch(arena, refs[top - 1]);
            continue;
        }
        case BVH_LEAF: {
            const struct bvh_leaf *leaf = leaf_of(a, tree, ref, room);
            COUNT(leaves);
            if (leaf_blocks(r, leaf, edge_bits, &span, tmax))
                return true;
            break;
        }
        case BVH_OBJECT:
            waits = object_waits(a, r, span.from, &ref, keys, refs, &top, &put_off);
            if (waits == WAITING_READY)
                continue;
            if (waits == WAITING_PUT_OFF)
                break;
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
                                                   uint32_t start, const struct trace_ray *r,
                                                   double tmin, uint32_t object,
                                                   struct trace_best *best)
{
    struct leaf_pending pending;
    walk_closest(a, tree, start, r, tmin, object, &pending, best);
    pending_settle(a, r, tmin, object, &pending, best);
}

static __attribute__((noinline)) bool mesh_any(const struct accel *a, const struct bvh *tree,
                                               const struct trace_ray *r, double tmin, double tmax)
{
    return walk_any(a, tree, r, tmin, tmax);
}

/* Float's boxes would all be met: trace_far.c. */
static inline bool ray_is_far(const struct accel *a, const struct trace_ray *r)
{
    return __builtin_expect(r->slack > a->far_slack, 0);
}

static void kernel_closest(const struct accel *a, const struct ray *ray, struct hit *out)
{
    struct trace_ray ready;
    double tmin;
    LEAF_ROOM(room, TRACE_ROOM);
    struct trace_best best = {.object = SCENE_NONE, .primitive = SCENE_NONE, .room = room};
    if (!(ray->tmin >= 0.0)) { /* keys cannot be ordered as integers */
        trace_plain.closest(a, ray, out);
        return;
    }
    if (ready_scene_ray(a, ray, &ready, &tmin, &best.tmax)) {
        if (ray_is_far(a, &ready)) {
            trace_far_closest(a, ray, out);
            return;
        }
        best.t = best.tmax;
        mesh_closest(a, &a->scene_tree, a->scene_tree.root, &ready, tmin, SCENE_NONE, &best);
    }
    if (best.found)
        ready_hit(a, &ready, &best, out);
    else
        out->object = SCENE_NONE;
}

static bool kernel_occluded(const struct accel *a, const struct ray *ray)
{
    struct trace_ray ready;
    double tmin, tmax;
    if (!(ray->tmin >= 0.0))
        return trace_plain.occluded(a, ray);
    if (!ready_scene_ray(a, ray, &ready, &tmin, &tmax))
        return false;
    if (ray_is_far(a, &ready))
        return trace_far_occluded(a, ray);
    return walk_any(a, &a->scene_tree, &ready, tmin, tmax);
}

/* --- Many rays, few triangles ---------------------------------------------- */

/* Where all of a tree stays close there is nothing to wait for but one ray's own chain of
 * operations: so rays are readied together, walked one by one, and finished together, each of which
 * the processor overlaps better than all three in turn. */
struct guest {
    struct trace_ray ray;
    struct trace_best best;
    struct leaf_pending pending;
    double tmin;
    size_t index;
    enum { GUEST_HITS_NOTHING, GUEST_WALKS, GUEST_APART } way; /* apart: not by this walk */
#ifdef TRACE_COMPACT
    struct bvh_leaf room[TRACE_ROOM];
#endif
};

#ifdef TRACE_COMPACT
#define ROOM_OF(s) ((s)->room)
#else
#define ROOM_OF(s) NULL
#endif

/* Readies up to TRACE_BATCH of the rays from *next on that are wanted; returns how many. */
static size_t guests_ready(struct guest *guests, const struct accel *a, const struct ray *rays,
                           const uint8_t *active, size_t count, size_t *next)
{
    size_t used = 0;
    for (; *next < count && used < TRACE_BATCH; ++*next) {
        size_t i = *next;
        if (active && !active[i])
            continue;
        struct guest *g = &guests[used++];
        g->index = i;
        g->best =
            (struct trace_best){.object = SCENE_NONE, .primitive = SCENE_NONE, .room = ROOM_OF(g)};
        if (!(rays[i].tmin >= 0.0))
            g->way = GUEST_APART;
        else if (!ready_scene_ray(a, &rays[i], &g->ray, &g->tmin, &g->best.tmax))
            g->way = GUEST_HITS_NOTHING;
        else
            g->way = ray_is_far(a, &g->ray) ? GUEST_APART : GUEST_WALKS;
        g->best.t = g->best.tmax;
    }
    return used;
}

static void apart_closest(const struct accel *a, const struct ray *ray, struct hit *out)
{
    if (ray->tmin >= 0.0)
        trace_far_closest(a, ray, out);
    else
        trace_plain.closest(a, ray, out);
}

static bool apart_occluded(const struct accel *a, const struct ray *ray)
{
    return ray->tmin >= 0.0 ? trace_far_occluded(a, ray) : trace_plain.occluded(a, ray);
}

static void few_closest(const struct accel *a, const struct ray *rays, const uint8_t *active,
                        size_t count, struct hit *hits)
{
    struct guest guests[TRACE_BATCH];
    size_t next = 0, used;
    while ((used = guests_ready(guests, a, rays, active, count, &next)) > 0) {
        for (size_t i = 0; i < used; i++) {
            struct guest *g = &guests[i];
            if (g->way == GUEST_WALKS)
                walk_closest(a, &a->scene_tree, a->scene_tree.root, &g->ray, g->tmin, SCENE_NONE,
                             &g->pending, &g->best);
        }
        for (size_t i = 0; i < used; i++) {
            struct guest *g = &guests[i];
            if (g->way == GUEST_WALKS)
                pending_settle(a, &g->ray, g->tmin, SCENE_NONE, &g->pending, &g->best);
            if (g->best.found)
                ready_hit(a, &g->ray, &g->best, &hits[g->index]);
            else if (g->way == GUEST_APART)
                apart_closest(a, &rays[g->index], &hits[g->index]);
            else
                hits[g->index].object = SCENE_NONE;
        }
    }
}

static void few_occluded(const struct accel *a, const struct ray *rays, const uint8_t *active,
                         size_t count, uint8_t *occluded)
{
    struct guest guests[TRACE_BATCH];
    size_t next = 0, used;
    while ((used = guests_ready(guests, a, rays, active, count, &next)) > 0)
        for (size_t i = 0; i < used; i++) {
            const struct guest *g = &guests[i];
            const struct ray *ray = &rays[g->index];
            if (g->way == GUEST_WALKS)
                occluded[g->index] = walk_any(a, &a->scene_tree, &g->ray, g->tmin, g->best.t);
            else
                occluded[g->index] = g->way == GUEST_APART && apart_occluded(a, ray);
        }
}

/* --- Many rays ------------------------------------------------------------ */

/* A ray under way. */
struct runner {
    struct trace_ray ray;
    struct trace_best best; /* any hit: t is tmax */
    struct leaf_span span;
    struct leaf_pending pending;
    uint32_t ref, top, put_off;
    size_t index; /* in the caller's arrays */
#ifdef TRACE_COMPACT
    struct bvh_leaf room[TRACE_ROOM];
#endif
    uint32_t keys[BVH_STACK + STACK_SLACK] __attribute__((aligned(64)));
    uint32_t refs[BVH_STACK + STACK_SLACK] __attribute__((aligned(64)));
};

/* Readies the next ray that needs a walk; false when there is none left. */
static bool runner_start(struct runner *s, const struct accel *a, const struct ray *ray)
{
    s->best =
        (struct trace_best){.object = SCENE_NONE, .primitive = SCENE_NONE, .room = ROOM_OF(s)};
    double tmin;
    if (!ready_scene_ray(a, ray, &s->ray, &tmin, &s->best.tmax))
        return false;
    s->best.t = s->best.tmax;
    s->span = leaf_span_of(tmin, s->best.t);
    s->pending.leaf = s->pending.open = NULL;
    s->ref = a->scene_tree.root;
    s->top = s->put_off = 0;
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
        m8 met = node_meet(node, &s->ray, f8_splat(s->span.from), f8_splat(s->span.to), &entry);
        unsigned mask = m8_bits(met);
        if (!mask)
            break;
        unsigned count = (unsigned)__builtin_popcount(mask);
        if (count == 1)
            s->ref = node->child[__builtin_ctz(mask)];
        else
            s->ref =
                children_sort(entry, met, count, node->child, s->keys + s->top, s->refs + s->top);
        s->top += count - 1;
        prefetch(arena, s->ref);
        return true;
    }
    case BVH_LEAF: {
        const struct bvh_leaf *leaf =
            leaf_of(a, &a->scene_tree, s->ref, leaf_room(&s->best, &s->pending));
        COUNT(leaves);
        leaf_closest(a, &s->ray, leaf, edge_bits, SCENE_NONE, &s->span, &s->pending, &s->best);
        break;
    }
    case BVH_OBJECT: {
        enum waiting waits =
            object_waits(a, &s->ray, s->span.from, &s->ref, s->keys, s->refs, &s->top, &s->put_off);
        if (waits == WAITING_READY) {
            prefetch(arena, s->ref);
            return true;
        }
        if (waits == WAITING_PUT_OFF)
            break;
        pending_settle(a, &s->ray, s->span.tmin, SCENE_NONE, &s->pending, &s->best);
        object_closest(a, &s->ray, s->span.tmin, s->ref >> BVH_KIND_BITS, &s->best);
        s->span.to = round_up(s->best.t);
        break;
    }
    case BVH_EMPTY:
        break;
    }
    uint32_t limit = float_bits(s->span.to), top = s->top;
    do {
        if (top == 0) {
            pending_settle(a, &s->ray, s->span.tmin, SCENE_NONE, &s->pending, &s->best);
            return false;
        }
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
        m8 met = node_meet(node, &s->ray, f8_splat(s->span.from), f8_splat(s->span.to), &entry);
        unsigned mask = m8_bits(met);
        if (!mask)
            break;
        /* Sorting, which pays for a single ray, costs more than it saves here: measured. */
        s->ref = children_list(mask, node->child, s->refs + s->top);
        s->top += (unsigned)__builtin_popcount(mask) - 1;
        prefetch(arena, s->ref);
        return true;
    }
    case BVH_LEAF: {
        LEAF_ROOM(room, 1);
        const struct bvh_leaf *leaf = leaf_of(a, &a->scene_tree, s->ref, room);
        COUNT(leaves);
        s->best.found = leaf_blocks(&s->ray, leaf, edge_bits, &s->span, s->best.t);
        break;
    }
    case BVH_OBJECT: {
        enum waiting waits =
            object_waits(a, &s->ray, s->span.from, &s->ref, s->keys, s->refs, &s->top, &s->put_off);
        if (waits == WAITING_READY) {
            prefetch(arena, s->ref);
            return true;
        }
        if (waits == WAITING_PUT_OFF)
            break;
        s->best.found = object_any(a, &s->ray, s->span.tmin, s->best.t, s->ref >> BVH_KIND_BITS);
        break;
    }
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
                         const uint8_t *active, size_t count, size_t *next, struct hit *hits)
{
    while (*next < count) {
        s->index = (*next)++;
        if (active && !active[s->index])
            continue;
        if (!(rays[s->index].tmin >= 0.0))
            trace_plain.closest(a, &rays[s->index], &hits[s->index]);
        else if (!runner_start(s, a, &rays[s->index]))
            hits[s->index].object = SCENE_NONE;
        else if (ray_is_far(a, &s->ray))
            trace_far_closest(a, &rays[s->index], &hits[s->index]);
        else
            return true;
    }
    return false;
}

static void kernel_closest_batch(const struct accel *a, const struct ray *rays,
                                 const uint8_t *active, size_t count, struct hit *hits)
{
    if (a->scene_tree.bytes < INTERLEAVE_MIN && !a->lazy) {
        few_closest(a, rays, active, count, hits);
        return;
    }
    struct runner runners[TRACE_BATCH];
    uint32_t edge_bits = float_bits(a->scene_tree.edge_unit);
    size_t next = 0, live = 0;
    while (live < TRACE_BATCH && closest_next(&runners[live], a, rays, active, count, &next, hits))
        live++;
    struct runner *order[TRACE_BATCH];
    for (size_t i = 0; i < live; i++)
        order[i] = &runners[i];
    while (live > 0) {
        for (size_t i = 0; i < live; i++) {
            struct runner *s = order[i];
            if (runner_step_closest(s, a, edge_bits))
                continue;
            if (s->best.found)
                ready_hit(a, &s->ray, &s->best, &hits[s->index]);
            else
                hits[s->index].object = SCENE_NONE;
            if (!closest_next(s, a, rays, active, count, &next, hits))
                order[i--] = order[--live];
        }
    }
}

static bool occluded_next(struct runner *s, const struct accel *a, const struct ray *rays,
                          const uint8_t *active, size_t count, size_t *next, uint8_t *occluded)
{
    while (*next < count) {
        s->index = (*next)++;
        if (active && !active[s->index])
            continue;
        if (!(rays[s->index].tmin >= 0.0))
            occluded[s->index] = trace_plain.occluded(a, &rays[s->index]);
        else if (!runner_start(s, a, &rays[s->index]))
            occluded[s->index] = 0;
        else if (ray_is_far(a, &s->ray))
            occluded[s->index] = trace_far_occluded(a, &rays[s->index]);
        else
            return true;
    }
    return false;
}

static void kernel_occluded_batch(const struct accel *a, const struct ray *rays,
                                  const uint8_t *active, size_t count, uint8_t *occluded)
{
    if (a->scene_tree.bytes < INTERLEAVE_ANY_MIN && !a->lazy) {
        few_occluded(a, rays, active, count, occluded);
        return;
    }
    struct runner runners[TRACE_BATCH];
    uint32_t edge_bits = float_bits(a->scene_tree.edge_unit);
    size_t next = 0, live = 0;
    while (live < TRACE_BATCH &&
           occluded_next(&runners[live], a, rays, active, count, &next, occluded))
        live++;
    struct runner *order[TRACE_BATCH];
    for (size_t i = 0; i < live; i++)
        order[i] = &runners[i];
    while (live > 0) {
        for (size_t i = 0; i < live; i++) {
            struct runner *s = order[i];
            if (runner_step_any(s, a, edge_bits))
                continue;
            occluded[s->index] = s->best.found;
            if (!occluded_next(s, a, rays, active, count, &next, occluded))
                order[i--] = order[--live];
        }
    }
}

const struct trace_kernel TRACE_KERNEL = {
    TRACE_NAME,           kernel_closest,        kernel_occluded,
    kernel_closest_batch, kernel_occluded_batch, TRACE_FLAT,
};
