#include "worker/render/bvh_spatial.h"

#include <emmintrin.h>
#include <string.h>

/* Of the root's area (after Stich et al.). */
static const float OVERLAP_MIN = 1e-5f;

/* What a wide node of leaves holds at most: to cut there adds nodes for little. */
enum { FEW = BVH_WIDTH * BVH_BLOCK };

/* --- Boxes ------------------------------------------------------------------ */

static void box_clear(float box[8])
{
    for (int k = 0; k < 8; k++)
        box[k] = __FLT_MAX__;
}

static void box_grow(float box[8], const float other[8])
{
    for (int k = 0; k < 8; k++)
        box[k] = other[k] < box[k] ? other[k] : box[k];
}

static float box_area(const float box[8])
{
    float x = -(box[0] + box[4]), y = -(box[1] + box[5]), z = -(box[2] + box[6]);
    return x * y + (y * z + z * x);
}

float bvh_spatial_overlap_min(const struct bvh_extent *root)
{
    return OVERLAP_MIN * box_area(root->box);
}

bool bvh_spatial_worth(const struct bvh_builder *b, const struct bvh_range *r,
                       const struct bvh_extent half[2])
{
    float both[8];
    if (r->limit == r->end || r->end - r->begin <= FEW)
        return false;
    for (int k = 0; k < 8; k++)
        both[k] = half[0].box[k] > half[1].box[k] ? half[0].box[k] : half[1].box[k];
    for (int k = 0; k < 3; k++)
        if (!(both[k] <= -both[4 + k]))
            return false;
    return box_area(both) > b->overlap_min;
}

/* --- Pieces ----------------------------------------------------------------- */

/* A box in two registers; the fourth of each is anything. */
struct piece {
    __m128 lo, hi;
};

static inline struct piece piece_of(const struct bvh_ref *ref)
{
    return (struct piece){_mm_loadu_ps(ref->lo), _mm_loadu_ps(ref->hi)};
}

static inline void piece_put(const struct piece *p, const struct bvh_ref *whole,
                             struct bvh_ref *out)
{
    uint32_t primitive = whole->primitive, owner = whole->owner;
    _mm_storeu_ps(out->lo, p->lo);
    _mm_storeu_ps(out->hi, p->hi);
    out->primitive = primitive;
    out->owner = owner;
}

static inline void piece_add(struct piece *p, __m128 lo, __m128 hi)
{
    p->lo = _mm_min_ps(lo, p->lo);
    p->hi = _mm_max_ps(hi, p->hi);
}

static inline void box_grow_piece(float box[8], const struct piece *p)
{
    const __m128 sign = _mm_set1_ps(-0.0f);
    _mm_storeu_ps(box, _mm_min_ps(p->lo, _mm_loadu_ps(box)));
    _mm_storeu_ps(box + 4, _mm_min_ps(_mm_xor_ps(sign, p->hi), _mm_loadu_ps(box + 4)));
}

/* Adds to both pieces where an edge from one side of the plane to the other passes it: rounded to
 * floats and a last place wider, which is more than doubles round. `beside` is set but for the
 * axis, and `plane` on it. */
static inline void edge_add(const float a[4], const float b[4], int axis, float at, __m128 beside,
                            __m128 plane, struct piece *left, struct piece *right)
{
    double along = ((double)at - (double)a[axis]) / ((double)b[axis] - (double)a[axis]);
    __m128 af = _mm_loadu_ps(a), bf = _mm_loadu_ps(b);
    __m128d a0 = _mm_cvtps_pd(af), a1 = _mm_cvtps_pd(_mm_movehl_ps(af, af));
    __m128d b0 = _mm_cvtps_pd(bf), b1 = _mm_cvtps_pd(_mm_movehl_ps(bf, bf));
    __m128d part = _mm_set1_pd(along);
    a0 = _mm_add_pd(a0, _mm_mul_pd(part, _mm_sub_pd(b0, a0)));
    a1 = _mm_add_pd(a1, _mm_mul_pd(part, _mm_sub_pd(b1, a1)));
    __m128 x = _mm_movelh_ps(_mm_cvtpd_ps(a0), _mm_cvtpd_ps(a1));
    __m128 off = _mm_mul_ps(_mm_andnot_ps(_mm_set1_ps(-0.0f), x), _mm_set1_ps(0x1p-23f));
    off = _mm_and_ps(_mm_add_ps(off, _mm_set1_ps(0x1p-149f)), beside);
    x = _mm_or_ps(_mm_and_ps(x, beside), plane);
    piece_add(left, _mm_sub_ps(x, off), _mm_add_ps(x, off));
    piece_add(right, _mm_sub_ps(x, off), _mm_add_ps(x, off));
}

/* What is cut keeps within the box that it had. A piece that only roundings made would be inside
 * out. */
static inline struct piece piece_keep(const struct piece *whole, const struct piece *part)
{
    __m128 lo = _mm_max_ps(whole->lo, part->lo), hi = _mm_min_ps(whole->hi, part->hi);
    return (struct piece){_mm_min_ps(lo, hi), _mm_max_ps(lo, hi)};
}

