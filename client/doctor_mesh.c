#include "client/doctor_mesh.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"

/* --- Vertices ------------------------------------------------------------ */

static uint64_t hash_of(const double p[3])
{
    uint64_t h = 0;
    for (int k = 0; k < 3; k++) {
        uint64_t bits;
        memcpy(&bits, &p[k], sizeof bits);
        h = (h ^ bits) * UINT64_C(0x9e3779b97f4a7c15);
        h ^= h >> 29;
    }
    return h;
}

/* out[v]: the lowest vertex at v's place. */
static enum err weld(const struct scene_mesh *m, uint32_t *out)
{
    size_t slots = 16;
    while (slots < 2 * (size_t)m->vertex_count)
        slots *= 2;
    uint32_t *table = mem_alloc_array(slots, sizeof *table);
    if (!table)
        return ERR_NOMEM;
    memset(table, 0xff, slots * sizeof *table);
    for (uint32_t v = 0; v < m->vertex_count; v++) {
        double p[3];
        for (size_t k = 0; k < 3; k++)
            p[k] = m->positions[3 * (size_t)v + k] + 0.0; /* one zero */
        size_t at = (size_t)hash_of(p) & (slots - 1);
        for (; table[at] != SCENE_NONE; at = (at + 1) & (slots - 1)) {
            const double *q = m->positions + 3 * (size_t)table[at];
            if (q[0] == p[0] && q[1] == p[1] && q[2] == p[2])
                break;
        }
        if (table[at] == SCENE_NONE)
            table[at] = v;
        out[v] = table[at];
    }
    mem_free(table);
    return ERR_OK;
}

static void measure_bounds(const struct scene_mesh *m, struct doctor_mesh *out)
{
    for (int k = 0; k < 3; k++) {
        out->low[k] = DBL_MAX;
        out->high[k] = -DBL_MAX;
    }
    for (size_t i = 0; i < m->vertex_count; i++) {
        const double *p = m->positions + 3 * i;
        for (int k = 0; k < 3; k++) {
            out->low[k] = p[k] < out->low[k] ? p[k] : out->low[k];
            out->high[k] = p[k] > out->high[k] ? p[k] : out->high[k];
        }
    }
}

/* The distance from x to the next float, or double. */
static double ulp_of(double x, int mantissa_bits)
{
    int exponent;
    (void)frexp(x, &exponent);
    return ldexp(1, exponent - mantissa_bits);
}

/* The largest power of ten that all of an axis's coordinates (of some thousands) are multiples of,
 * or `finest` when that is smaller. */
static double decimal_step(const struct scene_mesh *m, size_t axis, double finest)
{
    enum { LOOKED_AT = 4096, FIRST = 15, LAST = -20 };
    size_t stride = m->vertex_count / LOOKED_AT + 1;
    for (int power = FIRST; power >= LAST; power--) {
        double ten = pow(10, abs(power)), step = power < 0 ? 1 / ten : ten;
        bool all = step > finest;
        for (size_t v = 0; all && v < m->vertex_count; v += stride) {
            double p = m->positions[3 * v + axis], x = power < 0 ? p * ten : p / ten;
            all = fabs(x - nearbyint(x)) <= fabs(x) * 0x1p-51;
        }
        if (all)
            return step;
    }
    return finest;
}

/* In what steps an axis's coordinates come: those of floats if all of them are, or of decimals. */
static double axis_step(const struct scene_mesh *m, size_t axis, double reach)
{
    bool floats = true;
    for (size_t v = 0; floats && v < m->vertex_count; v++) {
        double p = m->positions[3 * v + axis];
        floats = (double)(float)p == p;
    }
    return decimal_step(m, axis, ulp_of(reach, floats ? 24 : 53));
}

/* The axis with the coarsest steps that digits could be to blame for: coarser ones than these
 * parts of the distance are someone's round numbers. */
static void measure_steps(const struct scene_mesh *m, struct doctor_mesh *out)
{
    const double digits = 1e-5;
    for (size_t k = 0; k < 3; k++) {
        double reach = fmax(fabs(out->low[k]), fabs(out->high[k]));
        double step = reach > 0 ? axis_step(m, k, reach) : 0;
        if (step < digits * reach && step > out->step) {
            out->step = step;
            out->reach = reach;
        }
    }
}

/* --- Triangles ------------------------------------------------------------ */

static void count_at(struct doctor_count *c, uint32_t triangle)
{
    if (c->count++ == 0 || triangle < c->first)
        c->first = triangle;
}

/* Lengths by powers of two: enough for a median to a factor of two. */
struct lengths {
    uint64_t of[2200], total;
    double unit; /* a power of two that brings the mesh to about 1: products stay in range */
};

