/* client/import_assimp.h: from assimp's scene to ours, in the child process.
 *
 * Internal to import_assimp*.c, the one door to assimp. Its data is not trusted: every index
 * is checked, every number that is not finite becomes zero and is said once. One thread.
 */
#ifndef CLIENT_IMPORT_ASSIMP_H
#define CLIENT_IMPORT_ASSIMP_H

#include <assimp/cfileio.h>
#include <assimp/scene.h>

#include "client/import_gltf.h"
#include "client/import_wire.h"

/* A node of the hierarchy with its place in the world. */
struct assimp_node {
    const struct aiNode *node;
    double world[16];
};

struct assimp_import {
    struct import *im;
    struct import_message *message;
    const struct aiScene *from;
    const char *uv_sets; /* glTF: a digit for each material; NULL: any other format */
    struct assimp_node *nodes;
    size_t node_count, node_capacity;
    uint32_t *mesh_of;      /* assimp's mesh -> ours, SCENE_NONE: not yet or no face */
    uint32_t *material_of;  /* assimp's material -> ours */
    struct buf doc, floats; /* glTF rewritten with floats, when that was needed */
    bool has_escapes;       /* glTF: names may have %20, which assimp does not decode */
    double (*emission)[3];  /* of each of assimp's materials: what its area lights emit */
};

/* Our mesh of one of assimp's, in its own space; *has_face is false when there is none, and then
 * `out` is not set. ERR_NOMEM, ERR_LIMIT. */
TL_NODISCARD enum err assimp_mesh(struct assimp_import *a, const struct aiMesh *mesh,
                                  struct scene_mesh *out, bool *has_face);

/* Moves the vertices of a mesh into the world by its bones. */
TL_NODISCARD enum err assimp_skin(struct assimp_import *a, const struct aiMesh *mesh,
                                  const double world[16], struct scene_mesh *out);

/* Moves the vertices of a mesh by a matrix that an object cannot have, such as a flat one. */
void assimp_bake(const double world[16], struct scene_mesh *mesh);

/* Fills material_of and emission. */
TL_NODISCARD enum err assimp_materials(struct assimp_import *a);

/* Objects, cameras and lights. */
TL_NODISCARD enum err assimp_hierarchy(struct assimp_import *a);

/* How assimp opens files: the rewritten document in place of the model, names decoded. Borrows
 * `a`. */
struct aiFileIO assimp_files(struct assimp_import *a);

void assimp_matrix(const struct aiMatrix4x4 *m, double out[16]);

#endif
