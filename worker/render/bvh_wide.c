/* From the binary tree to the wide one: which binary nodes become wide nodes is
 * chosen by dynamic programming over the surface area cost. */
#include "worker/render/bvh_place.h"

#include <emmintrin.h>
#include <string.h>

#include "common/mem.h"

/* Cost of a box test of eight children, and of a block of triangles, per unit of area. */
static const float NODE_COST = 1.0f, LEAF_COST = 1.0f;

/* Of a binary node: the least cost of its subtree when it may take up 1..8 child slots. */
struct costs {
    float cost[BVH_WIDTH];
};

/* And how slots are shared by its children: those of the left one when both have i + 1; 0: as with
 * fewer. */
struct choice {
    uint8_t left[BVH_WIDTH];
};

/* A wide node to be written. */
struct plan {
    uint32_t child[BVH_WIDTH];  /* binary nodes */
    uint32_t offset[BVH_WIDTH]; /* references in the arena */
    uint32_t unit, count, depth;
};

static float half_area(const struct bvh2_node *n)
{
    float x = n->hi[0] - n->lo[0], y = n->hi[1] - n->lo[1], z = n->hi[2] - n->lo[2];
    return x * y + (y * z + z * x);
}

/* Takes over the cost, and the number of slots it goes with, where it is less. */
static inline void lanes_offer(__m128 cost, int slots, __m128 *least, __m128i *best)
{
    __m128i less = _mm_castps_si128(_mm_cmplt_ps(cost, *least));
    *least = _mm_min_ps(cost, *least);
    *best = _mm_or_si128(_mm_and_si128(less, _mm_set1_epi32(slots)), _mm_andnot_si128(less, *best));
}

/* The least cost when two children share 2..8 slots, and how many the left one gets then: all
 * shares at once, one number of slots for the left one after the other. */
static void share(const struct costs *left, const struct costs *right, float shared[BVH_WIDTH],
                  uint32_t best[BVH_WIDTH])
{
    const __m128 none = _mm_setr_ps(__builtin_inff(), 0.0f, 0.0f, 0.0f);
    __m128i low = _mm_castps_si128(_mm_loadu_ps(right->cost));
    __m128i high = _mm_castps_si128(_mm_loadu_ps(right->cost + 4));
    __m128 least[2] = {_mm_set1_ps(__builtin_inff()), _mm_set1_ps(__builtin_inff())};
    __m128i taken[2] = {_mm_set1_epi32(1), _mm_set1_epi32(1)};
    for (int l = 1; l < BVH_WIDTH; l++) {
        high = _mm_or_si128(_mm_slli_si128(high, 4), _mm_srli_si128(low, 12));
        low = _mm_or_si128(_mm_slli_si128(low, 4), _mm_castps_si128(none));
        __m128 cost = _mm_set1_ps(left->cost[l - 1]);
        lanes_offer(_mm_add_ps(cost, _mm_castsi128_ps(low)), l, &least[0], &taken[0]);
        lanes_offer(_mm_add_ps(cost, _mm_castsi128_ps(high)), l, &least[1], &taken[1]);
    }
    for (int i = 0; i < 2; i++) {
        _mm_storeu_ps(&shared[4 * i], least[i]);
        _mm_storeu_si128((__m128i *)&best[4 * i], taken[i]);
    }
}

/* `out` may be one of the children's. */
static void choose(float area, const struct costs *left, const struct costs *right,
                   struct costs *out, struct choice *choice)
{
    float shared[BVH_WIDTH];
    uint32_t best[BVH_WIDTH];
    share(left, right, shared, best);
    out->cost[0] = area * NODE_COST + shared[BVH_WIDTH - 1];
    choice->left[0] = (uint8_t)best[BVH_WIDTH - 1];
    for (int i = 1; i < BVH_WIDTH; i++) {
        bool better = shared[i] < out->cost[i - 1];
        out->cost[i] = better ? shared[i] : out->cost[i - 1];
        choice->left[i] = (uint8_t)(better ? best[i] : 0);
    }
}

static bool is_leaf(const struct bvh2_node *n)
{
    return n->left & BVH2_LEAF;
}

struct choosing {
    const struct bvh2 *tree;
    struct choice *choices;
    struct costs *costs; /* of the top's nodes and of the roots of the other runs */
};

static void leaf_costs(float area, struct costs *out)
{
    for (int k = 0; k < BVH_WIDTH; k++)
        out->cost[k] = area * LEAF_COST;
}

/* A run is in preorder, so from its end on a node meets its children's costs on top of a stack, the
 * left one's last. */
