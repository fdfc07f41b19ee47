#include "tests/numerics/closed_mesh.h"

#include <math.h>
#include <stdlib.h>

#include "common/mem.h"

const char *const closed_names[CLOSED_KINDS] = {"icosphere", "hull", "noisy"};

static size_t add_vertex(struct gen_mesh *m, double x, double y, double z)
{
    if (!mem_grow((void **)&m->positions, m->vertex_count, &m->vertex_capacity,
                  3 * sizeof *m->positions))
        abort();
    float *p = m->positions + 3 * m->vertex_count;
    p[0] = (float)x;
    p[1] = (float)y;
    p[2] = (float)z;
    return m->vertex_count++;
}

static void add_triangle(struct gen_mesh *m, size_t a, size_t b, size_t c)
{
    if (!mem_grow((void **)&m->indices, m->triangle_count, &m->triangle_capacity,
                  3 * sizeof *m->indices))
        abort();
    uint32_t *at = m->indices + 3 * m->triangle_count++;
    at[0] = (uint32_t)a;
    at[1] = (uint32_t)b;
    at[2] = (uint32_t)c;
}

/* The vertex on the sphere between two others: one vertex an edge, whichever side asks. */
static size_t middle(struct gen_mesh *m, size_t a, size_t b)
{
    double p[3], length = 0;
    for (size_t k = 0; k < 3; k++) {
        p[k] = (double)m->positions[3 * a + k] + (double)m->positions[3 * b + k];
        length += p[k] * p[k];
    }
    for (size_t k = 0; k < 3; k++)
        p[k] /= sqrt(length);
    for (size_t v = 0; v < m->vertex_count; v++) {
        const float *q = m->positions + 3 * v;
        if (q[0] == (float)p[0] && q[1] == (float)p[1] && q[2] == (float)p[2])
            return v;
    }
    return add_vertex(m, p[0], p[1], p[2]);
}

static void icosphere(struct gen_mesh *m, int levels)
{
    static const uint32_t faces[20][3] = {
        {0, 11, 5},  {0, 5, 1},  {0, 1, 7},  {0, 7, 10}, {0, 10, 11}, {1, 5, 9}, {5, 11, 4},
        {11, 10, 2}, {10, 7, 6}, {7, 1, 8},  {3, 9, 4},  {3, 4, 2},   {3, 2, 6}, {3, 6, 8},
        {3, 8, 9},   {4, 9, 5},  {2, 4, 11}, {6, 2, 10}, {8, 6, 7},   {9, 8, 1}};
    static const int corners[12][3] = {{-1, 2, 0}, {1, 2, 0}, {-1, -2, 0}, {1, -2, 0},
                                       {0, -1, 2}, {0, 1, 2}, {0, -1, -2}, {0, 1, -2},
                                       {2, 0, -1}, {2, 0, 1}, {-2, 0, -1}, {-2, 0, 1}};
    const double golden = (1 + sqrt(5)) / 2, unit = 1 / sqrt(1 + golden * golden);
    for (int i = 0; i < 12; i++) { /* 2 stands for the golden ratio */
        double p[3];
        for (int k = 0; k < 3; k++)
            p[k] = unit * (abs(corners[i][k]) == 2 ? corners[i][k] / 2 * golden : corners[i][k]);
        (void)add_vertex(m, p[0], p[1], p[2]);
    }
    for (int i = 0; i < 20; i++)
        add_triangle(m, faces[i][0], faces[i][1], faces[i][2]);
    for (int level = 0; level < levels; level++) {
        struct gen_mesh coarse = *m;
        m->indices = NULL;
        m->triangle_count = m->triangle_capacity = 0;
        for (size_t t = 0; t < coarse.triangle_count; t++) {
            const uint32_t *v = coarse.indices + 3 * t;
            size_t ab = middle(m, v[0], v[1]), bc = middle(m, v[1], v[2]);
            size_t ca = middle(m, v[2], v[0]);
            add_triangle(m, v[0], ab, ca);
            add_triangle(m, v[1], bc, ab);
            add_triangle(m, v[2], ca, bc);
            add_triangle(m, ab, bc, ca);
        }
        mem_free(coarse.indices);
    }
}

/* Six times the volume of a tetrahedron of integer points, exactly. */
static int side_of(const int64_t a[3], const int64_t b[3], const int64_t c[3], const int64_t d[3])
{
    int64_t e[3][3];
    for (int k = 0; k < 3; k++) {
        e[0][k] = b[k] - a[k];
        e[1][k] = c[k] - a[k];
        e[2][k] = d[k] - a[k];
    }
    __int128 det = 0;
    for (int k = 0; k < 3; k++) {
        int x = (k + 1) % 3, y = (k + 2) % 3;
        det += (__int128)e[2][k] * (e[0][x] * e[1][y] - e[0][y] * e[1][x]);
    }
    return det > 0 ? 1 : det < 0 ? -1 : 0;
}

/* Every triangle of points that has all others on one side, turned outward. */
static void hull(struct gen_mesh *m)
{
    enum { POINTS = 64, UNIT = 1 << 20 };
    int64_t p[POINTS][3];
    uint64_t state = 12;
    for (int i = 0; i < POINTS; i++) {
        double v[3], length = 0;
        for (int k = 0; k < 3; k++) {
            v[k] = gen_random(&state) + gen_random(&state) + gen_random(&state) - 1.5;
            length += v[k] * v[k];
        }
        for (int k = 0; k < 3; k++)
            p[i][k] = (int64_t)lround(v[k] / sqrt(length) * UNIT);
        (void)add_vertex(m, (double)p[i][0] / UNIT, (double)p[i][1] / UNIT, (double)p[i][2] / UNIT);
    }
    for (size_t a = 0; a < POINTS; a++)
        for (size_t b = a + 1; b < POINTS; b++)
            for (size_t c = b + 1; c < POINTS; c++) {
                bool above = false, below = false;
                for (size_t d = 0; d < POINTS && !(above && below); d++) {
                    int side = side_of(p[a], p[b], p[c], p[d]);
                    above |= side > 0;
                    below |= side < 0;
                }
                if (!above)
                    add_triangle(m, a, b, c);
                else if (!below)
                    add_triangle(m, a, c, b);
            }
}

void closed_make(enum closed_kind kind, struct gen_mesh *out)
{
    static const double origin[3] = {0, 0, 0};
    gen_mesh_init(out);
    if (kind == CLOSED_ICOSPHERE)
        icosphere(out, 3);
    else if (kind == CLOSED_HULL)
        hull(out);
    else if (gen_ball(out, 12, origin, 0.9, 0.3, 1) != ERR_OK)
        abort();
}

void closed_ray(const struct gen_mesh *m, uint64_t *state, size_t i, struct ray *out)
{
    size_t triangle = (size_t)(gen_random(state) * (double)m->triangle_count);
    const uint32_t *v = m->indices + 3 * triangle;
    size_t corner = (size_t)(gen_random(state) * 3);
    const float *a = m->positions + 3 * (size_t)v[corner];
    const float *b = m->positions + 3 * (size_t)v[(corner + 1) % 3];
    double along = i % 3 == 1 ? gen_random(state) : 0;
    for (int k = 0; k < 3; k++) {
        double to = (double)a[k] + along * ((double)b[k] - (double)a[k]);
        if (i % 3 == 2)
            to = 2 * gen_random(state) - 1;
        out->org[k] = 0.1 * gen_random(state) - 0.05;
        out->dir[k] = to - out->org[k];
    }
    out->tmin = 0;
    out->tmax = __builtin_inf();
}
