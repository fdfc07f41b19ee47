/* worker/render/bvh_split.h: bins, sweeps and partitions of the binary tree's builder.
 *
 * Included by one .c file per instruction set, which defines BVH_SPLITTER. Written in
 * f8, a box of bvh_parts.h in one register or two: the same operations in the same order
 * everywhere, so the same tree. Pure; any thread.
 *
 * Binning by size, beside x, y and z, is what keeps a few huge triangles among many
 * small ones from spoiling the top of the tree: they are split off as a group when
 * that is the cheapest cut.
 */
#ifndef WORKER_RENDER_BVH_SPLIT_H
#define WORKER_RENDER_BVH_SPLIT_H

#include "worker/render/bvh_spatial.h"

#include <immintrin.h>
#include <string.h>

#define ALWAYS_INLINE static inline __attribute__((always_inline))

enum { SIZE_RANGE_MIN = 64 /* a smaller range is not split by size */ };

typedef __m128 f4;

#ifdef __AVX2__

typedef __m256 f8;

static inline f8 f8_load(const float p[8])
{
    return _mm256_loadu_ps(p);
}
static inline void f8_store(float p[8], f8 a)
{
    _mm256_storeu_ps(p, a);
}
/* a < b ? a : b: an `a` that is not a number gives b. */
static inline f8 f8_min(f8 a, f8 b)
{
    return _mm256_min_ps(a, b);
}
static inline f8 f8_of(f4 low, f4 high)
{
    return _mm256_insertf128_ps(_mm256_castps128_ps256(low), high, 1);
}
static inline f4 f8_low(f8 a)
{
    return _mm256_castps256_ps128(a);
}
static inline f4 f8_high(f8 a)
{
    return _mm256_extractf128_ps(a, 1);
}
static inline f8 f8_and(f8 a, f8 b)
{
    return _mm256_and_ps(a, b);
}
static inline f8 f8_or(f8 a, f8 b)
{
    return _mm256_or_ps(a, b);
}
static inline f8 f8_xor(f8 a, f8 b)
{
    return _mm256_xor_ps(a, b);
}
static inline f8 f8_not(f8 a)
{
    return _mm256_xor_ps(a, _mm256_castsi256_ps(_mm256_set1_epi32(-1)));
}

#else

typedef struct {
    __m128 low, high;
} f8;

static inline f8 f8_load(const float p[8])
{
    return (f8){_mm_loadu_ps(p), _mm_loadu_ps(p + 4)};
}
static inline void f8_store(float p[8], f8 a)
{
    _mm_storeu_ps(p, a.low);
    _mm_storeu_ps(p + 4, a.high);
}
static inline f8 f8_min(f8 a, f8 b)
{
    return (f8){_mm_min_ps(a.low, b.low), _mm_min_ps(a.high, b.high)};
}
static inline f8 f8_of(f4 low, f4 high)
{
    return (f8){low, high};
}
static inline f4 f8_low(f8 a)
{
    return a.low;
}
static inline f4 f8_high(f8 a)
{
    return a.high;
}
static inline f8 f8_and(f8 a, f8 b)
{
    return (f8){_mm_and_ps(a.low, b.low), _mm_and_ps(a.high, b.high)};
}
static inline f8 f8_or(f8 a, f8 b)
{
    return (f8){_mm_or_ps(a.low, b.low), _mm_or_ps(a.high, b.high)};
}
static inline f8 f8_xor(f8 a, f8 b)
{
    return (f8){_mm_xor_ps(a.low, b.low), _mm_xor_ps(a.high, b.high)};
}
static inline f8 f8_not(f8 a)
{
    __m128 all = _mm_castsi128_ps(_mm_set1_epi32(-1));
    return (f8){_mm_xor_ps(a.low, all), _mm_xor_ps(a.high, all)};
}

#endif

/* --- Boxes ------------------------------------------------------------------ */

static inline f4 negate(f4 a)
{
    return _mm_xor_ps(a, _mm_set1_ps(-0.0f));
}