static void add_length(struct lengths *l, double length2)
{
    int exponent;
    if (!(length2 > 0))
        return;
    (void)frexp(sqrt(length2), &exponent);
    l->of[exponent + 1100]++;
    l->total++;
}

static double median_length(const struct lengths *l)
{
    uint64_t seen = 0;
    for (int i = 0; i < 2200; i++) {
        seen += l->of[i];
        if (l->total && 2 * seen >= l->total)
            return ldexp(0.75, i - 1100) / l->unit;
    }
    return 0;
}

static void measure_triangle(const struct scene_mesh *m, uint32_t t, struct lengths *lengths,
                             struct doctor_mesh *out)
{
    const double *p[3];
    double e[3][3], n[3], length2[3], longest2 = 0, area2 = 0;
    for (size_t i = 0; i < 3; i++)
        p[i] = m->positions + 3 * (size_t)m->indices[3 * (size_t)t + i];
    for (size_t i = 0; i < 3; i++) {
        length2[i] = 0;
        for (int k = 0; k < 3; k++) {
            e[i][k] = (p[(i + 1) % 3][k] - p[i][k]) * lengths->unit;
            length2[i] += e[i][k] * e[i][k];
        }
        add_length(lengths, length2[i]);
        longest2 = length2[i] > longest2 ? length2[i] : longest2;
    }
    for (int k = 0; k < 3; k++) {
        int x = (k + 1) % 3, y = (k + 2) % 3;
        n[k] = e[0][x] * e[1][y] - e[0][y] * e[1][x];
        area2 += n[k] * n[k];
        out->volume_signed += n[k] / 6 * ((p[0][k] - out->low[k]) * lengths->unit);
    }
    double area = sqrt(area2);
    /* Below this the cross product is rounding alone. */
    if (!(area > longest2 * 0x1p-50)) {
        count_at(&out->flat, t);
        return;
    }
    double aspect = longest2 / area;
    out->aspect_max = aspect > out->aspect_max ? aspect : out->aspect_max;
    if (aspect > DOCTOR_NEEDLE_ASPECT)
        count_at(&out->needles, t);
    if (!m->normals)
        return;
    bool front = false, back = false;
    for (size_t i = 0; i < 3; i++) {
        const float *f = m->normals + 3 * (size_t)m->indices[3 * (size_t)t + i];
        double cosine = n[0] * (double)f[0] + n[1] * (double)f[1] + n[2] * (double)f[2];
        front |= cosine > 0;
        back |= cosine < 0;
    }
    if (front && back)
        count_at(&out->against, t);
}

/* --- Pairs ------------------------------------------------------------------ */

struct corners {
    uint32_t vertex[3]; /* welded, ascending */
    uint32_t triangle;
};

static int compare_corners(const void *a, const void *b)
{
    const struct corners *x = a, *y = b;
    for (int k = 0; k < 3; k++)
        if (x->vertex[k] != y->vertex[k])
            return x->vertex[k] < y->vertex[k] ? -1 : 1;
    return x->triangle < y->triangle ? -1 : x->triangle > y->triangle;
}

static void sort_three(uint32_t v[3])
{
    for (int i = 0; i < 3; i++) {
        int a = i == 1 ? 1 : 0; /* 0-1, 1-2, 0-1 */
        if (v[a] > v[a + 1]) {
            uint32_t swap = v[a];
            v[a] = v[a + 1];
            v[a + 1] = swap;
        }
    }
}

static enum err find_duplicates(const struct scene_mesh *m, const uint32_t *welded,
                                struct doctor_mesh *out)
{
    struct corners *all = mem_alloc_array(m->triangle_count, sizeof *all);
    size_t count = 0;
    if (!all)
        return ERR_NOMEM;
    for (uint32_t t = 0; t < m->triangle_count; t++) {
        struct corners *c = &all[count];
        for (size_t k = 0; k < 3; k++)
            c->vertex[k] = welded[m->indices[3 * (size_t)t + k]];
        c->triangle = t;
        sort_three(c->vertex);
        /* Repeated corners are counted as flat. */
        count += c->vertex[0] != c->vertex[1] && c->vertex[1] != c->vertex[2];
    }
    qsort(all, count, sizeof *all, compare_corners);
    for (size_t i = 1; i < count; i++)
        if (memcmp(all[i].vertex, all[i - 1].vertex, sizeof all[i].vertex) == 0)
            count_at(&out->duplicates, all[i].triangle);
    mem_free(all);
    return ERR_OK;
}

