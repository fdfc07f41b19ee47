/* common/ply_file.h: PLY meshes: ascii, little and big endian, every scalar type.
 *
 * Vertices with x, y, z and optionally nx, ny, nz and u, v (also s, t, texture_u,
 * texture_v), or "texcoord" of the faces' corners, which splits vertices; faces as lists
 * "vertex_indices" or "vertex_index", polygons split by ear clipping, or "tristrips"; all other
 * elements and properties are skipped. Coordinates stay double. Pure apart from memory; one thread.
 */
#ifndef COMMON_PLY_FILE_H
#define COMMON_PLY_FILE_H

#include "common/diag.h"
#include "common/scene.h"

/* You release `out` (scene_mesh_release); out->name is NULL. Problems carry the line in ascii files
 * and the element's number in binary ones. A file without a face is a problem that says what it
 * holds instead. ERR_INPUT, ERR_LIMIT, ERR_NOMEM. */
TL_NODISCARD enum err ply_read_mesh(const char *data, size_t bytes, const char *file,
                                    struct scene_mesh *out, struct diag_list *problems);

#endif
