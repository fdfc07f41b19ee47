/* The trees of an accel as bytes, and back: written by the worker's cache, read from a disk that
 * may have changed them. Owns the layout of the saved form; every reference is checked before a ray
 * can follow it. No state, any thread. */
#include <string.h>

#include "worker/render/accel_parts.h"

/* Raised with every change of what bvh.h lays out or the builder means by it. */
enum { TREES_LAYOUT = 3, ARENA_ALIGN = 64 };

struct saved_head {
    char magic[8];
    uint32_t layout, unit_bytes, node_bytes, leaf_bytes;
    uint64_t triangle_count, mesh_count, object_count;
    uint64_t pad[2];
};

/* One for the scene's tree and one for each mesh; their arenas follow in the same order, the first
 * at a multiple of ARENA_ALIGN. */
struct saved_tree {
    uint64_t bytes, node_count, leaf_count, depth_max;
    double reach, sah_cost;
    float lo[3], hi[3], edge_unit;
    uint32_t root, measured, pad;
};

_Static_assert(sizeof(struct saved_head) == 64 && sizeof(struct saved_tree) == 88, "no padding");

static const char magic[8] = {'T', 'L', 'Y', 'T', 'R', 'E', 'E', 'S'};

static size_t leaf_bytes(const struct accel *a)
{
    return a->options.compact ? sizeof(struct bvh_packed) : sizeof(struct bvh_leaf);
}

static struct saved_head head_of(const struct accel *a)
{
    struct saved_head head = {.layout = TREES_LAYOUT,
                              .unit_bytes = BVH_UNIT_BYTES,
                              .node_bytes = sizeof(struct bvh_node),
                              .leaf_bytes = (uint32_t)leaf_bytes(a),
                              .triangle_count = a->stats.triangle_count,
                              .mesh_count = a->mesh_count,
                              .object_count = a->object_count};
    memcpy(head.magic, magic, sizeof magic);
    return head;
}

bool accel_is_restored(const struct accel *a)
{
    return a->saved != NULL;
}

void accel_trees_forget(struct accel *a)
{
    a->scene_tree = (struct bvh){.root = BVH_EMPTY};
    for (size_t i = 0; i < a->mesh_count; i++)
        a->mesh_trees[i] = (struct bvh){.root = BVH_EMPTY};
}

/* --- The key ------------------------------------------------------------- */

/* Runs of bytes, each with a digest of its own, so that threads share the work. */
struct hashing {
    struct hash_run {
        const void *data;
        size_t bytes;
    } * runs;
    digest *digests;
    size_t count, capacity;
};

enum { HASH_RUN_BYTES = 1 << 20 };

static enum err add_runs(struct hashing *h, const void *data, size_t bytes)
{
    const unsigned char *at = data;
    while (bytes > 0) {
        size_t some = bytes < HASH_RUN_BYTES ? bytes : HASH_RUN_BYTES;
        if (!mem_grow((void **)&h->runs, h->count, &h->capacity, sizeof *h->runs))
            return ERR_NOMEM;
        h->runs[h->count++] = (struct hash_run){at, some};
        at += some;
        bytes -= some;
    }
    return ERR_OK;
}

static void hash_run(void *arg, size_t index)
{
    const struct hashing *h = arg;
    h->digests[index] = digest_of(h->runs[index].data, h->runs[index].bytes);
}

static enum err hash_meshes(const struct accel_input *input, const struct accel_runner *runner,
                            struct hashing *h)
{
    for (size_t i = 0; i < input->mesh_count; i++) {
        const struct accel_mesh *m = &input->meshes[i];
        TL_TRY(add_runs(h, m->positions, (size_t)m->vertex_count * 3 * sizeof *m->positions));
        TL_TRY(add_runs(h, m->indices, (size_t)m->triangle_count * 3 * sizeof *m->indices));
    }
    h->digests = mem_alloc_array(h->count, sizeof *h->digests);
    if (!h->digests)
        return ERR_NOMEM;
    bvh_run(runner, h->count, hash_run, h);
    return ERR_OK;
}

