/* worker/scene/scene_parts.h: the steps of scene_build, a file each.
 *
 * Each fills its part of the render scene from the arena. ERR_NOMEM.
 */
#ifndef WORKER_SCENE_SCENE_PARTS_H
#define WORKER_SCENE_SCENE_PARTS_H

#include "worker/render/render_scene.h"
#include "worker/scene/scene_build.h"

/* What the objects of a scene need of one image. */
struct image_use {
    bool used, pyramid;
    bool weighed; /* its colours count by their opacity */
};

/* Centre, scale, meshes, objects. ERR_LIMIT for an extent beyond double. */
TL_NODISCARD enum err scene_build_geometry(struct render_scene *rs, const struct scene *scene);

/* The images that textures use, as the tracing core reads them, into rs->images: one for each of
 * the scene's; of those unused nothing is set, and those that are late are absent. */
TL_NODISCARD enum err scene_build_images(struct render_scene *rs, const struct scene *scene,
                                         const struct scene_building *how);

/* One image with what is looked up of it. Memory is the arena's; nothing else is touched. */
TL_NODISCARD enum err texture_image_make(struct arena *arena, const struct scene_image *from,
                                         const struct image_use *use, struct texture_image *out);

/* The sides of all levels of an image, without room for texels. */
void texture_image_levels(const struct scene_image *from, bool pyramid, struct texture_image *out);

/* The levels of a base into an image that has their sides. */
TL_NODISCARD enum err texture_image_base(struct arena *arena, const struct package_base *from,
                                         struct texture_image *out);

/* A piece of an image with so many levels (texture_piece). */
TL_NODISCARD enum err texture_piece_make(struct arena *arena, const struct scene_image *from,
                                         uint32_t levels, const void **out);

/* rs->late, if anything is late; before scene_build_images, which tells it of each late image that
 * is used. */
TL_NODISCARD enum err scene_late_new(struct render_scene *rs, const struct scene *scene,
                                     const struct late_chunk *late);
TL_NODISCARD enum err scene_late_leave_out(struct render_scene *rs, const struct scene *scene,
                                           uint32_t image, const struct image_use *use,
                                           const struct late_chunk *from);
void scene_late_free(struct scene_late *late); /* NULL: nothing to do */
size_t scene_late_bytes(const struct scene_late *late);

/* Textures and materials. */
TL_NODISCARD enum err scene_build_materials(struct render_scene *rs, const struct scene *scene,
                                            const struct scene_building *how);

/* Area lights of the objects, the lights of the scene, the environment. After the others. */
TL_NODISCARD enum err scene_build_lights(struct render_scene *rs, const struct scene *scene);

/* The environment: how it is turned, and how its map is drawn. After the materials. */
TL_NODISCARD enum err scene_build_sky(struct render_scene *rs, const struct scene *scene);

/* The tree over the lights with a place; intensities[light] is that along its axis. Leaves
 * lights.tree.nodes NULL if there is none. After the table of lights is complete. */
TL_NODISCARD enum err scene_build_light_tree(struct render_scene *rs, const double *intensities);

#endif
