/* numerics_figures, continued: the rows of docs/NUMERICS.md that are one number each. A row's lines
 * begin with its name; a method that a line does not have has no part in it. Rays that leave a
 * surface look beyond 0 and, where that is said, beyond 1e-4 in the others' columns.
 */
#include "tests/numerics/figure_methods.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"
#include "tests/numerics/closed_mesh.h"

typedef __float128 quad;

static const double pi = 3.14159265358979323846;

static void *array_of(size_t count, size_t bytes)
{
    void *out = mem_alloc_array(count, bytes);
    if (!out)
        abort();
    return out;
}

static void put_shares(const char *figure, const size_t counts[METHODS], size_t of)
{
    for (int m = 0; m < METHODS; m++)
        figure_put(figure, (enum figure_method)m, 0, (double)counts[m] / (double)of);
}

/* How far beyond where they start the others' rays look: nothing, and a usual absolute epsilon. */
static const double beyonds[] = {0, 1e-4};

/* --- T6 ---------------------------------------------------------------------- */

enum { SIDE = 8 };

struct lattice {
    int axis, slope[2];
};

static void lattice_point(const struct lattice *l, int x, int y, double out[3])
{
    out[(l->axis + 1) % 3] = x;
    out[(l->axis + 2) % 3] = y;
    out[l->axis] = l->slope[0] * x + l->slope[1] * y;
}

/* 2 x 2 squares, in two triangles each; those of square i are 2 i and 2 i + 1. */
static void lattice_world(const struct lattice *l, struct figure_world *w)
{
    enum { POINTS = SIDE + 1 };
    double positions[3 * POINTS * POINTS];
    uint32_t indices[6 * SIDE * SIDE], *to = indices;
    for (int i = 0; i < POINTS * POINTS; i++)
        lattice_point(l, 2 * (i % POINTS), 2 * (i / POINTS), positions + (size_t)(3 * i));
    for (uint32_t i = 0; i < SIDE * SIDE; i++) {
        uint32_t a = i / SIDE * POINTS + i % SIDE;
        const uint32_t corners[6] = {a, a + 1, a + POINTS + 1, a, a + POINTS + 1, a + POINTS};
        memcpy(to, corners, sizeof corners);
        to += 6;
    }
    figure_world_of(w, positions, (size_t)POINTS * POINTS, indices, (size_t)2 * SIDE * SIDE);
}

/* The lowest numbered triangle that holds (x, y): integers, so there is no doubt. */
static uint32_t lattice_winner(int x, int y)
{
    for (uint32_t i = 0; i < 2 * SIDE * SIDE; i++) {
        int u = x - 2 * ((int)(i / 2) % SIDE), v = y - 2 * ((int)(i / 2) / SIDE);
        if (u >= 0 && u <= 2 && v >= 0 && v <= 2 && (i % 2 ? u <= v : v <= u))
            return i;
    }
    return SCENE_NONE;
}

/* Rays through every vertex, edge and centre: no hit, or a t that is not the whole number it is, or
 * another triangle than the lowest numbered. */
static void lattices(void)
{
    static const int slopes[][2] = {{0, 0}, {1, 0}, {1, 1}, {-1, 2}};
    size_t missed[METHODS] = {0}, inexact[METHODS] = {0}, other[METHODS] = {0}, rays = 0;
    for (int i = 0; i < 12; i++) {
        struct lattice l = {.axis = i % 3, .slope = {slopes[i / 3][0], slopes[i / 3][1]}};
        struct figure_world w;
        lattice_world(&l, &w);
        for (int k = 0; k < 27; k++) {
            const int d[3] = {k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1};
            if (d[l.axis] == l.slope[0] * d[(l.axis + 1) % 3] + l.slope[1] * d[(l.axis + 2) % 3])
                continue; /* along the plane */
            for (int n = 0; n < (2 * SIDE + 1) * (2 * SIDE + 1); n++, rays++) {
                int x = n % (2 * SIDE + 1), y = n / (2 * SIDE + 1), steps = 1 + (x + y + k) % 5;
                double org[3], dir[3];
                lattice_point(&l, x, y, org);
                for (int c = 0; c < 3; c++) {
                    org[c] -= steps * d[c];
                    dir[c] = d[c];
                }
                for (int m = 0; m < METHODS; m++) {
                    struct figure_hit hit = figure_nearest(&w, (enum figure_method)m, org, dir, 0);
                    missed[m] += isinf(hit.t) != 0;
                    inexact[m] += !isinf(hit.t) && hit.t != steps;
                    other[m] += !isinf(hit.t) && hit.triangle != lattice_winner(x, y);
                }
            }
        }
        figure_world_free(&w);
    }
    put_shares("T6 missed", missed, rays);
    put_shares("T6 t is not exact", inexact, rays);
    put_shares("T6 another triangle than the lowest", other, rays);
}

