/* The binary tree: binned SAH or object median, depth bounded. */
#include "worker/render/bvh.h"

#include <string.h>

enum { BINS = 16 };

struct box {
    float lo[3], hi[3];
};

struct range {
    uint32_t begin, end, depth;
    uint32_t parent; /* whose right child this is, or UINT32_MAX */
};

static const struct box box_empty = {{__FLT_MAX__, __FLT_MAX__, __FLT_MAX__},
                                     {-__FLT_MAX__, -__FLT_MAX__, -__FLT_MAX__}};

static void box_grow(struct box *b, const float lo[3], const float hi[3])
{
    for (int k = 0; k < 3; k++) {
        b->lo[k] = lo[k] < b->lo[k] ? lo[k] : b->lo[k];
        b->hi[k] = hi[k] > b->hi[k] ? hi[k] : b->hi[k];
    }
}

static float box_half_area(const struct box *b)
{
    float x = b->hi[0] - b->lo[0], y = b->hi[1] - b->lo[1], z = b->hi[2] - b->lo[2];
    return x * y + (y * z + z * x);
}

/* Twice the centre, halved first so that it cannot overflow. */
static float ref_centre(const struct bvh_ref *r, int k)
{
    return 0.5f * r->lo[k] + 0.5f * r->hi[k];
}

static uint32_t blocks(uint32_t count)
{
    return (count + BVH_BLOCK - 1) / BVH_BLOCK;
}

static uint32_t ceil_log2(uint32_t n)
{
    return n <= 1 ? 0 : 32 - (uint32_t)__builtin_clz(n - 1);
}

/* A leaf holds triangles of one block, or one object. */
static bool is_leaf(const struct bvh_ref *refs, const struct range *r)
{
    if (r->end - r->begin > BVH_BLOCK)
        return false;
    for (uint32_t i = r->begin; i < r->end; i++)
        if (refs[i].primitive & BVH_REF_OBJECT)
            return r->end - r->begin == 1;
    return true;
}

/* Orders by centre, then by primitive, so that equal centres split by index. */
static bool ref_less(const struct bvh_ref *a, const struct bvh_ref *b, int axis)
{
    float ca = ref_centre(a, axis), cb = ref_centre(b, axis);
    return ca < cb || (ca == cb && a->primitive < b->primitive);
}

/* A position in [begin, end) that no input can foresee to its profit, yet always the same. */
static uint32_t scattered(uint32_t begin, uint32_t end, uint32_t salt)
{
    uint64_t hash = ((uint64_t)begin << 32 | end) * UINT64_C(0x9e3779b97f4a7c15) + salt;
    hash = (hash ^ hash >> 29) * UINT64_C(0xbf58476d1ce4e5b9);
    return begin + (uint32_t)((hash >> 32) * (end - begin) >> 32);
}

static struct bvh_ref median_of_three(const struct bvh_ref *a, const struct bvh_ref *b,
                                      const struct bvh_ref *c, int axis)
{
    if (ref_less(b, a, axis)) {
        const struct bvh_ref *swap = a;
        a = b;
        b = swap;
    }
    return ref_less(c, a, axis) ? *a : ref_less(c, b, axis) ? *c : *b;
}

/* Hoare's selection: refs[nth] comes to its sorted place. */
static void select_nth(struct bvh_ref *refs, uint32_t begin, uint32_t end, uint32_t nth, int axis)
{
    while (end - begin > 1) {
        uint32_t last = end - 1;
        struct bvh_ref pivot =
            median_of_three(&refs[scattered(begin, last, 1)], &refs[scattered(begin, last, 2)],
                            &refs[scattered(begin, last, 3)], axis);
        uint32_t i = begin, j = last;
        for (;; i++, j--) {
            while (ref_less(&refs[i], &pivot, axis))
                i++;
            while (ref_less(&pivot, &refs[j], axis))
                j--;
            if (i >= j)
                break;
            struct bvh_ref swap = refs[i];
            refs[i] = refs[j];
            refs[j] = swap;
        }
        /* The pivot was not the last one, so both sides are smaller than the whole. */
        if (nth <= j)
            end = j + 1;
        else
            begin = j + 1;
    }
}

static uint32_t split_median(struct bvh_ref *refs, const struct range *r, const struct box *centres)
{
    int axis = 0;
    for (int k = 1; k < 3; k++)
        if (centres->hi[k] - centres->lo[k] > centres->hi[axis] - centres->lo[axis])
            axis = k;
    uint32_t middle = r->begin + (r->end - r->begin) / 2;
    select_nth(refs, r->begin, r->end, middle, axis);
    return middle;
}

