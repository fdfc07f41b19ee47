/* worker/render/bvh_parts.h: what the files that build the binary tree share.
 *
 * bvh_build.c cuts the work into pieces; bvh_split.h, compiled once per instruction
 * set, does the pieces' inner loops. All give the same tree, bit for bit.
 *
 * A box is eight floats in the order of a bvh_ref with the upper side negated, so that
 * one minimum grows both sides: x, y, z low, junk, -x, -y, -z high, junk. The bounds of
 * centres (doubled) have the same form. Thread: the caller's; no state.
 */
#ifndef WORKER_RENDER_BVH_PARTS_H
#define WORKER_RENDER_BVH_PARTS_H

#include "worker/render/bvh.h"

enum {
    BVH_BINS_MAX = 32,
    BVH_BIN_SHIFT = 7,
    BVH_BIN_AXES = 4, /* x, y, z, size */
    BVH_SIZE_AXIS = 3,
};

/* What is known of a range of references. */
struct bvh_extent {
    float box[8], centre[8];
    float area_limit; /* no reference has a greater half area */
};

struct bvh_range {
    uint32_t begin, end, limit; /* end <= limit: room for pieces of triangles */
    uint32_t depth;
    bool in_spare;  /* which of the two arrays holds it */
    uint32_t *link; /* where the parent wants the node's number; NULL for a root */
    struct bvh_extent extent;
};

/* How a range is binned. */
struct bvh_grid {
    float low[4], scale[4];
    float last;        /* bins - 1 */
    uint32_t size_top; /* size key of the last bin */
    int bins, axes;
};

/* All axes of a bin lie together: one offset finds them, and their counts. */
struct bvh_bins {
    struct bvh_bin {
        float box[3][8];   /* by x, y, z */
        uint32_t count[4]; /* by x, y, z, size */
        uint32_t unused[4];
    } bin[BVH_BINS_MAX] __attribute__((aligned(128)));
    float sized[BVH_BINS_MAX][8]; /* boxes by size, where the grid has that axis */
};
_Static_assert(sizeof(struct bvh_bin) == 128, "a bin's offset is its number shifted");

struct bvh_cut {
    float cost;
    int axis, border; /* bins below border go left; axis -1: none found */
};

struct bvh_builder {
    struct bvh2 *out;
    const struct accel_runner *runner;
    const struct bvh_splitter *splitter;
    bool median;
    const struct bvh_source *source; /* space is split too (bvh_spatial.h); NULL: it is not */
    float overlap_min;
};

/* What a range was split into. The left half begins where the range did. */
struct bvh_halves {
    uint32_t left_end, right_begin, right_end;
    bool in_spare;
    struct bvh_extent half[2];
};

/* Where one piece of a range goes: references of bins below the border to left_at and up,
 * the others to right_at and up; and the bounds of both sides' centres. */
struct bvh_scatter {
    uint32_t left_at, right_at;
    float centre[2][8]; /* left, right: out */
};

/* The inner loops, one set per instruction set. */
struct bvh_splitter {
    /* Everything about refs[0..count). */
    void (*measure)(const struct bvh_ref *refs, uint32_t count, struct bvh_extent *out);
    /* The greatest half area. */
    float (*area_max)(const struct bvh_ref *refs, uint32_t count);
    /* Is it worth it to bin by size, as far as area_limit tells? */
    bool (*sizes_matter)(const struct bvh_extent *e, uint32_t count);
    void (*grid_init)(const struct bvh_extent *e, uint32_t count, bool sized, struct bvh_grid *out);
    void (*bins_fill)(const struct bvh_grid *g, const struct bvh_ref *refs, uint32_t count,
                      struct bvh_bins *out);
    void (*bins_merge)(const struct bvh_grid *g, const struct bvh_bins *other,
                       struct bvh_bins *bins);
    /* The cheapest border, and the boxes of both sides if there is one. */
    struct bvh_cut (*bins_cut)(const struct bvh_grid *g, const struct bvh_bins *bins,
                               struct bvh_extent *left, struct bvh_extent *right);
    void (*scatter)(const struct bvh_grid *g, const struct bvh_cut *cut, const struct bvh_ref *from,
                    uint32_t count, struct bvh_ref *to, struct bvh_scatter *s);
    /* Builds a subtree into the nodes from `next` on; returns the end of what it used. */
    uint32_t (*subtree)(const struct bvh_builder *b, const struct bvh_range *root, uint32_t next);
};

extern const struct bvh_splitter bvh_split_sse2, bvh_split_avx2;

/* --- What bvh_build.c gives the splitters ---------------------------------- */

/* What is left of the depth must suffice for halving. */
bool bvh_must_halve(const struct bvh_builder *b, const struct bvh_range *r);

/* Halves at the object median of the longest axis, in place; returns the border. */
uint32_t bvh_split_median(struct bvh_ref *refs, const struct bvh_range *r);

static inline struct bvh_ref *bvh_range_refs(const struct bvh_builder *b, const struct bvh_range *r)
{
    return r->in_spare ? b->out->spare : b->out->refs;
}

static inline struct bvh_ref *bvh_range_other(const struct bvh_builder *b,
                                              const struct bvh_range *r)
{
    return r->in_spare ? b->out->refs : b->out->spare;
}

static inline void bvh_node_write(struct bvh2_node *node, const struct bvh_extent *e)
{
    for (int k = 0; k < 3; k++) {
        node->lo[k] = e->box[k];
        node->hi[k] = -e->box[4 + k];
    }
}

/* Places halves of so many references in the other array; what room is left is shared. */
static inline void bvh_halves_place(const struct bvh_range *r, uint32_t left, uint32_t right,
                                    struct bvh_halves *out)
{
    uint64_t spare = r->limit - r->begin - left - right;
    out->left_end = r->begin + left;
    out->right_begin = out->left_end + (uint32_t)(spare * left / ((uint64_t)left + right));
    out->right_end = out->right_begin + right;
    out->in_spare = !r->in_spare;
}

/* Halves that stay where they are; the right one gets all the room. */
static inline void bvh_halves_stay(const struct bvh_range *r, uint32_t middle,
                                   struct bvh_halves *out)
{
    out->left_end = out->right_begin = middle;
    out->right_end = r->end;
    out->in_spare = r->in_spare;
}

/* Pushes the halves of a split range, the left one on top. */
static inline void bvh_push_halves(struct bvh_range *stack, int *top, const struct bvh_range *r,
                                   const struct bvh_halves *h, struct bvh2_node *node)
{
    uint32_t depth = r->depth + 1;
    stack[(*top)++] = (struct bvh_range){h->right_begin, h->right_end, r->limit,  depth,
                                         h->in_spare,    &node->right, h->half[1]};
    stack[(*top)++] = (struct bvh_range){r->begin,    h->left_end, h->right_begin, depth,
                                         h->in_spare, &node->left, h->half[0]};
}

#endif