/* --- T9 ---------------------------------------------------------------------- */

static void random_direction(uint64_t *state, double out[3])
{
    double z = 2 * gen_random(state) - 1, a = 2 * pi * gen_random(state), r = sqrt(1 - z * z);
    out[0] = r * cos(a);
    out[1] = r * sin(a);
    out[2] = z;
}

/* Corners in 10^-8 to 10^8. */
static void wild_triangle(uint64_t *state, double p[9])
{
    double at[3], d[3], size = pow(10, 16 * gen_random(state) - 8);
    double away = pow(10, 8 * gen_random(state));
    random_direction(state, at);
    for (int i = 0; i < 3; i++) {
        random_direction(state, d);
        for (int k = 0; k < 3; k++)
            p[3 * i + k] = size * (at[k] * away + d[k]);
    }
}

/* A ray at a random place of a triangle from two of its sizes away. */
static void aim_at(uint64_t *state, const double p[9], double length, double org[3], double dir[3])
{
    double b = gen_random(state), c = (1 - b) * gen_random(state);
    random_direction(state, dir);
    for (int k = 0; k < 3; k++) {
        double at = p[k] + b * (p[3 + k] - p[k]) + c * (p[6 + k] - p[k]);
        org[k] = at + 2 * length * dir[k];
        dir[k] = at - org[k];
    }
}

/* Any direction, or one almost along the plane of normal n. */
static void leaving_direction(uint64_t *state, const double n[3], bool along, double out[3])
{
    random_direction(state, out);
    double up = out[0] * n[0] + out[1] * n[1] + out[2] * n[2];
    double size2 = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
    for (int k = 0; k < 3 && along; k++)
        out[k] -= up * n[k] / size2 * (1 - 1e-6);
}

/* The normal, of about the size of 1, and the longest edge. */
static double normal_of(const double p[9], double n[3])
{
    double e1[3], e2[3], length = 0;
    for (int k = 0; k < 3; k++) {
        e1[k] = p[3 + k] - p[k];
        e2[k] = p[6 + k] - p[k];
        length = fmax(length, fmax(fabs(e1[k]), fabs(e2[k])));
    }
    for (int k = 0; k < 3; k++)
        n[k] = (e1[(k + 1) % 3] * e2[(k + 2) % 3] - e1[(k + 2) % 3] * e2[(k + 1) % 3]) /
               (length * length);
    return length;
}

/* Rays that leave a triangle, half of them almost along it, and meet it again. */
static void self_hits(double beyond)
{
    enum { TRIANGLES = 3000, AIMS = 4, LEAVING = 20 };
    size_t again[METHODS] = {0}, left[METHODS] = {0};
    uint64_t state = 51;
    for (int i = 0; i < TRIANGLES; i++) {
        double p[9], n[3];
        struct figure_world w;
        wild_triangle(&state, p);
        figure_world_of(&w, p, 3, (const uint32_t[3]){0, 1, 2}, 1);
        double length = normal_of(p, n);
        for (int aim = 0; aim < AIMS * LEAVING; aim++) {
            double org[3], dir[3], to[3];
            aim_at(&state, p, length, org, dir);
            leaving_direction(&state, n, aim % 2, to);
            for (int m = 0; m < METHODS; m++) {
                struct figure_path path;
                figure_path_begin(&path, &w, (enum figure_method)m, beyond, org, dir);
                if (isinf(figure_path_step(&path, &w, to).t))
                    continue;
                again[m] += !isinf(figure_path_step(&path, &w, to).t);
                left[m]++;
            }
        }
        figure_world_free(&w);
    }
    for (int m = 0; m < METHODS; m++)
        figure_put("T9 met again", (enum figure_method)m, beyond,
                   (double)again[m] / (double)left[m]);
    for (int m = 0; m < METHODS && beyond <= 0; m++)
        figure_put("T9 missed", (enum figure_method)m, 0,
                   1 - (double)left[m] / ((double)TRIANGLES * AIMS * LEAVING));
}

