/* client/import_model.h: a scene under construction, shared by the importers.
 *
 * Each importer fills one `struct import` through the functions below, which keep the
 * scene's limits and make names distinct. import_finish then lights and frames what has
 * no light or camera. The struct owns all it holds. One thread.
 */
#ifndef CLIENT_IMPORT_MODEL_H
#define CLIENT_IMPORT_MODEL_H

#include "common/diag.h"
#include "common/image_file.h"
#include "common/job_spec.h"
#include "common/name_table.h"
#include "common/scene.h"

/* Where an image came from, so that the same file is read once and `tilery import` can refer to
 * it instead of writing it again. */
struct import_source {
    char *path; /* a file beside the model; NULL: inside the model */
    enum image_use use;
    uint32_t image;      /* SCENE_NONE: it cannot be had, which has been said */
    unsigned char *data; /* its file's bytes, if it has no path and keep_bytes is set */
    size_t bytes;
};

struct import {
    const char *path; /* of the model, as the user named it; borrowed */
    char *folder;     /* where its relative paths start */
    struct diag_list *problems;
    struct scene scene;
    size_t image_capacity, texture_capacity, material_capacity, mesh_capacity, object_capacity,
        light_capacity;
    struct name_table material_names, texture_names; /* in use */
    struct name_table source_names;                  /* of sources: what was asked for */
    struct import_source *sources;
    size_t source_count, source_capacity;
    bool keep_bytes; /* of pictures inside the model, so that they can be written as they are */
    bool has_camera;
    double aspect;         /* width over height that the camera asks for; 0: any */
    bool has_lamp;         /* a light without a surface, or an emitter brighter than white paper */
    uint64_t source_bytes; /* of the files read */
    uint64_t vertex_count; /* seen, for what to say of a model without a face */
    uint64_t point_count, line_count; /* elements left out */
    uint64_t unsmoothed_count;        /* faces without the normals that would round them */
    uint64_t told;                    /* bit per IMPORT_ONCE: what has been said */
    /* Of a scene that comes from the child, one for each object: the node that shows it, nodes
     * counted breadth first; SCENE_NONE if its vertices are in the world. Else empty. */
    uint32_t *object_nodes;
    size_t object_node_count, object_node_capacity;
};

TL_NODISCARD enum err import_init(struct import *im, const char *path, struct diag_list *problems);
void import_release(struct import *im);

/* Each takes what it is given, also on failure. The index goes to *out, which may be NULL.
 * ERR_LIMIT with a problem, ERR_NOMEM. */
TL_NODISCARD enum err import_add_mesh(struct import *im, struct scene_mesh *mesh, uint32_t *out);
TL_NODISCARD enum err import_add_object(struct import *im, const struct scene_object *object);
TL_NODISCARD enum err import_add_light(struct import *im, const struct scene_light *light);
/* A material or texture with a copy of `name`; "" or NULL is named by `stem`. */
TL_NODISCARD enum err import_add_material(struct import *im, struct scene_material *material,
                                          const char *name, uint32_t *out);
TL_NODISCARD enum err import_add_texture(struct import *im, struct scene_texture *texture,
                                         const char *name, uint32_t *out);
/* Takes the pixels. */
TL_NODISCARD enum err import_add_image(struct import *im, struct scene_image *image, uint32_t *out);

/* The image of a file, relative to the model's folder; read once for each use. SCENE_NONE and a
 * warning, once, when it cannot be had: the model is then shown without. ERR_NOMEM. */
TL_NODISCARD enum err import_image_file(struct import *im, const char *path, enum image_use use,
                                        uint32_t *out);
/* The same of bytes inside the model; `key` tells them apart. */
TL_NODISCARD enum err import_image_bytes(struct import *im, const char *key, const void *data,
                                         size_t bytes, enum image_use use, uint32_t *out);

/* Blue on the whole: normals that were saved under the name of a bump map. */
bool import_is_normal_map(const struct scene_image *image);

/* Warnings about the model: `id` as in docs/ERRORS.md. */
void import_warn(struct import *im, const char *id, const char *hint, const char *format, ...)
    TL_PRINTF(4, 5);
enum err import_fail(struct import *im, const char *id, const char *hint, const char *format, ...)
    TL_PRINTF(4, 5);

/* Says each only once per model. */
enum import_once {
    IMPORT_ONCE_UV_SET,
    IMPORT_ONCE_OCCLUSION,
    IMPORT_ONCE_VOLUME,
    IMPORT_ONCE_DETAIL_MAP,
    IMPORT_ONCE_BUMP,
    IMPORT_ONCE_NORMAL_MAP,
    IMPORT_ONCE_SHEAR,
    IMPORT_ONCE_SKIN,
    IMPORT_ONCE_ALPHA_MAP,
    IMPORT_ONCE_BAD_NUMBER,
    IMPORT_ONCE_LIGHT_TYPE,
    IMPORT_ONCE_SPECULAR_GLOSSINESS,
    IMPORT_ONCE_CAMERA,
};
bool import_once(struct import *im, enum import_once what);

/* The readers. ERR_INPUT with problems, ERR_NOMEM, ERR_IO. */
TL_NODISCARD enum err import_obj(struct import *im, const char *text, size_t bytes);
TL_NODISCARD enum err import_ply(struct import *im, const char *data, size_t bytes);
TL_NODISCARD enum err import_gltf(struct import *im, const char *data, size_t bytes);
TL_NODISCARD enum err import_other(struct import *im);

/* Checks that there is a face, adds a sky and a camera where there is none, says so, and fills
 * `spec`. */
TL_NODISCARD enum err import_finish(struct import *im, struct job_spec *spec);
void import_frame(struct import *im);

/* Leaves backface_culling to those materials for which it shows: of a mesh that is not closed, and
 * that turns a back to the camera, which is set. */
void import_settle_culling(struct import *im);
TL_NODISCARD enum err import_sky(struct import *im);

/* Reads a model into an initialised `im`, finished. */
TL_NODISCARD enum err import_run(struct import *im, struct job_spec *spec);

/* Writes the scene as `path`, its meshes and the pictures that are no files into folders beside
 * it. On failure *failed is the file that could not be written; you own it. ERR_IO, ERR_NOSPACE,
 * ERR_NOT_FOUND (no such folder), ERR_NOMEM. */
TL_NODISCARD enum err import_write(const struct import *im, const struct job_spec *spec,
                                   const char *path, char **failed);

/* The bounds of all objects in world space. */
void import_bounds(const struct import *im, double low[3], double high[3]);

/* True if the camera looks somewhere, upright, with numbers in range. */
TL_NODISCARD bool import_camera_valid(const struct scene_camera *c);

/* out = m * p for an affine row-major 4x4. */
void import_transform_point(const double m[16], const double p[3], double out[3]);
void import_transform_vector(const double m[16], const double v[3], double out[3]);
/* out = a * b; out may not be either. */
void import_transform_multiply(const double a[16], const double b[16], double out[16]);

#endif
