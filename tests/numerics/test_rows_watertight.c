/* T5 to T8: no ray leaks, no box is missed, needles are met where they are. */
#include "tests/numerics/rows.h"

#include <math.h>
#include <stdlib.h>

#include "common/mem.h"
#include "common/scene.h"
#include "tests/numerics/closed_mesh.h"
#include "tests/prop/test_accel_kit.h"
#include "worker/render/accel_parts.h"

/* The plain kernel's own box test, which is static there. */
#include "worker/render/trace_plain.c"

static const enum accel_isa isas[] = {ACCEL_ISA_SSE2, ACCEL_ISA_AVX2, ACCEL_ISA_AVX512};

/* --- T5 ---------------------------------------------------------------------- */

/* Rays from inside that hit nothing, one by one and in batches. */
static size_t count_leaks(const struct accel *a, const struct gen_mesh *m, size_t count)
{
    enum { BATCH = 1000 };
    static struct ray rays[BATCH];
    static struct hit hits[BATCH];
    uint64_t state = 7;
    size_t leaks = 0;
    for (size_t i = 0; i < count; i += BATCH) {
        for (size_t j = 0; j < BATCH; j++)
            closed_ray(m, &state, i + j, &rays[j]);
        accel_closest_batch(a, rays, BATCH, hits);
        for (size_t j = 0; j < BATCH; j++) {
            leaks += hits[j].object == SCENE_NONE;
            if (i % (10 * BATCH) == 0)
                leaks += !accel_occluded(a, &rays[j]);
        }
    }
    return leaks;
}

/* The rays that one builder and kernel get: 10^8 with --long, but for brute force, which would take
 * days. */
static size_t leak_rays(bool brute)
{
    if (brute)
        return rows_long ? 300000 : 2000;
    return rows_long ? 100000000 : 100000;
}

/* Every mesh through every kernel and builder. */
static void test_t05_leaks(void **state)
{
    (void)state;
    for (int kind = 0; kind < CLOSED_KINDS; kind++) {
        struct gen_mesh mesh, copy;
        struct trace_scene s;
        closed_make((enum closed_kind)kind, &mesh);
        copy = mesh;
        trace_scene_wrap(&s, &mesh);
        size_t total = 0, leaks = 0;
        for (int builder = 0; builder < JOB_BUILDER_COUNT; builder++)
            for (int i = 0; i < 3; i++) {
                bool brute = builder == JOB_BUILDER_NONE;
                if (brute && i > 0)
                    continue; /* without a tree there is one kernel */
                struct accel *a = kit_build(&s.input, (enum job_builder)builder, isas[i], NULL);
                leaks += count_leaks(a, &copy, leak_rays(brute));
                total += leak_rays(brute);
                accel_free(a);
            }
        printf("  T5 %s: %zu leaks of %zu rays\n", closed_names[kind], leaks, total);
        (void)fflush(stdout);
        assert_int_equal(leaks, 0);
        trace_scene_release(&s);
    }
}

/* Rows 0 to 2 of the inverse, as the scene build computes it: by cofactors, in double. */
static void affine_inverse(const double m[12], double out[12])
{
    double c[9];
    for (int r = 0; r < 3; r++)
        for (int k = 0; k < 3; k++) {
            int r1 = 4 * ((r + 1) % 3), r2 = 4 * ((r + 2) % 3), k1 = (k + 1) % 3, k2 = (k + 2) % 3;
            c[3 * r + k] = m[r1 + k1] * m[r2 + k2] - m[r1 + k2] * m[r2 + k1];
        }
    double det = m[0] * c[0] + m[1] * c[1] + m[2] * c[2];
    for (int r = 0; r < 3; r++) {
        for (int k = 0; k < 3; k++)
            out[4 * r + k] = c[3 * k + r] / det;
        out[4 * r + 3] = -(out[4 * r] * m[3] + out[4 * r + 1] * m[7] + out[4 * r + 2] * m[11]);
    }
}

