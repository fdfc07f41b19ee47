/* common/scene_loader.h: a scene file while it is being read.
 *
 * Internal to scene_json.c and its parts, one for each top-level key. A part reads its
 * key into the scene or the spec, adds problems, and goes on, so that one run shows all
 * of them; only memory running out stops it (`out_of_memory`, looked at in the end).
 */
#ifndef COMMON_SCENE_LOADER_H
#define COMMON_SCENE_LOADER_H

#include "common/image_file.h"
#include "common/job_spec.h"
#include "common/json_get.h"
#include "common/name_table.h"
#include "common/scene.h"

struct scene_loader {
    struct json_get g;
    const char *folder; /* where paths start; borrowed */
    struct scene scene;
    struct job_spec spec;
    bool out_of_memory;
    struct name_table textures, materials; /* name -> index */
    struct name_table meshes, images;      /* path (images: with their use) -> index below */
    uint32_t *mesh_of, *image_of;          /* -> scene's index, SCENE_NONE when unreadable */
    size_t mesh_of_capacity, image_of_capacity;
    size_t texture_capacity, material_capacity, mesh_capacity, image_capacity;
    size_t object_capacity, light_capacity;
};

void scene_load_integrator(struct scene_loader *l, const struct json *v);
void scene_load_film(struct scene_loader *l, const struct json *v);
void scene_load_camera(struct scene_loader *l, const struct json *v);
void scene_load_textures(struct scene_loader *l, const struct json *v);
void scene_load_materials(struct scene_loader *l, const struct json *v);
void scene_load_objects(struct scene_loader *l, const struct json *v);
void scene_load_lights(struct scene_loader *l, const struct json *v);
void scene_load_environment(struct scene_loader *l, const struct json *v);

/* --- What the parts share ------------------------------------------------ */

/* Optional vectors: three finite numbers; colours are not negative, and one number is grey. */
bool scene_load_vec3(struct scene_loader *l, const struct json *object, const char *key,
                     double out[3]);
bool scene_load_color(struct scene_loader *l, const struct json *object, const char *key,
                      double out[3]);

/* A 4x4 affine, invertible matrix. */
bool scene_load_transform(struct scene_loader *l, const struct json *object, const char *key,
                          double out[16]);

/* The index of a name that the member `key` refers to; SCENE_NONE when absent or unknown (then a
 * problem saying no `what` has that name). */
uint32_t scene_load_reference(struct scene_loader *l, const struct json *object, const char *key,
                              const struct name_table *table, const char *what);

/* A name as a key of the file gives it; NULL (and a problem, or out_of_memory) when too long. */
char *scene_load_name(struct scene_loader *l, const struct json *v);

/* The path of a file that exists, joined to the folder; NULL and a problem with the nearest name
 * when it does not. You own it. */
char *scene_load_path(struct scene_loader *l, const struct json *v, const char *path);

/* Names the value whose file was just read in the problems from number `from` on. */
void scene_load_name_user(struct scene_loader *l, const struct json *v, size_t from);

/* Room for one more element, at most `count_max`; NULL with the reason noted. */
#define scene_load_grow(l, items, count, capacity, count_max, at)                                  \
    scene_load_grow_bytes((l), (void **)&(items), (count), &(capacity), (count_max),               \
                          sizeof *(items), (at))
bool scene_load_grow_bytes(struct scene_loader *l, void **items, size_t count, size_t *capacity,
                           size_t count_max, size_t item_bytes, const struct json *at);

#define SCENE_LOAD_KEYS(l, v, keys)                                                                \
    json_get_keys(&(l)->g, (v), (keys), sizeof(keys) / sizeof *(keys))

#endif
