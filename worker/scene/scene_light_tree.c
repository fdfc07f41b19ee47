/* The tree over the lights that have a place, top down: among 12 slices along each axis, the cut of
 * the least cost (intensity times extent times solid angle of the cones, Conty and Kulla 2018,
 * eq. 1, with the square of the box's diagonal for its area, which lights in a plane or on a line
 * have too). One light per leaf. Owns no memory but the arena's. One thread. */
#include "common/dmath.h"
#include "worker/scene/scene_parts.h"

enum {
    SLICES = 12,
    /* Cuts by cost go no deeper: then halves by count, so that depth is bounded. */
    COST_DEPTH_MAX = 48,
    STACK_MAX = COST_DEPTH_MAX + 34,
};

/* By which a cone or angle is made wider, so that no rounding loses a direction. */
static const double COSINE_SLACK = 1e-12;

struct bounds {
    double low[3], high[3];
    vec3 axis;
    double cos_o, cos_e;
    double intensity; /* 0: of nothing */
};

struct item {
    struct bounds b;
    uint32_t light;
};

static const struct bounds nothing = {
    .low = {VEC_INFINITY, VEC_INFINITY, VEC_INFINITY},
    .high = {-VEC_INFINITY, -VEC_INFINITY, -VEC_INFINITY},
};

static double clamp_cosine(double c)
{
    return c < -1 ? -1 : c > 1 ? 1 : c;
}

/* The cone about two cones. */
static void unite_cones(struct bounds *a, const struct bounds *b)
{
    double dot = clamp_cosine(v3_dot(a->axis, b->axis));
    double oa = dmath_acos(a->cos_o), ob = dmath_acos(b->cos_o), apart = dmath_acos(dot);
    if (apart + ob <= oa)
        return;
    if (apart + oa <= ob) {
        a->axis = b->axis;
        a->cos_o = b->cos_o;
        return;
    }
    double o = (oa + apart + ob) / 2;
    vec3 aside = v3_mad(b->axis, a->axis, -dot);
    double length = v3_length(aside);
    if (o >= VEC_PI || !(length > 1e-9)) {
        /* Opposite axes have no middle; axes that are one have the wider cone's. */
        a->cos_o = dot > 0 && o < VEC_PI ? (oa > ob ? a->cos_o : b->cos_o) : -1;
        return;
    }
    double s, c, so, co;
    dmath_sincos(o - oa, &s, &c);
    dmath_sincos(o, &so, &co);
    a->axis = v3_unit(v3_mad(v3_scale(a->axis, c), aside, s / length));
    a->cos_o = clamp_cosine(co - COSINE_SLACK);
}

static void unite(struct bounds *a, const struct bounds *b)
{
    if (!(a->intensity > 0)) {
        *a = *b;
        return;
    }
    for (int k = 0; k < 3; k++) {
        a->low[k] = b->low[k] < a->low[k] ? b->low[k] : a->low[k];
        a->high[k] = b->high[k] > a->high[k] ? b->high[k] : a->high[k];
    }
    unite_cones(a, b);
    a->cos_e = b->cos_e < a->cos_e ? b->cos_e : a->cos_e;
    a->intensity += b->intensity;
}

static void include(struct bounds *b, vec3 p)
{
    const double v[3] = {p.x, p.y, p.z};
    for (int k = 0; k < 3; k++) {
        b->low[k] = v[k] < b->low[k] ? v[k] : b->low[k];
        b->high[k] = v[k] > b->high[k] ? v[k] : b->high[k];
    }
}