/* Cuts a piece of a triangle in two. */
static void piece_cut(const struct piece *whole, const float v[3][4], int axis, float at,
                      struct piece *left, struct piece *right)
{
    const __m128 most = _mm_set1_ps(__FLT_MAX__), least = _mm_set1_ps(-__FLT_MAX__);
    const __m128i lane = _mm_cmpeq_epi32(_mm_setr_epi32(0, 1, 2, 3), _mm_set1_epi32(axis));
    const __m128 on = _mm_castsi128_ps(lane);
    const __m128 beside = _mm_castsi128_ps(_mm_xor_si128(lane, _mm_set1_epi32(-1)));
    const __m128 plane = _mm_and_ps(_mm_set1_ps(at), on);
    struct piece l = {most, least}, r = {most, least};
    for (int i = 0; i < 3; i++) {
        const float *a = v[i], *b = v[i == 2 ? 0 : i + 1];
        __m128 corner = _mm_loadu_ps(a);
        if (a[axis] <= at)
            piece_add(&l, corner, corner);
        if (a[axis] >= at)
            piece_add(&r, corner, corner);
        if ((a[axis] < at && b[axis] > at) || (a[axis] > at && b[axis] < at))
            edge_add(a, b, axis, at, beside, plane, &l, &r);
    }
    *left = piece_keep(whole, &l);
    *right = piece_keep(whole, &r);
}

/* --- Bins ------------------------------------------------------------------- */

void bvh_spatial_grid_init(const struct bvh_extent *e, struct bvh_spatial_grid *g)
{
    for (int k = 0; k < 3; k++) {
        float low = e->box[k], size = -e->box[4 + k] - low;
        g->scale[k] = (float)BVH_SPATIAL_BINS / size;
        g->border[k][0] = low;
        for (int i = 1; i < BVH_SPATIAL_BINS; i++) {
            g->border[k][i] = low + size * ((float)i / (float)BVH_SPATIAL_BINS);
            if (!(g->border[k][i] > g->border[k][i - 1]) || !(g->scale[k] < __FLT_MAX__))
                g->scale[k] = 0.0f;
        }
    }
}

/* The last bin whose border is not above x; `below`: below x. */
static int bin_of(const struct bvh_spatial_grid *g, int axis, float x, bool below)
{
    const float *border = g->border[axis];
    float guess = (x - border[0]) * g->scale[axis];
    int i = guess > 0.0f ? guess < (float)BVH_SPATIAL_BINS ? (int)guess : BVH_SPATIAL_BINS - 1 : 0;
    while (i > 0 && (below ? border[i] >= x : border[i] > x))
        i--;
    while (i < BVH_SPATIAL_BINS - 1 && (below ? border[i + 1] < x : border[i + 1] <= x))
        i++;
    return i;
}

static void bins_add(const struct bvh_builder *b, const struct bvh_spatial_grid *g, int axis,
                     const struct bvh_ref *ref, struct bvh_spatial_bins *out)
{
    bool whole = ref->primitive & BVH_REF_OBJECT;
    float middle = 0.5f * ref->lo[axis] + 0.5f * ref->hi[axis];
    int first = bin_of(g, axis, whole ? middle : ref->lo[axis], false);
    int last = whole ? first : bin_of(g, axis, ref->hi[axis], true);
    last = last < first ? first : last;
    out->first[axis][first]++;
    out->last[axis][last]++;
    if (first == last) {
        struct piece all = piece_of(ref);
        box_grow_piece(out->box[axis][first], &all);
        return;
    }
    struct piece rest = piece_of(ref), left;
    float v[3][4];
    b->source->vertices(b->source->ctx, ref, v);
    for (int i = first; i < last; i++) {
        piece_cut(&rest, (const float(*)[4])v, axis, g->border[axis][i + 1], &left, &rest);
        box_grow_piece(out->box[axis][i], &left);
    }
    box_grow_piece(out->box[axis][last], &rest);
}

void bvh_spatial_fill(const struct bvh_builder *b, const struct bvh_spatial_grid *g,
                      const struct bvh_ref *refs, uint32_t count, struct bvh_spatial_bins *out)
{
    memset(out, 0, sizeof *out);
    for (int axis = 0; axis < 3; axis++) {
        if (g->scale[axis] == 0.0f)
            continue;
        for (int i = 0; i < BVH_SPATIAL_BINS; i++)
            box_clear(out->box[axis][i]);
        for (uint32_t i = 0; i < count; i++)
            bins_add(b, g, axis, &refs[i], out);
    }
}

void bvh_spatial_merge(const struct bvh_spatial_bins *other, struct bvh_spatial_bins *bins)
{
    for (int axis = 0; axis < 3; axis++)
        for (int i = 0; i < BVH_SPATIAL_BINS; i++) {
            box_grow(bins->box[axis][i], other->box[axis][i]);
            bins->first[axis][i] += other->first[axis][i];
            bins->last[axis][i] += other->last[axis][i];
        }
}

