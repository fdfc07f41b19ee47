/* client/import.h: models of other programs into a scene and the job it asks for.
 *
 * OBJ with MTL and PLY go through our own readers, in double. glTF 2.0 (text and binary)
 * and whatever else assimp reads go through assimp in a child process of this program with
 * limits on time and memory, so that its crash or hang is a problem of the model, not ours;
 * what the child sends back is read as hostile bytes. The kind is told by the contents first,
 * then by the name.
 *
 * A model without a light gets a sky, one without a camera is framed; both are said as
 * warnings, as is everything that is left out, once each. Blocking; one thread.
 */
#ifndef CLIENT_IMPORT_H
#define CLIENT_IMPORT_H

#include "common/job_spec.h"
#include "common/scene.h"

/* True if `path` should go through import_model: by its contents a model, or by its name no scene
 * JSON. A file that cannot be read is judged by its name. */
bool import_is_model(const char *path);

/* On success `scene` is yours to release and satisfies scene_check, and `spec` is job_spec_init's
 * with the model's aspect ratio. ERR_INPUT: problems has at least one error; ERR_NOMEM; ERR_IO (no
 * child process). On failure both are untouched. */
TL_NODISCARD enum err import_model(const char *path, struct scene *scene, struct job_spec *spec,
                                   struct diag_list *problems);

/* The first argument of the child process. main() hands over before anything else:
 *
 *     if (argc > 1 && strcmp(argv[1], IMPORT_CHILD_ARGUMENT) == 0)
 *         return import_child_main(argc, argv);
 */
#define IMPORT_CHILD_ARGUMENT "--import-child"
int import_child_main(int argc, char **argv);

#endif