/* Rays from inside a mesh under a transform, at what its vertices and edges have become. */
static size_t instance_leaks(const struct gen_mesh *m, const double to_scene[12], bool compact,
                             size_t count)
{
    struct accel_mesh view = {m->positions, m->indices, (uint32_t)m->vertex_count,
                              (uint32_t)m->triangle_count};
    struct accel_object object = {.type = ACCEL_INSTANCE};
    struct accel_input input = {&view, 1, &object, 1};
    struct accel_options options = {.compact = compact};
    struct accel *a;
    uint64_t state = 8;
    size_t leaks = 0;
    memcpy(object.to_scene, to_scene, sizeof object.to_scene);
    affine_inverse(to_scene, object.from_scene);
    assert_int_equal(accel_new(&input, &options, NULL, &a), ERR_OK);
    for (size_t i = 0; i < count; i++) {
        struct ray ray, at;
        struct hit hit;
        closed_ray(m, &state, i, &ray);
        at = ray;
        for (int r = 0; r < 3; r++) {
            const double *row = to_scene + 4 * r;
            double to = row[3];
            at.org[r] = row[3];
            for (int k = 0; k < 3; k++) {
                at.org[r] += row[k] * ray.org[k];
                to += row[k] * (ray.org[k] + ray.dir[k]);
            }
            at.dir[r] = to - at.org[r];
        }
        accel_closest(a, &at, &hit);
        leaks += hit.object == SCENE_NONE;
    }
    accel_free(a);
    return leaks;
}

/* The other ways to a triangle: an instance under a shear and a mirroring, and a tree of less
 * memory. */
static void test_t05_instances(void **state)
{
    (void)state;
    static const double shears[][12] = {
        {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0},
        {1, 0.7, -0.3, 0.125, 0, 1, 0.9, -3.7, 0, 0, 1, 1e3},
        {1e-5, 0, 0, 0, 0, -1e-5, 0, 1e-7, 0, 0, 1e-5, 0.3},
        {0.6, -800, 0, 1e6, 0.8, 600, 0, 0, 0, 0, 1e-3, 0},
    };
    for (int kind = 0; kind < CLOSED_KINDS; kind++)
        for (size_t k = 0; k < sizeof shears / sizeof *shears; k++)
            for (int compact = 0; compact < 2; compact++) {
                struct gen_mesh mesh;
                closed_make((enum closed_kind)kind, &mesh);
                size_t count = rows_long ? 5000000 : 60000;
                size_t leaks = instance_leaks(&mesh, shears[k], compact, count);
                if (leaks)
                    fail_msg("%s, transform %zu, compact %d: %zu leaks of %zu", closed_names[kind],
                             k, compact, leaks, count);
                gen_mesh_release(&mesh);
            }
}

/* --- T6 ---------------------------------------------------------------------- */

/* A grid of 2 x 2 squares a side SIDE on the plane through three lattice axes: z = sx x + sy y,
 * turned so that `axis` is z. */
enum { SIDE = 8 };

struct lattice {
    int axis, slope[2];
    int64_t scale; /* the mesh and the rays in this many units */
};

static void lattice_point(const struct lattice *l, int x, int y, int out[3])
{
    out[(l->axis + 1) % 3] = x;
    out[(l->axis + 2) % 3] = y;
    out[l->axis] = l->slope[0] * x + l->slope[1] * y;
}

static void lattice_mesh(const struct lattice *l, struct gen_mesh *m)
{
    gen_mesh_init(m);
    for (int y = 0; y < SIDE; y++)
        for (int x = 0; x < SIDE; x++) {
            int p[3], q[3], r[3];
            double corner[3], e1[3], e2[3];
            lattice_point(l, 2 * x, 2 * y, p);
            lattice_point(l, 2 * x + 2, 2 * y, q);
            lattice_point(l, 2 * x, 2 * y + 2, r);
            for (int k = 0; k < 3; k++) {
                corner[k] = (double)p[k];
                e1[k] = (double)(q[k] - p[k]);
                e2[k] = (double)(r[k] - p[k]);
            }
            assert_int_equal(gen_quad(m, corner, e1, e2), ERR_OK);
        }
}

/* Is (x, y) in the closed triangle i of the grid? Integers, so there is no doubt. */
static bool lattice_holds(uint32_t i, int x, int y)
{
    int column = (int)(i / 2) % SIDE, row = (int)(i / 2) / SIDE;
    int u = x - 2 * column, v = y - 2 * row;
    if (u < 0 || u > 2 || v < 0 || v > 2)
        return false;
    return i % 2 == 0 ? v <= u : u <= v;
}

