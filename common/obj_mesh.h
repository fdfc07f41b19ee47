/* common/obj_mesh.h: the triangles of an OBJ file as one indexed mesh.
 *
 * Corners with the same position, uv and normal become one vertex. Normals are made
 * unit (zero ones stay); where some corners lack a uv or a normal, theirs are zero. Pure
 * apart from memory; one thread.
 */
#ifndef COMMON_OBJ_MESH_H
#define COMMON_OBJ_MESH_H

#include "common/obj_file.h"
#include "common/scene.h"

#define OBJ_MATERIAL_ALL (UINT32_MAX - 1)

/* All triangles, or those of one material (OBJ_NONE: of none). out->name is NULL. There must be at
 * least one such triangle. You release `out` (scene_mesh_release). ERR_NOMEM. */
TL_NODISCARD enum err obj_mesh(const struct obj_model *model, uint32_t material,
                               struct scene_mesh *out);

#endif
