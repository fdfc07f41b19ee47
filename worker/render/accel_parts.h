/* worker/render/accel_parts.h: what an accel is made of, for the kernels.
 *
 * One tree holds the triangles of all plain objects, the spheres and the instances;
 * every instanced mesh has a tree of its own in mesh space. Triangles of the scene's
 * tree are numbered through all objects in order, so that the order of their numbers
 * is the order of (object, primitive).
 */
#ifndef WORKER_RENDER_ACCEL_PARTS_H
#define WORKER_RENDER_ACCEL_PARTS_H

#include <emmintrin.h>
#include <string.h>

#include "common/scene.h"
#include "worker/render/accel_lazy.h"
#include "worker/render/bvh_place.h"
#include "worker/render/trace.h"

/* What a kernel answers in: rays of the caller, validated inside. */
struct trace_kernel {
    const char *name;
    void (*closest)(const struct accel *a, const struct ray *ray, struct hit *out);
    bool (*occluded)(const struct accel *a, const struct ray *ray);
    /* Of rays with active[i] != 0; `active` may be NULL: all. */
    void (*closest_batch)(const struct accel *a, const struct ray *rays, const uint8_t *active,
                          size_t count, struct hit *hits);
    void (*occluded_batch)(const struct accel *a, const struct ray *rays, const uint8_t *active,
                           size_t count, uint8_t *occluded);
    const struct trace_kernel *flat; /* for scenes that have a table; NULL: none */
};

extern const struct trace_kernel trace_plain, trace_sse2, trace_avx2, trace_avx512;
extern const struct trace_kernel trace_sse2_compact, trace_avx2_compact, trace_avx512_compact;
extern const struct trace_kernel trace_sse2_fast, trace_avx2_fast, trace_avx512_fast;
extern const struct trace_kernel trace_avx2_flat, trace_avx512_flat;

/* Rays with tmin >= 0 from so far away that float's boxes would all be met (trace_far.c). */
void trace_far_closest(const struct accel *a, const struct ray *ray, struct hit *out);
bool trace_far_occluded(const struct accel *a, const struct ray *ray);

/* An instance: its matrices by column, for whole vectors to be loaded. What a ray needs on its way
 * in comes first. */
struct accel_motion {
    double from_scene[4][4];
    const struct bvh *tree; /* NULL: no instance */
    double slack_share; /* of a ray's slack, once moved: a power of two, 1 unless it stretches */
    float filter_share; /* of its filter_slack: 1, or not a number where float is not to decide */
    double to_scene[3][4] __attribute__((aligned(32)));
} __attribute__((aligned(64)));

/* Objects whose trees are built when a ray first meets them (accel_lazy.h). */
struct accel_lazy {
    struct accel_locks locks;
    struct bvh_place place;  /* of the scene's tree and of theirs */
    _Atomic uint32_t *roots; /* object_count; of an object: its tree, or one of the two below */
    float (*boxes)[6];       /* of the same, as the rows of bvh_node.bounds */
    uint64_t object_count;
    atomic_uint_fast64_t built_count, failures;
};

/* References of kind BVH_EMPTY that no tree has. */
#define ACCEL_UNBUILT  UINT32_C(0xffffffff)
#define ACCEL_NOT_LAZY UINT32_C(0xfffffffb)

/* The triangles of a scene that has few, side by side: all of them are tested in less time than a
 * tree takes to leave some out. Row i is triangle number i; rows from `count` on are points at the
 * origin. The one behind the last answers for a ray that hits nothing. A few spheres come after. */
enum { FLAT_MAX = 64, FLAT_FOUR = 4, FLAT_SPHERES_MAX = 2 };

struct accel_flat {
    float filter[3][3][FLAT_MAX]; /* vertex, axis, triangle */
    float edge[FLAT_MAX];         /* the triangle's largest extent, rounded up */
    double v[FLAT_MAX + 1][3][4]; /* triangle, axis, vertex; the fourth: 2^-12 edge^2 */
    double ng[FLAT_MAX + 1][4];   /* of its hits */
    double four[3][4][FLAT_FOUR]; /* axis, vertex and v's fourth, triangle: of the first four */
    uint32_t object[FLAT_MAX + 1], primitive[FLAT_MAX + 1];
    uint32_t count;
    uint32_t sphere_count, spheres[FLAT_SPHERES_MAX]; /* their objects, in order */
} __attribute__((aligned(64)));

