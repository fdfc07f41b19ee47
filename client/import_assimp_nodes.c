/* Assimp's hierarchy: objects, cameras, lights. */
#include <math.h>
#include <string.h>

#include "client/import_assimp.h"
#include "common/dmath.h"
#include "common/mem.h"

/* A hierarchy deeper or larger than this is damaged. */
enum { NODES_MAX = 1 << 20 };

void assimp_matrix(const struct aiMatrix4x4 *m, double out[16])
{
    const float rows[12] = {m->a1, m->a2, m->a3, m->a4, m->b1, m->b2,
                            m->b3, m->b4, m->c1, m->c2, m->c3, m->c4};
    for (int i = 0; i < 12; i++)
        out[i] = isfinite(rows[i]) ? (double)rows[i] : 0;
    out[12] = out[13] = out[14] = 0;
    out[15] = 1;
}

static enum err add_node(struct assimp_import *a, const struct aiNode *node,
                         const double parent[16])
{
    double local[16];
    if (a->node_count >= NODES_MAX)
        return import_fail(a->im, "model-too-large", NULL, "over %d nodes", NODES_MAX);
    if (!mem_grow((void **)&a->nodes, a->node_count, &a->node_capacity, sizeof *a->nodes))
        return ERR_NOMEM;
    struct assimp_node *n = &a->nodes[a->node_count++];
    n->node = node;
    assimp_matrix(&node->mTransformation, local);
    import_transform_multiply(parent, local, n->world);
    return ERR_OK;
}

/* Parents come before their children. */
static enum err list_nodes(struct assimp_import *a)
{
    static const double identity[16] = {[0] = 1, [5] = 1, [10] = 1, [15] = 1};
    if (!a->from->mRootNode)
        return ERR_OK;
    TL_TRY(add_node(a, a->from->mRootNode, identity));
    for (size_t i = 0; i < a->node_count; i++) {
        const struct aiNode *node = a->nodes[i].node;
        double world[16];
        memcpy(world, a->nodes[i].world, sizeof world);
        for (unsigned c = 0; c < node->mNumChildren; c++)
            TL_TRY(add_node(a, node->mChildren[c], world));
    }
    return ERR_OK;
}

/* --- Objects ------------------------------------------------------------- */

static bool all_within(const double *v, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (!(fabs(v[i]) <= SCENE_NUMBER_MAX))
            return false;
    return true;
}

/* A mesh that other nodes show too, made when it is first needed. */
static enum err shared_mesh(struct assimp_import *a, unsigned index, uint32_t *out, bool *has_face)
{
    struct scene_mesh mesh;
    *has_face = a->mesh_of[index] != SCENE_NONE;
    if (!*has_face) {
        TL_TRY(assimp_mesh(a, a->from->mMeshes[index], &mesh, has_face));
        if (*has_face)
            TL_TRY(import_add_mesh(a->im, &mesh, &a->mesh_of[index]));
    }
    *out = a->mesh_of[index];
    return ERR_OK;
}

/* A mesh of its own, its vertices in the world. */
static enum err own_mesh(struct assimp_import *a, const struct aiMesh *from, const double world[16],
                         uint32_t *out, bool *has_face)
{
    struct scene_mesh mesh;
    TL_TRY(assimp_mesh(a, from, &mesh, has_face));
    if (!*has_face)
        return ERR_OK;
    if (from->mNumBones > 0)
        TL_TRY(assimp_skin(a, from, world, &mesh));
    else
        assimp_bake(world, &mesh);
    if (!all_within(mesh.positions, 3 * (size_t)mesh.vertex_count))
        return import_fail(a->im, "not-finite", NULL, "its transforms leave the range of numbers");
    return import_add_mesh(a->im, &mesh, out);
}

/* An object, and which node shows it. */
static enum err add_shown(struct import *im, const struct scene_object *object, uint32_t node)
{
    if (!mem_grow((void **)&im->object_nodes, im->object_node_count, &im->object_node_capacity,
                  sizeof *im->object_nodes))
        return ERR_NOMEM;
    im->object_nodes[im->object_node_count++] = node;
    return import_add_object(im, object);
}

static enum err add_object(struct assimp_import *a, const struct assimp_node *n, unsigned index)
{
    if (index >= a->from->mNumMeshes)
        return ERR_OK;
    const struct aiMesh *from = a->from->mMeshes[index];
    unsigned material = from->mMaterialIndex;
    struct scene_object object;
    bool has_face;
    scene_object_init(&object);
    bool in_place = from->mNumBones == 0 && scene_transform_valid(n->world);
    if (in_place) {
        memcpy(object.transform, n->world, sizeof object.transform);
        TL_TRY(shared_mesh(a, index, &object.mesh, &has_face));
    } else {
        TL_TRY(own_mesh(a, from, n->world, &object.mesh, &has_face));
    }
    if (!has_face)
        return ERR_OK;
    if (material < a->from->mNumMaterials) {
        const double *e = a->emission[material];
        object.material = a->material_of[material];
        object.emits = e[0] > 0 || e[1] > 0 || e[2] > 0;
        memcpy(object.radiance, e, sizeof object.radiance);
        a->im->has_lamp |= fmax(e[0], fmax(e[1], e[2])) > 1;
    }
    return add_shown(a->im, &object, in_place ? (uint32_t)(n - a->nodes) : SCENE_NONE);
}

/* --- Cameras and lights of formats other than glTF ------------------------ */

static const struct assimp_node *node_named(const struct assimp_import *a,
                                            const struct aiString *name)
{
    for (size_t i = 0; i < a->node_count; i++)
        if (strcmp(a->nodes[i].node->mName.data, name->data) == 0)
            return &a->nodes[i];
    return a->node_count ? &a->nodes[0] : NULL;
}