static inline f8 box_empty(void)
{
    return f8_of(_mm_set1_ps(__FLT_MAX__), _mm_set1_ps(__FLT_MAX__));
}

/* Without the numbers beside the box: as floats they are subnormal, and what those are added to or
 * multiplied by takes some CPUs (Zen 5) a hundred cycles. */
static inline f8 box_of(const struct bvh_ref *r)
{
    const f4 sign = _mm_set1_ps(-0.0f);
    const f4 keep = _mm_castsi128_ps(_mm_setr_epi32(-1, -1, -1, 0));
    const void *whole = r; /* eight lanes: corners, and the numbers beside them */
    f8 box = f8_and(f8_load(whole), f8_of(keep, keep));
    return f8_xor(box, f8_of(_mm_setzero_ps(), sign));
}

/* Minus the extents. */
static inline f4 box_size(f8 box)
{
    return _mm_add_ps(f8_low(box), f8_high(box));
}

/* Twice the centre. */
static inline f4 box_centre(f8 box)
{
    return _mm_sub_ps(f8_low(box), f8_high(box));
}

static inline float half_area(f8 box)
{
    f4 d = box_size(box);
    f4 e = _mm_mul_ps(d, _mm_shuffle_ps(d, d, _MM_SHUFFLE(3, 0, 2, 1)));
    f4 s = _mm_add_ss(e, _mm_shuffle_ps(e, e, _MM_SHUFFLE(1, 1, 1, 1)));
    return _mm_cvtss_f32(_mm_add_ss(s, _mm_shuffle_ps(e, e, _MM_SHUFFLE(2, 2, 2, 2))));
}

/* Of four boxes at once. */
static inline f4 half_areas(const f8 box[4])
{
    f4 x = box_size(box[0]), y = box_size(box[1]), z = box_size(box[2]), w = box_size(box[3]);
    _MM_TRANSPOSE4_PS(x, y, z, w);
    return _mm_add_ps(_mm_add_ps(_mm_mul_ps(x, y), _mm_mul_ps(y, z)), _mm_mul_ps(z, x));
}

static float area_max(const struct bvh_ref *refs, uint32_t count)
{
    float most = 0.0f;
    for (uint32_t i = 0; i < count; i++) {
        float area = half_area(box_of(&refs[i]));
        most = area > most ? area : most;
    }
    return most;
}

static void measure(const struct bvh_ref *refs, uint32_t count, struct bvh_extent *out)
{
    f8 box = box_empty(), centre = box_empty();
    for (uint32_t i = 0; i < count; i++) {
        f8 own = box_of(&refs[i]);
        f4 c = box_centre(own);
        box = f8_min(box, own);
        centre = f8_min(centre, f8_of(c, negate(c)));
    }
    f8_store(out->box, box);
    f8_store(out->centre, centre);
    out->area_limit = half_area(box);
}

/* --- Bins ------------------------------------------------------------------- */

/* Half octaves of area. */
static inline uint32_t size_key(float area)
{
    uint32_t bits;
    memcpy(&bits, &area, sizeof bits);
    return bits >> 22;
}

static inline int size_bin(const struct bvh_grid *g, float area)
{
    int below = (int)g->size_top - (int)size_key(area);
    int bin = g->bins - 1 - below;
    return bin < 0 ? 0 : bin >= g->bins ? g->bins - 1 : bin;
}

struct bin_scale {
    f4 low, scale, last;
};

static inline struct bin_scale bin_scale_of(const struct bvh_grid *g)
{
    return (struct bin_scale){_mm_loadu_ps(g->low), _mm_loadu_ps(g->scale), _mm_set1_ps(g->last)};
}

/* What is not a number goes last. */
static inline __m128i bin_of(f4 centre, const struct bin_scale *by)
{
    f4 at = _mm_mul_ps(_mm_sub_ps(centre, by->low), by->scale);
    return _mm_cvttps_epi32(_mm_max_ps(_mm_min_ps(at, by->last), _mm_setzero_ps()));
}

