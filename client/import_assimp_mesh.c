/* client/import_assimp_mesh.c: triangles, normals and texture coordinates from assimp's meshes.
 *
 * Numbers that are not finite are replaced, with one warning. Runs in the importer's child; one
 * thread.
 */
#include <math.h>
#include <string.h>

#include "client/import_assimp.h"
#include "common/mem.h"
#include "common/model_file.h"

static void tell_bad_number(struct import *im)
{
    if (import_once(im, IMPORT_ONCE_BAD_NUMBER))
        import_warn(im, "not-finite", NULL,
                    "numbers that are not finite are taken as zero, faces at them left out");
}

/* A number the file may have made anything. */
static double finite_or_zero(struct assimp_import *a, double v)
{
    if (isfinite(v))
        return v;
    tell_bad_number(a->im);
    return 0;
}

static void unit_or_zero(double x, double y, double z, float out[3])
{
    double length = sqrt(x * x + y * y + z * z);
    bool good = length > 0 && isfinite(length);
    out[0] = good ? (float)(x / length) : 0;
    out[1] = good ? (float)(y / length) : 0;
    out[2] = good ? (float)(z / length) : 0;
}

/* --- Vertices ------------------------------------------------------------ */

/* The weight of a morph target in the file's rest state. */
static double weight_of(const struct aiMesh *mesh, unsigned target)
{
    const struct aiAnimMesh *m = mesh->mAnimMeshes[target];
    double w = (double)m->mWeight;
    return m->mNumVertices == mesh->mNumVertices && isfinite(w) ? w : 0;
}

static void position_of(struct assimp_import *a, const struct aiMesh *mesh, unsigned i,
                        double out[3])
{
    const struct aiVector3D *p = &mesh->mVertices[i];
    out[0] = finite_or_zero(a, (double)p->x);
    out[1] = finite_or_zero(a, (double)p->y);
    out[2] = finite_or_zero(a, (double)p->z);
    for (unsigned t = 0; t < mesh->mNumAnimMeshes; t++) {
        double w = weight_of(mesh, t);
        const struct aiVector3D *moved = mesh->mAnimMeshes[t]->mVertices;
        if (w == 0 || !moved)
            continue;
        out[0] += w * finite_or_zero(a, (double)moved[i].x - (double)p->x);
        out[1] += w * finite_or_zero(a, (double)moved[i].y - (double)p->y);
        out[2] += w * finite_or_zero(a, (double)moved[i].z - (double)p->z);
    }
}

static void normal_of(const struct aiMesh *mesh, unsigned i, float out[3])
{
    const struct aiVector3D *n = &mesh->mNormals[i];
    double x = (double)n->x, y = (double)n->y, z = (double)n->z;
    for (unsigned t = 0; t < mesh->mNumAnimMeshes; t++) {
        double w = weight_of(mesh, t);
        const struct aiVector3D *moved = mesh->mAnimMeshes[t]->mNormals;
        if (w == 0 || !moved)
            continue;
        x += w * ((double)moved[i].x - (double)n->x);
        y += w * ((double)moved[i].y - (double)n->y);
        z += w * ((double)moved[i].z - (double)n->z);
    }
    unit_or_zero(x, y, z, out);
}

static const struct aiVector3D *uvs_of(const struct assimp_import *a, const struct aiMesh *mesh)
{
    unsigned set = 0, material = mesh->mMaterialIndex;
    if (a->uv_sets && material < strlen(a->uv_sets))
        set = (unsigned)(a->uv_sets[material] - '0');
    if (set >= AI_MAX_NUMBER_OF_TEXTURECOORDS || !mesh->mTextureCoords[set])
        set = 0;
    return mesh->mTextureCoords[set];
}

