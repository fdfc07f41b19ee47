/* worker/render/bvh.h: the tree itself, eight children wide, and how it is built.
 *
 * A tree lies in one arena of 32-byte units. A reference (`uint32_t`) is the unit
 * at which a thing starts, shifted left by BVH_KIND_BITS, with its kind below:
 *
 *   BVH_NODE    struct bvh_node, 224 bytes: the boxes of 8 children by axis
 *   BVH_LEAF    struct bvh_leaf, 160 bytes: 4 triangles by vertex, axis and lane; in a compact
 *               tree struct bvh_packed, 64 bytes: their vertices by number
 *   BVH_OBJECT  no unit but the number of a sphere or an instance
 *   BVH_EMPTY   a child slot not in use
 *
 * Boxes hold what they hold exactly (vertices are floats; all else was rounded
 * outward): the error of float traversal is charged to the ray (trace.h). A leaf of
 * fewer than four triangles repeats its last one, which changes no answer.
 *
 * Building: bvh2_build splits references into a binary tree whose leaves are
 * blocks, on any number of threads with the same result; bvh_wide_build turns it
 * into this one by dynamic programming (Ylitie, Karras, Laine, HPG 2017, 3.1). The
 * tree's shape changes no hit. Thread: building uses the runner; read-only after.
 */
#ifndef WORKER_RENDER_BVH_H
#define WORKER_RENDER_BVH_H

#include "common/mem.h"
#include "worker/render/accel.h"

enum {
    BVH_WIDTH = 8,
    BVH_BLOCK = 4,      /* triangles of a leaf */
    BVH_DEPTH_MAX = 64, /* of the binary tree, so of this one too */
    BVH_STACK = (BVH_WIDTH - 1) * BVH_DEPTH_MAX + 1,
    BVH_UNIT_BYTES = 32,
    BVH_KIND_BITS = 2,
    BVH_PRIMITIVES_MAX = 1 << 30,
};

enum bvh_kind { BVH_NODE, BVH_LEAF, BVH_OBJECT, BVH_EMPTY };

struct bvh_node {
    float bounds[6][BVH_WIDTH]; /* rows: x low, x high, y low, y high, z low, z high */
    uint32_t child[BVH_WIDTH];
};

struct bvh_leaf {
    float v[3][3][BVH_BLOCK] __attribute__((aligned(16))); /* vertex, axis, lane */
    uint32_t id[BVH_BLOCK]; /* low 30 bits: triangle; the top bits of all four: edge code */
};

/* A leaf that leaves its vertices in the mesh. */
struct bvh_packed {
    uint32_t vertex[3][BVH_BLOCK];
    uint32_t id[BVH_BLOCK]; /* as in bvh_leaf */
};

_Static_assert(sizeof(struct bvh_packed) == 2 * BVH_UNIT_BYTES, "packed leaf layout");
_Static_assert(sizeof(struct bvh_node) == 7 * BVH_UNIT_BYTES, "node layout");
_Static_assert(sizeof(struct bvh_leaf) == 5 * BVH_UNIT_BYTES, "leaf layout");

/* What is built over. `primitive` is a triangle's number within the tree, or with
 * BVH_REF_OBJECT set the number of a sphere or an instance. `owner` is for the
 * caller's vertex callback. */
struct bvh_ref {
    float lo[3];
    uint32_t primitive;
    float hi[3];
    uint32_t owner;
};
#define BVH_REF_OBJECT UINT32_C(0x80000000)

struct bvh {
    unsigned char *arena; /* owned */
    size_t bytes;
    uint32_t root;          /* BVH_EMPTY kind when there is nothing */
    float lo[3], hi[3];     /* of everything */
    double reach;           /* largest |coordinate| of lo and hi */
    bool measured;          /* lo, hi and reach are set */
    float edge_unit;        /* the edge code's unit; see trace.h */
    bool compact;           /* leaves are packed ones */
    const float *positions; /* compact: the vertices of its only mesh; NULL: look at the object */
    uint64_t node_count, leaf_count, depth_max;
    double sah_cost, sah_binary; /* half areas of nodes and leaves over the root's */
};