static inline void bins_put(struct bvh_bins *b, int axis, int offset, f8 box)
{
    struct bvh_bin *bin = (struct bvh_bin *)((char *)b->bin + offset);
    f8_store(bin->box[axis], f8_min(box, f8_load(bin->box[axis])));
    bin->count[axis]++;
}

ALWAYS_INLINE void bins_add(struct bvh_bins *b, const struct bvh_grid *g,
                            const struct bin_scale *by, bool sized, const struct bvh_ref *ref)
{
    f8 box = box_of(ref);
    __m128i offset = _mm_slli_epi32(bin_of(box_centre(box), by), BVH_BIN_SHIFT);
    bins_put(b, 0, _mm_extract_epi16(offset, 0), box);
    bins_put(b, 1, _mm_extract_epi16(offset, 2), box);
    bins_put(b, 2, _mm_extract_epi16(offset, 4), box);
    if (sized) {
        int bin = size_bin(g, half_area(box));
        f8_store(b->sized[bin], f8_min(box, f8_load(b->sized[bin])));
        b->bin[bin].count[BVH_SIZE_AXIS]++;
    }
}

/* Two references at a time from far apart, since neighbours wait for each other's bin. */
ALWAYS_INLINE void bins_fill_as(const struct bvh_grid *g, const struct bvh_ref *refs,
                                uint32_t count, bool sized, struct bvh_bins *out)
{
    struct bin_scale by = bin_scale_of(g);
    const struct bvh_ref *middle = refs + count / 2;
    for (int i = 0; i < g->bins; i++) {
        for (int axis = 0; axis < 3; axis++)
            f8_store(out->bin[i].box[axis], box_empty());
        f8_store(out->sized[i], box_empty());
        _mm_storeu_si128((__m128i *)out->bin[i].count, _mm_setzero_si128());
    }
    for (const struct bvh_ref *a = refs, *b = middle; a < middle; a++, b++) {
        bins_add(out, g, &by, sized, a);
        bins_add(out, g, &by, sized, b);
    }
    if (count & 1)
        bins_add(out, g, &by, sized, &refs[count - 1]);
}

static void bins_fill(const struct bvh_grid *g, const struct bvh_ref *refs, uint32_t count,
                      struct bvh_bins *out)
{
    if (g->axes > BVH_SIZE_AXIS)
        bins_fill_as(g, refs, count, true, out);
    else
        bins_fill_as(g, refs, count, false, out);
}

/* The box of a bin by any of the axes. */
static inline const float *bin_box(const struct bvh_bins *b, int axis, int bin)
{
    return axis == BVH_SIZE_AXIS ? b->sized[bin] : b->bin[bin].box[axis];
}

static void bins_merge(const struct bvh_grid *g, const struct bvh_bins *other,
                       struct bvh_bins *bins)
{
    for (int i = 0; i < g->bins; i++) {
        for (int axis = 0; axis < BVH_BIN_AXES; axis++)
            bins->bin[i].count[axis] += other->bin[i].count[axis];
        for (int axis = 0; axis < 3; axis++) {
            float *at = bins->bin[i].box[axis];
            f8_store(at, f8_min(f8_load(other->bin[i].box[axis]), f8_load(at)));
        }
        f8_store(bins->sized[i], f8_min(f8_load(other->sized[i]), f8_load(bins->sized[i])));
    }
}

/* --- The sweep ---------------------------------------------------------------- */

/* What lies on one side of a border, by axis. */
struct side {
    f8 box[BVH_BIN_AXES];
    __m128i count;
};

static inline struct side side_empty(void)
{
    struct side s;
    for (int axis = 0; axis < BVH_BIN_AXES; axis++)
        s.box[axis] = box_empty();
    s.count = _mm_setzero_si128();
    return s;
}

