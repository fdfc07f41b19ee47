/* Is the hierarchy a tree, and in which order will assimp number the materials? */
#include <string.h>

#include "client/import_gltf.h"
#include "common/mem.h"

/* Deeper hierarchies are refused: assimp walks them by recursion, as we do here. */
enum { DEPTH_MAX = 256 };

struct visit {
    struct gltf *t;
    bool *node_seen, *mesh_seen, *material_seen;
};

/* Assimp numbers materials as it meets them first, mesh by mesh. */
static void meet_mesh(struct visit *v, const struct json *node)
{
    struct gltf *t = v->t;
    uint32_t index;
    const struct json *mesh = gltf_reference(t, node, "mesh", GLTF_MESHES, &index);
    const struct json *list = json_get_member(mesh, "primitives");
    if (!mesh || v->mesh_seen[index] || !list || list->type != JSON_ARRAY)
        return;
    v->mesh_seen[index] = true;
    for (const struct json *p = list->first; p; p = p->next) {
        if (!gltf_reference(t, p, "material", GLTF_MATERIALS, &index) || v->material_seen[index])
            continue;
        v->material_seen[index] = true;
        t->order[t->order_count++] = index;
    }
}

static enum err refuse(struct visit *v, const struct json *at, const char *text)
{
    json_get_problem(&v->t->g, DIAG_ERROR, at, "bad-hierarchy", NULL, "%s", text);
    return ERR_INPUT;
}

/* A node after its children. */
static enum err meet_node(struct visit *v, const struct json *index, int depth)
{
    const struct gltf_table *nodes = &v->t->tables[GLTF_NODES];
    uint64_t i;
    if (!json_value_uint(&v->t->g, index, 0, UINT32_MAX - 1, &i))
        return ERR_INPUT;
    if (i >= nodes->count)
        return refuse(v, index, "no such node");
    if (depth > DEPTH_MAX)
        return refuse(v, index, "nodes are nested over 256 deep");
    if (v->node_seen[i])
        return refuse(v, index, "the node is there twice, expected a tree");
    v->node_seen[i] = true;
    const struct json *children = json_get_member(nodes->items[i], "children");
    for (const struct json *c = children ? children->first : NULL; c; c = c->next)
        TL_TRY(meet_node(v, c, depth + 1));
    meet_mesh(v, nodes->items[i]);
    return ERR_OK;
}

static enum err meet_scene(struct visit *v)
{
    struct gltf *t = v->t;
    uint32_t index;
    const struct json *scene = gltf_reference(t, t->g.root, "scene", GLTF_SCENES, &index);
    if (!scene && !json_get_member(t->g.root, "scene"))
        scene = t->tables[GLTF_SCENES].items[0];
    const struct json *nodes = json_get_member(scene, "nodes");
    if (nodes && !json_get_is(&t->g, nodes, JSON_ARRAY))
        return ERR_INPUT;
    for (const struct json *n = nodes ? nodes->first : NULL; n; n = n->next)
        TL_TRY(meet_node(v, n, 0));
    return ERR_OK;
}

static enum err meet_all(struct visit *v)
{
    struct gltf *t = v->t;
    const struct gltf_table *tables = t->tables;
    v->node_seen = mem_calloc(tables[GLTF_NODES].count + 1, 1);
    v->mesh_seen = mem_calloc(tables[GLTF_MESHES].count + 1, 1);
    v->material_seen = mem_calloc(tables[GLTF_MATERIALS].count + 1, 1);
    t->order = mem_calloc(tables[GLTF_MATERIALS].count + 1, sizeof *t->order);
    if (!v->node_seen || !v->mesh_seen || !v->material_seen || !t->order)
        return ERR_NOMEM;
    return meet_scene(v);
}

enum err gltf_order(struct gltf *t)
{
    struct visit v = {.t = t};
    const struct gltf_table *tables = t->tables;
    if (tables[GLTF_SCENES].count == 0)
        return import_fail(t->im, "no-face", "export a scene that shows them",
                           "no scene in it: it holds %zu meshes and %zu nodes that none shows",
                           tables[GLTF_MESHES].count, tables[GLTF_NODES].count);
    enum err e = meet_all(&v);
    mem_free(v.node_seen);
    mem_free(v.mesh_seen);
    mem_free(v.material_seen);
    return e;
}