/* --- T10, T11 ---------------------------------------------------------------- */

/* Time to build 10^6 triangles about one point over that of as many anywhere; the least of some. */
static void coincident_centres(void)
{
    enum { QUADS = 500000, RUNS = 3 };
    double seconds[2][2];
    uint64_t random = 52;
    for (int kind = 0; kind < 2; kind++) {
        struct gen_mesh m;
        struct trace_scene s;
        struct trace_peer *peer = trace_peer_new(NULL, 1);
        struct accel *a;
        struct accel_options options = {.builder = JOB_BUILDER_SAH};
        gen_mesh_init(&m);
        for (size_t i = 0; i < QUADS; i++) {
            double corner[3], e[2][3];
            for (int k = 0; k < 3; k++) {
                e[0][k] = 0.1 * gen_random(&random) - 0.05;
                e[1][k] = 0.1 * gen_random(&random) - 0.05;
                corner[k] = (kind ? 2 * gen_random(&random) - 1 : 0) - 0.5 * (e[0][k] + e[1][k]);
            }
            if (gen_quad(&m, corner, e[0], e[1]) != ERR_OK)
                abort();
        }
        trace_scene_wrap(&s, &m);
        seconds[0][kind] = seconds[1][kind] = (double)INFINITY;
        for (int run = 0; peer && run < RUNS; run++) {
            double begin = trace_seconds(1);
            trace_peer_build(peer, &s, PEER_MEDIUM, false);
            seconds[0][kind] = fmin(seconds[0][kind], trace_seconds(1) - begin);
            begin = trace_seconds(1);
            if (accel_new(&s.input, &options, NULL, &a) != ERR_OK)
                abort();
            seconds[1][kind] = fmin(seconds[1][kind], trace_seconds(1) - begin);
            accel_free(a);
        }
        trace_peer_free(peer);
        trace_scene_release(&s);
    }
    figure_put("T10 build over one at random", EMBREE, 0, seconds[0][0] / seconds[0][1]);
    figure_put("T10 build over one at random", OURS, 0, seconds[1][0] / seconds[1][1]);
}

/* Triangles of 2^-k at 2^-k, down to where floats end; rays at the middle of each. Ours is asked
 * for the floats that Embree gets: a scene build would round them once more, around the middle. */
static void shrinking(void)
{
    enum { LEVELS = 126, RAYS = 20 };
    double positions[LEVELS * 9];
    uint32_t indices[LEVELS * 3];
    size_t lost[METHODS] = {0};
    uint64_t state = 53;
    struct figure_world w;
    for (int k = 0; k < LEVELS; k++) {
        double x = ldexp(1, -k), y = 1.5 * x;
        const double p[9] = {x, x, 0, y, x, 0, x, y, 0};
        memcpy(positions + (size_t)(9 * k), p, sizeof p);
        for (int c = 0; c < 3; c++)
            indices[3 * k + c] = (uint32_t)(3 * k + c);
    }
    figure_world_of(&w, positions, (size_t)3 * LEVELS, indices, LEVELS);
    struct accel *a;
    struct accel_options options = {.builder = JOB_BUILDER_SAH};
    if (accel_new(&w.floats.input, &options, NULL, &a) != ERR_OK)
        abort();
    for (int i = 0; i < LEVELS * RAYS; i++) {
        double size = ldexp(1, -(i % LEVELS));
        double b = 0.1 + 0.3 * gen_random(&state), c = 0.1 + 0.3 * gen_random(&state);
        const double org[3] = {size * (1 + 0.5 * b), size * (1 + 0.5 * c), 1}, dir[3] = {0, 0, -1};
        for (int m = 0; m < OURS; m++)
            lost[m] += isinf(figure_nearest(&w, (enum figure_method)m, org, dir, 0).t) != 0;
        struct ray ray = {{org[0], org[1], org[2]}, {0, 0, -1}, 0, (double)INFINITY};
        lost[OURS] += !accel_occluded(a, &ray);
    }
    accel_free(a);
    put_shares("T11 missed", lost, (size_t)LEVELS * RAYS);
    figure_world_free(&w);
}

