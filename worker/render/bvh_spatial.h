/* worker/render/bvh_spatial.h: splits of space, in which a triangle that crosses the plane goes to
 * both sides, each with the box of its own piece (Stich, Friedrich, Dietrich, HPG 2009).
 *
 * A range of references has room for more than it holds; whatever is added is taken from
 * there, and the rest is shared by the halves in proportion, so the tree's references are
 * bounded. The cost is that of the binned splits, blocks times half areas, and a split of
 * space has to beat the best of those. A piece's box holds all of the piece but for
 * roundings of doubles. Spheres and instances are never cut. Scalar, the same everywhere,
 * so the same tree on any CPU and any number of threads. Pure; any thread. Tests:
 * test_accel_split.
 */
#ifndef WORKER_RENDER_BVH_SPATIAL_H
#define WORKER_RENDER_BVH_SPATIAL_H

#include "worker/render/bvh_parts.h"

enum { BVH_SPATIAL_BINS = 16 };

/* Planes at equal distances; a reference is in all bins that its box reaches into. */
struct bvh_spatial_grid {
    float border[3][BVH_SPATIAL_BINS]; /* [i]: between bins i - 1 and i; [0]: the range's low end */
    float scale[3];                    /* 0: the range is too flat along the axis */
};

struct bvh_spatial_bins {
    float box[3][BVH_SPATIAL_BINS][8];
    uint32_t first[3][BVH_SPATIAL_BINS], last[3][BVH_SPATIAL_BINS]; /* references that begin, end */
};

struct bvh_spatial_cut {
    float cost, at; /* the plane */
    int axis;       /* -1: none found */
    int border;
    uint32_t left, right; /* references on both sides */
};

/* Half areas of overlap below this are not worth a look. */
float bvh_spatial_overlap_min(const struct bvh_extent *root);

/* Are there many, is there room, and do the halves of the best binned split overlap enough? */
bool bvh_spatial_worth(const struct bvh_builder *b, const struct bvh_range *r,
                       const struct bvh_extent half[2]);

void bvh_spatial_grid_init(const struct bvh_extent *e, struct bvh_spatial_grid *out);
void bvh_spatial_fill(const struct bvh_builder *b, const struct bvh_spatial_grid *g,
                      const struct bvh_ref *refs, uint32_t count, struct bvh_spatial_bins *out);
void bvh_spatial_merge(const struct bvh_spatial_bins *other, struct bvh_spatial_bins *bins);

/* The cheapest plane that costs less than `cost` and fits into the range's room. */
struct bvh_spatial_cut bvh_spatial_cut(const struct bvh_spatial_grid *g,
                                       const struct bvh_spatial_bins *bins,
                                       const struct bvh_range *r, float cost);

/* Puts references to both sides, from left_at and right_at of *s up, and measures what is there:
 * half[i]'s box and centre. */
void bvh_spatial_scatter(const struct bvh_builder *b, const struct bvh_spatial_cut *cut,
                         const struct bvh_ref *refs, uint32_t count, struct bvh_ref *to,
                         struct bvh_scatter *s, struct bvh_extent half[2]);

/* All of that for a range of few; false if there is no such plane. */
bool bvh_spatial_split(const struct bvh_builder *b, const struct bvh_range *r, float cost,
                       struct bvh_halves *out);

#endif