static void choose_task(void *arg, size_t index)
{
    struct choosing *c = arg;
    const struct bvh2_node *nodes = c->tree->nodes;
    struct bvh2_run *run = &c->tree->runs[index + 1];
    struct costs stack[BVH_DEPTH_MAX + 2];
    int top = 0;
    run->area = 0.0;
    for (uint32_t i = run->end; i-- > run->begin;) {
        float area = half_area(&nodes[i]);
        run->area += (double)area;
        if (is_leaf(&nodes[i])) {
            leaf_costs(area, &stack[top++]);
        } else {
            top--;
            choose(area, &stack[top], &stack[top - 1], &stack[top - 1], &c->choices[i]);
        }
    }
    c->costs[run->begin] = stack[0];
}

/* The top's children may be roots of other runs; children come after their parents here too. */
static void choose_top(struct choosing *c)
{
    const struct bvh2_node *nodes = c->tree->nodes;
    struct bvh2_run *run = &c->tree->runs[0];
    run->area = 0.0;
    for (uint32_t i = run->end; i-- > run->begin;) {
        float area = half_area(&nodes[i]);
        run->area += (double)area;
        choose(area, &c->costs[nodes[i].left], &c->costs[nodes[i].right], &c->costs[i],
               &c->choices[i]);
    }
}

/* Lists the binary nodes that fill the slots of the wide node made of `root`. */
static void plan_children(const struct bvh2_node *nodes, const struct choice *choices,
                          uint32_t root, struct plan *plan)
{
    struct {
        uint32_t node, slots;
    } stack[BVH_WIDTH + 1];
    int top = 0;
    uint32_t left = choices[root].left[0];
    plan->count = 0;
    stack[top].node = nodes[root].right;
    stack[top++].slots = BVH_WIDTH - left;
    stack[top].node = nodes[root].left;
    stack[top++].slots = left;
    while (top > 0) {
        uint32_t node = stack[--top].node, slots = stack[top].slots;
        if (!is_leaf(&nodes[node]))
            while (slots > 1 && choices[node].left[slots - 1] == 0)
                slots--;
        if (is_leaf(&nodes[node]) || slots == 1) {
            plan->child[plan->count++] = node;
            continue;
        }
        left = choices[node].left[slots - 1];
        stack[top].node = nodes[node].right;
        stack[top++].slots = slots - left;
        stack[top].node = nodes[node].left;
        stack[top++].slots = left;
    }
}

struct planner {
    const struct bvh2_node *nodes;
    const struct bvh_ref *refs;
    const struct choice *choices;
    struct plan *plans;
    size_t count, capacity;
    uint64_t units;
    size_t leaf_bytes;
};

/* Gives leaves their place right behind the node, and nodes theirs when they are planned. */
static enum err plan_node(struct planner *p, uint32_t root, uint32_t depth, size_t *out)
{
    if (!mem_grow((void **)&p->plans, p->count, &p->capacity, sizeof *p->plans))
        return ERR_NOMEM;
    struct plan *plan = &p->plans[p->count];
    *out = p->count++;
    plan->unit = (uint32_t)p->units;
    plan->depth = depth;
    p->units += sizeof(struct bvh_node) / BVH_UNIT_BYTES;
    if (is_leaf(&p->nodes[root])) { /* a tree of a single leaf still has a node */
        plan->child[0] = root;
        plan->count = 1;
    } else {
        plan_children(p->nodes, p->choices, root, plan);
    }
    for (uint32_t i = 0; i < plan->count; i++) {
        const struct bvh2_node *child = &p->nodes[plan->child[i]];
        if (!is_leaf(child))
            continue;
        uint32_t primitive = p->refs[child->left & ~BVH2_LEAF].primitive;
        if (primitive & BVH_REF_OBJECT) {
            plan->offset[i] = (primitive & ~BVH_REF_OBJECT) << BVH_KIND_BITS | BVH_OBJECT;
        } else {
            plan->offset[i] = (uint32_t)p->units << BVH_KIND_BITS | BVH_LEAF;
            p->units += p->leaf_bytes / BVH_UNIT_BYTES;
        }
    }
    return p->units >> (32 - BVH_KIND_BITS) ? ERR_LIMIT : ERR_OK;
}

