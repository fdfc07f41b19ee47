/* tests/prop/test_accel_kit.h: hostile rays, and comparing answers bit for bit. */
#ifndef TESTS_PROP_TEST_ACCEL_KIT_H
#define TESTS_PROP_TEST_ACCEL_KIT_H

#include "tests/bench/trace_scene.h"

/* A third of the rays is aimed at vertices, a third at edges, a third at random; among them
 * are axis-parallel ones, zeros of both signs, origins on the planes of vertices, far
 * origins, short intervals and directions of very different lengths. */
void kit_ray(const struct trace_scene *s, uint64_t *state, size_t i, struct ray *out);

/* The closest hits by single calls, on four threads; the caller frees them with mem_free. */
struct hit *kit_hits(const struct accel *a, const struct ray *rays, size_t count);

/* How many of the rays b does not answer with these hits, bit for bit, single, batch and any hit.
 */
size_t kit_disagreements(const struct hit *want, const struct accel *b, const struct ray *rays,
                         size_t count);

/* The same of the hits of another accel. */
size_t kit_differences(const struct accel *a, const struct accel *b, const struct ray *rays,
                       size_t count);

struct accel *kit_build(const struct accel_input *input, enum job_builder builder,
                        enum accel_isa isa, const struct accel_runner *runner);

/* A runner of `threads` threads that takes its work in a scrambled order. */
struct accel_runner kit_runner(uint32_t threads);

/* argv: "--long" makes tests take minutes. Output then comes line by line, for who waits. */
bool kit_long(int argc, char **argv);

#endif
