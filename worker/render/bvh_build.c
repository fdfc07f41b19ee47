/* The binary tree: binned SAH over three axes and size, or object median.
 *
 * The top of the tree is split one node at a time, each pass over its references cut
 * into chunks of a fixed size; what has become small enough is a task of its own. The
 * chunks and tasks depend on the references alone and every merge is exact (minima,
 * maxima, counts), so the tree is the same on any number of threads. The passes
 * themselves are bvh_split.h, for the CPU's instruction set.
 */
#include "worker/render/bvh_spatial.h"

#include <string.h>

#include "common/mem.h"

enum {
    CHUNK = 16384,   /* references in one piece of a pass */
    TASK_MIN = 4096, /* a smaller range is not cut into tasks */
    TASKS = 64,      /* about */
};

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

uint32_t bvh_split_median(struct bvh_ref *refs, const struct bvh_range *r)
{
    float size[3];
    for (int k = 0; k < 3; k++)
        size[k] = -(r->extent.centre[k] + r->extent.centre[4 + k]);
    int axis = size[1] > size[0] ? 1 : 0;
    axis = size[2] > size[axis] ? 2 : axis;
    uint32_t middle = r->begin + (r->end - r->begin) / 2;
    select_nth(refs, r->begin, r->end, middle, axis);
    return middle;
}

static uint32_t ceil_log2(uint32_t n)
{
    return n <= 1 ? 0 : 32 - (uint32_t)__builtin_clz(n - 1);
}

bool bvh_must_halve(const struct bvh_builder *b, const struct bvh_range *r)
{
    return b->median || BVH_DEPTH_MAX - r->depth <= ceil_log2(r->end - r->begin) + 1;
}

/* --- Splitting a large range in chunks --------------------------------------- */

struct chunked {
    const struct bvh_builder *build;
    const struct bvh_range *range;
    struct bvh_grid grid;
    struct bvh_cut cut;
    struct chunk {
        struct bvh_extent extent;
        struct bvh_bins bins;
        struct bvh_scatter scatter;
        uint32_t left; /* how many of it go left */
    } * chunks;
    size_t count;
    struct bvh_spatial_grid space;
    struct bvh_spatial_cut plane;
    struct spatial_chunk {
        struct bvh_spatial_bins bins;
        struct bvh_extent half[2];
    } * spatial; /* NULL: space is not split */
};

static const struct bvh_ref *chunk_refs(const struct chunked *c, size_t i, uint32_t *count)
{
    uint32_t begin = c->range->begin + (uint32_t)i * CHUNK;
    *count = c->range->end - begin > CHUNK ? CHUNK : c->range->end - begin;
    return &bvh_range_refs(c->build, c->range)[begin];
}

static void chunk_extent(void *arg, size_t i)
{
    struct chunked *c = arg;
    uint32_t count;
    const struct bvh_ref *refs = chunk_refs(c, i, &count);
    c->build->splitter->measure(refs, count, &c->chunks[i].extent);
}

static void chunk_area(void *arg, size_t i)
{
    struct chunked *c = arg;
    uint32_t count;
    const struct bvh_ref *refs = chunk_refs(c, i, &count);
    c->chunks[i].extent.area_limit = c->build->splitter->area_max(refs, count);
}

static void chunk_bins(void *arg, size_t i)
{
    struct chunked *c = arg;
    uint32_t count;
    const struct bvh_ref *refs = chunk_refs(c, i, &count);
    c->build->splitter->bins_fill(&c->grid, refs, count, &c->chunks[i].bins);
}

static void chunk_scatter(void *arg, size_t i)
{
    struct chunked *c = arg;
    uint32_t count;
    const struct bvh_ref *refs = chunk_refs(c, i, &count);
    c->build->splitter->scatter(&c->grid, &c->cut, refs, count, bvh_range_other(c->build, c->range),
                                &c->chunks[i].scatter);
}

