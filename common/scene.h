/* common/scene.h: the scene as everyone after the parsers sees it.
 *
 * A plain tree of arrays: indices instead of names, transforms composed, images
 * decoded. scene_json.h and the importer make it from files (client only),
 * package.h turns it into chunks and back, worker/scene builds from it what the
 * tracing core reads. What the job decides (spp, size, crop, integrator, ...) is
 * not here but in job_spec.h, so that changing it re-sends nothing.
 *
 * World space is right-handed, +Y up, in the user's units. Colours are linear
 * Rec.709. Matrices are 4x4 row-major, translation at [3], [7], [11].
 *
 * The scene owns everything it points to. One thread at a time.
 * Invariants: scene_check.
 */
#ifndef COMMON_SCENE_H
#define COMMON_SCENE_H

#include "common/err.h"

#define SCENE_NONE UINT32_MAX /* "no such index" */

/* Limits that the parsers, the package reader and the core share. */
enum {
    SCENE_NAME_BYTES_MAX = 255,
    SCENE_TEXTURES_MAX = 1 << 16,
    SCENE_MATERIALS_MAX = 1 << 16,
    SCENE_MESHES_MAX = 1 << 20,
    SCENE_OBJECTS_MAX = 1 << 22,
    SCENE_LIGHTS_MAX = 1 << 20,
    SCENE_IMAGE_SIDE_MAX = 32768,
    SCENE_TRIANGLES_MAX = 1 << 30, /* in one mesh */
};

enum scene_image_format {
    SCENE_IMAGE_F32,     /* linear */
    SCENE_IMAGE_U8_SRGB, /* colour channels sRGB-encoded, alpha linear */
    SCENE_IMAGE_U8_LINEAR,
};

/* Row 0 is the top row of the picture. */
struct scene_image {
    uint32_t width, height;
    uint32_t channel_count; /* 1 grey, 3 RGB, 4 RGBA */
    enum scene_image_format format;
    void *pixels; /* width * height * channel_count floats or bytes, interleaved */
};

enum scene_texture_type { SCENE_TEXTURE_CONSTANT, SCENE_TEXTURE_CHECKERBOARD, SCENE_TEXTURE_IMAGE };
/* How a texture is looked up: at a point (checkerboards have no other than NEAREST there), or over
 * what a sample of the picture stands for. */
enum scene_texture_filter { SCENE_FILTER_NEAREST, SCENE_FILTER_BILINEAR, SCENE_FILTER_MIPMAP };
enum scene_wrap { SCENE_WRAP_REPEAT, SCENE_WRAP_CLAMP, SCENE_WRAP_MIRROR };

struct scene_texture {
    char *name;
    enum scene_texture_type type;
    enum scene_texture_filter filter;
    double color[2][3];      /* constant: [0]; checkerboard: both; image: [0] is a factor */
    uint32_t image;          /* index, or SCENE_NONE */
    enum scene_wrap wrap[2]; /* of s and t */
    double uv_matrix[6];     /* s = m0 u + m1 v + m2, t = m3 u + m4 v + m5 */
};

enum scene_material_type {
    SCENE_MATERIAL_DIFFUSE,
    SCENE_MATERIAL_MIRROR,     /* perfect, reflectance R */
    SCENE_MATERIAL_REFRACTION, /* perfect refraction without Fresnel */
    SCENE_MATERIAL_GLASS,      /* smooth Fresnel dielectric, tints R and T */
    SCENE_MATERIAL_ROUGH_CONDUCTOR,
    SCENE_MATERIAL_ROUGH_DIELECTRIC,
    SCENE_MATERIAL_PRINCIPLED, /* glTF metallic-roughness and its extensions */
    SCENE_MATERIAL_BLACK,      /* absorbs; a light without a material */
};

enum scene_distribution { SCENE_BECKMANN, SCENE_GGX };

struct scene_material {
    char *name;
    uint32_t number; /* in the list of the scene as it was read; SCENE_NONE: its place here */
    enum scene_material_type type;
    uint32_t texture;      /* albedo, reflectance or base colour; SCENE_NONE: `color` */
    double color[3];       /* used when texture is SCENE_NONE; else a factor (default 1) */
    bool twosided;         /* diffuse: reflects on both sides of the normal */
    bool backface_culling; /* principled: rays that come from behind do not meet it */
    bool vertex_colors;    /* diffuse, principled: times the mesh's colours, and opacity times its
                              alphas, where it has some */
    enum scene_distribution distribution;
    uint32_t bump_texture;   /* heights along the normal, as luminance; SCENE_NONE: none */
    double bump_scale;       /* world units that a height of 1 stands for */
    double alpha_x, alpha_y; /* roughness of microfacets, as in alpha = roughness^2 */
    double eta;              /* relative index of refraction, inside over outside */
    double R[3], T[3];
    double etaI[3], etaT[3], k[3]; /* conductor: outside and inside index, absorption */

    /* Principled; textures SCENE_NONE when absent. */
    double metallic, roughness;
    uint32_t metallic_roughness_texture; /* G roughness, B metallic, as in glTF */
    double emission[3];
    uint32_t emission_texture;
    bool emission_vertex_colors; /* emission times the mesh's colours, where it has some */
    bool emission_twosided;      /* meshes emit it on both sides */
    uint32_t normal_texture;
    double normal_scale;
    double transmission;
    uint32_t transmission_texture;
    double clearcoat, clearcoat_roughness;
    double sheen_color[3], sheen_roughness;
    double specular, specular_color[3];
    double alpha;        /* opacity; 1 unless alpha is used */
    double alpha_cutoff; /* < 0: blend, else mask; used with base colour's alpha */
    bool alpha_used;
};