struct bins {
    struct box box[BINS];
    uint32_t count[BINS];
};

static int bin_of(const struct bvh_ref *ref, int axis, float low, float scale)
{
    int bin = (int)((ref_centre(ref, axis) - low) * scale);
    return bin < BINS ? bin : BINS - 1;
}

/* The cheapest border between bins; cost in half areas times blocks. */
static float bins_sweep(const struct bins *b, int *border)
{
    float right_cost[BINS], best = __FLT_MAX__;
    struct box box = box_empty;
    uint32_t count = 0;
    for (int i = BINS - 1; i > 0; i--) {
        box_grow(&box, b->box[i].lo, b->box[i].hi);
        count += b->count[i];
        right_cost[i] = count ? box_half_area(&box) * (float)blocks(count) : -1.0f;
    }
    box = box_empty;
    count = 0;
    for (int i = 1; i < BINS; i++) {
        box_grow(&box, b->box[i - 1].lo, b->box[i - 1].hi);
        count += b->count[i - 1];
        if (!count || right_cost[i] < 0.0f)
            continue;
        float cost = box_half_area(&box) * (float)blocks(count) + right_cost[i];
        if (cost < best) {
            best = cost;
            *border = i;
        }
    }
    return best;
}

static uint32_t split_sah(struct bvh_ref *refs, const struct range *r, const struct box *centres)
{
    int axis = -1, border = 0;
    float best = __FLT_MAX__;
    for (int k = 0; k < 3; k++) {
        float extent = centres->hi[k] - centres->lo[k];
        float scale = (float)BINS * 0.999f / extent;
        if (!(extent > 0.0f) || !(scale < __FLT_MAX__))
            continue;
        struct bins bins;
        for (int i = 0; i < BINS; i++)
            bins.box[i] = box_empty;
        memset(bins.count, 0, sizeof bins.count);
        for (uint32_t i = r->begin; i < r->end; i++) {
            int bin = bin_of(&refs[i], k, centres->lo[k], scale);
            box_grow(&bins.box[bin], refs[i].lo, refs[i].hi);
            bins.count[bin]++;
        }
        int at = 0;
        float cost = bins_sweep(&bins, &at);
        if (cost < best) {
            best = cost;
            axis = k;
            border = at;
        }
    }
    if (axis < 0)
        return split_median(refs, r, centres);
    float scale = (float)BINS * 0.999f / (centres->hi[axis] - centres->lo[axis]);
    uint32_t left = r->begin, right = r->end;
    while (left < right) {
        if (bin_of(&refs[left], axis, centres->lo[axis], scale) < border) {
            left++;
        } else {
            struct bvh_ref swap = refs[left];
            refs[left] = refs[--right];
            refs[right] = swap;
        }
    }
    return left;
}

enum err bvh2_build(struct bvh_ref *refs, uint32_t count, bool median,
                    const struct accel_runner *runner, struct bvh2_node *nodes,
                    uint32_t *node_count)
{
    (void)runner;
    struct range stack[BVH_DEPTH_MAX + 1];
    int top = 0;
    uint32_t used = 0;
    stack[top++] = (struct range){0, count, 0, UINT32_MAX};
    while (top > 0) {
        struct range r = stack[--top];
        uint32_t self = used++;
        if (r.parent != UINT32_MAX)
            nodes[r.parent].first = self;
        struct box box = box_empty, centres = box_empty;
        for (uint32_t i = r.begin; i < r.end; i++) {
            float c[3] = {ref_centre(&refs[i], 0), ref_centre(&refs[i], 1),
                          ref_centre(&refs[i], 2)};
            box_grow(&box, refs[i].lo, refs[i].hi);
            box_grow(&centres, c, c);
        }
        memcpy(nodes[self].lo, box.lo, sizeof box.lo);
        memcpy(nodes[self].hi, box.hi, sizeof box.hi);
        nodes[self].count = 0;
        if (is_leaf(refs, &r)) {
            nodes[self].first = r.begin;
            nodes[self].count = r.end - r.begin;
            continue;
        }
        /* What is left of the depth must suffice for halving. */
        bool halve = median || BVH_DEPTH_MAX - r.depth <= ceil_log2(r.end - r.begin) + 1;
        uint32_t middle = halve ? split_median(refs, &r, &centres) : split_sah(refs, &r, &centres);
        stack[top++] = (struct range){middle, r.end, r.depth + 1, self};
        stack[top++] = (struct range){r.begin, middle, r.depth + 1, UINT32_MAX};
    }
    *node_count = used;
    return ERR_OK;
}
