/* The trees of an accel as bytes, and back: written by the worker's cache, read from a disk that
 * may have changed them. Owns the layout of the saved form; every reference is checked before a ray
 * can follow it. No state, any thread. */
#include <string.h>

#include "worker/render/accel_parts.h"

/* Raised with every change of what bvh.h lays out or the builder means by it. */
enum { TREES_LAYOUT = 1 };

struct saved_head {
    char magic[8];
    uint32_t layout, unit_bytes, node_bytes, leaf_bytes;
    uint64_t triangle_count, mesh_count, object_count;
    uint64_t pad[2];
};

/* One for the scene's tree and one for each mesh; their arenas follow in the same order. */
struct saved_tree {
    uint64_t bytes, node_count, leaf_count, depth_max;
    double reach, sah_cost;
    float lo[3], hi[3], edge_unit;
    uint32_t root, measured, pad;
};

_Static_assert(sizeof(struct saved_head) == 64 && sizeof(struct saved_tree) == 88, "no padding");

static const char magic[8] = {'T', 'L', 'Y', 'T', 'R', 'E', 'E', 'S'};

static struct saved_head head_of(const struct accel *a)
{
    struct saved_head head = {.layout = TREES_LAYOUT,
                              .unit_bytes = BVH_UNIT_BYTES,
                              .node_bytes = sizeof(struct bvh_node),
                              .leaf_bytes = sizeof(struct bvh_leaf),
                              .triangle_count = a->stats.triangle_count,
                              .mesh_count = a->mesh_count,
                              .object_count = a->object_count};
    memcpy(head.magic, magic, sizeof magic);
    return head;
}

bool accel_is_restored(const struct accel *a)
{
    return a->restored;
}

enum err accel_trees_key(const struct accel_input *input, const struct accel_options *options,
                         digest *out)
{
    struct digest_ctx c;
    const uint32_t what[] = {TREES_LAYOUT, (uint32_t)options->builder, (uint32_t)input->mesh_count,
                             (uint32_t)input->object_count};
    TL_TRY(digest_begin(&c));
    digest_add(&c, what, sizeof what);
    for (size_t i = 0; i < input->mesh_count; i++) {
        const struct accel_mesh *m = &input->meshes[i];
        digest_add(&c, &m->vertex_count, sizeof m->vertex_count);
        digest_add(&c, &m->triangle_count, sizeof m->triangle_count);
        digest_add(&c, m->positions, (size_t)m->vertex_count * 3 * sizeof *m->positions);
        digest_add(&c, m->indices, (size_t)m->triangle_count * 3 * sizeof *m->indices);
    }
    for (size_t i = 0; i < input->object_count; i++) {
        const struct accel_object *o = &input->objects[i];
        uint32_t words[] = {(uint32_t)o->type, o->mesh};
        digest_add(&c, words, sizeof words);
        digest_add(&c, o->center, sizeof o->center);
        digest_add(&c, &o->radius, sizeof o->radius);
        digest_add(&c, o->to_scene, sizeof o->to_scene);
        digest_add(&c, o->from_scene, sizeof o->from_scene);
    }
    *out = digest_end(&c);
    return ERR_OK;
}

/* --- Saving -------------------------------------------------------------- */

static unsigned char *put(unsigned char *out, const void *data, size_t bytes)
{
    if (bytes)
        memcpy(out, data, bytes);
    return out + bytes;
}

static unsigned char *save_tree(const struct bvh *b, unsigned char *out)
{
    struct saved_tree s = {.bytes = b->bytes,
                           .node_count = b->node_count,
                           .leaf_count = b->leaf_count,
                           .depth_max = b->depth_max,
                           .reach = b->reach,
                           .sah_cost = b->sah_cost,
                           .edge_unit = b->edge_unit,
                           .root = b->root,
                           .measured = b->measured};
    memcpy(s.lo, b->lo, sizeof s.lo);
    memcpy(s.hi, b->hi, sizeof s.hi);
    return put(out, &s, sizeof s);
}

size_t accel_trees_bytes(const struct accel *a)
{
    size_t bytes = sizeof(struct saved_head) + sizeof(struct saved_tree) + a->scene_tree.bytes;
    for (size_t i = 0; i < a->mesh_count; i++)
        bytes += sizeof(struct saved_tree) + a->mesh_trees[i].bytes;
    return bytes;
}

void accel_trees_save(const struct accel *a, unsigned char *out)
{
    struct saved_head head = head_of(a);
    out = put(out, &head, sizeof head);
    out = save_tree(&a->scene_tree, out);
    for (size_t i = 0; i < a->mesh_count; i++)
        out = save_tree(&a->mesh_trees[i], out);
    out = put(out, a->scene_tree.arena, a->scene_tree.bytes);
    for (size_t i = 0; i < a->mesh_count; i++)
        out = put(out, a->mesh_trees[i].arena, a->mesh_trees[i].bytes);
}

/* --- Checking ------------------------------------------------------------ */

/* A walk over one tree. `nodes_left` and `leaves_left` bound it where references form no tree. */
struct walk {
    const struct accel *accel;
    const struct bvh *tree;
    uint64_t nodes_left, leaves_left;
    uint32_t triangle_count;
    bool in_scene; /* spheres and instances may occur */
};

/* True if `bytes` at the reference's unit lie in the arena. */
static bool in_arena(const struct bvh *b, uint32_t ref, size_t bytes)
{
    size_t at = (size_t)(ref >> BVH_KIND_BITS) * BVH_UNIT_BYTES;
    return at <= b->bytes && bytes <= b->bytes - at;
}