/* Positions as the file gives them, in double. Normals, uvs and colours are per
 * vertex; NULL when absent. */
struct scene_mesh {
    char *name;
    uint32_t vertex_count, triangle_count;
    double *positions; /* 3 * vertex_count */
    float *normals;    /* 3 * vertex_count, unit or zero; or NULL */
    float *uvs;        /* 2 * vertex_count; or NULL */
    float *colors;     /* 3 * vertex_count, linear, 0 to 1; or NULL */
    float *alphas;     /* vertex_count, opacity, 0 to 1; or NULL: 1 */
    uint32_t *indices; /* 3 * triangle_count, each < vertex_count */
};

enum scene_object_type {
    SCENE_OBJECT_MESH,
    SCENE_OBJECT_SPHERE,
    SCENE_OBJECT_NOTHING, /* keeps its number, but nothing can meet it (scene_plan.h) */
};

struct scene_object {
    enum scene_object_type type;
    uint32_t mesh;            /* index, or SCENE_NONE for others */
    double transform[16];     /* object to world, affine; the identity for a sphere */
    double center[3], radius; /* sphere, world */
    uint32_t material;        /* index, or SCENE_NONE: black */
    bool emits;               /* area light, on the side of the geometric normal */
    double radiance[3];
};

enum scene_light_type { SCENE_LIGHT_POINT, SCENE_LIGHT_SPOT, SCENE_LIGHT_DIRECTIONAL };

/* Lights without a surface, for the path integrator. */
struct scene_light {
    enum scene_light_type type;
    double position[3];
    double direction[3];         /* unit, the way the light travels; spot and directional */
    double intensity[3];         /* W/sr for point and spot, W/m^2 for directional */
    double cos_inner, cos_outer; /* spot: full inside the first, nothing outside the second */
};

enum scene_camera_type {
    SCENE_CAMERA_PINHOLE,
    SCENE_CAMERA_THIN_LENS,
    SCENE_CAMERA_ORTHOGRAPHIC,
    SCENE_CAMERA_PANORAMA,
};

struct scene_camera {
    enum scene_camera_type type;
    double position[3], look_at[3], ref_up[3];
    double fov;             /* vertical, degrees, 0 < fov < 180 */
    double focal_length;    /* thin lens: distance of the plane of focus */
    double aperture_radius; /* thin lens */
    double ortho_height;    /* orthographic: height of the view in world units */
};

struct scene_envmap {
    uint32_t texture; /* SCENE_NONE: no environment */
    double scale;
    double transform[16]; /* local to world; its rotation counts */
};

struct scene {
    struct scene_camera camera;
    struct scene_envmap envmap;
    /* The source report's light, read by the integrator intersection_test only. */
    double seed_light_position[3], seed_light_flux[3];

    struct scene_image *images;
    size_t image_count;
    struct scene_texture *textures;
    size_t texture_count;
    struct scene_material *materials;
    size_t material_count;
    struct scene_mesh *meshes;
    size_t mesh_count;
    struct scene_object *objects;
    size_t object_count;
    struct scene_light *lights;
    size_t light_count;

    bool uvs_left_out;     /* by a package made for jobs that do not show them */
    uint64_t source_bytes; /* of the files that all this was read from; no package carries it */
};

/* An empty scene: default camera, no environment, identity transforms. */
void scene_init(struct scene *s);
void scene_release(struct scene *s);

/* Defaults of one element, as SCENE-FORMAT and docs/SCENE.md give them. */
void scene_camera_init(struct scene_camera *c);
void scene_texture_init(struct scene_texture *t);
void scene_image_texture_init(struct scene_texture *t); /* of type IMAGE; still without one */
void scene_material_init(struct scene_material *m);
void scene_object_init(struct scene_object *o);

/* True if every index is in range, every number finite, every transform affine and invertible,
 * every count within its limit. One pass over all of it. */
TL_NODISCARD bool scene_valid(const struct scene *s);

/* The same without looking into the images i with late[i], which may be empty; NULL: there are
 * none. */
TL_NODISCARD bool scene_valid_without(const struct scene *s, const bool *late);

/* What scene_valid asks of an image. */
TL_NODISCARD bool scene_image_valid(const struct scene_image *image);

/* The same without looking into meshes and images: only their counts matter. */
TL_NODISCARD bool scene_tables_valid(const struct scene *s);

/* Asserts scene_valid: what the parsers and package_read have made sure of. */
void scene_check(const struct scene *s);

/* True if a 4x4 row-major matrix is affine, finite and well enough conditioned to invert: its
 * determinant is over 1e-13 of the product of its rows' lengths, so that scale does not matter. */
TL_NODISCARD bool scene_transform_valid(const double m[16]);

/* True if the triangles take up the vertices in their order and none is left, as packages have
 * them. */
bool scene_mesh_in_order(const struct scene_mesh *m);

/* Coordinates, colours and the like are at most this large: squares stay finite. */
#define SCENE_NUMBER_MAX 1e150

#endif