/* --- T12, T13 ---------------------------------------------------------------- */

/* Rays at vertices and edges of a ball under two ways to build the tree: another triangle, or
 * another t. */
static void builders(const struct gen_mesh *ball)
{
    enum { RAYS = 60000 };
    static const enum figure_method peers[2] = {EMBREE, EMBREE_ROBUST};
    struct figure_world w;
    struct accel *ours[2];
    size_t differ[METHODS] = {0}, rays = 0;
    uint64_t state = 54;
    figure_world_make(&w, ball, 1, 0);
    struct trace_peer *high[2] = {trace_peer_new(NULL, 1), trace_peer_new(NULL, 1)};
    for (int i = 0; i < 2; i++) {
        struct accel_options options = {.builder = i ? JOB_BUILDER_MEDIAN : JOB_BUILDER_SAH};
        if (!high[i] || accel_new(&w.floats.input, &options, NULL, &ours[i]) != ERR_OK)
            abort();
        trace_peer_build(high[i], &w.floats, PEER_HIGH, i);
    }
    for (size_t i = 0; i < RAYS; i++) {
        struct ray ray;
        struct hit hit[2];
        closed_ray(ball, &state, i, &ray);
        if (i % 3 == 2)
            continue;
        rays++;
        for (int k = 0; k < 2; k++) {
            struct figure_hit a = figure_nearest(&w, peers[k], ray.org, ray.dir, 0);
            struct trace_peer *medium = w.peer[k];
            w.peer[k] = high[k];
            struct figure_hit b = figure_nearest(&w, peers[k], ray.org, ray.dir, 0);
            w.peer[k] = medium;
            differ[peers[k]] += a.triangle != b.triangle || (!isinf(a.t) && a.t != b.t);
            accel_closest(ours[k], &ray, &hit[k]);
        }
        differ[OURS] += hit[0].primitive != hit[1].primitive || hit[0].t != hit[1].t;
    }
    for (int m = EMBREE; m < METHODS; m++)
        figure_put("T12 another hit", (enum figure_method)m, 0, (double)differ[m] / (double)rays);
    for (int i = 0; i < 2; i++) {
        trace_peer_free(high[i]);
        accel_free(ours[i]);
    }
    figure_world_free(&w);
}

/* A ball around a point light: places of its wall that the light does not reach, for there is no
 * wall, or it stands before itself. */
static void dark_walls(const struct gen_mesh *ball, double beyond)
{
    enum { RAYS = 6000 };
    for (int k = -6; k <= 6; k += 3) {
        struct figure_world w;
        size_t dark[METHODS] = {0}, rays = 0;
        uint64_t state = 55;
        figure_world_make(&w, ball, 0.9 * pow(10, k), 0);
        for (size_t i = 2; i < RAYS; i += 3, rays++) {
            static const double middle[3] = {0, 0, 0};
            struct ray ray;
            double back[3];
            closed_ray(ball, &state, i, &ray);
            for (int c = 0; c < 3; c++) {
                ray.dir[c] *= w.scale;
                back[c] = -ray.dir[c];
            }
            for (int m = 0; m < METHODS; m++) {
                struct figure_path path;
                figure_path_begin(&path, &w, (enum figure_method)m, beyond, middle, ray.dir);
                double there = figure_path_step(&path, &w, back).t;
                /* The light is as far back; the wall behind it farther. */
                dark[m] += isinf(there) || figure_path_step(&path, &w, back).t < there * 0.999;
            }
        }
        char figure[40];
        (void)snprintf(figure, sizeof figure, "T13 dark beyond %g", beyond);
        for (int m = 0; m < METHODS; m++)
            figure_put(figure, (enum figure_method)m, pow(10, k), (double)dark[m] / (double)rays);
        figure_world_free(&w);
    }
}