/* --- The plane -------------------------------------------------------------- */

static float side_cost(const float box[8], uint32_t count)
{
    return box_area(box) * (float)((count + BVH_BLOCK - 1) / BVH_BLOCK);
}

static void cut_axis(const struct bvh_spatial_grid *g, const struct bvh_spatial_bins *bins,
                     const struct bvh_range *r, int axis, struct bvh_spatial_cut *best)
{
    uint32_t count = r->end - r->begin, room = r->limit - r->begin;
    uint32_t rights[BVH_SPATIAL_BINS], left = 0, right = 0;
    float costs[BVH_SPATIAL_BINS], box[8];
    box_clear(box);
    for (int i = BVH_SPATIAL_BINS - 1; i > 0; i--) {
        box_grow(box, bins->box[axis][i]);
        right += bins->last[axis][i];
        rights[i] = right;
        costs[i] = right > 0 ? side_cost(box, right) : 0.0f;
    }
    box_clear(box);
    for (int i = 1; i < BVH_SPATIAL_BINS; i++) {
        box_grow(box, bins->box[axis][i - 1]);
        left += bins->first[axis][i - 1];
        if (left == 0 || left >= count || rights[i] == 0 || rights[i] >= count ||
            left + rights[i] > room)
            continue;
        float cost = side_cost(box, left) + costs[i];
        if (cost < best->cost)
            *best = (struct bvh_spatial_cut){cost, g->border[axis][i], axis, i, left, rights[i]};
    }
}

struct bvh_spatial_cut bvh_spatial_cut(const struct bvh_spatial_grid *g,
                                       const struct bvh_spatial_bins *bins,
                                       const struct bvh_range *r, float cost)
{
    struct bvh_spatial_cut best = {.cost = cost, .axis = -1};
    for (int axis = 0; axis < 3; axis++)
        if (g->scale[axis] != 0.0f)
            cut_axis(g, bins, r, axis, &best);
    return best;
}

/* --- Partition -------------------------------------------------------------- */

static void half_add(struct bvh_extent *half, const struct piece *p)
{
    __m128 centre = _mm_add_ps(p->lo, p->hi);
    struct piece at = {centre, centre};
    box_grow_piece(half->box, p);
    box_grow_piece(half->centre, &at);
}

void bvh_spatial_scatter(const struct bvh_builder *b, const struct bvh_spatial_cut *cut,
                         const struct bvh_ref *refs, uint32_t count, struct bvh_ref *to,
                         struct bvh_scatter *s, struct bvh_extent half[2])
{
    for (int side = 0; side < 2; side++) {
        box_clear(half[side].box);
        box_clear(half[side].centre);
    }
    for (uint32_t i = 0; i < count; i++) {
        const struct bvh_ref *ref = &refs[i];
        bool whole = ref->primitive & BVH_REF_OBJECT;
        float middle = 0.5f * ref->lo[cut->axis] + 0.5f * ref->hi[cut->axis];
        bool left = (whole ? middle : ref->lo[cut->axis]) < cut->at;
        bool right = !left || (!whole && ref->hi[cut->axis] > cut->at);
        struct piece all = piece_of(ref), piece[2] = {all, all};
        if (left && right) {
            float v[3][4];
            b->source->vertices(b->source->ctx, ref, v);
            piece_cut(&all, (const float(*)[4])v, cut->axis, cut->at, &piece[0], &piece[1]);
        }
        if (left) {
            piece_put(&piece[0], ref, &to[s->left_at++]);
            half_add(&half[0], &piece[0]);
        }
        if (right) {
            piece_put(&piece[1], ref, &to[s->right_at++]);
            half_add(&half[1], &piece[1]);
        }
    }
}

bool bvh_spatial_split(const struct bvh_builder *b, const struct bvh_range *r, float cost,
                       struct bvh_halves *out)
{
    const struct bvh_ref *refs = &bvh_range_refs(b, r)[r->begin];
    uint32_t count = r->end - r->begin;
    struct bvh_spatial_grid grid;
    struct bvh_spatial_bins bins;
    bvh_spatial_grid_init(&r->extent, &grid);
    bvh_spatial_fill(b, &grid, refs, count, &bins);
    struct bvh_spatial_cut cut = bvh_spatial_cut(&grid, &bins, r, cost);
    if (cut.axis < 0)
        return false;
    bvh_halves_place(r, cut.left, cut.right, out);
    struct bvh_scatter s = {.left_at = r->begin, .right_at = out->right_begin};
    bvh_spatial_scatter(b, &cut, refs, count, bvh_range_other(b, r), &s, out->half);
    for (int side = 0; side < 2; side++)
        out->half[side].area_limit = r->extent.area_limit;
    TL_DASSERT(s.left_at == out->left_end && s.right_at == out->right_end);
    return true;
}