struct edge {
    uint32_t low, high; /* welded */
    uint32_t triangle;
    uint32_t forward; /* 1: the triangle runs from low to high */
};

static int compare_edges(const void *a, const void *b)
{
    const struct edge *x = a, *y = b;
    if (x->low != y->low)
        return x->low < y->low ? -1 : 1;
    if (x->high != y->high)
        return x->high < y->high ? -1 : 1;
    return x->triangle < y->triangle ? -1 : x->triangle > y->triangle;
}

/* Of the triangles that share one edge. */
static void judge_edge(const struct edge *e, size_t count, struct doctor_mesh *out)
{
    size_t forward = 0;
    for (size_t i = 0; i < count; i++)
        forward += e[i].forward;
    if (count % 2)
        out->closed = false;
    if (count == 1)
        count_at(&out->open_edges, e->triangle);
    else if (count > 2)
        count_at(&out->fans, e->triangle);
    else if (forward != 1)
        count_at(&out->turned, e->triangle);
}

static enum err find_edges(const struct scene_mesh *m, const uint32_t *welded,
                           struct doctor_mesh *out)
{
    struct edge *all = mem_alloc_array(m->triangle_count, 3 * sizeof *all);
    size_t count = 0;
    if (!all)
        return ERR_NOMEM;
    for (uint32_t t = 0; t < m->triangle_count; t++) {
        const uint32_t *v = m->indices + 3 * (size_t)t;
        uint32_t w[3] = {welded[v[0]], welded[v[1]], welded[v[2]]};
        if (w[0] == w[1] || w[1] == w[2] || w[2] == w[0])
            continue;
        for (size_t k = 0; k < 3; k++) {
            uint32_t a = w[k], b = w[(k + 1) % 3];
            all[count++] = (struct edge){a < b ? a : b, a < b ? b : a, t, a < b};
        }
    }
    qsort(all, count, sizeof *all, compare_edges);
    out->closed = count > 0;
    for (size_t i = 0, next; i < count; i = next) {
        next = i + 1;
        while (next < count && all[next].low == all[i].low && all[next].high == all[i].high)
            next++;
        judge_edge(all + i, next - i, out);
    }
    mem_free(all);
    return ERR_OK;
}

/* --- All ---------------------------------------------------------------------- */

enum err doctor_mesh_measure(const struct scene_mesh *mesh, struct doctor_mesh *out)
{
    struct lengths *lengths = mem_calloc(1, sizeof *lengths);
    if (!lengths)
        return ERR_NOMEM;
    *out = (struct doctor_mesh){0};
    measure_bounds(mesh, out);
    measure_steps(mesh, out);
    double extent = 0;
    int exponent;
    for (int k = 0; k < 3; k++)
        extent = fmax(extent, out->high[k] - out->low[k]);
    (void)frexp(extent, &exponent);
    lengths->unit = ldexp(1, exponent > -1000 ? -exponent : 1000);
    for (uint32_t t = 0; t < mesh->triangle_count; t++)
        measure_triangle(mesh, t, lengths, out);
    out->edge_median = median_length(lengths);
    mem_free(lengths);
    return ERR_OK;
}

enum err doctor_mesh_examine(const struct scene_mesh *mesh, struct doctor_mesh *out)
{
    uint32_t *welded = mem_alloc_array(mesh->vertex_count, sizeof *welded);
    enum err e = welded ? doctor_mesh_measure(mesh, out) : ERR_NOMEM;
    if (e == ERR_OK)
        e = weld(mesh, welded);
    if (e == ERR_OK)
        e = find_duplicates(mesh, welded, out);
    if (e == ERR_OK)
        e = find_edges(mesh, welded, out);
    mem_free(welded);
    return e;
}

/* In half extents, from the origin: nearer, no mesh has lost detail to its place. */
static const double far_halves = 16;

static double half_extent(const struct doctor_mesh *m)
{
    double half = 0;
    for (int k = 0; k < 3; k++)
        half = fmax(half, 0.5 * (m->high[k] - m->low[k]));
    return half;
}

bool doctor_mesh_may_be_coarse(const struct scene_mesh *mesh)
{
    struct doctor_mesh m;
    double reach = 0;
    measure_bounds(mesh, &m);
    for (int k = 0; k < 3; k++)
        reach = fmax(reach, fmax(fabs(m.low[k]), fabs(m.high[k])));
    return reach > far_halves * half_extent(&m);
}

bool doctor_mesh_is_coarse(const struct doctor_mesh *m)
{
    const double edge_steps = 1e4;
    return m->reach > far_halves * half_extent(m) && m->edge_median < edge_steps * m->step;
}
