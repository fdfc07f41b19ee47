#include "common/ply_wedge.h"

#include <string.h>

#include "common/mem.h"

/* Corners of one vertex are compared with so many others: more only take memory. */
enum { VARIANTS_COMPARED = 32 };

/* A vertex of the new mesh. */
struct variant {
    uint32_t vertex; /* of the old one */
    uint32_t next;   /* older variant of the same; UINT32_MAX: none */
    float uv[2];
};

struct splitter {
    struct variant *variants;
    size_t count, capacity;
    uint32_t *newest; /* variant of each old vertex, or UINT32_MAX */
};

/* The variant of a vertex with these coordinates, made if need be. */
static enum err variant_of(struct splitter *s, uint32_t vertex, const float uv[2], uint32_t *out)
{
    uint32_t at = s->newest[vertex];
    for (int i = 0; at != UINT32_MAX && i < VARIANTS_COMPARED; i++, at = s->variants[at].next) {
        if (memcmp(s->variants[at].uv, uv, sizeof s->variants[at].uv) == 0) {
            *out = at;
            return ERR_OK;
        }
    }
    if (s->count >= UINT32_MAX - 1)
        return ERR_LIMIT;
    if (!mem_grow((void **)&s->variants, s->count, &s->capacity, sizeof *s->variants))
        return ERR_NOMEM;
    *out = (uint32_t)s->count++;
    s->variants[*out] = (struct variant){vertex, s->newest[vertex], {uv[0], uv[1]}};
    s->newest[vertex] = *out;
    return ERR_OK;
}

/* The mesh's arrays anew, a vertex for each variant. */
static enum err gather(struct scene_mesh *mesh, const struct splitter *s)
{
    double *positions = mem_alloc_array(s->count, 3 * sizeof *positions);
    float *normals = mesh->normals ? mem_alloc_array(s->count, 3 * sizeof *normals) : NULL;
    float *uvs = mem_alloc_array(s->count, 2 * sizeof *uvs);
    float *colors = mesh->colors ? mem_alloc_array(s->count, 3 * sizeof *colors) : NULL;
    float *alphas = mesh->alphas ? mem_alloc_array(s->count, sizeof *alphas) : NULL;
    if (!positions || (mesh->normals && !normals) || (mesh->colors && !colors) ||
        (mesh->alphas && !alphas) || !uvs) {
        mem_free(positions);
        mem_free(normals);
        mem_free(uvs);
        mem_free(colors);
        mem_free(alphas);
        return ERR_NOMEM;
    }
    for (size_t i = 0; i < s->count; i++) {
        size_t from = s->variants[i].vertex;
        memcpy(positions + 3 * i, mesh->positions + 3 * from, 3 * sizeof *positions);
        if (normals)
            memcpy(normals + 3 * i, mesh->normals + 3 * from, 3 * sizeof *normals);
        if (colors)
            memcpy(colors + 3 * i, mesh->colors + 3 * from, 3 * sizeof *colors);
        if (alphas)
            alphas[i] = mesh->alphas[from];
        memcpy(uvs + 2 * i, s->variants[i].uv, sizeof s->variants[i].uv);
    }
    mem_free(mesh->positions);
    mem_free(mesh->normals);
    mem_free(mesh->uvs);
    mem_free(mesh->colors);
    mem_free(mesh->alphas);
    mesh->colors = colors;
    mesh->alphas = alphas;
    mesh->positions = positions;
    mesh->normals = normals;
    mesh->uvs = uvs;
    mesh->vertex_count = (uint32_t)s->count;
    return ERR_OK;
}

enum err ply_split_corners(struct scene_mesh *mesh, const float *corner_uvs)
{
    size_t corners = 3 * (size_t)mesh->triangle_count;
    struct splitter s = {.newest = mem_alloc_array(mesh->vertex_count, sizeof *s.newest)};
    uint32_t *indices = mem_alloc_array(corners, sizeof *indices);
    enum err e = s.newest && indices ? ERR_OK : ERR_NOMEM;
    for (size_t i = 0; e == ERR_OK && i < mesh->vertex_count; i++)
        s.newest[i] = UINT32_MAX;
    for (size_t i = 0; e == ERR_OK && i < corners; i++)
        e = variant_of(&s, mesh->indices[i], corner_uvs + 2 * i, &indices[i]);
    if (e == ERR_OK)
        e = gather(mesh, &s);
    if (e == ERR_OK) {
        mem_free(mesh->indices);
        mesh->indices = indices;
        indices = NULL;
    }
    mem_free(indices);
    mem_free(s.newest);
    mem_free(s.variants);
    return e;
}