/* --- T15, T17 ---------------------------------------------------------------- */

/* Planes of two triangles each, square, at z = 0, -gap, ...; they lie to one side of x = 0 and
 * y = 0, so that no diagonal is in the way. */
static void planes_world(struct figure_world *w, int count, double gap, double half)
{
    double *positions = array_of((size_t)count, 12 * sizeof *positions);
    uint32_t *indices = array_of((size_t)count, 6 * sizeof *indices);
    for (int i = 0; i < count; i++) {
        double z = -gap * i;
        const double p[12] = {-half, -half, z, half, -half, z, half, half, z, -half, half, z};
        uint32_t a = 4 * (uint32_t)i;
        const uint32_t corners[6] = {a, a + 1, a + 2, a, a + 2, a + 3};
        memcpy(positions + 12 * (size_t)i, p, sizeof p);
        memcpy(indices + 6 * (size_t)i, corners, sizeof corners);
    }
    figure_world_of(w, positions, 4 * (size_t)count, indices, 2 * (size_t)count);
    mem_free(positions);
    mem_free(indices);
}

/* A slab of glass: how far the place is off where a ray leaves it, in thicknesses, and how many do
 * not leave by the other side. Snell's law in double for all. */
static void slabs_of_glass(double half, double beyond)
{
    enum { STEPS = 870 };
    double worst[METHODS] = {0};
    size_t lost[METHODS] = {0};
    struct figure_world w;
    planes_world(&w, 2, 1, half);
    for (int i = 1; i < STEPS; i++) {
        double sine = sin(0.1 * i * pi / 180), cosine = cos(0.1 * i * pi / 180), inner = sine / 1.5;
        const double dir[3] = {sine, 0, -cosine}, in[3] = {inner, 0, -sqrt(1 - inner * inner)};
        const double org[3] = {-0.5 * sine / cosine, 0.3, 0.5};
        for (int m = 0; m < METHODS; m++) {
            struct figure_path path;
            double at[3];
            figure_path_begin(&path, &w, (enum figure_method)m, beyond, org, dir);
            uint32_t first = figure_path_step(&path, &w, in).triangle;
            uint32_t second = figure_path_step(&path, &w, in).triangle;
            figure_path_at(&path, &w, at);
            if (first / 2 != 0 || second / 2 != 1)
                lost[m]++;
            else
                worst[m] = fmax(worst[m], fabs(at[0] - in[0] / -in[2]));
        }
    }
    for (int m = 0; m < METHODS; m++) {
        figure_put("T15 place off", (enum figure_method)m, 2 * half, worst[m]);
        figure_put("T15 not through", (enum figure_method)m, beyond,
                   (double)lost[m] / (double)(STEPS - 1));
    }
    figure_world_free(&w);
}

/* A thousand planes, one behind another: rays that do not meet each once and in order. */
static void shared_faces(double beyond)
{
    enum { PLANES = 1000, RAYS = 40 };
    size_t strayed[METHODS] = {0};
    struct figure_world w;
    uint64_t state = 56;
    planes_world(&w, PLANES, 0x1p-10, 4);
    for (int i = 0; i < RAYS; i++) {
        const double org[3] = {gen_random(&state) - 0.5, gen_random(&state) - 0.5, 0.4};
        const double dir[3] = {0.6 * gen_random(&state), 0.1, -0.7};
        for (int m = 0; m < METHODS; m++) {
            struct figure_path path;
            bool stray = false;
            figure_path_begin(&path, &w, (enum figure_method)m, beyond, org, dir);
            for (uint32_t k = 0; k < PLANES && !stray; k++)
                stray = figure_path_step(&path, &w, dir).triangle / 2 != k;
            strayed[m] += stray;
        }
    }
    for (int m = 0; m < METHODS; m++)
        figure_put("T17 strayed", (enum figure_method)m, beyond, (double)strayed[m] / RAYS);
    figure_world_free(&w);
}

/* --- T16, T21 ---------------------------------------------------------------- */