/* Where leaves get their triangles from. */
struct bvh_source {
    /* The nine coordinates, [vertex][axis]; the fourth of each may be anything. */
    void (*vertices)(void *ctx, const struct bvh_ref *ref, float out[3][4]);
    /* The numbers of the vertices in their mesh. */
    void (*indices)(void *ctx, const struct bvh_ref *ref, uint32_t out[3]);
    /* Asks for the memory that `vertices` is going to read. */
    void (*ask)(void *ctx, const struct bvh_ref *ref);
    void *ctx;
};

/* References are not more than so many and one in BVH_SPATIAL_MORE by splits of space. */
enum { BVH_SPATIAL_MORE = 1 };

/* How to build. The tree depends on `median`, `spatial` and `compact` alone. */
struct bvh_how {
    bool median;  /* split at the object median of the longest axis, else by the surface
                     area heuristic */
    bool spatial; /* split space too, and triangles with it (bvh_spatial.h); not for a place */
    bool compact; /* pack leaves */
    enum accel_isa isa; /* the widest to be used */
    float edge;         /* the largest extent of a triangle along any axis */
    const struct accel_runner *runner;
    struct bvh_place *place; /* where the tree is put (bvh_place.h); NULL: an arena of its own */
};

/* Builds over refs[0..count), as bvh2_build takes them. ERR_NOMEM; ERR_LIMIT: over
 * BVH_PRIMITIVES_MAX or too large for the arena's references, or too deep for a place. */
TL_NODISCARD enum err bvh_new(struct bvh_ref *refs, size_t count, const struct bvh_how *how,
                              const struct bvh_source *source, struct bvh *out);
void bvh_release(struct bvh *b);

/* --- The binary tree between the two steps ------------------------------- */

struct bvh2_node {
    float lo[3];
    uint32_t left; /* a leaf: its first reference, with BVH2_LEAF set */
    float hi[3];
    uint32_t right; /* a leaf: how many, 1..BVH_BLOCK */
};
#define BVH2_LEAF UINT32_C(0x80000000)

/* The binary tree. Nodes lie in runs, children behind their parents within a run; the
 * run of the top comes first and its leaves are the roots of the others. */
struct bvh2 {
    struct bvh2_node *nodes;
    struct bvh2_run {
        uint32_t begin, end;
        double area; /* half areas of its nodes, once they are chosen from */
    } * runs;
    size_t run_count, node_limit;
    struct bvh_ref *refs; /* reordered */
    uint32_t ref_count;   /* with room for pieces */
    struct bvh_ref *spare;
};

/* Takes refs[0..count), count > 0, allocated by bvh_alloc; frees them whatever happens or
 * hands them on in out->refs. `source` gives the triangles that space splits. */
TL_NODISCARD enum err bvh2_build(struct bvh_ref *refs, uint32_t count, const struct bvh_how *how,
                                 const struct bvh_source *source, struct bvh2 *out);
void bvh2_release(struct bvh2 *b);

/* Memory for the tables of a tree: big ones in huge pages. */
static inline void *bvh_alloc(size_t count, size_t bytes)
{
    size_t total;
    if (__builtin_mul_overflow(count, bytes, &total))
        return NULL;
    return mem_alloc_aligned(total, total >= 4 * (size_t)MEM_HUGE_PAGE ? MEM_HUGE_PAGE : 64);
}

/* Runs fn over 0..count-1, on the runner's threads where there is one. */
static inline void bvh_run(const struct accel_runner *runner, size_t count,
                           void (*fn)(void *arg, size_t index), void *arg)
{
    if (runner && runner->thread_count > 1 && count > 1) {
        runner->run(runner->ctx, count, fn, arg);
        return;
    }
    for (size_t i = 0; i < count; i++)
        fn(arg, i);
}

static inline const void *bvh_at(const unsigned char *arena, uint32_t ref)
{
    const uint32_t kind = (1 << BVH_KIND_BITS) - 1;
    return arena + (size_t)(ref & ~kind) * (BVH_UNIT_BYTES >> BVH_KIND_BITS);
}

static inline const struct bvh_node *bvh_node_at(const unsigned char *arena, uint32_t ref)
{
    return (const struct bvh_node *)bvh_at(arena, ref);
}

static inline const struct bvh_leaf *bvh_leaf_at(const unsigned char *arena, uint32_t ref)
{
    return (const struct bvh_leaf *)bvh_at(arena, ref);
}

static inline const struct bvh_packed *bvh_packed_at(const unsigned char *arena, uint32_t ref)
{
    return (const struct bvh_packed *)bvh_at(arena, ref);
}

#endif
