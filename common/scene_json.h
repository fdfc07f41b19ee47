/* common/scene_json.h: a scene file into a scene and the job it asks for.
 *
 * Reads the course renderer's format as it stands and our additions (docs/SCENE.md),
 * with the meshes (.obj, .ply) and images (.exr, .png, .jpg, .hdr) it names, relative to
 * the file's folder. Everything wrong is collected in one run, each problem with its JSON
 * path or file:line. Client only; one thread.
 *
 * What it leaves in the scene: all indices valid, all numbers finite, transforms
 * invertible, meshes not empty. Where vertex normals exist and a face's winding disagrees
 * with its first vertex's normal, the winding is flipped (in the mesh's own space).
 */
#ifndef COMMON_SCENE_JSON_H
#define COMMON_SCENE_JSON_H

#include "common/job_spec.h"
#include "common/scene.h"

/* On success `scene` is yours to release and `spec` holds what the file says over
 * job_spec_init's defaults. ERR_INPUT: problems has at least one error; ERR_NOMEM. On failure
 * both are untouched. Warnings may be added in either case. A file that cannot be read is
 * ERR_INPUT too. */
TL_NODISCARD enum err scene_json_read_file(const char *path, struct scene *scene,
                                           struct job_spec *spec, struct diag_list *problems);

/* The same from memory: `file` names the text in problems, `folder` is where paths start. */
TL_NODISCARD enum err scene_json_read(const char *text, size_t bytes, const char *file,
                                      const char *folder, struct scene *scene,
                                      struct job_spec *spec, struct diag_list *problems);

/* False if nothing in the scene could ever light a picture of this integrator. */
TL_NODISCARD bool scene_can_be_lit(const struct scene *scene, enum job_integrator integrator);

#endif