static void add_object(struct digest_ctx *c, const struct accel_object *o)
{
    uint32_t words[] = {(uint32_t)o->type, o->mesh};
    digest_add(c, words, sizeof words);
    digest_add(c, o->center, sizeof o->center);
    digest_add(c, &o->radius, sizeof o->radius);
    digest_add(c, o->to_scene, sizeof o->to_scene);
    digest_add(c, o->from_scene, sizeof o->from_scene);
}

static enum err hash_all(const struct accel_input *input, const struct accel_options *options,
                         const struct hashing *h, digest *out)
{
    struct digest_ctx c;
    const uint32_t what[] = {TREES_LAYOUT, (uint32_t)options->builder, options->compact,
                             (uint32_t)input->mesh_count, (uint32_t)input->object_count};
    TL_TRY(digest_begin(&c));
    digest_add(&c, what, sizeof what);
    for (size_t i = 0; i < input->mesh_count; i++) { /* the counts say where runs belong */
        digest_add(&c, &input->meshes[i].vertex_count, sizeof input->meshes[i].vertex_count);
        digest_add(&c, &input->meshes[i].triangle_count, sizeof input->meshes[i].triangle_count);
    }
    digest_add(&c, h->digests, h->count * sizeof *h->digests);
    for (size_t i = 0; i < input->object_count; i++)
        add_object(&c, &input->objects[i]);
    *out = digest_end(&c);
    return ERR_OK;
}

enum err accel_trees_key(const struct accel_input *input, const struct accel_options *options,
                         const struct accel_runner *runner, digest *out)
{
    struct hashing h = {0};
    enum err e = hash_meshes(input, runner, &h);
    if (e == ERR_OK)
        e = hash_all(input, options, &h, out);
    mem_free(h.runs);
    mem_free(h.digests);
    return e;
}

/* --- Saving -------------------------------------------------------------- */

/* The part of the saved bytes that is asked for. */
struct window {
    size_t from, to;
    unsigned char *out; /* where `from` goes */
    size_t at;          /* of what is put next */
};

/* Copies what of the next `bytes` lies in the window; `data` NULL: zeros. */
static void put(struct window *w, const void *data, size_t bytes)
{
    size_t begin = w->at > w->from ? w->at : w->from;
    size_t end = w->at + bytes < w->to ? w->at + bytes : w->to;
    if (begin < end && data)
        memcpy(w->out + (begin - w->from), (const unsigned char *)data + (begin - w->at),
               end - begin);
    else if (begin < end)
        memset(w->out + (begin - w->from), 0, end - begin);
    w->at += bytes;
}

static void put_tree(struct window *w, const struct bvh *b)
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
    put(w, &s, sizeof s);
}

/* Of all heads, up to the first arena. */
static size_t heads_bytes(const struct accel *a)
{
    size_t bytes = sizeof(struct saved_head) + (a->mesh_count + 1) * sizeof(struct saved_tree);
    return (bytes + ARENA_ALIGN - 1) / ARENA_ALIGN * ARENA_ALIGN;
}

size_t accel_trees_bytes(const struct accel *a)
{
    size_t bytes = heads_bytes(a) + a->scene_tree.bytes;
    for (size_t i = 0; i < a->mesh_count; i++)
        bytes += a->mesh_trees[i].bytes;
    return bytes;
}

void accel_trees_copy(const struct accel *a, size_t from, size_t bytes, unsigned char *out)
{
    struct saved_head head = head_of(a);
    struct window w = {.from = from, .to = from + bytes, .out = out};
    size_t arenas_at = heads_bytes(a);
    put(&w, &head, sizeof head);
    if (from < arenas_at) {
        put_tree(&w, &a->scene_tree);
        for (size_t i = 0; i < a->mesh_count && w.at < w.to; i++)
            put_tree(&w, &a->mesh_trees[i]);
    }
    if (w.at < w.to && w.at < arenas_at)
        put(&w, NULL, arenas_at - w.at);
    w.at = arenas_at;
    put(&w, a->scene_tree.arena, a->scene_tree.bytes);
    for (size_t i = 0; i < a->mesh_count && w.at < w.to; i++)
        put(&w, a->mesh_trees[i].arena, a->mesh_trees[i].bytes);
}

/* --- Checking ------------------------------------------------------------ */

