/* The binary tree: binned SAH over three axes and size, or object median.
 *
 * The top of the tree is split one node at a time, each pass over its references cut
 * into chunks of a fixed size; what has become small enough is a task of its own. The
 * chunks and tasks depend on the references alone and every merge is exact (minima,
 * maxima, counts), so the tree is the same on any number of threads.
 *
 * Binning by size, beside x, y and z, is what keeps a few huge triangles among many
 * small ones from spoiling the top of the tree: they are split off as a group when
 * that is the cheapest split.
 */
#include "worker/render/bvh.h"

#include <immintrin.h>
#include <string.h>

#include "common/mem.h"

enum {
    AXES = 4, /* x, y, z, size */
    SIZE_AXIS = 3,
    BINS_MAX = 32,
    CHUNK = 16384,       /* references in one piece of a pass */
    TASK_MIN = 4096,     /* a smaller range is not cut into tasks */
    TASKS = 64,          /* about */
    SIZE_RANGE_MIN = 64, /* a smaller range is not split by size */
};

struct box4 {
    _Alignas(32) __m128 lo;
    __m128 hi; /* the fourth lanes hold whatever a reference has there */
};

struct extent {
    struct box4 box, centre; /* centres are doubled */
    float area_max;
};

/* How a range is binned. */
struct grid {
    float low[4], scale[4];
    float last;        /* bins - 1 */
    uint32_t size_top; /* size key of the last bin */
    int bins, axes;
};

struct bins {
    struct box4 box[AXES][BINS_MAX];
    uint32_t count[AXES][BINS_MAX];
};

struct split {
    float cost;
    int axis, border; /* bins below border go left; axis -1: none found */
};

struct range {
    uint32_t begin, end, depth;
    bool in_spare;  /* which of the two arrays holds it */
    uint32_t *link; /* where the parent wants the node's number; NULL for a root */
};

struct build {
    struct bvh2 *out;
    const struct accel_runner *runner;
    bool median;
};

/* --- Boxes ---------------------------------------------------------------- */

static inline struct box4 box4_empty(void)
{
    return (struct box4){_mm_set1_ps(__FLT_MAX__), _mm_set1_ps(-__FLT_MAX__)};
}

static inline void box4_grow(struct box4 *b, __m128 lo, __m128 hi)
{
    b->lo = _mm_min_ps(b->lo, lo);
    b->hi = _mm_max_ps(b->hi, hi);
}

static inline float half_area(__m128 lo, __m128 hi)
{
    __m128 d = _mm_sub_ps(hi, lo);
    __m128 e = _mm_mul_ps(d, _mm_shuffle_ps(d, d, _MM_SHUFFLE(3, 0, 2, 1)));
    __m128 s = _mm_add_ss(e, _mm_shuffle_ps(e, e, _MM_SHUFFLE(1, 1, 1, 1)));
    return _mm_cvtss_f32(_mm_add_ss(s, _mm_shuffle_ps(e, e, _MM_SHUFFLE(2, 2, 2, 2))));
}

static inline uint32_t blocks(uint32_t count)
{
    return (count + BVH_BLOCK - 1) / BVH_BLOCK;
}

static void extent_init(struct extent *e)
{
    e->box = e->centre = box4_empty();
    e->area_max = 0.0f;
}

static void extent_merge(struct extent *e, const struct extent *other)
{
    box4_grow(&e->box, other->box.lo, other->box.hi);
    box4_grow(&e->centre, other->centre.lo, other->centre.hi);
    e->area_max = other->area_max > e->area_max ? other->area_max : e->area_max;
}

static void extent_add(struct extent *e, const struct bvh_ref *refs, uint32_t begin, uint32_t end,
                       bool sized)
{
    struct extent own = *e;
    for (uint32_t i = begin; i < end; i++) {
        __m128 lo = _mm_load_ps(refs[i].lo), hi = _mm_load_ps(refs[i].hi);
        __m128 centre = _mm_add_ps(lo, hi);
        box4_grow(&own.box, lo, hi);
        box4_grow(&own.centre, centre, centre);
        if (sized) {
            float area = half_area(lo, hi);
            own.area_max = area > own.area_max ? area : own.area_max;
        }
    }
    *e = own;
}

