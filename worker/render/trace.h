/* worker/render/trace.h: a ray made ready for a tree, and the kernels that walk it.
 *
 * Inside, a direction may be scaled by a power of two, and t to match, exactly: by SIMD
 * kernels where its largest component is not within 2^20 of 1, by the others always, so
 * that it is in [1, 2). The same hits come out either way. The float side of a ray carries the
 * error of float traversal: with u = 2^-24, R = |org|max + reach, each slab of a box is widened by
 * 8 u R, which covers the roundings of the origin, the reciprocal, the products and sums, with or
 * without fma, and of t (docs/TRACING.md derives it). A box is culled only if the widened, rounded
 * interval is empty or starts strictly behind the best hit; an operand that is not a number never
 * culls.
 *
 * Thread: everything here lives on the caller's stack.
 */
#ifndef WORKER_RENDER_TRACE_H
#define WORKER_RENDER_TRACE_H

#include "worker/render/bvh.h"

enum { TRACE_ROW = BVH_WIDTH * sizeof(float) };

/* Arrays of four have an element of padding, for whole vectors to be stored. */
struct trace_ray {
    double org[4], dir[4];
    double porg[4];  /* permuted: the largest component of dir last */
    double shear[4]; /* Woop's Sx, Sy, Sz */
    float near_offset[4], far_offset[4], inverse[4]; /* t = plane * inverse - offset */
    float filter_org[4], filter_shear[4];            /* permuted; shear[3] is -shear[2] */
    uint32_t row[4];  /* bytes to the row of bvh_node.bounds with the near planes; those of the far
                         ones are TRACE_ROW bytes before or behind: row ^ TRACE_ROW */
    uint32_t axis[4]; /* what was permuted to where */
    double slack;     /* by which a hit point may lie beside its triangle: 2^-30 R; less
                         where an instance stretches */
    double rescale, unscale; /* what dir was scaled by here, and its inverse */
    double scale; /* dir = caller's direction * scale; caller's t = t * scale; a power of two */
    float filter_slope; /* of a block with edges <= e: an edge function's float error is below */
    float filter_slack; /* slope * e + floor; slack: 2^-20 R */
    float filter_floor;
    float filter_depth;  /* twice what a triangle's depths may be wrong by in float */
    float filter_spread; /* 13.8 |shear[2]| */
} __attribute__((aligned(32)));

/* The best hit so far. `object` is SCENE_NONE for a triangle of the scene's own tree,
 * whose `primitive` then counts through all its objects. */
struct trace_best {
    double t;
    double tmax; /* where the ray ends, as t did at first; read where float decides */
    uint32_t object, primitive;
    const struct bvh_leaf *leaf; /* where a triangle was met, and its lane; or NULL */
    struct bvh_leaf *room;       /* compact trees: TRACE_ROOM leaves to unpack to */
    uint32_t lane;
    bool found;
    double v, w, det; /* with a leaf: the edge functions of vertices 1 and 2, and their sum */
};

/* Of unpacked leaves, three are looked at once: the best hit's, the pending one and the next. */
enum { TRACE_ROOM = 4 };

/* Units of 2^-24 R by which boxes are widened; where float decides, by its errors too, as far as an
 * instance may stretch them: where one stretches more, double decides. So it does for a ray from
 * TRACE_FAR_FAST reaches away, of which float would leave less than half of its bits. */
enum {
    TRACE_PAD = 9,
    TRACE_STRETCH_FAST = 8,
    TRACE_PAD_FAST = TRACE_PAD + 48 * TRACE_STRETCH_FAST,
    TRACE_FAR_FAST = 1 << 12,
    TRACE_FAR = 1 << 13 /* half extents of the scene, for boxes where double decides: trace_far.c */
};

/* Readies a ray for a tree of that reach: scales `dir`, which the caller has scaled by `outer`
 * already. `pad` is one of the above. False if `dir` is zero or not finite; then *out is garbage.
 */
bool trace_ray_init(const double org[3], const double dir[3], double outer, double reach,
                    double pad, struct trace_ray *out);

#endif
