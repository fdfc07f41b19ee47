/* common/ply_wedge.h: texture coordinates of a mesh's corners to those of its vertices.
 *
 * PLY files of scans (MeshLab's "texcoord" of a face) have coordinates per corner, a
 * scene's mesh per vertex: vertices whose corners differ are split. Pure apart from memory;
 * any thread. Test: test_models.
 */
#ifndef COMMON_PLY_WEDGE_H
#define COMMON_PLY_WEDGE_H

#include "common/scene.h"

/* `corner_uvs` has u and v of each corner in the order of mesh->indices. Replaces the mesh's
 * vertices; those that no triangle uses go. ERR_LIMIT: over 2^32 - 2 of them; ERR_NOMEM: nothing
 * changed. */
TL_NODISCARD enum err ply_split_corners(struct scene_mesh *mesh, const float *corner_uvs);

#endif
