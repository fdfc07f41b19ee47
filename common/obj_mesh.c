#include "common/obj_mesh.h"

#include <math.h>
#include <string.h>

#include "common/mem.h"
#include "common/model_file.h"

/* Corner -> vertex. Most corners are the vertex that their position was last, which one look at a
 * small table tells; the others are found by open addressing, at most half full. Both hold
 * vertex + 1. */
struct welder {
    const struct obj_model *model;
    struct obj_corner *vertices;
    size_t count, capacity;
    uint32_t *slots;
    size_t mask;
    uint32_t *last; /* of each position; NULL: for a small part of the model it is not worth it */
};

static size_t hash(const struct obj_corner *c)
{
    uint64_t h = c->position * UINT64_C(0x9E3779B97F4A7C15);
    h = (h ^ (h >> 29) ^ c->uv) * UINT64_C(0xBF58476D1CE4E5B9);
    h = (h ^ (h >> 32) ^ c->normal) * UINT64_C(0x94D049BB133111EB);
    return (size_t)(h ^ (h >> 31));
}

static bool same(const struct obj_corner *a, const struct obj_corner *b)
{
    return a->position == b->position && a->uv == b->uv && a->normal == b->normal;
}

/* The vertex + 1 that the corner is, or 0. */
static uint32_t find(const struct welder *w, const struct obj_corner *c)
{
    for (size_t slot = hash(c) & w->mask; w->slots[slot]; slot = (slot + 1) & w->mask)
        if (same(&w->vertices[w->slots[slot] - 1], c))
            return w->slots[slot];
    return 0;
}

static void enter(struct welder *w, uint32_t vertex)
{
    size_t slot = hash(&w->vertices[vertex - 1]) & w->mask;
    while (w->slots[slot])
        slot = (slot + 1) & w->mask;
    w->slots[slot] = vertex;
}

/* Room for one more vertex. */
static bool grow(struct welder *w)
{
    if (!mem_grow((void **)&w->vertices, w->count, &w->capacity, sizeof *w->vertices))
        return false;
    if (2 * (w->count + 1) <= w->mask + 1)
        return true;
    uint32_t *slots = mem_calloc(2 * (w->mask + 1), sizeof *slots);
    if (!slots)
        return false;
    mem_free(w->slots);
    w->slots = slots;
    w->mask = 2 * w->mask + 1;
    for (size_t i = 0; i < w->count; i++)
        enter(w, (uint32_t)i + 1);
    return true;
}

/* The vertex + 1 of a corner; 0: out of memory. */
static uint32_t weld(struct welder *w, const struct obj_corner *c)
{
    uint32_t *last = w->last ? &w->last[c->position] : NULL;
    if (last && *last && same(&w->vertices[*last - 1], c))
        return *last;
    uint32_t vertex = last && *last == 0 ? 0 : find(w, c); /* a new position is a new vertex */
    if (vertex == 0) {
        if (!grow(w))
            return 0;
        w->vertices[w->count] = *c;
        vertex = (uint32_t)++w->count;
        enter(w, vertex);
    }
    if (last)
        *last = vertex;
    return vertex;
}

static bool is_wanted(const struct obj_triangle *t, uint32_t material)
{
    return material == OBJ_MATERIAL_ALL || t->material == material;
}

static bool welder_init(struct welder *w, const struct obj_model *model, size_t corner_count)
{
    enum { SLOTS_MIN = 1024, POSITIONS_A_CORNER_MAX = 4 };
    bool wants_last = model->position_count / POSITIONS_A_CORNER_MAX <= corner_count;
    *w = (struct welder){.model = model, .mask = SLOTS_MIN - 1};
    w->slots = mem_calloc(SLOTS_MIN, sizeof *w->slots);
    w->last = wants_last ? mem_calloc(model->position_count, sizeof *w->last) : NULL;
    return w->slots && (w->last || !wants_last);
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
    good = good && m.indices;
    for (size_t i = 0; good && i < model->triangle_count; i++) {
        for (size_t j = 0; good && j < 3 && is_wanted(&model->triangles[i], material); j++) {
            uint32_t vertex = weld(&w, &model->triangles[i].corners[j]);
            good = vertex != 0;
            m.indices[at++] = vertex - 1;
        }
    }
    m.vertex_count = (uint32_t)w.count;
    good = good && fill_vertices(&w, &m);
    mem_free(w.vertices);
    mem_free(w.slots);
    mem_free(w.last);
    if (!good) {
        scene_mesh_release(&m);
        return ERR_NOMEM;
    }
    *out = m;
    return ERR_OK;
}