struct accel {
    const struct trace_kernel *kernel;
    struct accel_options options;
    double pad;                /* of rays: see trace.h */
    double far_slack;          /* a ray with more of it is for trace_far.c */
    struct accel_mesh *meshes; /* copies of the input's arrays */
    struct accel_object *objects;
    size_t mesh_count, object_count;
    struct accel_motion *motions; /* object_count; set for instances; NULL if there are none */
    uint32_t *triangle_first;     /* object_count + 1: first number of an object's triangles */
    struct bvh scene_tree;
    struct bvh *mesh_trees;  /* mesh_count; empty unless instanced */
    struct accel_flat *flat; /* NULL: the scene's tree is walked */
    struct accel_stats stats;
    void *saved;             /* owned: what saved trees lie in; NULL: they were built */
    struct accel_lazy *lazy; /* NULL: all trees are built */
};

/* The nearest float not above, and not below. */
static inline float accel_round_down(double x)
{
    float f = (float)x;
    return (double)f > x ? f - __builtin_fabsf(f) * 0x1p-23f - 0x1p-149f : f;
}

static inline float accel_round_up(double x)
{
    return -accel_round_down(-x);
}

/* The box of a triangle; the caller sets what else a reference has. *out lies at 16 bytes. */
void accel_triangle_ref(const struct accel_mesh *m, uint32_t triangle, struct bvh_ref *out);

/* The box of an instance, from that of its mesh alone, whatever tree that has: answers depend on
 * it.
 */
void accel_instance_ref(const struct accel_object *o, const struct bvh *mesh, struct bvh_ref *out);

/* Makes the boxes of instances among the references what the scene's tree, of that reach, is to
 * have: smaller where their meshes' trees say so, all of space where a transform is too lopsided
 * for any. */
void accel_instances_fit(const struct accel *a, struct bvh_ref *refs, size_t count, double reach);

/* The part of the slack that rays have in each instance, and of the float side's. */
void accel_slacks_share(struct accel *a);

/* What leaves of the scene's tree, and of trees in its arena, are made from. */
struct bvh_source accel_scene_source(const struct accel *a);

/* Sets a->lazy, with room for all trees. ERR_NOMEM, ERR_LIMIT: to be ended as well. */
TL_NODISCARD enum err accel_lazy_begin(struct accel *a, const struct accel_lazy_plan *plan,
                                       const struct accel_locks *locks);
void accel_lazy_end(struct accel *a);

/* What has been built since. */
void accel_lazy_count(const struct accel *a, struct accel_stats *stats);

/* Builds the object's tree unless another thread has; its root, or BVH_EMPTY without memory. */
uint32_t accel_lazy_build(const struct accel *a, uint32_t number);

/* The root of the tree of an object, ACCEL_UNBUILT or ACCEL_NOT_LAZY. */
static inline uint32_t accel_lazy_root(const struct accel *a, uint32_t number)
{
    return a->lazy ? atomic_load_explicit(&a->lazy->roots[number], memory_order_acquire)
                   : ACCEL_NOT_LAZY;
}

/* Makes the trees of an accel whose input is copied and numbered lie in `data`, which must stay.
 * ERR_CORRUPT: some of them then do, and are to be forgotten. */
TL_NODISCARD enum err accel_trees_load(struct accel *a, void *data, size_t bytes,
                                       const struct accel_runner *runner);

/* No trees any more, and nothing freed: they lay in memory of another. */
void accel_trees_forget(struct accel *a);

/* Makes the table if the scene is one for it, and has the kernel use it. ERR_NOMEM. */
TL_NODISCARD enum err accel_flat_make(struct accel *a);