ALWAYS_INLINE void side_add(struct side *s, const struct bvh_bins *b, bool sized, int bin)
{
    for (int axis = 0; axis < 3; axis++)
        s->box[axis] = f8_min(s->box[axis], f8_load(b->bin[bin].box[axis]));
    if (sized)
        s->box[BVH_SIZE_AXIS] = f8_min(s->box[BVH_SIZE_AXIS], f8_load(b->sized[bin]));
    s->count = _mm_add_epi32(s->count, _mm_loadu_si128((const __m128i *)b->bin[bin].count));
}

/* Half areas times blocks; not a number where there is nothing. */
static inline f4 side_cost(const struct side *s)
{
    __m128i blocks = _mm_srli_epi32(_mm_add_epi32(s->count, _mm_set1_epi32(BVH_BLOCK - 1)), 2);
    _Static_assert(BVH_BLOCK == 4, "blocks by a shift");
    return _mm_mul_ps(half_areas(s->box), _mm_cvtepi32_ps(blocks));
}

/* The boxes of both sides of a cut. */
static inline void cut_boxes(const struct bvh_grid *g, const struct bvh_bins *b,
                             const struct bvh_cut *cut, struct bvh_extent *left,
                             struct bvh_extent *right)
{
    f8 box[2] = {box_empty(), box_empty()};
    for (int i = 0; i < cut->border; i++)
        box[0] = f8_min(box[0], f8_load(bin_box(b, cut->axis, i)));
    for (int i = cut->border; i < g->bins; i++)
        box[1] = f8_min(box[1], f8_load(bin_box(b, cut->axis, i)));
    f8_store(left->box, box[0]);
    f8_store(right->box, box[1]);
}

/* All axes in one go. Of equal costs the lowest axis, and then the lowest border, is taken. */
ALWAYS_INLINE struct bvh_cut sweep_as(const struct bvh_grid *g, const struct bvh_bins *b,
                                      bool sized)
{
    f4 right_cost[BVH_BINS_MAX], best = _mm_set1_ps(__FLT_MAX__);
    __m128i border = _mm_setzero_si128();
    struct side side = side_empty();
    for (int i = g->bins - 1; i > 0; i--) {
        side_add(&side, b, sized, i);
        right_cost[i] = side_cost(&side);
    }
    side = side_empty();
    for (int i = 1; i < g->bins; i++) {
        side_add(&side, b, sized, i - 1);
        f4 cost = _mm_add_ps(side_cost(&side), right_cost[i]);
        __m128i less = _mm_castps_si128(_mm_cmplt_ps(cost, best));
        best = _mm_min_ps(cost, best);
        border =
            _mm_or_si128(_mm_and_si128(less, _mm_set1_epi32(i)), _mm_andnot_si128(less, border));
    }
    float costs[BVH_BIN_AXES];
    int borders[BVH_BIN_AXES];
    _mm_storeu_ps(costs, best);
    _mm_storeu_si128((__m128i *)borders, border);
    struct bvh_cut cut = {__FLT_MAX__, -1, 0};
    for (int axis = 0; axis < g->axes; axis++)
        if (costs[axis] < cut.cost)
            cut = (struct bvh_cut){costs[axis], axis, borders[axis]};
    return cut;
}

static struct bvh_cut bins_cut(const struct bvh_grid *g, const struct bvh_bins *b,
                               struct bvh_extent *left, struct bvh_extent *right)
{
    struct bvh_cut cut = g->axes > BVH_SIZE_AXIS ? sweep_as(g, b, true) : sweep_as(g, b, false);
    if (cut.axis >= 0)
        cut_boxes(g, b, &cut, left, right);
    return cut;
}

/* --- Partition ---------------------------------------------------------------- */

/* One lane in all four. */
static inline f4 lane_in_all(f4 a, int lane)
{
#ifdef __AVX2__
    return _mm_permutevar_ps(a, _mm_set1_epi32(lane));
#else
    return _mm_castsi128_ps(_mm_set1_epi32(0 - (_mm_movemask_ps(a) >> lane & 1)));
#endif
}