/* A walk over one tree, or a part of it. `nodes_left` and `leaves_left` bound it where references
 * form no tree. */
struct walk {
    const struct accel *accel;
    const struct bvh *tree;
    uint64_t nodes_left, leaves_left;
    uint32_t triangle_count, mesh;
    bool in_scene; /* spheres and instances may occur; else the tree is that of a mesh */
};

/* True if `bytes` at the reference's unit lie in the arena. */
static bool in_arena(const struct bvh *b, uint32_t ref, size_t bytes)
{
    size_t at = (size_t)(ref >> BVH_KIND_BITS) * BVH_UNIT_BYTES;
    return at <= b->bytes && bytes <= b->bytes - at;
}

/* The mesh of a triangle that the tree may hold; NULL: it may not. */
static const struct accel_mesh *triangle_mesh(const struct walk *w, uint32_t id)
{
    uint32_t number = id & (BVH_PRIMITIVES_MAX - 1);
    if (number >= w->triangle_count)
        return NULL;
    if (!w->in_scene)
        return &w->accel->meshes[w->mesh];
    return &w->accel->meshes[w->accel->objects[accel_triangle_object(w->accel, number)].mesh];
}

static bool packed_holds(const struct walk *w, const struct bvh_packed *leaf)
{
    for (int lane = 0; lane < BVH_BLOCK; lane++) {
        const struct accel_mesh *mesh = triangle_mesh(w, leaf->id[lane]);
        for (int i = 0; i < 3; i++)
            if (!mesh || leaf->vertex[i][lane] >= mesh->vertex_count)
                return false;
    }
    return true;
}

