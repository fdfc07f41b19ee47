#include "scenes/gen_mesh.h"

#include <math.h>

#include "common/mem.h"

void gen_mesh_init(struct gen_mesh *m)
{
    *m = (struct gen_mesh){0};
}

void gen_mesh_release(struct gen_mesh *m)
{
    mem_free(m->positions);
    mem_free(m->indices);
    gen_mesh_init(m);
}

static enum err add_vertex(struct gen_mesh *m, const double p[3])
{
    if (!mem_grow((void **)&m->positions, m->vertex_count, &m->vertex_capacity,
                  3 * sizeof *m->positions))
        return ERR_NOMEM;
    for (size_t k = 0; k < 3; k++)
        m->positions[3 * m->vertex_count + k] = (float)p[k];
    m->vertex_count++;
    return ERR_OK;
}

static enum err add_triangle(struct gen_mesh *m, size_t a, size_t b, size_t c)
{
    if (!mem_grow((void **)&m->indices, m->triangle_count, &m->triangle_capacity,
                  3 * sizeof *m->indices))
        return ERR_NOMEM;
    uint32_t *at = &m->indices[3 * m->triangle_count++];
    at[0] = (uint32_t)a;
    at[1] = (uint32_t)b;
    at[2] = (uint32_t)c;
    return ERR_OK;
}

double gen_random(uint64_t *state)
{
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    return (double)(*state * UINT64_C(0x2545f4914f6cdd1d) >> 11) * 0x1p-53;
}

enum err gen_quad(struct gen_mesh *m, const double corner[3], const double edge1[3],
                  const double edge2[3])
{
    size_t first = m->vertex_count;
    for (int i = 0; i < 4; i++) {
        double p[3];
        for (int k = 0; k < 3; k++)
            p[k] = corner[k] + (i == 1 || i == 2 ? edge1[k] : 0.0) + (i >= 2 ? edge2[k] : 0.0);
        TL_TRY(add_vertex(m, p));
    }
    TL_TRY(add_triangle(m, first, first + 1, first + 2));
    return add_triangle(m, first, first + 2, first + 3);
}

static enum err walls(struct gen_mesh *m, double y0, double y1)
{
    const double h = y1 - y0;
    const double quads[5][3][3] = {
        {{-1, y0, -1}, {0, 0, 2}, {2, 0, 0}}, {{-1, y1, -1}, {2, 0, 0}, {0, 0, 2}},
        {{-1, y0, -1}, {2, 0, 0}, {0, h, 0}}, {{-1, y0, -1}, {0, h, 0}, {0, 0, 2}},
        {{1, y0, -1}, {0, 0, 2}, {0, h, 0}},
    };
    for (int i = 0; i < 5; i++)
        TL_TRY(gen_quad(m, quads[i][0], quads[i][1], quads[i][2]));
    return ERR_OK;
}

enum err gen_room(struct gen_mesh *m)
{
    return walls(m, -1.0, 1.0);
}

/* A box over four floor points, without its bottom. */
static enum err standing_box(struct gen_mesh *m, const double floor[4][2], double height,
                             const double shift[3])
{
    for (int i = 0; i < 4; i++) {
        const double *a = floor[i], *b = floor[(i + 1) % 4];
        TL_TRY(gen_quad(m, (double[3]){a[0] + shift[0], 1e-4 + shift[1], a[1] + shift[2]},
                        (double[3]){b[0] - a[0], 0, b[1] - a[1]}, (double[3]){0, height, 0}));
    }
    return gen_quad(m,
                    (double[3]){floor[0][0] + shift[0], height + shift[1], floor[0][1] + shift[2]},
                    (double[3]){floor[1][0] - floor[0][0], 0, floor[1][1] - floor[0][1]},
                    (double[3]){floor[3][0] - floor[0][0], 0, floor[3][1] - floor[0][1]});
}

enum err gen_cornell(struct gen_mesh *m)
{
    static const double low[4][2] = {
        {-0.04607, -0.573007}, {0.124253, -0.003104}, {0.703337, -0.176177}, {0.533009, -0.746079}};
    static const double tall[4][2] = {{0.0495656, 0.108948},
                                      {-0.523986, -0.0906493},
                                      {-0.720444, 0.473882},
                                      {-0.146892, 0.673479}};
    TL_TRY(walls(m, 0.0, 2.0));
    TL_TRY(standing_box(m, low, 0.6, (double[3]){-0.7, 0, 0.6}));
    return standing_box(m, tall, 1.2, (double[3]){0.7, 0, -0.5});
}

/* Uniform in [-1, 1] at the points of an integer lattice. */
static double lattice(int64_t x, int64_t y, int64_t z, uint32_t seed)
{
    uint64_t h = (uint64_t)x * UINT64_C(0x9e3779b97f4a7c15) ^
                 (uint64_t)y * UINT64_C(0xc2b2ae3d27d4eb4f) ^
                 (uint64_t)z * UINT64_C(0x165667b19e3779f9) ^ seed;
    h = (h ^ h >> 31) * UINT64_C(0xbf58476d1ce4e5b9);
    h = (h ^ h >> 29) * UINT64_C(0x94d049bb133111eb);
    return (double)(h >> 11) * 0x1p-52 - 1.0;
}

/* Lattice values, blended smoothly. */
static double noise(const double p[3], uint32_t seed)
{
    int64_t cell[3];
    double f[3], sum = 0.0;
    for (int k = 0; k < 3; k++) {
        double low = floor(p[k]);
        cell[k] = (int64_t)low;
        f[k] = (p[k] - low) * (p[k] - low) * (3.0 - 2.0 * (p[k] - low));
    }
    for (int i = 0; i < 8; i++) {
        double weight = 1.0;
        for (int k = 0; k < 3; k++)
            weight *= i >> k & 1 ? f[k] : 1.0 - f[k];
        sum +=
            weight * lattice(cell[0] + (i & 1), cell[1] + (i >> 1 & 1), cell[2] + (i >> 2), seed);
    }
    return sum;
}

