/* The kernel without SIMD: the plainest walk, which the others are measured against.
 * It also serves what they leave out: no tree, Moeller-Trumbore, negative tmin. */
#include "worker/render/accel_parts.h"

#include "worker/render/trace_exact.h"

struct walk {
    const struct accel *accel;
    double tmin;
    bool any; /* stop at the first hit */
};

static bool triangle_hit(const struct walk *w, const struct trace_ray *ray, const float v[3][3],
                         double *t)
{
    struct exact_edges edges;
    double b1, b2;
    if (w->accel->options.intersector == JOB_INTERSECTOR_MOLLER_TRUMBORE)
        return exact_moller_trumbore(ray, v, t, &b1, &b2);
    return exact_woop(ray, v, &edges, t);
}

static void offer_triangle(const struct walk *w, const struct trace_ray *ray, const float v[3][3],
                           uint32_t object, uint32_t primitive, struct trace_best *best)
{
    double t;
    if (triangle_hit(w, ray, v, &t))
        accel_offer(w->accel, t, w->tmin, object, primitive, NULL, 0, best);
}

static void offer_leaf(const struct walk *w, const struct trace_ray *ray,
                       const struct bvh_leaf *leaf, uint32_t object, struct trace_best *best)
{
    for (int lane = 0; lane < BVH_BLOCK; lane++) {
        float v[3][3];
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++)
                v[i][k] = leaf->v[i][k][lane];
        offer_triangle(w, ray, v, object, leaf->id[lane] & (BVH_PRIMITIVES_MAX - 1), best);
    }
}

/* One slab after the other; an operand that is not a number is ignored. */
static bool box_hit(const struct trace_ray *ray, const struct bvh_node *node, int slot, float from,
                    float to, float *entry)
{
    for (int k = 0; k < 3; k++) {
        uint32_t row = ray->row[k] / TRACE_ROW;
        float near = node->bounds[row][slot] * ray->inverse[k] - ray->near_offset[k];
        float far = node->bounds[row ^ 1][slot] * ray->inverse[k] - ray->far_offset[k];
        from = near > from ? near : from;
        to = far < to ? far : to;
    }
    *entry = from;
    return !(from > to);
}

/* The nearest floats around a double. */
static float round_up(double x)
{
    float f = (float)x;
    return (double)f < x ? f + __builtin_fabsf(f) * 0x1p-23f + 0x1p-149f : f;
}

struct entry {
    uint32_t ref;
    float near;
};

/* Pushes the children that the ray meets, the nearest last. */
static int push_children(const struct trace_ray *ray, const struct bvh_node *node, float from,
                         float to, struct entry *stack, int top)
{
    int bottom = top;
    for (int slot = 0; slot < BVH_WIDTH; slot++) {
        float near;
        if ((node->child[slot] & 3) == BVH_EMPTY || !box_hit(ray, node, slot, from, to, &near))
            continue;
        int at = top++;
        for (; at > bottom && stack[at - 1].near < near; at--)
            stack[at] = stack[at - 1];
        stack[at] = (struct entry){node->child[slot], near};
    }
    return top;
}

static void offer_object(const struct walk *w, const struct trace_ray *ray, uint32_t object,
                         struct trace_best *best);

static void walk_tree(const struct walk *w, const struct bvh *tree, const struct trace_ray *ray,
                      uint32_t object, struct trace_best *best)
{
    struct entry stack[BVH_STACK];
    struct bvh_leaf room;
    int top = 0;
    float from = -round_up(-w->tmin);
    stack[top++] = (struct entry){tree->root, from};
    while (top > 0 && !(w->any && best->found)) {
        struct entry e = stack[--top];
        float to = round_up(best->t);
        if (e.near > to)
            continue;
        switch ((enum bvh_kind)(e.ref & 3)) {
        case BVH_NODE:
            top = push_children(ray, bvh_node_at(tree->arena, e.ref), from, to, stack, top);
            break;
        case BVH_LEAF:
            offer_leaf(w, ray, accel_leaf(w->accel, tree, e.ref, &room), object, best);
            break;
        case BVH_OBJECT:
            offer_object(w, ray, e.ref >> BVH_KIND_BITS, best);
            break;
        case BVH_EMPTY:
            break;
        }
    }
}

static void offer_mesh(const struct walk *w, const struct trace_ray *ray,
                       const struct accel_mesh *mesh, uint32_t object, struct trace_best *best)
{
    for (uint32_t i = 0; i < mesh->triangle_count; i++) {
        float v[3][3];
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++)
                v[j][k] = mesh->positions[3 * (size_t)mesh->indices[3 * (size_t)i + (size_t)j] +
                                          (size_t)k];
        offer_triangle(w, ray, v, object, i, best);
        if (w->any && best->found)
            return;
    }
}