/* --- Bins ----------------------------------------------------------------- */

/* Half octaves of area. */
static inline uint32_t size_key(float area)
{
    uint32_t bits;
    memcpy(&bits, &area, sizeof bits);
    return bits >> 22;
}

static inline int size_bin(const struct grid *g, float area)
{
    int below = (int)g->size_top - (int)size_key(area);
    int bin = g->bins - 1 - below;
    return bin < 0 ? 0 : bin >= g->bins ? g->bins - 1 : bin;
}

/* Sizes are worth a look where one reference takes much of the range's area. */
static void grid_init(struct grid *g, const struct extent *e, uint32_t count)
{
    float lo[4], hi[4];
    _mm_storeu_ps(lo, e->centre.lo);
    _mm_storeu_ps(hi, e->centre.hi);
    g->bins = count > 1024 ? 32 : count > 32 ? 16 : 8;
    g->last = (float)(g->bins - 1);
    for (int k = 0; k < 3; k++) {
        float extent = hi[k] - lo[k];
        g->low[k] = lo[k];
        g->scale[k] = extent > 0.0f ? (float)g->bins * 0.9999f / extent : 0.0f;
    }
    g->low[3] = g->scale[3] = 0.0f;
    g->size_top = size_key(e->area_max);
    bool sized =
        count >= SIZE_RANGE_MIN && e->area_max > 0.03125f * half_area(e->box.lo, e->box.hi);
    g->axes = sized ? 4 : 3;
}

static void bins_init(struct bins *b, const struct grid *g)
{
    for (int axis = 0; axis < g->axes; axis++)
        for (int i = 0; i < g->bins; i++) {
            b->box[axis][i] = box4_empty();
            b->count[axis][i] = 0;
        }
}

static inline void bins_put(struct bins *b, int axis, int bin, __m128 lo, __m128 hi)
{
    box4_grow(&b->box[axis][bin], lo, hi);
    b->count[axis][bin]++;
}

static inline void bins_add_one(struct bins *b, const struct grid *g, const struct bvh_ref *ref)
{
    __m128 lo = _mm_load_ps(ref->lo), hi = _mm_load_ps(ref->hi);
    __m128 at =
        _mm_mul_ps(_mm_sub_ps(_mm_add_ps(lo, hi), _mm_loadu_ps(g->low)), _mm_loadu_ps(g->scale));
    /* What is not a number goes last. */
    at = _mm_max_ps(_mm_min_ps(at, _mm_set1_ps(g->last)), _mm_setzero_ps());
    __m128i bin = _mm_cvttps_epi32(at);
    bins_put(b, 0, _mm_extract_epi16(bin, 0), lo, hi);
    bins_put(b, 1, _mm_extract_epi16(bin, 2), lo, hi);
    bins_put(b, 2, _mm_extract_epi16(bin, 4), lo, hi);
    if (g->axes > 3)
        bins_put(b, SIZE_AXIS, size_bin(g, half_area(lo, hi)), lo, hi);
}

/* Two references at a time from far apart, since neighbours wait for each other's bin. */
static void bins_add_sse2(struct bins *b, const struct grid *g, const struct bvh_ref *refs,
                          uint32_t begin, uint32_t end)
{
    uint32_t half = (end - begin) / 2;
    for (uint32_t i = begin; i < begin + half; i++) {
        bins_add_one(b, g, &refs[i]);
        bins_add_one(b, g, &refs[i + half]);
    }
    if ((end - begin) & 1)
        bins_add_one(b, g, &refs[end - 1]);
}

/* The same boxes and counts with a reference, or a bin, in one register. */
__attribute__((target("avx2"))) static inline void bins_put_avx2(struct bins *b, int axis, int bin,
                                                                 __m256 ref)
{
    float *at = (float *)&b->box[axis][bin];
    __m256 old = _mm256_load_ps(at);
    _mm256_store_ps(at, _mm256_blend_ps(_mm256_min_ps(old, ref), _mm256_max_ps(old, ref), 0xf0));
    b->count[axis][bin]++;
}

