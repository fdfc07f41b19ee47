/* worker/render/accel_lazy.h: trees of objects that are built when a ray first meets them.
 *
 * A scene of many rooms is mostly never seen. Where it pays (accel_lazy_choose) the scene's
 * tree holds such an object as a box alone; the first ray that enters the box has the
 * object's own tree built behind it, in the same arena and the same space, and goes on
 * into it. Which trees there are changes no hit, only where time and memory go.
 *
 *   UNBUILT --first ray, holding the object's lock--> built: the root's reference
 *
 * A ray meets what is built first: only what may still lie before its nearest hit is built.
 * Out of memory while building: the object is left out for that ray, and accel_failures
 * grows, so that the caller can throw away what it has rendered.
 *
 * Thread: choosing uses the runner; building, any number of render threads, each object
 * under its lock. Tests: test_accel_lazy.
 */
#ifndef WORKER_RENDER_ACCEL_LAZY_H
#define WORKER_RENDER_ACCEL_LAZY_H

#include "worker/render/accel.h"

/* What every object of an input is when it waits for its first ray. */
struct accel_lazy_plan {
    struct accel_lazy_box {
        float lo[3], hi[3];
        float edge; /* the largest extent of a triangle */
        bool lazy;
    } * boxes; /* object_count; of plain triangle objects that have any */
    size_t object_count;
    uint64_t lazy_count, lazy_triangles;
};

/* Measures the objects and chooses (scene_lazy.h has the rule): none of a scene where that would
 * not pay (few large objects, one that outweighs all, or objects that overlap so much that a ray
 * enters many in vain), and none unless options have the SAH builder, Woop's test and precision
 * exact, under which the shape of a tree decides nothing. ERR_NOMEM. */
TL_NODISCARD enum err accel_lazy_choose(const struct accel_input *input,
                                        const struct accel_options *options,
                                        const struct accel_runner *runner, uint32_t triangles_min,
                                        struct accel_lazy_plan *out);
void accel_lazy_plan_release(struct accel_lazy_plan *plan);

/* One lock for each object, or for several. */
struct accel_locks {
    void (*lock)(void *ctx, uint32_t object);
    void (*unlock)(void *ctx, uint32_t object);
    void *ctx;
};

/* accel_new with a plan that chose some. The plan may be released afterwards; input's arrays and
 * the locks' ctx must outlive the accel. ERR_NOMEM; ERR_LIMIT: too many triangles for one arena,
 * build them all at once. */
TL_NODISCARD enum err accel_new_lazy(const struct accel_input *input,
                                     const struct accel_options *options,
                                     const struct accel_runner *runner,
                                     const struct accel_lazy_plan *plan,
                                     const struct accel_locks *locks, struct accel **out);

/* How many trees could not be built so far, for want of memory. */
uint64_t accel_failures(const struct accel *a);

#endif
