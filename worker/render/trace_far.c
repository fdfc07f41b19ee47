/* Rays from so far away that float would leave nothing of where they pass: boxes in double.
 *
 * The pad of float's boxes is 9 u R and would meet every box from 10^6 scene sizes away. Here it is
 * what a hit may lie beside its triangle, and the kernels' order of things is kept: boxes decide
 * nothing but which triangles are tested. The bits are those of trace_exact.h. Scenes of triangles
 * alone (accel.far_slack says so): what objects of other kinds add to the pad is derived for float.
 * Pure; any thread. Bounds: docs/TRACING.md. Tests: test_accel.
 */
#include "worker/render/accel_parts.h"

#include "worker/render/trace_exact.h"

/* t = plane * inverse - offset, with the signs of the pad as the direction's. */
struct far_slabs {
    double inverse[3], near_offset[3], far_offset[3];
    uint32_t row[3]; /* of bvh_node.bounds; the far planes' is row ^ 1 */
};

static void slabs_init(struct far_slabs *s, const struct trace_ray *r)
{
    const double smallest = 0x1p-80; /* a smaller component moves no ray out of a padded slab */
    double pad = 4.0 * r->slack;
    for (int k = 0; k < 3; k++) {
        double size = exact_max(exact_abs(r->dir[k]), smallest);
        bool back = r->row[k] / TRACE_ROW % 2;
        double sign = back ? -1.0 : 1.0;
        s->inverse[k] = sign / size;
        s->near_offset[k] = (r->org[k] + sign * pad) * s->inverse[k];
        s->far_offset[k] = (r->org[k] - sign * pad) * s->inverse[k];
        s->row[k] = r->row[k] / TRACE_ROW;
    }
}

/* Where the ray enters and leaves the children; what is not a number is ignored. */
static void node_meet(const struct bvh_node *node, const struct far_slabs *s, double from,
                      double to, double enter[BVH_WIDTH], double leave[BVH_WIDTH])
{
    for (int i = 0; i < BVH_WIDTH; i++) {
        enter[i] = from;
        leave[i] = to;
    }
    for (int k = 0; k < 3; k++) {
        const float *near = node->bounds[s->row[k]], *far = node->bounds[s->row[k] ^ 1];
        double inverse = s->inverse[k], first = s->near_offset[k], last = s->far_offset[k];
        for (int i = 0; i < BVH_WIDTH; i++) {
            double in = (double)near[i] * inverse - first, out = (double)far[i] * inverse - last;
            enter[i] = in > enter[i] ? in : enter[i];
            leave[i] = out < leave[i] ? out : leave[i];
        }
    }
}

struct entry {
    double near;
    uint32_t ref;
};

/* Pushes the children that the ray meets, the nearest last. */
static int push_children(const struct bvh_node *node, const struct far_slabs *s, double from,
                         double to, struct entry *stack, int top)
{
    double enter[BVH_WIDTH], leave[BVH_WIDTH];
    int bottom = top;
    node_meet(node, s, from, to, enter, leave);
    for (int i = 0; i < BVH_WIDTH; i++) {
        if ((node->child[i] & 3) == BVH_EMPTY || enter[i] > leave[i])
            continue;
        int at = top++;
        for (; at > bottom && stack[at - 1].near < enter[i]; at--)
            stack[at] = stack[at - 1];
        stack[at] = (struct entry){enter[i], node->child[i]};
    }
    return top;
}

