/* tests/bench/trace_judge.h: who is right where two tracers differ, by brute force in __float128.
 *
 * For scenes of one mesh. A hit lies within a margin of its triangle, and nothing before it is
 * farther than a margin from being missed: 1e-9 of an edge and of t, and what 2^-50 of the
 * coordinates is on the ray. Pure; any thread. Method: triple products, exact but for the sums.
 */
#ifndef TESTS_BENCH_TRACE_JUDGE_H
#define TESTS_BENCH_TRACE_JUDGE_H

#include "tests/bench/trace_scene.h"

/* Is this triangle the nearest hit of the ray, or SCENE_NONE right about it? */
bool trace_judge_closest(const struct trace_scene *s, const struct ray *ray, uint32_t primitive);

/* Is the ray blocked or free, as is said? */
bool trace_judge_occluded(const struct trace_scene *s, const struct ray *ray, bool occluded);

#endif