/* Depth first, so that what is near in space is near in memory. */
static enum err plan_all(struct planner *p)
{
    struct {
        size_t plan;
        uint32_t next;
    } stack[BVH_DEPTH_MAX + 1];
    int top = 0;
    TL_TRY(plan_node(p, 0, 1, &stack[0].plan));
    stack[top++].next = 0;
    while (top > 0) {
        size_t at = stack[top - 1].plan;
        uint32_t slot = stack[top - 1].next++;
        if (slot == p->plans[at].count) {
            top--;
            continue;
        }
        if (is_leaf(&p->nodes[p->plans[at].child[slot]]))
            continue;
        size_t made = 0;
        TL_TRY(plan_node(p, p->plans[at].child[slot], p->plans[at].depth + 1, &made));
        p->plans[at].offset[slot] = p->plans[made].unit << BVH_KIND_BITS | BVH_NODE;
        stack[top].plan = made;
        stack[top++].next = 0;
    }
    return ERR_OK;
}

struct writer {
    const struct planner *planner;
    struct bvh *out;
    const struct bvh_source *source;
    uint32_t edge_bits; /* of edge_unit */
};

enum { PLANS_PER_TASK = 1024, PLANS_AHEAD = 4 };
enum { EDGE_CODES = 256, EDGE_SHIFT = 20 /* three bits of mantissa */ };

static float float_of(uint32_t bits)
{
    float f;
    memcpy(&f, &bits, sizeof f);
    return f;
}

static uint32_t bits_of(float f)
{
    uint32_t bits;
    memcpy(&bits, &f, sizeof bits);
    return bits;
}

/* The largest extent of a triangle, of all of it: its reference may be a piece. */
static __m128 extent_of(const float v[3][4])
{
    __m128 a = _mm_loadu_ps(v[0]), b = _mm_loadu_ps(v[1]), c = _mm_loadu_ps(v[2]);
    return _mm_sub_ps(_mm_max_ps(_mm_max_ps(a, b), c), _mm_min_ps(_mm_min_ps(a, b), c));
}

/* The least code whose value is at least the largest extent of the triangles. */
static uint32_t edge_code(const float v[BVH_BLOCK][3][4], uint32_t unit_bits)
{
    __m128 most = _mm_setzero_ps();
    for (uint32_t i = 0; i < BVH_BLOCK; i++)
        most = _mm_max_ps(extent_of(v[i]), most);
    most = _mm_max_ps(most, _mm_shuffle_ps(most, most, _MM_SHUFFLE(3, 0, 2, 1)));
    most = _mm_max_ss(most, _mm_shuffle_ps(most, most, _MM_SHUFFLE(2, 2, 2, 2)));
    float edge = _mm_cvtss_f32(most);
    uint32_t bits = bits_of(edge * (1.0f + 0x1p-22f));
    if (bits <= unit_bits)
        return 0;
    uint32_t code = (bits - unit_bits + (1u << EDGE_SHIFT) - 1) >> EDGE_SHIFT;
    return code < EDGE_CODES ? code : EDGE_CODES - 1;
}

/* A leaf's lanes. */
struct lanes {
    const struct bvh_ref *ref[BVH_BLOCK];
    float v[BVH_BLOCK][3][4] __attribute__((aligned(16)));
};

/* Finds them, and writes their ids with the edge code. */
static void leaf_lanes(const struct writer *w, const struct bvh2_node *from, struct lanes *out,
                       uint32_t id[BVH_BLOCK])
{
    const struct bvh_ref *refs = &w->planner->refs[from->left & ~BVH2_LEAF];
    for (uint32_t lane = 0; lane < BVH_BLOCK; lane++) {
        out->ref[lane] = &refs[lane < from->right ? lane : from->right - 1];
        w->source->vertices(w->source->ctx, out->ref[lane], out->v[lane]);
    }
    uint32_t code = edge_code((const float(*)[3][4])out->v, w->edge_bits);
    for (uint32_t lane = 0; lane < BVH_BLOCK; lane++)
        id[lane] =
            out->ref[lane]->primitive | (code >> lane & 1) << 31 | (code >> (4 + lane) & 1) << 30;
}

static void write_packed(const struct writer *w, const struct bvh2_node *from,
                         struct bvh_packed *leaf)
{
    struct lanes lanes;
    leaf_lanes(w, from, &lanes, leaf->id);
    for (uint32_t lane = 0; lane < BVH_BLOCK; lane++) {
        uint32_t vertex[3];
        w->source->indices(w->source->ctx, lanes.ref[lane], vertex);
        for (int i = 0; i < 3; i++)
            leaf->vertex[i][lane] = vertex[i];
    }
}