/* All bits set if the reference goes left, with bins as bins_add has them. */
ALWAYS_INLINE f4 goes_left(const struct bvh_grid *g, const struct bin_scale *by,
                           const struct bvh_cut *cut, bool sized, f8 box, f4 centre)
{
    if (sized)
        return _mm_castsi128_ps(_mm_set1_epi32(size_bin(g, half_area(box)) < cut->border ? -1 : 0));
    __m128i left = _mm_cmpgt_epi32(_mm_set1_epi32(cut->border), bin_of(centre, by));
    return lane_in_all(_mm_castsi128_ps(left), cut->axis);
}

/* `down`: what goes right is put downwards. */
ALWAYS_INLINE void scatter_as(const struct bvh_grid *g, const struct bvh_cut *pcut, bool sized,
                              bool down, const struct bvh_ref *from, uint32_t count,
                              struct bvh_ref *to, struct bvh_scatter *s)
{
    const struct bin_scale by = bin_scale_of(g);
    const struct bvh_cut cut = *pcut;
    f8 left = box_empty(), right = box_empty();
    struct bvh_ref *left_at = &to[s->left_at], *right_at = &to[s->right_at];
    for (const struct bvh_ref *end = from + count; from < end; from++) {
        f8 box = box_of(from);
        f4 c = box_centre(box), is_left = goes_left(g, &by, &cut, sized, box, c);
        size_t step = (size_t)_mm_cvtsi128_si32(_mm_castps_si128(is_left)) & 1;
        f8 centre = f8_of(c, negate(c)), mask = f8_of(is_left, is_left);
        left = f8_min(f8_or(centre, f8_not(mask)), left);
        right = f8_min(f8_or(centre, mask), right);
        struct bvh_ref *at = step ? left_at : right_at;
        f8_store((float *)at, f8_load((const float *)from));
        left_at += step;
        right_at = down ? right_at - 1 + step : right_at + 1 - step;
    }
    s->left_at = (uint32_t)(left_at - to);
    s->right_at = (uint32_t)(right_at - to);
    f8_store(s->centre[0], left);
    f8_store(s->centre[1], right);
}

static void scatter(const struct bvh_grid *g, const struct bvh_cut *cut, const struct bvh_ref *from,
                    uint32_t count, struct bvh_ref *to, struct bvh_scatter *s)
{
    if (cut->axis == BVH_SIZE_AXIS)
        scatter_as(g, cut, true, false, from, count, to, s);
    else
        scatter_as(g, cut, false, false, from, count, to, s);
}

/* --- A subtree ------------------------------------------------------------------ */

static void grid_init(const struct bvh_extent *e, uint32_t count, bool sized, struct bvh_grid *g)
{
    f4 first = _mm_loadu_ps(e->centre);
    f4 extent = negate(_mm_add_ps(first, _mm_loadu_ps(e->centre + 4)));
    f4 used = _mm_and_ps(_mm_cmpgt_ps(extent, _mm_setzero_ps()),
                         _mm_castsi128_ps(_mm_setr_epi32(-1, -1, -1, 0)));
    g->bins = count > 1024 ? BVH_BINS_MAX : count > 32 ? 16 : 8;
    g->last = (float)(g->bins - 1);
    f4 scale = _mm_div_ps(_mm_set1_ps((float)g->bins * 0.9999f), extent);
    _mm_storeu_ps(g->scale, _mm_and_ps(scale, used));
    _mm_storeu_ps(g->low, _mm_and_ps(first, used));
    g->size_top = size_key(e->area_limit);
    g->axes = sized ? BVH_BIN_AXES : BVH_BIN_AXES - 1;
}

/* Sizes are worth a look where one reference takes much of the range's area. */
static bool sizes_matter(const struct bvh_extent *e, uint32_t count)
{
    return count >= SIZE_RANGE_MIN && e->area_limit > 0.03125f * half_area(f8_load(e->box));
}

/* A leaf holds triangles of one block, or one object. */
static bool is_leaf(const struct bvh_ref *refs, const struct bvh_range *r)
{
    if (r->end - r->begin > BVH_BLOCK)
        return false;
    for (uint32_t i = r->begin; i < r->end; i++)
        if (refs[i].primitive & BVH_REF_OBJECT)
            return r->end - r->begin == 1;
    return true;
}

