/* common/scene_lazy.h: which objects may wait for their tree until a ray meets them: one rule for
 * the worker, which does it (worker/render/accel_lazy.h), and for `explain`, which tells of it.
 * Pure; any thread. Test: test_scene_build. */
#ifndef COMMON_SCENE_LAZY_H
#define COMMON_SCENE_LAZY_H

#include <stdbool.h>
#include <stdint.h>

/* Plain objects of so many triangles may wait for their tree until a ray meets them, where there
 * are so many of them and none has more than that part of all triangles, which one thread builds.
 */
enum {
    SCENE_LAZY_TRIANGLES_MIN = 2048,
    SCENE_LAZY_OBJECTS_MIN = 8,
    SCENE_LAZY_SHARE_MAX_INVERSE = 4
};

/* Whether they do: of `total` triangles they have half, and their boxes (half the surface: `areas`
 * in sum, `all` of the box of all) do not overlap so much that a ray enters many in vain. A ray
 * through the box of all meets areas / all of them on average; of n that fill a cube side by side
 * it meets the cube root of n, and twice that is taken for too much. */
static inline bool scene_lazy_pays(uint64_t objects, uint64_t triangles, uint64_t total,
                                   double areas, double all)
{
    double meets = areas / all;
    return objects >= SCENE_LAZY_OBJECTS_MIN && triangles >= total / 2 &&
           meets * meets * meets <= 8.0 * (double)objects;
}

#endif
