/* Tables of few triangles, made from the meshes: see struct accel_flat. */
#include <string.h>

#include "worker/render/accel_parts.h"

/* As accel_hit has it. */
static void flat_normal(const double v[3][4], double out[4])
{
    double e1[3], e2[3];
    for (int k = 0; k < 3; k++) {
        e1[k] = v[k][1] - v[k][0];
        e2[k] = v[k][2] - v[k][0];
    }
    for (int k = 0; k < 3; k++) {
        int x = (k + 1) % 3, y = (k + 2) % 3;
        out[k] = e1[x] * e2[y] - e1[y] * e2[x];
    }
}

static void flat_fill(struct accel_flat *f, uint32_t row, const struct accel_mesh *m,
                      uint32_t object, uint32_t primitive)
{
    float edge = 0.0f;
    for (int k = 0; k < 3; k++) {
        float low = __FLT_MAX__, high = -__FLT_MAX__;
        for (int i = 0; i < 3; i++) {
            size_t vertex = m->indices[3 * (size_t)primitive + (size_t)i];
            float x = m->positions[3 * vertex + (size_t)k];
            f->filter[i][k][row] = x;
            f->v[row][k][i] = (double)x;
            low = x < low ? x : low;
            high = x > high ? x : high;
        }
        edge = high - low > edge ? high - low : edge;
    }
    f->edge[row] = edge * (1.0f + 0x1p-22f);
    for (int k = 0; k < 3; k++)
        f->v[row][k][3] = 0x1p-12 * (double)f->edge[row] * (double)f->edge[row];
    for (int k = 0; k < 3 && row < FLAT_FOUR; k++)
        for (int i = 0; i < 4; i++)
            f->four[k][i][row] = f->v[row][k][i];
    flat_normal(f->v[row], f->ng[row]);
    f->object[row] = object;
    f->primitive[row] = primitive;
}

enum err accel_flat_make(struct accel *a)
{
    uint32_t count = a->triangle_first[a->object_count], row = 0;
    if (!a->kernel->flat || count == 0 || count > FLAT_MAX || a->lazy ||
        a->stats.sphere_count > FLAT_SPHERES_MAX || a->stats.instance_count)
        return ERR_OK;
    struct accel_flat *f = mem_alloc_aligned(sizeof *f, 64);
    if (!f)
        return ERR_NOMEM;
    memset(f, 0, sizeof *f);
    for (uint32_t i = 0; i < a->object_count; i++) {
        if (a->objects[i].type == ACCEL_SPHERE) {
            f->spheres[f->sphere_count++] = i;
            continue;
        }
        const struct accel_mesh *m = &a->meshes[a->objects[i].mesh];
        for (uint32_t k = 0; k < m->triangle_count; k++)
            flat_fill(f, row++, m, i, k);
    }
    f->count = count;
    f->object[FLAT_MAX] = SCENE_NONE;
    a->flat = f;
    a->kernel = a->kernel->flat;
    return ERR_OK;
}
