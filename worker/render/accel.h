/* worker/render/accel.h: rays against geometry, exactly.
 *
 * Owns the acceleration structure over triangles, spheres and instances, and
 * answers closest-hit and any-hit queries. Every builder, kernel, SIMD width and
 * batch size returns the same hit bit for bit: boxes and a float filter only
 * discard what the watertight test in double (Woop, Benthin, Wald, JCGT 2(1)
 * 2013) could not accept; ties in t go to the lowest (object, primitive). Under precision
 * fast that test runs in float: the same bits in every kernel and batch still, but not
 * those of the builders without SIMD, nor of exact.
 *
 * Space: scene space. The caller has moved the scene's centre to the origin and
 * scaled it by a power of two so that coordinates are about 1 (worker/scene), and
 * has rounded each vertex once to float. Spheres, rays and transforms are double.
 *
 * Thread: building uses the caller's task runner; queries are read-only and may
 * run on any number of threads, each with its default rounding mode and no flush
 * to zero. No allocation, clock, I/O or hidden state in queries.
 */
#ifndef WORKER_RENDER_ACCEL_H
#define WORKER_RENDER_ACCEL_H

#include "common/digest.h"
#include "common/err.h"
#include "common/job_spec.h"

struct accel; /* opaque */

/* Borrowed until accel_free. */
struct accel_mesh {
    const float *positions;  /* 3 * vertex_count, finite */
    const uint32_t *indices; /* 3 * triangle_count, each < vertex_count */
    uint32_t vertex_count, triangle_count;
};

enum accel_object_type { ACCEL_TRIANGLES, ACCEL_SPHERE, ACCEL_INSTANCE };

/* The index of an object in accel_input is the `object` of a hit. */
struct accel_object {
    enum accel_object_type type;
    uint32_t mesh;            /* TRIANGLES (vertices already in scene space) and INSTANCE */
    double center[3], radius; /* SPHERE */
    double to_scene[12];      /* INSTANCE: 3x4 row-major, mesh space to scene space, invertible */
    double from_scene[12];    /* its inverse, as the caller computed it */
};

struct accel_input {
    const struct accel_mesh *meshes;
    size_t mesh_count;
    const struct accel_object *objects;
    size_t object_count;
};

/* Runs fn(arg, 0..count-1) in any order on any threads and returns when all are done. */
struct accel_runner {
    void (*run)(void *ctx, size_t count, void (*fn)(void *arg, size_t index), void *arg);
    void *ctx;
    uint32_t thread_count;
};

/* "auto" takes the widest the CPU has. All give the same bits. */
enum accel_isa { ACCEL_ISA_AUTO, ACCEL_ISA_SSE2, ACCEL_ISA_AVX2, ACCEL_ISA_AVX512 };

struct accel_options {
    enum job_builder builder;
    enum job_intersector
        intersector;              /* moller-trumbore: the source report's test, epsilon and all */
    enum job_precision precision; /* fast: float decides; see docs/TRACING.md, 6 */
    enum accel_isa isa;
    bool compact; /* half the tree's bytes: leaves hold numbers of vertices; the same hits, slower.
                     Not for fast, nor without a tree. */
};

struct accel_stats {
    uint64_t triangle_count, sphere_count, instance_count;
    uint64_t node_count, leaf_count, depth_max;
    uint64_t bytes;
    double sah_cost; /* relative to the root's area: one a node, one a leaf; of the scene's tree */
    double sah_binary; /* of the tree before it was made wide; 0 if that was not built here */
    /* Of accel_new_lazy: objects that wait or waited for a first ray, and those that met one.
     * Nodes, leaves and cost are those of the scene's own tree, bytes all that is there now. */
    uint64_t lazy_count, lazy_built;
};

/* `runner` may be NULL: builds on the calling thread, the same tree. ERR_NOMEM. */
TL_NODISCARD enum err accel_new(const struct accel_input *input,
                                const struct accel_options *options,
                                const struct accel_runner *runner, struct accel **out);

/* The same, with trees from what accel_trees_copy gave over the same input, if it holds: whatever
 * the bytes are, no ray leaves them. Takes `saved` (from mem_alloc_aligned, at 64 or more; may be
 * NULL) whatever happens: the trees lie in it. */
TL_NODISCARD enum err accel_new_saved(const struct accel_input *input,
                                      const struct accel_options *options,
                                      const struct accel_runner *runner, void *saved,
                                      size_t saved_bytes, struct accel **out);

/* The trees as that many bytes, and any run of these: written to a file piece by piece, they are in
 * memory once. */
size_t accel_trees_bytes(const struct accel *a);
void accel_trees_copy(const struct accel *a, size_t from, size_t bytes, unsigned char *out);

/* True if the trees were saved ones. */
bool accel_is_restored(const struct accel *a);

/* Names what trees are built over: the same key, the same trees. ERR_NOMEM. */
TL_NODISCARD enum err accel_trees_key(const struct accel_input *input,
                                      const struct accel_options *options,
                                      const struct accel_runner *runner, digest *out);
void accel_free(struct accel *a);
void accel_stats_get(const struct accel *a, struct accel_stats *out);

/* dir need not be unit; t counts in lengths of dir. Hits lie in the open interval (tmin, tmax). A
 * ray with a non-finite component, a zero direction or tmin >= tmax hits nothing. */
struct ray {
    double org[3], dir[3];
    double tmin, tmax;
};

/* object == SCENE_NONE: no hit, and nothing else is set. */
struct hit {
    double t;
    double b1, b2; /* triangles: weights of vertices 1 and 2; spheres: 0 */
    double ng[3];  /* not unit; triangles (v1 - v0) x (v2 - v0) in scene space, spheres outward */
    uint32_t object, primitive; /* primitive: triangle of the mesh; 0 for a sphere */
};

void accel_closest(const struct accel *a, const struct ray *ray, struct hit *out);
bool accel_occluded(const struct accel *a, const struct ray *ray);

/* The main path: many rays interleaved, hiding memory latency behind each other; the same bits
 * as one at a time. occluded[i] is 0 or 1. */
void accel_closest_batch(const struct accel *a, const struct ray *rays, size_t count,
                         struct hit *hits);
void accel_occluded_batch(const struct accel *a, const struct ray *rays, size_t count,
                          uint8_t *occluded);

/* The same for rays i with active[i] != 0 alone: for rounds in which part of the rays go on,
 * without moving those together. Nothing is read of the other rays, nothing written of their
 * results. */
void accel_closest_masked(const struct accel *a, const struct ray *rays, const uint8_t *active,
                          size_t count, struct hit *hits);
void accel_occluded_masked(const struct accel *a, const struct ray *rays, const uint8_t *active,
                           size_t count, uint8_t *occluded);

/* The kernel that would run, for reports and tests: "sse2", "avx2", "avx512"; "plain" without SIMD
 * for builder none and moller-trumbore. */
const char *accel_isa_name(const struct accel *a);

#endif