/* 1 - n^2 (1 - cos^2) < 0, as textbooks have it: how many units in the last place of the sine from
 * the critical angle it takes the wrong branch. */
static void textbook_reflection(void)
{
    static const double etas[] = {1.0001, 1.33, 1.5, 2.4, 100};
    enum { REACH = 100000 };
    for (int e = 0; e < 5; e++) {
        double critical = 1 / etas[e], ulp = nextafter(critical, 2) - critical;
        int wrong = 0;
        for (int k = -REACH; k <= REACH; k++) {
            double sine = critical + k * ulp, cosine = sqrt((1 - sine) * (1 + sine));
            bool reflects = (quad)sine * (quad)etas[e] > 1;
            if (reflects != (1 - etas[e] * etas[e] * (1 - cosine * cosine) < 0))
                wrong = abs(k) > wrong ? abs(k) : wrong;
        }
        figure_put("T16 wrong up to", SEED, etas[e], wrong);
    }
}

/* The same rays at vertices and edges by two instruction sets: another t in any bit, or a hit that
 * only one of them has. */
static void instruction_sets(const struct gen_mesh *ball)
{
    enum { RAYS = 60000 };
    static const char *const sets[] = {"sse2", "avx2"};
    struct trace_peer *peer[2][2];
    struct figure_world w;
    size_t differ[METHODS] = {0}, rays = 0;
    uint64_t state = 57;
    figure_world_make(&w, ball, 1, 0);
    for (int i = 0; i < 4; i++) {
        peer[i / 2][i % 2] = trace_peer_new_isa(sets[i % 2]);
        if (!peer[i / 2][i % 2])
            abort();
        trace_peer_build(peer[i / 2][i % 2], &w.floats, PEER_MEDIUM, i / 2);
    }
    for (size_t i = 0; i < RAYS; i++) {
        struct ray ray;
        closed_ray(ball, &state, i, &ray);
        if (i % 3 == 2)
            continue;
        rays++;
        float form[8] = {(float)ray.org[0], (float)ray.org[1], (float)ray.org[2], 0,
                         (float)ray.dir[0], (float)ray.dir[1], (float)ray.dir[2], __builtin_inff()};
        for (int robust = 0; robust < 2; robust++) {
            struct trace_peer_hit hit[2];
            for (int set = 0; set < 2; set++)
                trace_peer_closest(peer[robust][set], form, &hit[set]);
            differ[EMBREE + robust] += hit[0].object != hit[1].object ||
                                       (hit[0].object != SCENE_NONE && hit[0].t != hit[1].t);
        }
        double a = (double)INFINITY, b = (double)INFINITY, t;
        for (size_t k = 0; k < w.count; k++) {
            if (figure_moller_trumbore(&w.triangles[k], ray.org, ray.dir, 1e-8, &t) && t < a)
                a = t;
            if (figure_moller_trumbore_fma(&w.triangles[k], ray.org, ray.dir, 1e-8, &t) && t < b)
                b = t;
        }
        differ[SEED] += a != b;
    }
    for (int m = SEED; m < METHODS; m++)
        if (m == SEED || m == EMBREE || m == EMBREE_ROBUST)
            figure_put("T21 other bits", (enum figure_method)m, 0,
                       (double)differ[m] / (double)rays);
    for (int i = 0; i < 4; i++)
        trace_peer_free(peer[i / 2][i % 2]);
    figure_world_free(&w);
}

void figure_rows(void)
{
    struct gen_mesh ball;
    closed_make(CLOSED_ICOSPHERE, &ball);
    lattices();
    coincident_centres();
    shrinking();
    builders(&ball);
    for (int i = 0; i < 2; i++) {
        self_hits(beyonds[i]);
        dark_walls(&ball, beyonds[i]);
        slabs_of_glass(64, beyonds[i]);
        slabs_of_glass(0x1p21, beyonds[i]);
        shared_faces(beyonds[i]);
    }
    textbook_reflection();
    if (__builtin_cpu_supports("fma") && __builtin_cpu_supports("avx2"))
        instruction_sets(&ball);
    gen_mesh_release(&ball);
}