static void vector(const struct aiVector3D *v, double out[3])
{
    out[0] = (double)v->x;
    out[1] = (double)v->y;
    out[2] = (double)v->z;
}

/* Full horizontal angle to full vertical angle, in degrees. */
static double vertical_degrees(double horizontal, double aspect)
{
    double half = dmath_tan(horizontal / 2) / aspect;
    return 2 * dmath_atan(half) * (180 / DMATH_PI);
}

static void take_camera(struct assimp_import *a)
{
    if (a->from->mNumCameras == 0)
        return;
    const struct aiCamera *from = a->from->mCameras[0];
    const struct assimp_node *n = node_named(a, &from->mName);
    struct scene_camera c;
    double at[3], look[3], up[3];
    scene_camera_init(&c);
    vector(&from->mPosition, at);
    vector(&from->mLookAt, look);
    vector(&from->mUp, up);
    double aspect = (double)from->mAspect > 0 ? (double)from->mAspect : 1;
    c.fov = vertical_degrees((double)from->mHorizontalFOV, aspect);
    if (!n || !(c.fov > 1 && c.fov < 170))
        return;
    import_transform_point(n->world, at, c.position);
    import_transform_vector(n->world, look, c.look_at);
    import_transform_vector(n->world, up, c.ref_up);
    for (int i = 0; i < 3; i++)
        c.look_at[i] += c.position[i];
    if (!import_camera_valid(&c))
        return;
    a->im->scene.camera = c;
    a->im->has_camera = true;
    a->im->aspect = (double)from->mAspect;
}

/* Such formats give a colour that does not fall off: light that is that bright, times pi, in the
 * middle of the model, so that white paper there looks that colour. */
static void scale_light(const struct import *im, double factor, struct scene_light *l)
{
    double low[3], high[3], d2 = 0;
    import_bounds(im, low, high);
    for (int i = 0; i < 3; i++) {
        double d = low[i] / 2 + high[i] / 2 - l->position[i];
        d2 += d * d;
    }
    bool falls_off = l->type != SCENE_LIGHT_DIRECTIONAL;
    for (int i = 0; i < 3; i++)
        l->intensity[i] *= DMATH_PI * factor * (falls_off ? d2 : 1);
}

static bool light_usable(const struct scene_light *l)
{
    double d = 0;
    for (int i = 0; i < 3; i++) {
        d += l->direction[i] * l->direction[i];
        if (!(l->intensity[i] >= 0 && l->intensity[i] <= SCENE_NUMBER_MAX))
            return false;
    }
    return d > 0.5 && d < 2 && all_within(l->position, 3) &&
           l->intensity[0] + l->intensity[1] + l->intensity[2] > 0;
}

static enum err take_light(struct assimp_import *a, const struct aiLight *from)
{
    static const enum scene_light_type types[] = {[aiLightSource_DIRECTIONAL] =
                                                      SCENE_LIGHT_DIRECTIONAL,
                                                  [aiLightSource_POINT] = SCENE_LIGHT_POINT,
                                                  [aiLightSource_SPOT] = SCENE_LIGHT_SPOT};
    const struct assimp_node *n = node_named(a, &from->mName);
    unsigned type = (unsigned)from->mType;
    if (type == aiLightSource_AMBIENT || !n)
        return ERR_OK;
    if (type < aiLightSource_DIRECTIONAL || type > aiLightSource_SPOT) {
        if (import_once(a->im, IMPORT_ONCE_LIGHT_TYPE))
            import_warn(a->im, "left-out", NULL, "lights of a kind we do not know are left out");
        return ERR_OK;
    }
    struct scene_light l = {.type = types[type]};
    double at[3], direction[3], d = 0;
    vector(&from->mPosition, at);
    vector(&from->mDirection, direction);
    import_transform_point(n->world, at, l.position);
    import_transform_vector(n->world, direction, l.direction);
    for (int i = 0; i < 3; i++)
        d += l.direction[i] * l.direction[i];
    for (int i = 0; i < 3; i++)
        l.direction[i] = d > 0 ? l.direction[i] / sqrt(d) : (i == 2 ? -1 : 0);
    l.intensity[0] = (double)from->mColorDiffuse.r;
    l.intensity[1] = (double)from->mColorDiffuse.g;
    l.intensity[2] = (double)from->mColorDiffuse.b;
    l.cos_inner = dmath_cos((double)from->mAngleInnerCone / 2);
    l.cos_outer = dmath_cos((double)from->mAngleOuterCone / 2);
    if (!(l.cos_inner >= l.cos_outer))
        l.cos_inner = l.cos_outer = isfinite(l.cos_outer) ? l.cos_outer : -1;
    scale_light(a->im, 1, &l);
    return light_usable(&l) ? import_add_light(a->im, &l) : ERR_OK;
}

enum err assimp_hierarchy(struct assimp_import *a)
{
    for (unsigned i = 0; i < a->from->mNumMeshes; i++)
        a->im->vertex_count += a->from->mMeshes[i]->mNumVertices;
    TL_TRY(list_nodes(a));
    for (size_t i = 0; i < a->node_count; i++)
        for (unsigned m = 0; m < a->nodes[i].node->mNumMeshes; m++)
            TL_TRY(add_object(a, &a->nodes[i], a->nodes[i].node->mMeshes[m]));
    if (a->uv_sets || a->im->scene.object_count == 0)
        return ERR_OK;
    take_camera(a);
    for (unsigned i = 0; i < a->from->mNumLights; i++)
        TL_TRY(take_light(a, a->from->mLights[i]));
    return ERR_OK;
}