/* The first set, which is linear. Where all are opaque there is no alpha. */
static bool fill_colors(const struct aiMesh *mesh, struct scene_mesh *m)
{
    const struct aiColor4D *from = mesh->mColors[0];
    m->colors = mem_alloc_array(mesh->mNumVertices, 3 * sizeof *m->colors);
    bool clear = false;
    for (size_t i = 0; m->colors && i < mesh->mNumVertices; i++) {
        const double c[3] = {(double)from[i].r, (double)from[i].g, (double)from[i].b};
        for (size_t k = 0; k < 3; k++)
            m->colors[3 * i + k] = model_vertex_color(c[k], false);
        clear |= !(from[i].a >= 1);
    }
    m->alphas = clear ? mem_alloc_array(mesh->mNumVertices, sizeof *m->alphas) : NULL;
    for (size_t i = 0; m->alphas && i < mesh->mNumVertices; i++)
        m->alphas[i] = model_vertex_color((double)from[i].a, false);
    return m->colors && (m->alphas || !clear);
}

static bool fill_vertices(struct assimp_import *a, const struct aiMesh *mesh, struct scene_mesh *m)
{
    const struct aiVector3D *uvs = uvs_of(a, mesh);
    size_t count = mesh->mNumVertices;
    m->vertex_count = mesh->mNumVertices;
    m->positions = mem_alloc_array(3 * count, sizeof *m->positions);
    m->normals = mesh->mNormals ? mem_alloc_array(3 * count, sizeof *m->normals) : NULL;
    m->uvs = uvs ? mem_alloc_array(2 * count, sizeof *m->uvs) : NULL;
    if (!m->positions || (mesh->mNormals && !m->normals) || (uvs && !m->uvs))
        return false;
    if (mesh->mColors[0] && !fill_colors(mesh, m))
        return false;
    for (unsigned i = 0; i < mesh->mNumVertices; i++) {
        position_of(a, mesh, i, m->positions + 3 * (size_t)i);
        if (m->normals)
            normal_of(mesh, i, m->normals + 3 * (size_t)i);
        if (m->uvs) {
            m->uvs[2 * (size_t)i] = (float)finite_or_zero(a, (double)uvs[i].x);
            m->uvs[2 * (size_t)i + 1] = (float)finite_or_zero(a, (double)uvs[i].y);
        }
    }
    return true;
}

/* --- Faces --------------------------------------------------------------- */

static bool vertex_is_finite(const struct aiMesh *mesh, unsigned i)
{
    const struct aiVector3D *p = &mesh->mVertices[i];
    return isfinite((double)p->x) && isfinite((double)p->y) && isfinite((double)p->z);
}

static bool is_triangle(const struct aiMesh *mesh, const struct aiFace *f)
{
    if (f->mNumIndices != 3)
        return false;
    for (int i = 0; i < 3; i++)
        if (f->mIndices[i] >= mesh->mNumVertices || !vertex_is_finite(mesh, f->mIndices[i]))
            return false;
    return true;
}

/* Counts triangles, and notes what else there is. */
static uint32_t count_triangles(struct assimp_import *a, const struct aiMesh *mesh)
{
    uint32_t count = 0;
    for (unsigned i = 0; i < mesh->mNumFaces; i++) {
        const struct aiFace *f = &mesh->mFaces[i];
        a->im->point_count += f->mNumIndices == 1;
        a->im->line_count += f->mNumIndices == 2;
        count += is_triangle(mesh, f);
        if (f->mNumIndices == 3 && !is_triangle(mesh, f))
            tell_bad_number(a->im);
    }
    return count;
}

static bool fill_faces(const struct aiMesh *mesh, struct scene_mesh *m)
{
    uint32_t *to = m->indices = mem_alloc_array(3 * (size_t)m->triangle_count, sizeof *m->indices);
    for (unsigned i = 0; to && i < mesh->mNumFaces; i++) {
        const struct aiFace *f = &mesh->mFaces[i];
        if (!is_triangle(mesh, f))
            continue;
        memcpy(to, f->mIndices, 3 * sizeof *to);
        to += 3;
    }
    return m->indices != NULL;
}