static bool leaf_holds(struct walk *w, uint32_t ref)
{
    if (!in_arena(w->tree, ref, sizeof(struct bvh_leaf)) || w->leaves_left-- == 0)
        return false;
    const struct bvh_leaf *leaf = bvh_leaf_at(w->tree->arena, ref);
    for (int lane = 0; lane < BVH_BLOCK; lane++)
        if ((leaf->id[lane] & (BVH_PRIMITIVES_MAX - 1)) >= w->triangle_count)
            return false;
    return true;
}

static bool object_holds(const struct walk *w, uint32_t ref)
{
    uint32_t object = ref >> BVH_KIND_BITS;
    return w->in_scene && object < w->accel->object_count &&
           w->accel->objects[object].type != ACCEL_TRIANGLES;
}

static bool tree_holds(struct walk *w)
{
    struct {
        uint32_t ref, next;
    } stack[BVH_DEPTH_MAX];
    int top = 0;
    if ((w->tree->root & 3) == BVH_EMPTY)
        return true;
    stack[top].ref = w->tree->root;
    stack[top++].next = 0;
    while (top > 0) {
        uint32_t at = stack[top - 1].ref, slot = stack[top - 1].next++;
        if (slot == 0 && ((at & 3) != BVH_NODE || w->nodes_left-- == 0 ||
                          !in_arena(w->tree, at, sizeof(struct bvh_node))))
            return false;
        if (slot == BVH_WIDTH) {
            top--;
            continue;
        }
        uint32_t child = bvh_node_at(w->tree->arena, at)->child[slot];
        enum bvh_kind kind = (enum bvh_kind)(child & 3);
        if ((kind == BVH_LEAF && !leaf_holds(w, child)) ||
            (kind == BVH_OBJECT && !object_holds(w, child)) ||
            (kind == BVH_NODE && top == BVH_DEPTH_MAX))
            return false;
        if (kind == BVH_NODE) {
            stack[top].ref = child;
            stack[top++].next = 0;
        }
    }
    return true;
}

/* --- Loading ------------------------------------------------------------- */

/* What is left of the saved bytes. */
struct rest {
    const unsigned char *at;
    size_t bytes;
};

/* The next `bytes`, or NULL. */
static const unsigned char *take(struct rest *r, size_t bytes)
{
    const unsigned char *at = r->at;
    if (bytes > r->bytes)
        return NULL;
    r->at += bytes;
    r->bytes -= bytes;
    return at;
}

static enum err load_tree(struct rest *heads, struct rest *arenas, struct walk *w, struct bvh *out)
{
    struct saved_tree s;
    const unsigned char *at = take(heads, sizeof s);
    if (!at)
        return ERR_CORRUPT;
    memcpy(&s, at, sizeof s);
    const unsigned char *arena = take(arenas, s.bytes);
    if (!arena || s.bytes % BVH_UNIT_BYTES || s.depth_max > BVH_DEPTH_MAX)
        return ERR_CORRUPT;
    struct bvh tree = {.bytes = s.bytes,
                       .node_count = s.node_count,
                       .leaf_count = s.leaf_count,
                       .depth_max = s.depth_max,
                       .reach = s.reach,
                       .sah_cost = s.sah_cost,
                       .edge_unit = s.edge_unit,
                       .root = s.root,
                       .measured = s.measured};
    memcpy(tree.lo, s.lo, sizeof s.lo);
    memcpy(tree.hi, s.hi, sizeof s.hi);
    tree.arena = s.bytes ? bvh_alloc(s.bytes / BVH_UNIT_BYTES, BVH_UNIT_BYTES) : NULL;
    if (s.bytes && !tree.arena)
        return ERR_NOMEM;
    if (s.bytes)
        memcpy(tree.arena, arena, s.bytes);
    w->tree = &tree;
    w->nodes_left = s.bytes / sizeof(struct bvh_node);
    w->leaves_left = s.bytes / sizeof(struct bvh_leaf);
    if (!tree_holds(w)) {
        bvh_release(&tree);
        return ERR_CORRUPT;
    }
    *out = tree;
    return ERR_OK;
}

enum err accel_trees_load(struct accel *a, const void *data, size_t bytes)
{
    struct rest heads = {data, bytes};
    struct saved_head expected = head_of(a);
    const unsigned char *head = take(&heads, sizeof expected);
    if (!head || memcmp(head, &expected, sizeof expected) != 0)
        return ERR_CORRUPT;
    struct rest arenas = heads;
    if (a->mesh_count >= heads.bytes / sizeof(struct saved_tree) ||
        !take(&arenas, (a->mesh_count + 1) * sizeof(struct saved_tree)))
        return ERR_CORRUPT;
    struct walk w = {
        .accel = a, .triangle_count = (uint32_t)a->stats.triangle_count, .in_scene = true};
    enum err e = load_tree(&heads, &arenas, &w, &a->scene_tree);
    w.in_scene = false;
    for (size_t i = 0; e == ERR_OK && i < a->mesh_count; i++) {
        w.triangle_count = a->meshes[i].triangle_count;
        e = load_tree(&heads, &arenas, &w, &a->mesh_trees[i]);
    }
    if (e == ERR_OK && arenas.bytes > 0)
        e = ERR_CORRUPT;
    return e;
}