/* Where each chunk's references go, in the order of chunks. */
static void chunks_place(struct chunked *c, struct bvh_halves *out)
{
    uint32_t left = 0, count;
    for (size_t i = 0; i < c->count; i++) {
        struct chunk *k = &c->chunks[i];
        k->left = 0;
        for (int bin = 0; bin < c->cut.border; bin++)
            k->left += k->bins.bin[bin].count[c->cut.axis];
        left += k->left;
    }
    bvh_halves_place(c->range, left, c->range->end - c->range->begin - left, out);
    uint32_t left_at = c->range->begin, right_at = out->right_begin;
    for (size_t i = 0; i < c->count; i++) {
        struct chunk *k = &c->chunks[i];
        chunk_refs(c, i, &count);
        k->scatter.left_at = left_at;
        k->scatter.right_at = right_at;
        left_at += k->left;
        right_at += count - k->left;
    }
}

static void grow(float box[8], const float other[8])
{
    for (int k = 0; k < 8; k++)
        box[k] = other[k] < box[k] ? other[k] : box[k];
}

/* What is known of a range of more than a chunk. */
static void measure_large(const struct bvh_builder *b, const struct bvh_range *r,
                          struct chunk *chunks, struct bvh_extent *out)
{
    struct chunked c = {.build = b, .range = r, .chunks = chunks};
    c.count = (r->end - r->begin + CHUNK - 1) / CHUNK;
    bvh_run(b->runner, c.count, chunk_extent, &c);
    *out = chunks[0].extent;
    for (size_t i = 1; i < c.count; i++) {
        grow(out->box, chunks[i].extent.box);
        grow(out->centre, chunks[i].extent.centre);
    }
    out->area_limit = __FLT_MAX__;
}

static void halve_large(const struct bvh_builder *b, const struct bvh_range *r,
                        struct chunk *chunks, struct bvh_halves *out)
{
    uint32_t middle = bvh_split_median(bvh_range_refs(b, r), r);
    struct bvh_range left = *r, right = *r;
    left.end = right.begin = middle;
    measure_large(b, &left, chunks, &out->half[0]);
    measure_large(b, &right, chunks, &out->half[1]);
    bvh_halves_stay(r, middle, out);
}

/* The grid of a large range, its bins in chunks[].bins and their sum. */
static void bin_large(struct chunked *c, struct bvh_extent *e, struct bvh_bins *all)
{
    const struct bvh_splitter *splitter = c->build->splitter;
    uint32_t count = c->range->end - c->range->begin;
    bool sized = splitter->sizes_matter(e, count);
    if (sized) {
        bvh_run(c->build->runner, c->count, chunk_area, c);
        e->area_limit = 0.0f;
        for (size_t i = 0; i < c->count; i++) {
            float area = c->chunks[i].extent.area_limit;
            e->area_limit = area > e->area_limit ? area : e->area_limit;
        }
        sized = splitter->sizes_matter(e, count);
    }
    splitter->grid_init(e, count, sized, &c->grid);
    bvh_run(c->build->runner, c->count, chunk_bins, c);
    *all = c->chunks[0].bins;
    for (size_t i = 1; i < c->count; i++)
        splitter->bins_merge(&c->grid, &c->chunks[i].bins, all);
}

/* By the cheapest of the bins' cuts. */
static void cut_large(struct chunked *c, struct bvh_halves *out)
{
    chunks_place(c, out);
    bvh_run(c->build->runner, c->count, chunk_scatter, c);
    for (int side = 0; side < 2; side++) {
        struct bvh_extent *half = &out->half[side];
        memcpy(half->centre, c->chunks[0].scatter.centre[side], sizeof half->centre);
        for (size_t i = 1; i < c->count; i++)
            grow(half->centre, c->chunks[i].scatter.centre[side]);
        half->area_limit = c->range->extent.area_limit;
    }
}

static void chunk_space_bins(void *arg, size_t i)
{
    struct chunked *c = arg;
    uint32_t count;
    const struct bvh_ref *refs = chunk_refs(c, i, &count);
    bvh_spatial_fill(c->build, &c->space, refs, count, &c->spatial[i].bins);
}