static void offer_instance(const struct walk *w, const struct trace_ray *ray, uint32_t number,
                           struct trace_best *best)
{
    const struct accel *a = w->accel;
    struct trace_ray inner;
    double rescale;
    if (!accel_instance_ray(a, number, ray, &inner, &rescale))
        return;
    uint32_t mesh = a->objects[number].mesh;
    struct walk in = {a, w->tmin / rescale, w->any};
    struct trace_best moved = *best;
    moved.t /= rescale;
    if (a->options.builder == JOB_BUILDER_NONE)
        offer_mesh(&in, &inner, &a->meshes[mesh], number, &moved);
    else
        walk_tree(&in, &a->mesh_trees[mesh], &inner, number, &moved);
    moved.t *= rescale;
    if (moved.found && (!best->found || moved.object != best->object ||
                        moved.primitive != best->primitive || moved.t != best->t))
        *best = moved;
}

/* An object with a tree of its own in the scene's arena. */
static void offer_lazy(const struct walk *w, const struct trace_ray *ray, uint32_t number,
                       struct trace_best *best)
{
    struct bvh tree = w->accel->scene_tree;
    tree.root = accel_lazy_root(w->accel, number);
    if (tree.root == ACCEL_UNBUILT)
        tree.root = accel_lazy_build(w->accel, number);
    walk_tree(w, &tree, ray, SCENE_NONE, best);
}

static void offer_object(const struct walk *w, const struct trace_ray *ray, uint32_t number,
                         struct trace_best *best)
{
    const struct accel_object *o = &w->accel->objects[number];
    double t;
    if (o->type == ACCEL_TRIANGLES)
        offer_lazy(w, ray, number, best);
    else if (o->type == ACCEL_INSTANCE)
        offer_instance(w, ray, number, best);
    else if (exact_sphere(ray, o->center, o->radius, w->tmin,
                          best->found ? __builtin_inf() : best->t, &t))
        accel_offer(w->accel, t, w->tmin, number, 0, NULL, 0, best);
}

/* Every primitive of the scene in order. */
static void walk_all(const struct walk *w, const struct trace_ray *ray, struct trace_best *best)
{
    const struct accel *a = w->accel;
    for (uint32_t i = 0; i < a->object_count && !(w->any && best->found); i++) {
        if (a->objects[i].type == ACCEL_TRIANGLES)
            offer_mesh(w, ray, &a->meshes[a->objects[i].mesh], i, best);
        else
            offer_object(w, ray, i, best);
    }
}

static bool walk_scene(const struct accel *a, const struct ray *ray, bool any,
                       struct trace_ray *ready, struct trace_best *best)
{
    struct walk w = {a, 0.0, any};
    *best = (struct trace_best){.object = SCENE_NONE, .primitive = SCENE_NONE};
    if (!accel_ray(a, ray, ready, &w.tmin, &best->t))
        return false;
    if (a->options.builder == JOB_BUILDER_NONE)
        walk_all(&w, ready, best);
    else
        walk_tree(&w, &a->scene_tree, ready, SCENE_NONE, best);
    return best->found;
}

static void plain_closest(const struct accel *a, const struct ray *ray, struct hit *out)
{
    struct trace_ray ready;
    struct trace_best best;
    if (walk_scene(a, ray, false, &ready, &best))
        accel_hit(a, &ready, &best, out);
    else
        out->object = SCENE_NONE;
}

static bool plain_occluded(const struct accel *a, const struct ray *ray)
{
    struct trace_ray ready;
    struct trace_best best;
    return walk_scene(a, ray, true, &ready, &best);
}

static void plain_closest_batch(const struct accel *a, const struct ray *rays,
                                const uint8_t *active, size_t count, struct hit *hits)
{
    for (size_t i = 0; i < count; i++)
        if (!active || active[i])
            plain_closest(a, &rays[i], &hits[i]);
}

static void plain_occluded_batch(const struct accel *a, const struct ray *rays,
                                 const uint8_t *active, size_t count, uint8_t *occluded)
{
    for (size_t i = 0; i < count; i++)
        if (!active || active[i])
            occluded[i] = plain_occluded(a, &rays[i]);
}

const struct trace_kernel trace_plain = {
    "plain", plain_closest, plain_occluded, plain_closest_batch, plain_occluded_batch, NULL,
};