static bool leaf_holds(struct walk *w, uint32_t ref)
{
    if (!in_arena(w->tree, ref, leaf_bytes(w->accel)) || w->leaves_left-- == 0)
        return false;
    if (w->tree->compact)
        return packed_holds(w, bvh_packed_at(w->tree->arena, ref));
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

static bool node_holds(struct walk *w, uint32_t ref)
{
    return (ref & 3) == BVH_NODE && in_arena(w->tree, ref, sizeof(struct bvh_node)) &&
           w->nodes_left-- > 0;
}

static bool child_holds(struct walk *w, uint32_t child)
{
    switch ((enum bvh_kind)(child & 3)) {
    case BVH_NODE:
        return true; /* looked at in its turn */
    case BVH_LEAF:
        return leaf_holds(w, child);
    case BVH_OBJECT:
        return object_holds(w, child);
    case BVH_EMPTY:
        return true;
    }
    return false;
}

/* What is below `root`, which is `depth` nodes deep itself. */
static bool below_holds(struct walk *w, uint32_t root, uint32_t depth)
{
    struct {
        uint32_t ref, next;
    } stack[BVH_DEPTH_MAX];
    uint32_t top = 0;
    stack[top].ref = root;
    stack[top++].next = 0;
    while (top > 0) {
        uint32_t at = stack[top - 1].ref, slot = stack[top - 1].next++;
        if (slot == 0 && !node_holds(w, at))
            return false;
        if (slot == BVH_WIDTH) {
            top--;
            continue;
        }
        uint32_t child = bvh_node_at(w->tree->arena, at)->child[slot];
        if (!child_holds(w, child))
            return false;
        if ((child & 3) != BVH_NODE)
            continue;
        if (depth + top > BVH_DEPTH_MAX - 1)
            return false;
        stack[top].ref = child;
        stack[top++].next = 0;
    }
    return true;
}

enum { PARTS_MIN = 64, PARTS_MAX = PARTS_MIN + BVH_WIDTH };

/* Parts of a tree, each walked on its own, with bounds of its own. */
struct parts {
    struct walk walk; /* each part's begins as this */
    struct part {
        uint32_t ref, depth;
        bool holds;
    } parts[PARTS_MAX];
    size_t count;
};

static void walk_part(void *arg, size_t index)
{
    struct parts *p = arg;
    struct walk w = p->walk;
    p->parts[index].holds = below_holds(&w, p->parts[index].ref, p->parts[index].depth);
}

/* Cuts a tree into parts, from the root down; false if a node on the way does not hold. */
static bool cut(struct parts *p, uint32_t root)
{
    struct walk w = p->walk;
    size_t next = 0;
    p->parts[p->count++] = (struct part){.ref = root};
    for (size_t steps = 0; next < p->count && p->count < PARTS_MIN && steps < PARTS_MIN; steps++) {
        struct part at = p->parts[next];
        if (!node_holds(&w, at.ref) || at.depth >= BVH_DEPTH_MAX - 1)
            return false;
        p->parts[next] = p->parts[--p->count];
        for (uint32_t slot = 0; slot < BVH_WIDTH; slot++) {
            uint32_t child = bvh_node_at(w.tree->arena, at.ref)->child[slot];
            if (!child_holds(&w, child))
                return false;
            if ((child & 3) == BVH_NODE)
                p->parts[p->count++] = (struct part){.ref = child, .depth = at.depth + 1};
        }
        next = p->count > 0 ? (next + 1) % p->count : 0;
    }
    return true;
}

/* A tree of less is walked at once. */
enum { PARTS_BYTES_MIN = 1 << 20 };

static bool tree_holds(struct walk *w, const struct accel_runner *runner)
{
    if ((w->tree->root & 3) == BVH_EMPTY)
        return true;
    if (w->tree->bytes < PARTS_BYTES_MIN)
        return below_holds(w, w->tree->root, 0);
    struct parts p = {.walk = *w};
    if (!cut(&p, w->tree->root))
        return false;
    bvh_run(runner, p.count, walk_part, &p);
    bool holds = true;
    for (size_t i = 0; i < p.count; i++)
        holds &= p.parts[i].holds;
    return holds;
}

/* --- Loading ------------------------------------------------------------- */

/* What is left of the saved bytes. */
struct rest {
    unsigned char *at;
    size_t bytes;
};

/* The next `bytes`, or NULL. */
static unsigned char *take(struct rest *r, size_t bytes)
{
    unsigned char *at = r->at;
    if (bytes > r->bytes)
        return NULL;
    r->at += bytes;
    r->bytes -= bytes;
    return at;
}

static enum err load_tree(struct rest *heads, struct rest *arenas, struct walk *w,
                          const struct accel_runner *runner, struct bvh *out)
{
    struct saved_tree s;
    const unsigned char *at = take(heads, sizeof s);
    if (!at)
        return ERR_CORRUPT;
    memcpy(&s, at, sizeof s);
    unsigned char *arena = take(arenas, s.bytes);
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
                       .measured = s.measured,
                       .compact = w->accel->options.compact};
    memcpy(tree.lo, s.lo, sizeof s.lo);
    memcpy(tree.hi, s.hi, sizeof s.hi);
    tree.arena = s.bytes ? arena : NULL;
    w->tree = &tree;
    w->nodes_left = s.bytes / sizeof(struct bvh_node);
    w->leaves_left = s.bytes / leaf_bytes(w->accel);
    if (!tree_holds(w, runner))
        return ERR_CORRUPT;
    *out = tree;
    return ERR_OK;
}

enum err accel_trees_load(struct accel *a, void *data, size_t bytes,
                          const struct accel_runner *runner)
{
    struct rest heads = {data, bytes}, arenas = heads;
    struct saved_head expected = head_of(a);
    if (a->mesh_count >= bytes / sizeof(struct saved_tree) || !take(&arenas, heads_bytes(a)))
        return ERR_CORRUPT;
    if (memcmp(take(&heads, sizeof expected), &expected, sizeof expected) != 0)
        return ERR_CORRUPT;
    struct walk w = {
        .accel = a, .triangle_count = (uint32_t)a->stats.triangle_count, .in_scene = true};
    enum err e = load_tree(&heads, &arenas, &w, runner, &a->scene_tree);
    w.in_scene = false;
    for (size_t i = 0; e == ERR_OK && i < a->mesh_count; i++) {
        w.triangle_count = a->meshes[i].triangle_count;
        w.mesh = (uint32_t)i;
        e = load_tree(&heads, &arenas, &w, runner, &a->mesh_trees[i]);
    }
    if (e == ERR_OK && arenas.bytes > 0)
        e = ERR_CORRUPT;
    return e;
}