/* The object whose triangle has this number in the scene's tree. */
static inline uint32_t accel_triangle_object(const struct accel *a, uint32_t number)
{
    /* As many steps whatever the number is: nothing for the processor to guess. */
    const uint32_t *first = a->triangle_first;
    for (size_t count = a->object_count; count > 1;) {
        size_t half = count / 2;
        first = first[half] <= number ? first + half : first;
        count -= half;
    }
    return (uint32_t)(first - a->triangle_first);
}

/* Three floats, which may end their array; the fourth is 0. */
static inline __m128 accel_vertex_load(const float *p)
{
    double xy; /* two floats at an address that is no double's */
    memcpy(&xy, p, sizeof xy);
    return _mm_movelh_ps(_mm_castpd_ps(_mm_set_sd(xy)), _mm_load_ss(&p[2]));
}

/* What a packed leaf stands for. */
static inline void accel_unpack(const struct accel *a, const struct bvh *tree,
                                const struct bvh_packed *packed, struct bvh_leaf *out)
{
    const float *positions[BVH_BLOCK];
    for (int lane = 0; lane < BVH_BLOCK; lane++) {
        positions[lane] = tree->positions;
        if (!tree->positions) {
            uint32_t number = packed->id[lane] & (BVH_PRIMITIVES_MAX - 1);
            uint32_t object = accel_triangle_object(a, number);
            positions[lane] = a->meshes[a->objects[object].mesh].positions;
        }
    }
    for (int i = 0; i < 3; i++) {
        __m128 v[BVH_BLOCK];
        for (int lane = 0; lane < BVH_BLOCK; lane++) {
            const float *p = &positions[lane][3 * (size_t)packed->vertex[i][lane]];
            v[lane] = accel_vertex_load(p);
        }
        _MM_TRANSPOSE4_PS(v[0], v[1], v[2], v[3]);
        for (int k = 0; k < 3; k++)
            _mm_store_ps(out->v[i][k], v[k]);
    }
    memcpy(out->id, packed->id, sizeof out->id);
}

/* The leaf of a reference, unpacked to `room` if it is a packed one. */
static inline const struct bvh_leaf *accel_leaf(const struct accel *a, const struct bvh *tree,
                                                uint32_t ref, struct bvh_leaf *room)
{
    if (!tree->compact)
        return bvh_leaf_at(tree->arena, ref);
    accel_unpack(a, tree, bvh_packed_at(tree->arena, ref), room);
    return room;
}

/* Does (object, primitive) of a hit at the same t come before the best one's? */
static inline bool accel_before(const struct accel *a, uint32_t object, uint32_t primitive,
                                const struct trace_best *best)
{
    uint32_t objects[2] = {object, best->object}, primitives[2] = {primitive, best->primitive};
    for (int i = 0; i < 2; i++) {
        if (objects[i] == SCENE_NONE) {
            objects[i] = accel_triangle_object(a, primitives[i]);
            primitives[i] -= a->triangle_first[objects[i]];
        }
    }
    return objects[0] < objects[1] || (objects[0] == objects[1] && primitives[0] < primitives[1]);
}

/* Takes a hit if it is nearer than the best, or as near and earlier in order. */
static inline bool accel_offer(const struct accel *a, double t, double tmin, uint32_t object,
                               uint32_t primitive, const struct bvh_leaf *leaf, uint32_t lane,
                               struct trace_best *best)
{
    if (!(t > tmin && t <= best->t))
        return false;
    if (t == best->t && !(best->found && accel_before(a, object, primitive, best)))
        return false;
    best->t = t;
    best->object = object;
    best->primitive = primitive;
    best->leaf = leaf;
    best->lane = lane;
    best->found = true;
    return true;
}

/* Moves a ray into an instance's space; false when nothing can be hit there. */
bool accel_instance_ray(const struct accel *a, uint32_t object, const struct trace_ray *ray,
                        struct trace_ray *out, double *rescale);

/* The caller's ray, made ready; false when it hits nothing by definition. */
bool accel_ray(const struct accel *a, const struct ray *ray, struct trace_ray *out, double *tmin,
               double *tmax);

/* Fills in weights, normal and numbers of the best hit. */
void accel_hit(const struct accel *a, const struct trace_ray *ray, const struct trace_best *best,
               struct hit *out);

#endif