static void write_leaf(const struct writer *w, const struct bvh2_node *from, struct bvh_leaf *leaf)
{
    struct lanes lanes;
    leaf_lanes(w, from, &lanes, leaf->id);
    for (int i = 0; i < 3; i++) {
        __m128 x = _mm_load_ps(lanes.v[0][i]), y = _mm_load_ps(lanes.v[1][i]);
        __m128 z = _mm_load_ps(lanes.v[2][i]), unused = _mm_load_ps(lanes.v[3][i]);
        _MM_TRANSPOSE4_PS(x, y, z, unused);
        _mm_store_ps(leaf->v[i][0], x);
        _mm_store_ps(leaf->v[i][1], y);
        _mm_store_ps(leaf->v[i][2], z);
    }
}

static void write_node(const struct writer *w, const struct plan *plan)
{
    struct bvh_node *node =
        (struct bvh_node *)(w->out->arena + (size_t)plan->unit * BVH_UNIT_BYTES);
    for (uint32_t i = 0; i < plan->count; i++) {
        const struct bvh2_node *child = &w->planner->nodes[plan->child[i]];
        for (int k = 0; k < 3; k++) {
            node->bounds[2 * k][i] = child->lo[k];
            node->bounds[2 * k + 1][i] = child->hi[k];
        }
        node->child[i] = plan->offset[i];
        void *leaf = w->out->arena + (size_t)(plan->offset[i] >> BVH_KIND_BITS) * BVH_UNIT_BYTES;
        if ((plan->offset[i] & 3) != BVH_LEAF)
            continue;
        if (w->out->compact)
            write_packed(w, child, leaf);
        else
            write_leaf(w, child, leaf);
    }
    for (uint32_t i = plan->count; i < BVH_WIDTH; i++) {
        for (int k = 0; k < 3; k++) {
            node->bounds[2 * k][i] = __builtin_inff();
            node->bounds[2 * k + 1][i] = -__builtin_inff();
        }
        node->child[i] = BVH_EMPTY;
    }
}

static void measure(const struct planner *p, struct bvh *out)
{
    double root = (double)half_area(&p->nodes[0]), sum = 0.0;
    out->node_count = p->count;
    for (size_t i = 0; i < p->count; i++) {
        const struct plan *plan = &p->plans[i];
        out->depth_max = plan->depth > out->depth_max ? plan->depth : out->depth_max;
        for (uint32_t c = 0; c < plan->count; c++) {
            sum += (double)half_area(&p->nodes[plan->child[c]]);
            out->leaf_count += is_leaf(&p->nodes[plan->child[c]]);
        }
    }
    out->sah_cost = root > 0.0 ? (root + sum) / root : 0.0;
}

static double binary_cost(const struct bvh2 *tree)
{
    double sum = 0.0, root = (double)half_area(&tree->nodes[0]);
    for (size_t run = 0; run < tree->run_count; run++)
        sum += tree->runs[run].area;
    return root > 0.0 ? sum / root : 0.0;
}

/* The unit of the edge code: its largest code covers the largest extent of all. */
static uint32_t edge_unit_bits(float edge)
{
    const uint32_t smallest = 0x00800000, span = (uint32_t)(EDGE_CODES - 1) << EDGE_SHIFT;
    uint32_t bits = bits_of(edge * (1.0f + 0x1p-21f));
    return bits > span + smallest ? bits - span : smallest;
}

/* The vertices of a node's leaves lie where the mesh has them: asked for before they are wanted. */
static void ask_for_leaves(const struct writer *w, const struct plan *plan)
{
    for (uint32_t i = 0; i < plan->count; i++) {
        const struct bvh2_node *child = &w->planner->nodes[plan->child[i]];
        if ((plan->offset[i] & 3) != BVH_LEAF)
            continue;
        const struct bvh_ref *refs = &w->planner->refs[child->left & ~BVH2_LEAF];
        for (uint32_t lane = 0; lane < child->right; lane++)
            w->source->ask(w->source->ctx, &refs[lane]);
    }
}

static void write_some(void *arg, size_t index)
{
    const struct writer *w = arg;
    size_t begin = index * PLANS_PER_TASK, end = begin + PLANS_PER_TASK;
    end = end < w->planner->count ? end : w->planner->count;
    for (size_t i = begin; i < end; i++) {
        if (i + PLANS_AHEAD < end)
            ask_for_leaves(w, &w->planner->plans[i + PLANS_AHEAD]);
        write_node(w, &w->planner->plans[i]);
    }
}

