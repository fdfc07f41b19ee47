/* tests/unit/test_trace_ready.h: trace_ready.h as the kernels for AVX2 have it, out of line.
 * Only where the processor has AVX2 and FMA. */
#ifndef TESTS_UNIT_TEST_TRACE_READY_H
#define TESTS_UNIT_TEST_TRACE_READY_H

#include "worker/render/accel_parts.h"

/* Readies a ray for a scene of that reach; false as ready_scene_ray. */
bool test_ready_exact(double reach, const struct ray *ray, struct trace_ray *out);
bool test_ready_fast(double reach, const struct ray *ray, struct trace_ray *out);

#endif