enum err assimp_mesh(struct assimp_import *a, const struct aiMesh *mesh, struct scene_mesh *out,
                     bool *has_face)
{
    struct scene_mesh m = {.triangle_count = mesh->mVertices ? count_triangles(a, mesh) : 0};
    *has_face = m.triangle_count > 0;
    if (!*has_face)
        return ERR_OK;
    if (m.triangle_count > SCENE_TRIANGLES_MAX)
        return ERR_LIMIT;
    m.name = mem_strndup(mesh->mName.data, mesh->mName.length < SCENE_NAME_BYTES_MAX
                                               ? mesh->mName.length
                                               : SCENE_NAME_BYTES_MAX);
    if (!m.name || !fill_faces(mesh, &m) || !fill_vertices(a, mesh, &m)) {
        scene_mesh_release(&m);
        return ERR_NOMEM;
    }
    *out = m;
    return ERR_OK;
}

/* --- Moving vertices ----------------------------------------------------- */

static void move_normal(const double m[16], float n[3])
{
    double from[3] = {(double)n[0], (double)n[1], (double)n[2]}, to[3];
    import_transform_vector(m, from, to);
    unit_or_zero(to[0], to[1], to[2], n);
}

void assimp_bake(const double world[16], struct scene_mesh *mesh)
{
    for (size_t i = 0; i < mesh->vertex_count; i++) {
        double p[3];
        import_transform_point(world, mesh->positions + 3 * i, p);
        memcpy(mesh->positions + 3 * i, p, sizeof p);
    }
    /* The inverse that normals would need does not exist. */
    mem_free(mesh->normals);
    mesh->normals = NULL;
}

static const struct assimp_node *find_node(const struct assimp_import *a, const char *name)
{
    for (size_t i = 0; i < a->node_count; i++)
        if (strcmp(a->nodes[i].node->mName.data, name) == 0)
            return &a->nodes[i];
    return NULL;
}

/* Adds each bone's matrix, by weight, to those of its vertices; the 17th number is the sum. */
static void add_bones(const struct assimp_import *a, const struct aiMesh *mesh, double (*sums)[17])
{
    for (unsigned b = 0; b < mesh->mNumBones; b++) {
        const struct aiBone *bone = mesh->mBones[b];
        const struct assimp_node *joint = find_node(a, bone->mName.data);
        double offset[16], m[16];
        if (!joint)
            continue;
        assimp_matrix(&bone->mOffsetMatrix, offset);
        import_transform_multiply(joint->world, offset, m);
        for (unsigned w = 0; w < bone->mNumWeights; w++) {
            double weight = (double)bone->mWeights[w].mWeight;
            unsigned vertex = bone->mWeights[w].mVertexId;
            if (!(weight > 0 && weight <= 1e6) || vertex >= mesh->mNumVertices)
                continue;
            for (int i = 0; i < 16; i++)
                sums[vertex][i] += weight * m[i];
            sums[vertex][16] += weight;
        }
    }
}

enum err assimp_skin(struct assimp_import *a, const struct aiMesh *mesh, const double world[16],
                     struct scene_mesh *out)
{
    double(*sums)[17] = mem_calloc(mesh->mNumVertices, sizeof *sums);
    if (!sums)
        return ERR_NOMEM;
    add_bones(a, mesh, sums);
    for (size_t v = 0; v < out->vertex_count; v++) {
        double m[16], p[3], total = sums[v][16];
        memcpy(m, world, sizeof m);
        for (int i = 0; total > 0 && i < 16; i++)
            m[i] = sums[v][i] / total;
        import_transform_point(m, out->positions + 3 * v, p);
        memcpy(out->positions + 3 * v, p, sizeof p);
        if (out->normals)
            move_normal(m, out->normals + 3 * v);
    }
    mem_free(sums);
    return ERR_OK;
}