/* `intensity` is along the axis of the light, times 1 / pi for an area. */
static struct bounds bounds_of(const struct light *l, double intensity)
{
    struct bounds b = nothing;
    b.axis = l->n;
    b.intensity = intensity;
    bool flat = l->type == LIGHT_TRIANGLE || l->type == LIGHT_QUAD;
    b.cos_o = flat && !l->twosided ? 1 - COSINE_SLACK : -1;
    include(&b, l->v0);
    switch (l->type) {
    case LIGHT_QUAD:
        include(&b, v3_add(v3_add(l->v0, l->e1), l->e2));
        include(&b, v3_add(l->v0, l->e1));
        include(&b, v3_add(l->v0, l->e2));
        break;
    case LIGHT_TRIANGLE:
        include(&b, v3_add(l->v0, l->e1));
        include(&b, v3_add(l->v0, l->e2));
        break;
    case LIGHT_SPHERE:
        for (int k = 0; k < 3; k++) {
            b.low[k] -= l->radius;
            b.high[k] += l->radius;
        }
        b.axis = v3(0, 0, 1);
        break;
    case LIGHT_SPOT: {
        double inner = dmath_acos(clamp_cosine(l->cos_inner));
        double s, outer = dmath_acos(clamp_cosine(l->cos_outer));
        dmath_sincos(outer - inner, &s, &b.cos_e);
        b.cos_o = clamp_cosine(l->cos_inner - COSINE_SLACK);
        b.cos_e -= COSINE_SLACK;
        break;
    }
    default:
        break;
    }
    return b;
}

static double diagonal2(const struct bounds *b)
{
    double sum = 0;
    for (int k = 0; k < 3; k++)
        sum += (b->high[k] - b->low[k]) * (b->high[k] - b->low[k]);
    return sum;
}

static double cost_of(const struct bounds *b)
{
    if (!(b->intensity > 0))
        return 0;
    double o = dmath_acos(b->cos_o), e = dmath_acos(clamp_cosine(b->cos_e));
    double w = o + e < VEC_PI ? o + e : VEC_PI, so, co, s, c;
    dmath_sincos(o, &so, &co);
    dmath_sincos(o - 2 * w, &s, &c);
    double angle = 2 * VEC_PI * (1 - co) + VEC_PI / 2 * (2 * w * so - c - 2 * o * so + co);
    return b->intensity * angle * diagonal2(b);
}

static double middle(const struct item *it, int axis)
{
    return 0.5 * (it->b.low[axis] + it->b.high[axis]);
}

static int slice_of(const struct item *it, int axis, double low, double high)
{
    int s = (int)((middle(it, axis) - low) / (high - low) * SLICES);
    return s < 0 ? 0 : s >= SLICES ? SLICES - 1 : s;
}

struct cut {
    int axis, slice; /* slices up to this one come first */
    double low, high, cost;
};

/* Looks for a better cut along one axis. */
static void try_axis(const struct item *items, uint32_t count, int axis, double longest,
                     struct cut *best)
{
    double low = VEC_INFINITY, high = -VEC_INFINITY;
    for (uint32_t i = 0; i < count; i++) {
        double m = middle(&items[i], axis);
        low = m < low ? m : low;
        high = m > high ? m : high;
    }
    if (!(high > low))
        return;
    struct bounds slices[SLICES], after[SLICES];
    for (int s = 0; s < SLICES; s++)
        slices[s] = nothing;
    for (uint32_t i = 0; i < count; i++)
        unite(&slices[slice_of(&items[i], axis, low, high)], &items[i].b);
    after[SLICES - 1] = slices[SLICES - 1];
    for (int s = SLICES - 2; s > 0; s--) {
        after[s] = after[s + 1];
        if (slices[s].intensity > 0)
            unite(&after[s], &slices[s]);
    }
    struct bounds before = nothing;
    for (int s = 0; s < SLICES - 1; s++) {
        if (slices[s].intensity > 0)
            unite(&before, &slices[s]);
        double cost = longest / (high - low) * (cost_of(&before) + cost_of(&after[s + 1]));
        if (before.intensity > 0 && after[s + 1].intensity > 0 && cost < best->cost)
            *best = (struct cut){axis, s, low, high, cost};
    }
}