/* The lanes whose edge functions, as exact_woop has them, are not of both signs. */
static unsigned leaf_unmixed(const struct trace_ray *r, const struct bvh_leaf *leaf)
{
    double x[3][BVH_BLOCK], y[3][BVH_BLOCK];
    int64_t mixed[BVH_BLOCK];
    for (int i = 0; i < 3; i++) {
        const float *vx = leaf->v[i][r->axis[0]], *vy = leaf->v[i][r->axis[1]];
        const float *vz = leaf->v[i][r->axis[2]];
        for (int l = 0; l < BVH_BLOCK; l++) {
            double z = (double)vz[l] - r->porg[2];
            x[i][l] = ((double)vx[l] - r->porg[0]) - r->shear[0] * z;
            y[i][l] = ((double)vy[l] - r->porg[1]) - r->shear[1] * z;
        }
    }
    for (int l = 0; l < BVH_BLOCK; l++) {
        double u = x[2][l] * y[1][l] - y[2][l] * x[1][l];
        double v = x[0][l] * y[2][l] - y[0][l] * x[2][l];
        double w = x[1][l] * y[0][l] - y[1][l] * x[0][l];
        double least = exact_min(exact_min(u, v), w), most = exact_max(exact_max(u, v), w);
        mixed[l] = (least < 0.0) & (most > 0.0);
    }
    unsigned unmixed = 0;
    for (int l = 0; l < BVH_BLOCK; l++)
        unmixed |= (unsigned)(mixed[l] ^ 1) << l;
    return unmixed;
}

static void offer_leaf(const struct accel *a, const struct trace_ray *r,
                       const struct bvh_leaf *leaf, double tmin, struct trace_best *best)
{
    for (unsigned lanes = leaf_unmixed(r, leaf); lanes; lanes &= lanes - 1) {
        int lane = __builtin_ctz(lanes);
        struct exact_edges edges;
        float v[3][3];
        double t;
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++)
                v[i][k] = leaf->v[i][k][lane];
        uint32_t primitive = leaf->id[lane] & (BVH_PRIMITIVES_MAX - 1);
        if (exact_woop(r, v, &edges, &t))
            accel_offer(a, t, tmin, SCENE_NONE, primitive, NULL, 0, best);
    }
}

/* The tree of an object that may wait for its first ray. */
static uint32_t object_root(const struct accel *a, uint32_t number)
{
    uint32_t root = accel_lazy_root(a, number);
    return root == ACCEL_UNBUILT ? accel_lazy_build(a, number) : root;
}

/* Finds the nearest hit before best->t, or with `any` one. */
static void walk(const struct accel *a, const struct trace_ray *r, double tmin, bool any,
                 struct trace_best *best)
{
    struct entry stack[BVH_STACK];
    struct far_slabs slabs;
    struct bvh_leaf room;
    int top = 0;
    slabs_init(&slabs, r);
    stack[top++] = (struct entry){tmin, a->scene_tree.root};
    while (top > 0 && !(any && best->found)) {
        struct entry e = stack[--top];
        if (e.near > best->t)
            continue;
        switch ((enum bvh_kind)(e.ref & 3)) {
        case BVH_NODE:
            top = push_children(bvh_node_at(a->scene_tree.arena, e.ref), &slabs, tmin, best->t,
                                stack, top);
            break;
        case BVH_LEAF:
            offer_leaf(a, r, accel_leaf(a, &a->scene_tree, e.ref, &room), tmin, best);
            break;
        case BVH_OBJECT:
            stack[top++] = (struct entry){e.near, object_root(a, e.ref >> BVH_KIND_BITS)};
            break;
        case BVH_EMPTY:
            break;
        }
    }
}

void trace_far_closest(const struct accel *a, const struct ray *ray, struct hit *out)
{
    struct trace_ray ready;
    struct trace_best best = {.object = SCENE_NONE, .primitive = SCENE_NONE};
    double tmin;
    if (accel_ray(a, ray, &ready, &tmin, &best.t))
        walk(a, &ready, tmin, false, &best);
    if (best.found)
        accel_hit(a, &ready, &best, out);
    else
        out->object = SCENE_NONE;
}

bool trace_far_occluded(const struct accel *a, const struct ray *ray)
{
    struct trace_ray ready;
    struct trace_best best = {.object = SCENE_NONE, .primitive = SCENE_NONE};
    double tmin;
    if (accel_ray(a, ray, &ready, &tmin, &best.t))
        walk(a, &ready, tmin, true, &best);
    return best.found;
}
