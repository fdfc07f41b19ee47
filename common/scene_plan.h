/* common/scene_plan.h: what a scene requires, and so what can stay behind.
 *
 * One pure function reads a scene and says what its picture can depend on: which objects
 * a path of light can meet, which materials, textures, pictures and channels of pictures
 * are read, which meshes need normals and texture coordinates, which features the tracing
 * core needs. The package sends what the plan keeps, `tilery explain` prints it.
 *
 * What is not kept changes no bit of any job's picture (tests/render/test_plan). The
 * plan is of the scene alone, but for one AOV that shows texture coordinates, so that
 * another job on it sends nothing again.
 *
 * Any thread. The plan refers to elements by index and borrows nothing.
 */
#ifndef COMMON_SCENE_PLAN_H
#define COMMON_SCENE_PLAN_H

#include "common/scene.h"
#include "common/scene_lazy.h"

/* name, as explain shows it */
#define SCENE_FEATURES(X)                                                                          \
    X(DIFFUSE, "diffuse")                                                                          \
    X(MIRROR, "mirror")                                                                            \
    X(REFRACTION, "refraction")                                                                    \
    X(GLASS, "glass")                                                                              \
    X(CONDUCTOR, "rough conductor")                                                                \
    X(ROUGH_DIELECTRIC, "rough dielectric")                                                        \
    X(PRINCIPLED, "principled")                                                                    \
    X(AREA_LIGHTS, "area lights")                                                                  \
    X(LIGHTS, "point-like lights")                                                                 \
    X(ENVIRONMENT, "environment")                                                                  \
    X(IMAGES, "image textures")                                                                    \
    X(PATTERNS, "patterns")                                                                        \
    X(FILTERED, "filtered textures")                                                               \
    X(NORMAL_MAPS, "normal maps")                                                                  \
    X(BUMPS, "bump maps")                                                                          \
    X(OPACITY, "opacity")                                                                          \
    X(CULLING, "backface culling")                                                                 \
    X(NORMALS, "vertex normals")                                                                   \
    X(UVS, "texture coordinates")                                                                  \
    X(COLORS, "colours of vertices")                                                               \
    X(DOUBLES, "coordinates in double")                                                            \
    X(SPHERES, "spheres")                                                                          \
    X(LENS, "depth of field")

enum scene_feature {
#define SCENE_FEATURE_ENUM(id, name) SCENE_FEATURE_##id,
    SCENE_FEATURES(SCENE_FEATURE_ENUM)
#undef SCENE_FEATURE_ENUM
        SCENE_FEATURE_COUNT
};
extern const char *const scene_feature_names[SCENE_FEATURE_COUNT];

/* Channels of a picture that something reads. */
enum {
    SCENE_CHANNEL_R = 1,
    SCENE_CHANNEL_G = 2,
    SCENE_CHANNEL_B = 4,
    SCENE_CHANNEL_A = 8,
    SCENE_CHANNELS_RGB = 7
};

struct scene_plan_mesh {
    uint32_t uses; /* by objects that can be met; 0: not kept */
    bool uvs;      /* some object's material looks something up by them */
    bool colors;   /* some object's material reads them */
    bool alphas;   /* and their opacity */
};

struct scene_plan {
    uint32_t features; /* 1 << enum scene_feature */
    bool *objects;     /* can be met, or emits */
    bool *materials;   /* of such objects */
    bool *emissions;   /* of each material: its emission texture is read */
    bool *textures;
    uint8_t *channels; /* of each image: what is read; 0: not kept */
    struct scene_plan_mesh *meshes;
    bool whole; /* keep what is stored, too: every vertex, channel and digit */
};

/* The scene is valid (scene_check); `aov` is the job's set (aov.h): where coordinates are shown,
 * all are kept. ERR_NOMEM; then `out` is empty. */
TL_NODISCARD enum err scene_plan_make(const struct scene *scene, uint32_t aov,
                                      struct scene_plan *out);

/* A plan that keeps everything: what the package would be without one. */
TL_NODISCARD enum err scene_plan_keep_all(const struct scene *scene, struct scene_plan *out);
void scene_plan_release(struct scene_plan *p);

/* The material with the textures that its type never reads taken out; strings are still the
 * scene's. `emission`: plan->emissions of it. */
struct scene_material scene_plan_material(const struct scene_material *m, bool emission);

/* True if no path of light can meet the object: its opacity is 0 everywhere, and it emits nothing
 * by itself. Such an object has no extent either (worker/scene). */
bool scene_object_is_nothing(const struct scene *scene, const struct scene_object *o);

static inline bool scene_plan_has(const struct scene_plan *p, enum scene_feature f)
{
    return p->features >> f & 1;
}

/* A mesh that several objects use is kept once, in its own space, from this many triangles on:
 * below, the second level of traversal costs more than the memory is worth. */
enum { SCENE_INSTANCE_TRIANGLES_MIN = 4096 };

/* A mesh whose half extent is between these parts of its distance from the scene's centre is held
 * in floats around a centre of its own: around the scene's it would be less than 2,048 steps wide.
 * Below the second even doubles do not tell its vertices apart out there. */
#define SCENE_OWN_SPACE_MAX 0x1p-14
#define SCENE_OWN_SPACE_MIN 0x1p-48

/* From so many triangles in all on trees are compact: half of gigabytes is worth more than the rays
 * it costs. */
enum { SCENE_COMPACT_TRIANGLES_MIN = 1 << 25 };

/* How many objects and triangles will wait so in a worker; zeros: all trees are built at once. */
struct scene_plan_lazy {
    uint64_t objects, triangles;
};
struct scene_plan_lazy scene_plan_lazy(const struct scene *scene, const struct scene_plan *p);

/* Estimates, in bytes, of what a worker holds while it renders: the tree; vertices with what they
 * carry; pictures; lights; all of these. tests/render/test_plan holds them to what is held. */
struct scene_plan_memory {
    uint64_t tree, geometry, images, lights, total;
    uint64_t triangles; /* in trees: those of instances once */
};
struct scene_plan_memory scene_plan_memory(const struct scene *scene, const struct scene_plan *p);

#endif