/* Puts the items before the cut first; how many those are. */
static uint32_t partition(struct item *items, uint32_t count, const struct cut *cut)
{
    uint32_t first = 0;
    for (uint32_t i = 0; i < count; i++) {
        if (slice_of(&items[i], cut->axis, cut->low, cut->high) > cut->slice)
            continue;
        struct item it = items[i];
        items[i] = items[first];
        items[first++] = it;
    }
    return first;
}

static uint32_t split(struct item *items, uint32_t count, const struct bounds *all, uint32_t depth)
{
    struct cut best = {.cost = VEC_INFINITY};
    double longest = 0;
    for (int k = 0; k < 3; k++)
        longest = all->high[k] - all->low[k] > longest ? all->high[k] - all->low[k] : longest;
    for (int k = 0; k < 3 && depth < COST_DEPTH_MAX; k++)
        try_axis(items, count, k, longest, &best);
    return best.cost < VEC_INFINITY ? partition(items, count, &best) : count / 2;
}

static void fill_node(struct light_node *n, const struct bounds *b)
{
    *n = (struct light_node){0};
    n->center = v3(0.5 * (b->low[0] + b->high[0]), 0.5 * (b->low[1] + b->high[1]),
                   0.5 * (b->low[2] + b->high[2]));
    n->radius2 = 0.25 * diagonal2(b);
    n->radius = sqrt(n->radius2);
    n->axis = b->axis;
    n->cos_o = b->cos_o;
    n->sin_o = sqrt(1 - b->cos_o * b->cos_o);
    n->cos_e = b->cos_e;
    n->intensity = b->intensity;
}

/* A range of items whose node is still to be made. */
struct todo {
    uint32_t begin, count, parent, depth;
    bool second;
};

static void build_nodes(struct item *items, uint32_t count, struct light_node *nodes,
                        uint32_t *leaf_of)
{
    struct todo stack[STACK_MAX];
    uint32_t used = 0, made = 0;
    stack[used++] = (struct todo){.count = count};
    while (used > 0) {
        struct todo t = stack[--used];
        struct bounds all = nothing;
        for (uint32_t i = 0; i < t.count; i++)
            unite(&all, &items[t.begin + i].b);
        uint32_t index = made++;
        fill_node(&nodes[index], &all);
        nodes[index].parent = t.parent;
        if (t.second)
            nodes[t.parent].right = index;
        if (t.count == 1) {
            nodes[index].light = items[t.begin].light;
            leaf_of[items[t.begin].light] = index;
            continue;
        }
        uint32_t first = split(items + t.begin, t.count, &all, t.depth);
        TL_ASSERT(first > 0 && first < t.count && used + 2 <= STACK_MAX);
        stack[used++] = (struct todo){t.begin + first, t.count - first, index, t.depth + 1, true};
        stack[used++] = (struct todo){t.begin, first, index, t.depth + 1, false};
    }
}

enum err scene_build_light_tree(struct render_scene *rs, const double *intensities)
{
    struct light_table *t = &rs->lights;
    uint32_t count = 0;
    struct item *items = mem_alloc_array(t->count, sizeof *items);
    if (!items)
        return ERR_NOMEM;
    for (size_t i = 0; i < t->count; i++)
        if (light_has_place(&t->lights[i]) && intensities[i] > 0)
            items[count++] = (struct item){bounds_of(&t->lights[i], intensities[i]), (uint32_t)i};
    struct light_node *nodes = arena_alloc(&rs->arena, 2 * (size_t)count, sizeof *nodes);
    uint32_t *leaf_of = arena_alloc(&rs->arena, t->count, sizeof *leaf_of);
    enum err e = nodes && leaf_of ? ERR_OK : ERR_NOMEM;
    for (size_t i = 0; e == ERR_OK && i < t->count; i++)
        leaf_of[i] = UINT32_MAX;
    if (e == ERR_OK && count > 0) {
        build_nodes(items, count, nodes, leaf_of);
        t->tree = (struct light_tree){.nodes = nodes, .leaf_of = leaf_of};
    }
    mem_free(items);
    return e;
}