static uint32_t lattice_winner(int x, int y)
{
    for (uint32_t i = 0; i < 2 * SIDE * SIDE; i++)
        if (lattice_holds(i, x, y))
            return i;
    return SCENE_NONE;
}

/* From the lattice point `steps` against `d` before (x, y): t is exactly `steps`. */
static size_t lattice_wrong(const struct accel *a, const struct lattice *l, int x, int y,
                            const int d[3], int steps)
{
    int to[3];
    lattice_point(l, x, y, to);
    struct ray ray = {.tmax = __builtin_inf()};
    struct hit hit;
    for (int k = 0; k < 3; k++) {
        ray.org[k] = (double)(to[k] - steps * d[k]);
        ray.dir[k] = d[k] == 0 && (x + y) % 2 ? -0.0 : (double)d[k];
    }
    accel_closest(a, &ray, &hit);
    return hit.object != 0 || hit.primitive != lattice_winner(x, y) || hit.t != (double)steps;
}

/* Through every vertex, edge middle and centre of every triangle's square, in all 26 directions
 * that cross the plane: the hit is there, its t exact, and of all triangles that share the point
 * the lowest numbered has it. */
static void test_t06_lattice(void **state)
{
    (void)state;
    static const int slopes[][2] = {{0, 0}, {1, 0}, {1, 1}, {-1, 2}};
    size_t rays = 0, wrong = 0;
    for (int i = 0; i < 12; i++) {
        struct lattice l = {.axis = i % 3, .slope = {slopes[i / 3][0], slopes[i / 3][1]}};
        struct gen_mesh mesh;
        struct trace_scene s;
        lattice_mesh(&l, &mesh);
        trace_scene_wrap(&s, &mesh);
        for (int kernel = 0; kernel < 6; kernel++) {
            const enum job_builder builder[] = {JOB_BUILDER_SAH,  JOB_BUILDER_SAH,
                                                JOB_BUILDER_SAH,  JOB_BUILDER_MEDIAN,
                                                JOB_BUILDER_SBVH, JOB_BUILDER_NONE};
            struct accel *a = kit_build(&s.input, builder[kernel], isas[kernel % 3], NULL);
            for (int k = 0; k < 27; k++) {
                int d[3] = {k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1};
                int across =
                    d[l.axis] - l.slope[0] * d[(l.axis + 1) % 3] - l.slope[1] * d[(l.axis + 2) % 3];
                for (int y = 0; across != 0 && y <= 2 * SIDE; y++)
                    for (int x = 0; x <= 2 * SIDE; x++, rays++)
                        wrong += lattice_wrong(a, &l, x, y, d, 1 + (x + y + k) % 5);
            }
            accel_free(a);
        }
        trace_scene_release(&s);
    }
    printf("  T6: %zu of %zu lattice rays wrong\n", wrong, rays);
    assert_int_equal(wrong, 0);
}

/* --- T7 ---------------------------------------------------------------------- */

typedef __float128 quad;

/* Does the closed box meet the ray, in quad precision, for t in [0, tmax]? A component of 0 meets
 * a slab when the origin lies in it. `grow` widens the box. */
static bool box_met(const double org[3], const double dir[3], const float lo[3], const float hi[3],
                    double tmax, double grow)
{
    quad from = 0, to = (quad)tmax;
    for (int k = 0; k < 3; k++) {
        quad o = (quad)org[k], d = (quad)dir[k];
        quad low = (quad)lo[k] - (quad)grow, high = (quad)hi[k] + (quad)grow;
        if (d == 0) {
            if (o < low || o > high)
                return false;
            continue;
        }
        quad a = (low - o) / d, b = (high - o) / d;
        from = (a < b ? a : b) > from ? (a < b ? a : b) : from;
        to = (a < b ? b : a) < to ? (a < b ? b : a) : to;
    }
    return from <= to;
}

/* A box, some of them flat, and a ray that may start on any of its planes, edges or corners, with
 * components that are 0, -0 or denormal. */