static void split_median(const struct bvh_builder *b, const struct bvh_range *r,
                         struct bvh_halves *out)
{
    struct bvh_ref *refs = bvh_range_refs(b, r);
    uint32_t middle = bvh_split_median(refs, r);
    bvh_halves_stay(r, middle, out);
    measure(&refs[r->begin], middle - r->begin, &out->half[0]);
    measure(&refs[middle], r->end - middle, &out->half[1]);
}

/* Puts a range's references to both sides of a cut. */
static void split_binned(const struct bvh_builder *b, const struct bvh_range *r,
                         const struct bvh_grid *grid, const struct bvh_bins *bins,
                         const struct bvh_cut *cut, struct bvh_halves *out)
{
    const struct bvh_ref *from = &bvh_range_refs(b, r)[r->begin];
    uint32_t count = r->end - r->begin, left = 0;
    for (int i = 0; i < cut->border; i++)
        left += bins->bin[i].count[cut->axis];
    bvh_halves_place(r, left, count - left, out);
    struct bvh_scatter s = {.left_at = r->begin, .right_at = out->right_end - 1};
    if (cut->axis == BVH_SIZE_AXIS)
        scatter_as(grid, cut, true, true, from, count, bvh_range_other(b, r), &s);
    else
        scatter_as(grid, cut, false, true, from, count, bvh_range_other(b, r), &s);
    for (int i = 0; i < 2; i++) {
        memcpy(out->half[i].centre, s.centre[i], sizeof out->half[i].centre);
        out->half[i].area_limit = r->extent.area_limit;
    }
}

/* Splits a range that is no leaf. */
static void split_range(const struct bvh_builder *b, struct bvh_range *r, struct bvh_halves *out)
{
    struct bvh_grid grid;
    struct bvh_bins bins;
    uint32_t count = r->end - r->begin;
    const struct bvh_ref *from = &bvh_range_refs(b, r)[r->begin];
    struct bvh_cut cut = {.axis = -1};
    if (!bvh_must_halve(b, r)) {
        bool sized = sizes_matter(&r->extent, count);
        if (sized) {
            r->extent.area_limit = area_max(from, count);
            sized = sizes_matter(&r->extent, count);
        }
        grid_init(&r->extent, count, sized, &grid);
        bins_fill(&grid, from, count, &bins);
        cut = bins_cut(&grid, &bins, &out->half[0], &out->half[1]);
    }
    if (cut.axis < 0)
        split_median(b, r, out);
    else if (!b->source || !bvh_spatial_worth(b, r, out->half) ||
             !bvh_spatial_split(b, r, cut.cost, out))
        split_binned(b, r, &grid, &bins, &cut, out);
}

static uint32_t subtree(const struct bvh_builder *b, const struct bvh_range *root, uint32_t next)
{
    struct bvh_range stack[BVH_DEPTH_MAX + 2];
    int top = 0;
    stack[top++] = *root;
    while (top > 0) {
        struct bvh_range r = stack[--top];
        struct bvh2_node *node = &b->out->nodes[next];
        const struct bvh_ref *refs = bvh_range_refs(b, &r);
        if (r.link)
            *r.link = next;
        next++;
        bvh_node_write(node, &r.extent);
        if (is_leaf(refs, &r)) {
            node->left = r.begin | BVH2_LEAF;
            node->right = r.end - r.begin;
            if (r.in_spare)
                memcpy(&b->out->refs[r.begin], &refs[r.begin], (r.end - r.begin) * sizeof *refs);
            continue;
        }
        struct bvh_halves halves;
        split_range(b, &r, &halves);
        bvh_push_halves(stack, &top, &r, &halves, node);
    }
    return next;
}

const struct bvh_splitter BVH_SPLITTER = {
    measure, area_max, sizes_matter, grid_init, bins_fill, bins_merge, bins_cut, scatter, subtree,
};

#endif
