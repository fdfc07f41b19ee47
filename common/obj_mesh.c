#include "common/obj_mesh.h"

#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "common/model_file.h"

/* Corner -> vertex, by open addressing; a slot holds vertex + 1. */
struct welder {
    const struct obj_model *model;
    struct obj_corner *vertices;
    size_t count;
    uint32_t *slots;
    size_t mask;
};

static size_t hash(const struct obj_corner *c)
{
    uint64_t h = c->position * UINT64_C(0x9E3779B97F4A7C15);
    h = (h ^ (h >> 29) ^ c->uv) * UINT64_C(0xBF58476D1CE4E5B9);
    h = (h ^ (h >> 32) ^ c->normal) * UINT64_C(0x94D049BB133111EB);
    return (size_t)(h ^ (h >> 31));
}

static uint32_t weld(struct welder *w, const struct obj_corner *c)
{
    size_t slot = hash(c) & w->mask;
    for (; w->slots[slot]; slot = (slot + 1) & w->mask) {
        const struct obj_corner *v = &w->vertices[w->slots[slot] - 1];
        if (v->position == c->position && v->uv == c->uv && v->normal == c->normal)
            return w->slots[slot] - 1;
    }
    w->vertices[w->count] = *c;
    w->slots[slot] = (uint32_t)++w->count;
    return w->slots[slot] - 1;
}

static bool is_wanted(const struct obj_triangle *t, uint32_t material)
{
    return material == OBJ_MATERIAL_ALL || t->material == material;
}

static bool welder_init(struct welder *w, const struct obj_model *model, size_t corner_count)
{
    size_t slots = 16;
    while (slots < 2 * corner_count)
        slots *= 2;
    *w = (struct welder){.model = model, .mask = slots - 1};
    w->vertices = mem_alloc_array(corner_count, sizeof *w->vertices);
    w->slots = mem_calloc(slots, sizeof *w->slots);
    return w->vertices && w->slots;
}

static void unit_normal(const double *n, float out[3])
{
    double largest = fmax(fabs(n[0]), fmax(fabs(n[1]), fabs(n[2])));
    if (!(largest > 0))
        return;
    double x = n[0] / largest, y = n[1] / largest, z = n[2] / largest;
    double length = sqrt(x * x + y * y + z * z);
    out[0] = (float)(x / length);
    out[1] = (float)(y / length);
    out[2] = (float)(z / length);
}

/* Fills the vertex arrays of a mesh whose counts and indices are set. */
static bool fill_vertices(const struct welder *w, struct scene_mesh *m)
{
    bool any_uv = false, any_normal = false;
    for (size_t i = 0; i < w->count; i++) {
        any_uv |= w->vertices[i].uv != OBJ_NONE;
        any_normal |= w->vertices[i].normal != OBJ_NONE;
    }
    m->positions = mem_alloc_array(w->count * 3, sizeof *m->positions);
    m->uvs = any_uv ? mem_calloc(w->count * 2, sizeof *m->uvs) : NULL;
    m->normals = any_normal ? mem_calloc(w->count * 3, sizeof *m->normals) : NULL;
    bool colored = w->model->colors != NULL;
    m->colors = colored ? mem_alloc_array(w->count * 3, sizeof *m->colors) : NULL;
    if (!m->positions || (colored && !m->colors) || (any_uv && !m->uvs) ||
        (any_normal && !m->normals))
        return false;
    for (size_t i = 0; i < w->count; i++) {
        const struct obj_corner *c = &w->vertices[i];
        memcpy(m->positions + 3 * i, w->model->positions + 3 * (size_t)c->position,
               3 * sizeof(double));
        if (colored)
            memcpy(m->colors + 3 * i, w->model->colors + 3 * (size_t)c->position,
                   3 * sizeof *m->colors);
        for (size_t j = 0; c->uv != OBJ_NONE && j < 2; j++)
            m->uvs[2 * i + j] = (float)w->model->uvs[2 * (size_t)c->uv + j];
        if (c->normal != OBJ_NONE)
            unit_normal(w->model->normals + 3 * (size_t)c->normal, m->normals + 3 * i);
    }
    return true;
}

enum err obj_mesh(const struct obj_model *model, uint32_t material, struct scene_mesh *out)
{
    size_t count = 0, at = 0;
    for (size_t i = 0; i < model->triangle_count; i++)
        count += is_wanted(&model->triangles[i], material);
    TL_ASSERT(count >= 1);
    struct welder w;
    struct scene_mesh m = {.triangle_count = (uint32_t)count};
    bool good = welder_init(&w, model, 3 * count);
    m.indices = mem_alloc_array(3 * count, sizeof *m.indices);
    for (size_t i = 0; good && m.indices && i < model->triangle_count; i++)
        for (size_t j = 0; j < 3 && is_wanted(&model->triangles[i], material); j++)
            m.indices[at++] = weld(&w, &model->triangles[i].corners[j]);
    m.vertex_count = (uint32_t)w.count;
    good = good && m.indices && fill_vertices(&w, &m);
    mem_free(w.vertices);
    mem_free(w.slots);
    if (!good) {
        scene_mesh_release(&m);
        return ERR_NOMEM;
    }
    *out = m;
    return ERR_OK;
}