/* Takes the units of a planned tree from the place and moves its references there. */
static enum err settle(struct planner *p, struct bvh_place *place, size_t *first)
{
    uint32_t depth = 0;
    for (size_t i = 0; i < p->count; i++)
        depth = p->plans[i].depth > depth ? p->plans[i].depth : depth;
    if (depth > BVH_PLACED_DEPTH_MAX)
        return ERR_LIMIT;
    size_t begin = atomic_fetch_add(&place->units_used, p->units);
    TL_ASSERT(begin + p->units <= place->units); /* the place has room for any tree */
    for (size_t i = 0; i < p->count; i++) {
        struct plan *plan = &p->plans[i];
        plan->unit += (uint32_t)begin;
        for (uint32_t c = 0; c < plan->count; c++)
            if ((plan->offset[c] & 3) != BVH_OBJECT)
                plan->offset[c] += (uint32_t)begin << BVH_KIND_BITS;
    }
    *first = begin;
    return ERR_OK;
}

/* Where the planned tree is written: an arena of its own, or within the place. */
static enum err find_arena(struct planner *p, struct bvh_place *place, struct bvh *out)
{
    size_t first = 0;
    if (place)
        TL_TRY(settle(p, place, &first));
    out->bytes = (size_t)p->units * BVH_UNIT_BYTES;
    out->arena = place ? place->arena : bvh_alloc(out->bytes, 1);
    out->root = (uint32_t)first << BVH_KIND_BITS | BVH_NODE;
    return out->arena ? ERR_OK : ERR_NOMEM;
}

static enum err wide_build(const struct bvh2 *tree, const struct bvh_how *how,
                           const struct bvh_source *source, struct bvh *out)
{
    enum err err = ERR_NOMEM;
    struct choosing choosing = {tree, NULL, NULL};
    struct planner p = {.nodes = tree->nodes, .refs = tree->refs};
    p.leaf_bytes = how->compact ? sizeof(struct bvh_packed) : sizeof(struct bvh_leaf);
    out->compact = how->compact;
    /* Only partly used. */
    choosing.choices = mem_alloc_aligned(tree->node_limit * sizeof *choosing.choices, 64);
    choosing.costs = mem_alloc_aligned(tree->node_limit * sizeof *choosing.costs, 64);
    if (!choosing.choices || !choosing.costs)
        goto done;
    bvh_run(how->runner, tree->run_count - 1, choose_task, &choosing);
    choose_top(&choosing);
    p.choices = choosing.choices;
    err = plan_all(&p);
    if (!err)
        err = find_arena(&p, how->place, out);
    if (err)
        goto done;
    struct writer w = {&p, out, source, edge_unit_bits(how->edge)};
    bvh_run(how->runner, (p.count + PLANS_PER_TASK - 1) / PLANS_PER_TASK, write_some, &w);
    out->edge_unit = float_of(w.edge_bits);
    measure(&p, out);
    out->sah_binary = binary_cost(tree);
done:
    mem_free(choosing.costs);
    mem_free(choosing.choices);
    mem_free(p.plans);
    return err;
}

enum err bvh_new(struct bvh_ref *refs, size_t count, const struct bvh_how *how,
                 const struct bvh_source *source, struct bvh *out)
{
    struct bvh made = {.root = BVH_EMPTY};
    *out = made;
    if (count == 0 || count > BVH_PRIMITIVES_MAX) {
        mem_free(refs);
        return count ? ERR_LIMIT : ERR_OK;
    }
    struct bvh2 tree;
    enum err err = bvh2_build(refs, (uint32_t)count, how, source, &tree);
    if (err)
        return err;
    err = wide_build(&tree, how, source, &made);
    bvh2_release(&tree);
    if (err == ERR_OK)
        *out = made;
    return err;
}

enum err bvh_place_new(size_t ref_count, float edge, struct bvh_place *out)
{
    /* At worst every reference is a leaf, and every node has two children. */
    const size_t units_each = (sizeof(struct bvh_node) + sizeof(struct bvh_leaf)) / BVH_UNIT_BYTES;
    size_t units = (ref_count + 1) * units_each;
    if (units >> (32 - BVH_KIND_BITS))
        return ERR_LIMIT;
    out->arena = bvh_alloc(units, BVH_UNIT_BYTES);
    out->units = units;
    out->edge = edge;
    atomic_init(&out->units_used, 0);
    return out->arena ? ERR_OK : ERR_NOMEM;
}

void bvh_place_release(struct bvh_place *p)
{
    mem_free(p->arena);
    p->arena = NULL;
}

void bvh_release(struct bvh *b)
{
    mem_free(b->arena);
    *b = (struct bvh){.root = BVH_EMPTY};
}
