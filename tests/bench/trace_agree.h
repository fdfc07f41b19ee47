/* tests/bench/trace_agree.h: do single calls, batches and Embree find the same?
 *
 * What the benchmark says beside its times: a fast answer has to be the right one. Thread: one.
 */
#ifndef TESTS_BENCH_TRACE_AGREE_H
#define TESTS_BENCH_TRACE_AGREE_H

#include "tests/bench/trace_peer.h"

/* Of a peer's answers and ours to the same rays. */
struct trace_agreement {
    size_t apart;  /* rays that one side says hit and the other not, or whose t differ by more
                      than 1e-4 of how far the scene is */
    size_t judged; /* of these, by trace_judge.h */
    size_t wrong, theirs; /* of those judged: where we are wrong, and where the peer is */
};

/* Rays that single calls and batches answer differently in any bit. */
size_t trace_agree_batch(const struct accel *a, const struct trace_rays *rays, bool shadow);

/* What the peer finds against what we do. Judges up to `judged_max` in scenes of one mesh. */
struct trace_agreement trace_agree_peer(const struct accel *a, struct trace_peer *p,
                                        const struct trace_scene *s, const struct trace_rays *rays,
                                        bool shadow, size_t judged_max);

#endif
