/* worker/scene/scene_parts.h: the steps of scene_build, a file each.
 *
 * Each fills its part of the render scene from the arena. ERR_NOMEM.
 */
#ifndef WORKER_SCENE_SCENE_PARTS_H
#define WORKER_SCENE_SCENE_PARTS_H

#include "worker/render/render_scene.h"

/* Centre, scale, meshes, objects. ERR_LIMIT for an extent beyond double. */
TL_NODISCARD enum err scene_build_geometry(struct render_scene *rs, const struct scene *scene);

/* The images that textures use, as the tracing core reads them: one for each of the scene's; of
 * those unused nothing is set. */
TL_NODISCARD enum err scene_build_images(struct render_scene *rs, const struct scene *scene,
                                         struct texture_image **out);

/* Textures and materials. */
TL_NODISCARD enum err scene_build_materials(struct render_scene *rs, const struct scene *scene);

/* Area lights of the objects, the lights of the scene, the environment. After the others. */
TL_NODISCARD enum err scene_build_lights(struct render_scene *rs, const struct scene *scene);

/* The environment: how it is turned, and how its map is drawn. After the materials. */
TL_NODISCARD enum err scene_build_sky(struct render_scene *rs, const struct scene *scene);

/* The tree over the lights with a place; intensities[light] is that along its axis. Leaves
 * lights.tree.nodes NULL if there is none. After the table of lights is complete. */
TL_NODISCARD enum err scene_build_light_tree(struct render_scene *rs, const double *intensities);

#endif