static void chunk_space_scatter(void *arg, size_t i)
{
    struct chunked *c = arg;
    uint32_t count;
    const struct bvh_ref *refs = chunk_refs(c, i, &count);
    bvh_spatial_scatter(c->build, &c->plane, refs, count, bvh_range_other(c->build, c->range),
                        &c->chunks[i].scatter, c->spatial[i].half);
}

/* Where each chunk's pieces go. */
static void chunks_place_pieces(struct chunked *c, struct bvh_halves *out)
{
    bvh_halves_place(c->range, c->plane.left, c->plane.right, out);
    uint32_t left_at = c->range->begin, right_at = out->right_begin;
    for (size_t i = 0; i < c->count; i++) {
        const struct bvh_spatial_bins *bins = &c->spatial[i].bins;
        c->chunks[i].scatter.left_at = left_at;
        c->chunks[i].scatter.right_at = right_at;
        for (int bin = 0; bin < c->plane.border; bin++)
            left_at += bins->first[c->plane.axis][bin];
        for (int bin = c->plane.border; bin < BVH_SPATIAL_BINS; bin++)
            right_at += bins->last[c->plane.axis][bin];
    }
}

/* By a plane, if one costs less; false if none does. */
static bool cut_space(struct chunked *c, struct bvh_halves *out)
{
    if (!c->spatial || !bvh_spatial_worth(c->build, c->range, out->half))
        return false;
    bvh_spatial_grid_init(&c->range->extent, &c->space);
    bvh_run(c->build->runner, c->count, chunk_space_bins, c);
    struct bvh_spatial_bins all = c->spatial[0].bins;
    for (size_t i = 1; i < c->count; i++)
        bvh_spatial_merge(&c->spatial[i].bins, &all);
    c->plane = bvh_spatial_cut(&c->space, &all, c->range, c->cut.cost);
    if (c->plane.axis < 0)
        return false;
    chunks_place_pieces(c, out);
    bvh_run(c->build->runner, c->count, chunk_space_scatter, c);
    for (int side = 0; side < 2; side++) {
        struct bvh_extent *half = &out->half[side];
        *half = c->spatial[0].half[side];
        for (size_t i = 1; i < c->count; i++) {
            grow(half->box, c->spatial[i].half[side].box);
            grow(half->centre, c->spatial[i].half[side].centre);
        }
        half->area_limit = c->range->extent.area_limit;
    }
    return true;
}

static void split_large(const struct bvh_builder *b, struct bvh_range *r, struct chunk *chunks,
                        struct spatial_chunk *spatial, struct bvh_halves *out)
{
    struct chunked c = {.build = b, .range = r, .chunks = chunks, .spatial = spatial};
    struct bvh_bins all;
    c.count = (r->end - r->begin + CHUNK - 1) / CHUNK;
    c.cut.axis = -1;
    if (!bvh_must_halve(b, r)) {
        bin_large(&c, &r->extent, &all);
        c.cut = b->splitter->bins_cut(&c.grid, &all, &out->half[0], &out->half[1]);
    }
    if (c.cut.axis < 0)
        halve_large(b, r, chunks, out);
    else if (!cut_space(&c, out))
        cut_large(&c, out);
}

/* --- The tree ---------------------------------------------------------------- */

struct tasks {
    const struct bvh_builder *build;
    struct bvh_range *ranges;
    size_t count, capacity;
};

static void task_run(void *arg, size_t i)
{
    struct tasks *t = arg;
    struct bvh2_run *run = &t->build->out->runs[i + 1];
    run->end = t->build->splitter->subtree(t->build, &t->ranges[i], run->begin);
}

static bool add_task(struct tasks *t, const struct bvh_range *r)
{
    if (!mem_grow((void **)&t->ranges, t->count, &t->capacity, sizeof *t->ranges))
        return false;
    t->ranges[t->count++] = *r;
    return true;
}

