/* worker/render/render_scene.h: the built scene, as the tracing core reads it.
 *
 * worker/scene makes it from a struct scene; render_unit only reads it, on any number
 * of threads, while late pictures are put in (texture.h). Everything lives in `arena`, but for the
 * acceleration structure, and borrows nothing from the scene it was made of.
 *
 * Scene space: world space moved by -center and multiplied by `scale`, a power of two,
 * so that coordinates are about 1. Radiance and albedo are the same in both; point
 * light intensities carry scale^2, so that the picture of a scene made 2^k times larger
 * with 4^k times the flux is the same bit for bit.
 */
#ifndef WORKER_RENDER_RENDER_SCENE_H
#define WORKER_RENDER_RENDER_SCENE_H

#include "common/mem.h"
#include "common/scene.h"
#include "worker/render/accel.h"
#include "worker/render/bsdf.h"
#include "worker/render/camera.h"
#include "worker/render/film_filter.h"
#include "worker/render/light.h"
#include "worker/render/texture.h"

/* Vertices of a mesh: in scene space, or in its own space when objects instance it. */
struct render_mesh {
    const float *positions;  /* 3 per vertex */
    const float *normals;    /* 3 per vertex, or NULL */
    const float *uvs;        /* 2 per vertex, or NULL */
    const float *colors;     /* 3 per vertex, linear; NULL: white, or nothing reads them */
    const float *alphas;     /* 1 per vertex, opacity; NULL: 1, or nothing reads them */
    const uint32_t *indices; /* 3 per triangle */
    uint32_t vertex_count, triangle_count;
};

struct render_object {
    enum accel_object_type type;
    uint32_t mesh; /* triangles and instances */
    uint32_t material;
    uint32_t light_begin; /* triangles: object_lights[light_begin + primitive] is its light; sphere:
                             [light_begin]; SCENE_NONE: does not emit */
    uint32_t emission_texture; /* times radiance; SCENE_NONE: none */
    bool emission_colors;      /* the colours of the mesh's vertices are, too */
    bool emission_twosided;
    rgb radiance; /* on the side of the geometric normal, or on both */
    vec3 center;
    double radius;
    double to_scene[12], from_scene[12]; /* instances */
};

struct render_scene {
    struct arena arena;
    struct job_spec spec;
    struct accel *accel;       /* owned */
    struct scene_locks *locks; /* owned; the tree's, where it has objects that wait */
    double center[3], scale;
    struct camera camera;
    struct film_filter filter;

    struct render_mesh *meshes;
    size_t mesh_count;
    struct render_object *objects;
    size_t object_count;
    struct material *materials; /* the last one is black, for objects without */
    size_t material_count;
    struct texture *textures;
    size_t texture_count;
    struct texture_image *images; /* of those that no texture shows nothing is set */
    size_t image_count;
    struct scene_late
        *late; /* owned; what of them comes later (worker/scene/scene_late.h); or NULL */
    struct light_table lights;
    const uint32_t *object_lights;

    /* Jobs on one scene share all but spec, camera and filter (scene_build.h). */
    struct render_scene *owner; /* of the arena and the tree; NULL: this one */
    uint32_t sharers;           /* of the owner: how many refer to it, itself included */
    struct scene_camera scene_camera;

    bool has_filtered;     /* some texture is averaged over footprints */
    double footprint_step; /* pixels between samples of the job */
    bool has_alpha;        /* some surface lets light through: shadow rays must look */
    bool has_glass;        /* some surface lets light through in one direction */
    vec3 seed_light_position;
    rgb seed_light_flux;
};

#endif