static void box_case(uint64_t *state, size_t i, float lo[3], float hi[3], double org[3],
                     double dir[3])
{
    for (int k = 0; k < 3; k++) {
        double a = 2 * gen_random(state) - 1, b = 2 * gen_random(state) - 1;
        if ((i >> k & 7) == 0)
            b = a;
        lo[k] = (float)(a < b ? a : b);
        hi[k] = (float)(a < b ? b : a);
        unsigned place = (unsigned)(gen_random(state) * 4);
        org[k] = place == 0   ? (double)lo[k]
                 : place == 1 ? (double)hi[k]
                              : 3 * gen_random(state) - 1.5;
        unsigned kind = (unsigned)(gen_random(state) * 8);
        dir[k] = kind == 0   ? 0.0
                 : kind == 1 ? -0.0
                 : kind == 2 ? 0x1p-1070
                 : kind == 3 ? -0x1p-1070
                             : 2 * gen_random(state) - 1;
    }
    if (fabs(dir[0]) < 1e-300 && fabs(dir[1]) < 1e-300 && fabs(dir[2]) < 1e-300)
        dir[i % 3] = i & 4 ? -1.0 : 1.0;
}

static void test_t07_boxes(void **state)
{
    (void)state;
    size_t count = rows_long ? 10000000 : 300000, met = 0, missed = 0, extra = 0;
    uint64_t random = 21;
    for (size_t i = 0; i < count; i++) {
        float lo[3], hi[3], entry;
        double org[3], dir[3];
        struct bvh_node node;
        struct trace_ray ray;
        box_case(&random, i, lo, hi, org, dir);
        for (int k = 0; k < 3; k++) {
            node.bounds[2 * k][0] = lo[k];
            node.bounds[2 * k + 1][0] = hi[k];
        }
        assert_true(trace_ray_init(org, dir, 1, 1, TRACE_PAD, &ray));
        bool ours = box_hit(&ray, &node, 0, 0, __builtin_inff(), &entry);
        bool truly = box_met(ray.org, ray.dir, lo, hi, (double)INFINITY, 0);
        met += truly;
        missed += truly && !ours;
        /* A hit by the padding that the proof asks for is no false one: 9 u R, twice. */
        extra += ours && !box_met(ray.org, ray.dir, lo, hi, (double)INFINITY, 20 * 0x1p-24 * 2.5);
    }
    printf("  T7: %zu of %zu met boxes missed; %zu of %zu hit beyond the padding\n", missed, met,
           extra, count);
    assert_true(met > count / 20);
    assert_int_equal(missed, 0);
    assert_true((double)extra <= 1e-3 * (double)count);
}

/* The wide kernels: closed boxes as meshes, rays from their own planes; the tree against brute
 * force, where nothing is culled. */
static void test_t07_kernels(void **state)
{
    (void)state;
    enum { BOXES = 200 };
    struct gen_mesh mesh;
    struct trace_scene s;
    uint64_t random = 22;
    gen_mesh_init(&mesh);
    static float lo[BOXES][3], hi[BOXES][3];
    double org[3], dir[3];
    for (size_t i = 0; i < BOXES; i++) {
        box_case(&random, 5, lo[i], hi[i], org, dir);
        for (int k = 0; k < 6; k++) {
            double corner[3], e[2][3] = {{0}};
            for (int c = 0; c < 3; c++)
                corner[c] = (double)lo[i][c];
            for (int c = 0; c < 2; c++) {
                int axis = (k + 1 + c) % 3;
                e[c][axis] = (double)hi[i][axis] - (double)lo[i][axis];
            }
            corner[k % 3] = k < 3 ? (double)lo[i][k % 3] : (double)hi[i][k % 3];
            assert_int_equal(gen_quad(&mesh, corner, e[0], e[1]), ERR_OK);
        }
    }
    trace_scene_wrap(&s, &mesh);
    size_t count = rows_long ? 1000000 : 3000, bad = 0;
    struct ray *rays = mem_alloc_array(count, sizeof *rays);
    assert_non_null(rays);
    for (size_t i = 0; i < count; i++) {
        float unused[2][3];
        rays[i] = (struct ray){.tmax = (double)INFINITY};
        box_case(&random, i, unused[0], unused[1], rays[i].org, rays[i].dir);
        for (int k = 0; k < 3; k++)
            if (gen_random(&random) < 0.5)
                rays[i].org[k] = (double)(i & 1 ? lo : hi)[i % BOXES][k];
    }
    struct accel *brute = kit_build(&s.input, JOB_BUILDER_NONE, ACCEL_ISA_AUTO, NULL);
    for (int i = 0; i < 3; i++) {
        struct accel *a = kit_build(&s.input, JOB_BUILDER_SAH, isas[i], NULL);
        bad += kit_differences(brute, a, rays, count);
        accel_free(a);
    }
    printf("  T7: %zu of %zu rays from box planes answered unlike brute force\n", bad, 3 * count);
    assert_int_equal(bad, 0);
    accel_free(brute);
    mem_free(rays);
    trace_scene_release(&s);
}