__attribute__((target("avx2"))) static inline void
bins_add_one_avx2(struct bins *b, const struct grid *g, const struct bvh_ref *r, bool sized)
{
    __m256 ref = _mm256_load_ps(r->lo);
    __m128 lo = _mm256_castps256_ps128(ref), hi = _mm256_extractf128_ps(ref, 1);
    __m128 at =
        _mm_mul_ps(_mm_sub_ps(_mm_add_ps(lo, hi), _mm_loadu_ps(g->low)), _mm_loadu_ps(g->scale));
    at = _mm_max_ps(_mm_min_ps(at, _mm_set1_ps(g->last)), _mm_setzero_ps());
    __m128i bin = _mm_cvttps_epi32(at);
    bins_put_avx2(b, 0, _mm_cvtsi128_si32(bin), ref);
    bins_put_avx2(b, 1, _mm_extract_epi32(bin, 1), ref);
    bins_put_avx2(b, 2, _mm_extract_epi32(bin, 2), ref);
    if (sized)
        bins_put_avx2(b, SIZE_AXIS, size_bin(g, half_area(lo, hi)), ref);
}

__attribute__((target("avx2"))) static void bins_add_avx2(struct bins *b, const struct grid *g,
                                                          const struct bvh_ref *refs,
                                                          uint32_t begin, uint32_t end)
{
    uint32_t half = (end - begin) / 2;
    const struct grid own = *g;
    bool sized = g->axes > 3;
    for (uint32_t i = begin; i < begin + half; i++) {
        bins_add_one_avx2(b, &own, &refs[i], sized);
        bins_add_one_avx2(b, &own, &refs[i + half], sized);
    }
    if ((end - begin) & 1)
        bins_add_one_avx2(b, &own, &refs[end - 1], sized);
}

static void bins_add(struct bins *b, const struct grid *g, const struct bvh_ref *refs,
                     uint32_t begin, uint32_t end)
{
    if (__builtin_cpu_supports("avx2"))
        bins_add_avx2(b, g, refs, begin, end);
    else
        bins_add_sse2(b, g, refs, begin, end);
}

static void bins_merge(struct bins *b, const struct bins *other, const struct grid *g)
{
    for (int axis = 0; axis < g->axes; axis++)
        for (int i = 0; i < g->bins; i++) {
            box4_grow(&b->box[axis][i], other->box[axis][i].lo, other->box[axis][i].hi);
            b->count[axis][i] += other->count[axis][i];
        }
}

/* The cheapest border of one axis; cost in half areas times blocks. */
static void bins_sweep(const struct bins *b, const struct grid *g, int axis, struct split *best)
{
    float right_cost[BINS_MAX];
    struct box4 box = box4_empty();
    uint32_t count = 0;
    for (int i = g->bins - 1; i > 0; i--) {
        box4_grow(&box, b->box[axis][i].lo, b->box[axis][i].hi);
        count += b->count[axis][i];
        right_cost[i] = count ? half_area(box.lo, box.hi) * (float)blocks(count) : -1.0f;
    }
    box = box4_empty();
    count = 0;
    for (int i = 1; i < g->bins && right_cost[i] >= 0.0f; i++) {
        box4_grow(&box, b->box[axis][i - 1].lo, b->box[axis][i - 1].hi);
        count += b->count[axis][i - 1];
        if (!count)
            continue;
        float cost = half_area(box.lo, box.hi) * (float)blocks(count) + right_cost[i];
        if (cost < best->cost)
            *best = (struct split){cost, axis, i};
    }
}

static struct split bins_split(const struct bins *b, const struct grid *g)
{
    struct split best = {__FLT_MAX__, -1, 0};
    for (int axis = 0; axis < g->axes; axis++)
        bins_sweep(b, g, axis, &best);
    return best;
}

/* The same arithmetic as in bins_add. */
static inline bool goes_left(const struct grid *g, const struct split *s, const struct bvh_ref *ref)
{
    if (s->axis == SIZE_AXIS)
        return size_bin(g, half_area(_mm_load_ps(ref->lo), _mm_load_ps(ref->hi))) < s->border;
    float at = ((ref->lo[s->axis] + ref->hi[s->axis]) - g->low[s->axis]) * g->scale[s->axis];
    at = at < g->last ? at : g->last;
    return (int)(at > 0.0f ? at : 0.0f) < s->border;
}