enum err gen_ball(struct gen_mesh *m, uint32_t side, const double center[3], double radius,
                  double bumps, uint32_t seed)
{
    for (int face = 0; face < 6; face++) {
        size_t first = m->vertex_count;
        int axis = face >> 1;
        for (uint32_t i = 0; i <= side; i++)
            for (uint32_t j = 0; j <= side; j++) {
                double d[3], p[3], length, height = 0.0, size = 0.5, frequency = 2.0;
                d[axis] = face & 1 ? 1.0 : -1.0;
                d[(axis + 1) % 3] = 2.0 * i / side - 1.0;
                d[(axis + 2) % 3] = (face & 1 ? 1.0 : -1.0) * (2.0 * j / side - 1.0);
                length = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
                for (int octave = 0; octave < 6; octave++, size *= 0.5, frequency *= 2.0) {
                    for (int k = 0; k < 3; k++)
                        p[k] = d[k] / length * frequency;
                    height += size * noise(p, seed + (uint32_t)octave);
                }
                for (int k = 0; k < 3; k++)
                    p[k] = center[k] + d[k] / length * radius * (1.0 + bumps * height);
                TL_TRY(add_vertex(m, p));
            }
        for (size_t i = 0; i < side; i++)
            for (size_t j = 0; j < side; j++) {
                size_t a = first + i * (side + 1) + j, b = a + side + 1;
                TL_TRY(add_triangle(m, a, b, b + 1));
                TL_TRY(add_triangle(m, a, b + 1, a + 1));
            }
    }
    return ERR_OK;
}

enum err gen_needles(struct gen_mesh *m, uint32_t count, double radius, double length, double width,
                     uint32_t seed)
{
    uint64_t state = seed * UINT64_C(0x9e3779b97f4a7c15) + 1;
    for (uint32_t i = 0; i < count; i++) {
        double c[3], d[3], e[3], cc, dd;
        size_t first = m->vertex_count;
        do {
            cc = dd = 0.0;
            for (int k = 0; k < 3; k++) {
                c[k] = 2.0 * gen_random(&state) - 1.0;
                d[k] = 2.0 * gen_random(&state) - 1.0;
                e[k] = 2.0 * gen_random(&state) - 1.0;
                cc += c[k] * c[k];
                dd += d[k] * d[k];
            }
        } while (cc > 1.0 || dd > 1.0 || dd < 0.01);
        for (int v = 0; v < 3; v++) {
            double p[3];
            for (int k = 0; k < 3; k++)
                p[k] = c[k] * radius + (v == 1 ? length / sqrt(dd) * d[k] : 0.0) +
                       (v == 2 ? width * e[k] : 0.0);
            TL_TRY(add_vertex(m, p));
        }
        TL_TRY(add_triangle(m, first, first + 1, first + 2));
    }
    return ERR_OK;
}

/* A box around a centre, turned about y and then about x, in units of the frame's grid. */
static enum err add_beam(struct gen_mesh *m, double unit, double x, double y, double z,
                         const double half[3])
{
    const double turn[3][3] = {{0.8, 0.0, 0.6}, {-0.168, 0.96, 0.224}, {-0.576, -0.28, 0.768}};
    const double centre[3] = {x, y, z};
    for (int face = 0; face < 6; face++) {
        int axis = face % 3, u = (axis + 1) % 3, v = (axis + 2) % 3;
        double local[3], corner[3], e[2][3];
        local[axis] = centre[axis] + (face < 3 ? -half[axis] : half[axis]);
        local[u] = centre[u] - half[u];
        local[v] = centre[v] - half[v];
        for (int k = 0; k < 3; k++) {
            corner[k] = 0.0;
            for (int i = 0; i < 3; i++)
                corner[k] += unit * turn[k][i] * local[i];
            e[0][k] = unit * turn[k][u] * (2.0 * half[u]);
            e[1][k] = unit * turn[k][v] * (2.0 * half[v]);
        }
        TL_TRY(gen_quad(m, corner, e[0], e[1]));
    }
    return ERR_OK;
}

enum err gen_frame(struct gen_mesh *m, uint32_t side, uint32_t storeys, double width)
{
    const double unit = width / side, end = 0.5 * (side - 1.0), half = 0.5 * side;
    const double column[3] = {0.05, 0.5, 0.05}, rail[3] = {0.01, 0.01, 0.5};
    const double along[3] = {half, 0.06, 0.04}, across[3] = {0.04, 0.06, half};
    for (uint32_t storey = 0; storey < storeys; storey++) {
        double y = storey - 0.5 * (storeys - 1.0);
        for (uint32_t i = 0; i < side; i++) {
            TL_TRY(add_beam(m, unit, i - end, y + 0.4, 0.0, across));
            TL_TRY(add_beam(m, unit, 0.0, y + 0.4, i - end, along));
            for (uint32_t j = 0; j < side; j++)
                TL_TRY(add_beam(m, unit, i - end, y, j - end, column));
            for (uint32_t j = 0; j + 1 < side; j++) {
                TL_TRY(add_beam(m, unit, i - end + 0.2, y - 0.2, j + 0.5 - end, rail));
                TL_TRY(add_beam(m, unit, i - end + 0.2, y - 0.3, j + 0.5 - end, rail));
            }
        }
    }
    return ERR_OK;
}
