/* As where float decides. */
#define TRACE_FAST
#include "tests/unit/test_trace_ready.h"

#include "worker/render/trace_ready.h"

bool test_ready_fast(double reach, const struct ray *ray, struct trace_ray *out)
{
    const struct accel a = {.scene_tree = {.reach = reach}};
    double tmin, tmax;
    return ready_scene_ray(&a, ray, out, &tmin, &tmax);
}