/* What is no ray hits nothing: each component NaN or infinite in turn, a zero direction. */
static void test_t07_no_rays(void **state)
{
    (void)state;
    struct gen_mesh mesh;
    struct trace_scene s;
    closed_make(CLOSED_ICOSPHERE, &mesh);
    trace_scene_wrap(&s, &mesh);
    static const double bad[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
    for (int i = 0; i < 3; i++) {
        struct accel *a = kit_build(&s.input, JOB_BUILDER_SAH, isas[i], NULL);
        for (int k = 0; k < 19; k++) {
            struct ray ray = {{0, 0, 0}, {0.3, -0.4, 0.5}, 0, (double)INFINITY};
            struct hit one, many;
            uint8_t occluded = 1;
            if (k == 18)
                memset(ray.dir, 0, sizeof ray.dir);
            else
                (k < 9 ? ray.org : ray.dir)[k % 3] = bad[k / 3 % 3];
            accel_closest(a, &ray, &one);
            accel_closest_batch(a, &ray, 1, &many);
            accel_occluded_batch(a, &ray, 1, &occluded);
            assert_true(one.object == SCENE_NONE && many.object == SCENE_NONE);
            assert_true(!occluded && !accel_occluded(a, &ray));
        }
        accel_free(a);
    }
    trace_scene_release(&s);
}

/* --- T8 ---------------------------------------------------------------------- */

struct needle {
    float v[9];
    struct ray ray;
};

/* In the plane z = 0, where floats hold any aspect; odd ones turned about two axes, which leaves
 * aspects up to 1e6 more or less what they were. The ray comes along the long side. */
static void needle_make(uint64_t *state, double aspect, double graze, bool turned, struct needle *n)
{
    double a = 6.28 * gen_random(state) * turned, b = 6.28 * gen_random(state) * turned;
    double c = cos(a), s = sin(a), d = cos(b), e = sin(b);
    const double axis[3][3] = {{c, s * d, s * e}, {-s, c * d, c * e}, {0, -e, d}};
    double apex = gen_random(state);
    double b1 = 0.05 + 0.45 * gen_random(state), b2 = 0.05 + 0.45 * gen_random(state);
    double to[2] = {b1 + b2 * apex, b2 * aspect};
    double from[3] = {to[0] - 2, to[1] - gen_random(state), 2 * graze};
    *n = (struct needle){.ray.tmax = (double)INFINITY};
    for (int k = 0; k < 3; k++) {
        n->v[3 + k] = (float)axis[0][k];
        n->v[6 + k] = (float)(apex * axis[0][k] + aspect * axis[1][k]);
        n->ray.org[k] = from[0] * axis[0][k] + from[1] * axis[1][k] + from[2] * axis[2][k];
        n->ray.dir[k] = to[0] * axis[0][k] + to[1] * axis[1][k] - n->ray.org[k];
    }
}

/* The very line against the very triangle, in quad precision: t, and the least of the three
 * weights; false when they are parallel. */
static bool needle_truth(const struct needle *n, quad *t, quad *least)
{
    quad e1[3], e2[3], s[3], p[3], q[3], det = 0, u = 0, v = 0;
    for (int k = 0; k < 3; k++) {
        e1[k] = (quad)n->v[3 + k] - (quad)n->v[k];
        e2[k] = (quad)n->v[6 + k] - (quad)n->v[k];
        s[k] = (quad)n->ray.org[k] - (quad)n->v[k];
    }
    *t = 0;
    for (int k = 0; k < 3; k++) {
        int x = (k + 1) % 3, y = (k + 2) % 3;
        p[k] = (quad)n->ray.dir[x] * e2[y] - (quad)n->ray.dir[y] * e2[x];
        q[k] = s[x] * e1[y] - s[y] * e1[x];
    }
    for (int k = 0; k < 3; k++) {
        det += e1[k] * p[k];
        u += s[k] * p[k];
        v += (quad)n->ray.dir[k] * q[k];
        *t += e2[k] * q[k];
    }
    if (det == 0)
        return false;
    u /= det;
    v /= det;
    *t /= det;
    *least = u < v ? u : v;
    *least = 1 - u - v < *least ? 1 - u - v : *least;
    return true;
}

/* Is t between the depths of the vertices along the ray's largest axis? */
static bool within_vertices(const struct needle *n, double t)
{
    int z = fabs(n->ray.dir[0]) > fabs(n->ray.dir[1]) ? 0 : 1;
    z = fabs(n->ray.dir[2]) > fabs(n->ray.dir[z]) ? 2 : z;
    double low = (double)INFINITY, high = -(double)INFINITY;
    for (int c = 0; c < 3; c++) {
        double at = ((double)n->v[3 * c + z] - n->ray.org[z]) / n->ray.dir[z];
        low = fmin(low, at);
        high = fmax(high, at);
    }
    return t >= low - 1e-8 && t <= high + 1e-8;
}

/* What a needle's ray and its hit come to. */
struct needle_counts {
    size_t met, missed, outside, beyond, coarse;
    double worst, worst_beyond; /* relative error of t; up to 1e6 and 1e-4 rad, and further */
};

static void needle_judge(const struct needle *n, const struct hit *hit, bool extreme,
                         struct needle_counts *c)
{
    quad t, least;
    if (!needle_truth(n, &t, &least))
        return;
    c->met += least > 0;
    if (hit->object == SCENE_NONE) {
        c->missed += least > 1e-12Q;
        return;
    }
    c->beyond += !within_vertices(n, hit->t);
    if (least < -1e-9Q) {
        c->outside++;
        return;
    }
    double off = fabs((double)(((quad)hit->t - t) / t));
    double *worst = extreme ? &c->worst_beyond : &c->worst;
    *worst = fmax(*worst, off);
    c->coarse += !extreme && off > 1e-8;
}

/* Aspects 1 to 1e8 under 1 to 1e-6 rad. A miss is allowed only within 1e-12 of an edge; t stays in
 * the triangle's own range, and up to aspect 1e6 under 1e-4 rad it is good to 1e-8: all of the
 * short form, and all but 1 in 100,000 of the long one (docs/NUMERICS.md, T8, says why no line
 * holds for all). */
static void test_t08_needles(void **state)
{
    (void)state;
    uint64_t random = 3;
    size_t count = rows_long ? 2000000 : 63000;
    struct needle_counts c = {0};
    for (size_t i = 0; i < count; i++) {
        size_t a = i % 9, g = i / 9 % 7;
        bool turned = i % 2 && a <= 6;
        struct needle n;
        needle_make(&random, pow(10, -(double)a), pow(10, -(double)g), turned, &n);
        struct accel_mesh mesh = {n.v, (const uint32_t[3]){0, 1, 2}, 3, 1};
        struct accel_object object = {.type = ACCEL_TRIANGLES};
        struct accel_input input = {&mesh, 1, &object, 1};
        struct accel *accel = kit_build(&input, JOB_BUILDER_SAH, isas[i % 3], NULL);
        struct hit hit;
        accel_closest(accel, &n.ray, &hit);
        accel_free(accel);
        needle_judge(&n, &hit, a > 6 || g > 4, &c);
    }
    printf(
        "  T8: %zu of %zu met needles missed, %zu hit from outside, t off by %.2g at most "
        "(%.2g beyond 1e6 or 1e-4 rad), over 1e-8 for %zu, outside the vertices' range for %zu\n",
        c.missed, c.met, c.outside, c.worst, c.worst_beyond, c.coarse, c.beyond);
    assert_true(c.met > count / 4);
    assert_int_equal(c.missed, 0);
    assert_int_equal(c.outside, 0);
    assert_int_equal(c.beyond, 0);
    assert_true(c.coarse <= (rows_long ? c.met / 100000 : 0));
}

int main(int argc, char **argv)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_t05_leaks),   cmocka_unit_test(test_t05_instances),
        cmocka_unit_test(test_t06_lattice), cmocka_unit_test(test_t07_boxes),
        cmocka_unit_test(test_t07_kernels), cmocka_unit_test(test_t07_no_rays),
        cmocka_unit_test(test_t08_needles),
    };
    return ROWS_RUN(argc, argv, tests);
}