/* Splits until every range is a task; leaves are tasks too. */
static enum err split_top(struct bvh_builder *b, uint32_t count, struct chunk *chunks,
                          struct spatial_chunk *spatial, struct tasks *tasks)
{
    uint32_t most = count / TASKS > TASK_MIN ? count / TASKS : TASK_MIN, next = 0;
    struct bvh_range stack[BVH_DEPTH_MAX + 2];
    int top = 0;
    stack[top] = (struct bvh_range){.end = count, .limit = b->out->ref_count};
    measure_large(b, &stack[top], chunks, &stack[top].extent);
    b->overlap_min = bvh_spatial_overlap_min(&stack[top++].extent);
    while (top > 0) {
        struct bvh_range r = stack[--top];
        if (r.end - r.begin <= most) {
            if (!add_task(tasks, &r))
                return ERR_NOMEM;
            continue;
        }
        struct bvh2_node *node = &b->out->nodes[next];
        struct bvh_halves halves;
        if (r.link)
            *r.link = next;
        next++;
        bvh_node_write(node, &r.extent);
        split_large(b, &r, chunks, spatial, &halves);
        bvh_push_halves(stack, &top, &r, &halves, node);
    }
    b->out->runs[0] = (struct bvh2_run){0, next, 0.0};
    return ERR_OK;
}

static enum err build_top(struct bvh_builder *b, uint32_t count, struct tasks *tasks)
{
    size_t chunk_count = (count + CHUNK - 1) / CHUNK;
    struct chunk *chunks = bvh_alloc(chunk_count, sizeof *chunks);
    struct spatial_chunk *spatial = b->source ? bvh_alloc(chunk_count, sizeof *spatial) : NULL;
    enum err err = ERR_NOMEM;
    if (chunks && (spatial || !b->source))
        err = split_top(b, count, chunks, spatial, tasks);
    mem_free(chunks);
    mem_free(spatial);
    return err;
}

/* Every task has room for all the nodes it could need; pages it does not touch cost nothing. */
static enum err build_tasks(struct bvh_builder *b, uint32_t count)
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
            next += 2 * (tasks.ranges[i].limit - tasks.ranges[i].begin) - 1;
        }
        bvh_run(b->runner, tasks.count, task_run, &tasks);
    } else {
        err = ERR_NOMEM;
    }
    mem_free(tasks.ranges);
    return err;
}

/* Room for pieces of triangles behind the references. */
static bool make_room(struct bvh_ref **refs, uint32_t count, uint32_t capacity)
{
    struct bvh_ref *more = bvh_alloc(capacity, sizeof *more);
    if (!more)
        return false;
    memcpy(more, *refs, count * sizeof *more);
    mem_free(*refs);
    *refs = more;
    return true;
}

enum err bvh2_build(struct bvh_ref *refs, uint32_t count, const struct bvh_how *how,
                    const struct bvh_source *source, struct bvh2 *out)
{
    uint32_t capacity = how->spatial ? count + count / BVH_SPATIAL_MORE : count;
    size_t limit = 2 * (size_t)capacity;
    *out = (struct bvh2){.refs = refs, .ref_count = capacity, .node_limit = limit};
    out->nodes = mem_alloc_aligned(limit * sizeof *out->nodes, 64); /* sparse: no huge pages */
    out->spare = bvh_alloc(capacity, sizeof *refs);
    bool avx2 = how->isa != ACCEL_ISA_SSE2 && __builtin_cpu_supports("avx2");
    struct bvh_builder b = {.out = out,
                            .runner = how->runner,
                            .splitter = avx2 ? &bvh_split_avx2 : &bvh_split_sse2,
                            .median = how->median,
                            .source = how->spatial ? source : NULL};
    bool ready = out->nodes && out->spare && (!b.source || make_room(&out->refs, count, capacity));
    enum err err = ready ? build_tasks(&b, count) : ERR_NOMEM;
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
