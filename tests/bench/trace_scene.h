/* tests/bench/trace_scene.h: the scenes and rays of the tracing benchmark and tests.
 *
 * A scene is meshes and objects for accel_new; the first object is made of triangles
 * and any others are instances of the second mesh. Rays are eight floats, as in the
 * files of --rays, so that both sides trace the same ones. Owned by the caller.
 */
#ifndef TESTS_BENCH_TRACE_SCENE_H
#define TESTS_BENCH_TRACE_SCENE_H

#include <emmintrin.h>

#include "scenes/gen_mesh.h"
#include "worker/render/accel.h"

struct trace_scene {
    struct gen_mesh mesh[2];
    struct accel_mesh views[2];
    struct accel_object *objects;
    struct accel_input input;
    uint64_t triangle_count; /* in memory, not counted once per instance */
};

struct trace_rays {
    float (*ray)[8]; /* origin, tnear, direction, tfar */
    size_t count;
};

enum trace_scene_id {
    TRACE_CORNELL,
    TRACE_BALL70K,
    TRACE_BALL1M,
    TRACE_OPEN1M,
    TRACE_NEEDLES,
    TRACE_INSTANCES,
    TRACE_FRAME,
    TRACE_SCENE_COUNT
};
enum trace_rays_id { TRACE_CAMERA, TRACE_BOUNCE, TRACE_SHADOW, TRACE_RANDOM, TRACE_RAYS_COUNT };

extern const char *const trace_scene_names[TRACE_SCENE_COUNT];
extern const char *const trace_rays_names[TRACE_RAYS_COUNT];

TL_NODISCARD enum err trace_scene_make(struct trace_scene *s, enum trace_scene_id id);

/* A scene around a mesh read from elsewhere; takes its arrays. */
void trace_scene_wrap(struct trace_scene *s, struct gen_mesh *mesh);
void trace_scene_release(struct trace_scene *s);

/* side * side rays of a kind; bounce and shadow rays start from what `a` finds. */
TL_NODISCARD enum err trace_rays_make(struct trace_rays *r, const struct accel *a,
                                      enum trace_scene_id scene, enum trace_rays_id kind,
                                      uint32_t side);
void trace_rays_release(struct trace_rays *r);

/* The double form of ray i. */
static inline struct ray trace_rays_get(const struct trace_rays *r, size_t i)
{
    __m128 org = _mm_loadu_ps(r->ray[i]), dir = _mm_loadu_ps(r->ray[i] + 4);
    __m128d near = _mm_cvtps_pd(_mm_movehl_ps(org, org)),
            far = _mm_cvtps_pd(_mm_movehl_ps(dir, dir));
    struct ray out;
    _mm_storeu_pd(out.org, _mm_cvtps_pd(org));
    _mm_storeu_pd(out.dir, _mm_cvtps_pd(dir));
    _mm_storel_pd(&out.org[2], near);
    _mm_storel_pd(&out.dir[2], far);
    _mm_storeh_pd(&out.tmin, near);
    _mm_storeh_pd(&out.tmax, far);
    return out;
}

#endif
