/* common/model_file.h: mesh files into one indexed mesh.
 *
 * OBJ (obj_file.h) and PLY (ply_file.h), told by the extension. Coordinates stay double.
 * Corners with the same position, uv and normal share a vertex. One thread.
 */
#ifndef COMMON_MODEL_FILE_H
#define COMMON_MODEL_FILE_H

#include "common/diag.h"
#include "common/scene.h"

/* `path` is opened; `shown` names it in problems. A mesh without a face is a problem,
 * and so is every index out of range. You own
 * what `out` points to (scene_mesh_release). ERR_INPUT with problems (file:line), ERR_NOMEM. */
TL_NODISCARD enum err model_read_mesh(const char *path, const char *shown, struct scene_mesh *out,
                                      struct diag_list *problems);

/* Frees what a mesh points to. */
void scene_mesh_release(struct scene_mesh *m);

/* Where vertex normals exist and a face's winding disagrees with its first vertex's normal, flips
 * the winding. Returns how many. */
uint32_t model_fix_winding(struct scene_mesh *m);

/* A channel of a vertex's colour as struct scene_mesh holds it: within 0 to 1 (what is not a number
 * is 0), decoded if the file has it sRGB-encoded. */
float model_vertex_color(double value, bool encoded);

#endif