/* --- The median ------------------------------------------------------------ */

/* Orders by centre, then by primitive, so that equal centres split by index. */
static bool ref_less(const struct bvh_ref *a, const struct bvh_ref *b, int axis)
{
    float ca = a->lo[axis] + a->hi[axis], cb = b->lo[axis] + b->hi[axis];
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

static uint32_t split_median(struct bvh_ref *refs, const struct range *r, const struct extent *e)
{
    float size[4];
    _mm_storeu_ps(size, _mm_sub_ps(e->centre.hi, e->centre.lo));
    int axis = size[1] > size[0] ? 1 : 0;
    axis = size[2] > size[axis] ? 2 : axis;
    uint32_t middle = r->begin + (r->end - r->begin) / 2;
    select_nth(refs, r->begin, r->end, middle, axis);
    return middle;
}

/* --- Splitting a small range ------------------------------------------------ */

static struct bvh_ref *range_refs(const struct build *b, const struct range *r)
{
    return r->in_spare ? b->out->spare : b->out->refs;
}

static struct bvh_ref *range_other(const struct build *b, const struct range *r)
{
    return r->in_spare ? b->out->refs : b->out->spare;
}

static uint32_t partition(const struct bvh_ref *from, struct bvh_ref *to, const struct range *r,
                          const struct grid *g, const struct split *s)
{
    uint32_t left = r->begin, right = r->end - 1;
    for (uint32_t i = r->begin; i < r->end; i++) {
        uint32_t is_left = goes_left(g, s, &from[i]);
        to[is_left ? left : right] = from[i];
        left += is_left;
        right -= 1 - is_left;
    }
    return left;
}

static uint32_t ceil_log2(uint32_t n)
{
    return n <= 1 ? 0 : 32 - (uint32_t)__builtin_clz(n - 1);
}

/* What is left of the depth must suffice for halving. */
static bool must_halve(const struct build *b, const struct range *r)
{
    return b->median || BVH_DEPTH_MAX - r->depth <= ceil_log2(r->end - r->begin) + 1;
}

/* Splits a range that is no leaf; returns the border and where the halves now are. */
static uint32_t split_small(const struct build *b, const struct range *r, const struct extent *e,
                            bool *in_spare)
{
    struct grid grid;
    struct bins bins;
    *in_spare = r->in_spare;
    if (must_halve(b, r))
        return split_median(range_refs(b, r), r, e);
    grid_init(&grid, e, r->end - r->begin);
    bins_init(&bins, &grid);
    bins_add(&bins, &grid, range_refs(b, r), r->begin, r->end);
    struct split split = bins_split(&bins, &grid);
    if (split.axis < 0)
        return split_median(range_refs(b, r), r, e);
    *in_spare = !r->in_spare;
    return partition(range_refs(b, r), range_other(b, r), r, &grid, &split);
}

/* --- Splitting a large range in chunks --------------------------------------- */

struct chunked {
    const struct build *build;
    const struct range *range;
    struct grid grid;
    struct split split;
    struct chunk {
        struct extent extent;
        struct bins bins;
        uint32_t left;              /* how many of it go left */
        uint32_t left_at, right_at; /* where to */
    } * chunks;
    size_t count;
};

static void chunk_bounds(const struct chunked *c, size_t i, uint32_t *begin, uint32_t *end)
{
    *begin = c->range->begin + (uint32_t)i * CHUNK;
    *end = c->range->end - *begin > CHUNK ? *begin + CHUNK : c->range->end;
}

static void chunk_extent(void *arg, size_t i)
{
    struct chunked *c = arg;
    uint32_t begin, end;
    chunk_bounds(c, i, &begin, &end);
    extent_init(&c->chunks[i].extent);
    extent_add(&c->chunks[i].extent, range_refs(c->build, c->range), begin, end, true);
}

static void chunk_bins(void *arg, size_t i)
{
    struct chunked *c = arg;
    uint32_t begin, end;
    chunk_bounds(c, i, &begin, &end);
    bins_init(&c->chunks[i].bins, &c->grid);
    bins_add(&c->chunks[i].bins, &c->grid, range_refs(c->build, c->range), begin, end);
}

static void chunk_scatter(void *arg, size_t i)
{
    struct chunked *c = arg;
    const struct bvh_ref *from = range_refs(c->build, c->range);
    struct bvh_ref *to = range_other(c->build, c->range);
    uint32_t begin, end, at[2] = {c->chunks[i].right_at, c->chunks[i].left_at};
    chunk_bounds(c, i, &begin, &end);
    for (uint32_t j = begin; j < end; j++)
        to[at[goes_left(&c->grid, &c->split, &from[j])]++] = from[j];
}

static uint32_t chunks_place(struct chunked *c)
{
    uint32_t left = c->range->begin;
    for (size_t i = 0; i < c->count; i++) {
        struct chunk *k = &c->chunks[i];
        k->left = 0;
        for (int bin = 0; bin < c->split.border; bin++)
            k->left += k->bins.count[c->split.axis][bin];
        k->left_at = left;
        left += k->left;
    }
    uint32_t right = left;
    for (size_t i = 0; i < c->count; i++) {
        uint32_t begin, end;
        chunk_bounds(c, i, &begin, &end);
        c->chunks[i].right_at = right;
        right += end - begin - c->chunks[i].left;
    }
    return left;
}

static uint32_t split_large(const struct build *b, const struct range *r, struct chunk *chunks,
                            struct extent *e, bool *in_spare)
{
    struct chunked c = {.build = b, .range = r, .chunks = chunks};
    c.count = (r->end - r->begin + CHUNK - 1) / CHUNK;
    bvh_run(b->runner, c.count, chunk_extent, &c);
    extent_init(e);
    for (size_t i = 0; i < c.count; i++)
        extent_merge(e, &chunks[i].extent);
    *in_spare = r->in_spare;
    if (must_halve(b, r))
        return split_median(range_refs(b, r), r, e);
    grid_init(&c.grid, e, r->end - r->begin);
    bvh_run(b->runner, c.count, chunk_bins, &c);
    struct bins all = chunks[0].bins;
    for (size_t i = 1; i < c.count; i++)
        bins_merge(&all, &chunks[i].bins, &c.grid);
    c.split = bins_split(&all, &c.grid);
    if (c.split.axis < 0)
        return split_median(range_refs(b, r), r, e);
    uint32_t middle = chunks_place(&c);
    bvh_run(b->runner, c.count, chunk_scatter, &c);
    *in_spare = !r->in_spare;
    return middle;
}

/* --- The tree ---------------------------------------------------------------- */

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

static void node_write(struct bvh2_node *node, const struct extent *e)
{
    float lo[4], hi[4];
    _mm_storeu_ps(lo, e->box.lo);
    _mm_storeu_ps(hi, e->box.hi);
    memcpy(node->lo, lo, sizeof node->lo);
    memcpy(node->hi, hi, sizeof node->hi);
}

/* Pushes the halves of a split range, the left one on top. */
static void push_halves(struct range *stack, int *top, const struct range *r, uint32_t middle,
                        bool in_spare, struct bvh2_node *node)
{
    stack[(*top)++] = (struct range){middle, r->end, r->depth + 1, in_spare, &node->right};
    stack[(*top)++] = (struct range){r->begin, middle, r->depth + 1, in_spare, &node->left};
}

/* Builds a subtree into the nodes from `next` on; returns the end of what it used. */
static uint32_t build_subtree(const struct build *b, struct range root, uint32_t next)
{
    struct range stack[BVH_DEPTH_MAX + 2];
    int top = 0;
    stack[top++] = root;
    while (top > 0) {
        struct range r = stack[--top];
        struct bvh2_node *node = &b->out->nodes[next];
        struct bvh_ref *refs = range_refs(b, &r);
        struct extent e;
        if (r.link)
            *r.link = next;
        next++;
        extent_init(&e);
        extent_add(&e, refs, r.begin, r.end, r.end - r.begin >= SIZE_RANGE_MIN);
        node_write(node, &e);
        if (is_leaf(refs, &r)) {
            node->left = r.begin | BVH2_LEAF;
            node->right = r.end - r.begin;
            if (r.in_spare)
                memcpy(&b->out->refs[r.begin], &refs[r.begin], (r.end - r.begin) * sizeof *refs);
            continue;
        }
        bool in_spare;
        uint32_t middle = split_small(b, &r, &e, &in_spare);
        push_halves(stack, &top, &r, middle, in_spare, node);
    }
    return next;
}

struct tasks {
    const struct build *build;
    struct range *ranges;
    size_t count, capacity;
};

static void task_run(void *arg, size_t i)
{
    struct tasks *t = arg;
    struct bvh2_run *run = &t->build->out->runs[i + 1];
    run->end = build_subtree(t->build, t->ranges[i], run->begin);
}

/* Splits until every range is a task; leaves are tasks too. */
static enum err build_top(const struct build *b, uint32_t count, struct tasks *tasks)
{
    uint32_t limit = count / TASKS > TASK_MIN ? count / TASKS : TASK_MIN, next = 0;
    size_t chunk_count = (count + CHUNK - 1) / CHUNK;
    struct chunk *chunks = bvh_alloc(chunk_count, sizeof *chunks);
    struct range stack[BVH_DEPTH_MAX + 2];
    int top = 0;
    enum err err = chunks ? ERR_OK : ERR_NOMEM;
    stack[top++] = (struct range){0, count, 0, false, NULL};
    while (!err && top > 0) {
        struct range r = stack[--top];
        if (r.end - r.begin <= limit) {
            if (mem_grow((void **)&tasks->ranges, tasks->count, &tasks->capacity,
                         sizeof *tasks->ranges))
                tasks->ranges[tasks->count++] = r;
            else
                err = ERR_NOMEM;
            continue;
        }
        struct bvh2_node *node = &b->out->nodes[next];
        struct extent e;
        bool in_spare;
        if (r.link)
            *r.link = next;
        next++;
        uint32_t middle = split_large(b, &r, chunks, &e, &in_spare);
        node_write(node, &e);
        push_halves(stack, &top, &r, middle, in_spare, node);
    }
    mem_free(chunks);
    b->out->runs[0] = (struct bvh2_run){0, next};
    return err;
}

/* Every task has room for all the nodes it could need; pages it does not touch cost nothing. */
static enum err build_tasks(const struct build *b, uint32_t count)
{
    struct tasks tasks = {b, NULL, 0, 0};
    b->out->runs = mem_alloc_array(1, sizeof *b->out->runs);
    enum err err = b->out->runs ? build_top(b, count, &tasks) : ERR_NOMEM;
    struct bvh2_run *runs = NULL;
    if (!err)
        runs = mem_realloc_array(b->out->runs, tasks.count + 1, sizeof *runs);
    if (runs) {
        b->out->runs = runs;
        b->out->run_count = tasks.count + 1;
        uint32_t next = runs[0].end;
        for (size_t i = 0; i < tasks.count; i++) {
            runs[i + 1].begin = next;
            next += 2 * (tasks.ranges[i].end - tasks.ranges[i].begin) - 1;
        }
        bvh_run(b->runner, tasks.count, task_run, &tasks);
    } else {
        err = ERR_NOMEM;
    }
    mem_free(tasks.ranges);
    return err;
}

enum err bvh2_build(struct bvh_ref *refs, uint32_t count, bool median,
                    const struct accel_runner *runner, struct bvh2 *out)
{
    size_t limit = 2 * (size_t)count;
    *out = (struct bvh2){.refs = refs, .ref_count = count, .node_limit = limit};
    out->nodes = mem_alloc_aligned(limit * sizeof *out->nodes, 64); /* sparse: no huge pages */
    out->spare = bvh_alloc(count, sizeof *refs);
    struct build b = {out, runner, median};
    enum err err = out->nodes && out->spare ? build_tasks(&b, count) : ERR_NOMEM;
    mem_free(out->spare);
    out->spare = NULL;
    if (err)
        bvh2_release(out);
    return err;
}

void bvh2_release(struct bvh2 *b)
{
    mem_free(b->nodes);
    mem_free(b->runs);
    mem_free(b->refs);
    *b = (struct bvh2){0};
}
