/* tests/bench/trace_peer.h: Embree behind the few calls the benchmark needs.
 *
 * Embree 3 is linked; Embree 4 is loaded from a library given by name (the two differ
 * only in how a ray is passed). Tests and benchmarks only: no program links this.
 */
#ifndef TESTS_BENCH_TRACE_PEER_H
#define TESTS_BENCH_TRACE_PEER_H

#include "tests/bench/trace_scene.h"

struct trace_peer; /* a device of Embree */

enum trace_peer_quality { PEER_MEDIUM, PEER_HIGH };

struct trace_peer_hit {
    float t;
    uint32_t object, primitive; /* object SCENE_NONE: none; instances as accel's objects */
};

/* `library` NULL: the linked Embree 3, else the path of Embree 4's. NULL if it cannot be had. */
struct trace_peer *trace_peer_new(const char *library, uint32_t threads);
/* The linked Embree 3 of one thread, held to an instruction set: "sse2", "avx2", "avx512". */
struct trace_peer *trace_peer_new_isa(const char *isa);
void trace_peer_free(struct trace_peer *p);

/* Builds, replacing what was built. */
void trace_peer_build(struct trace_peer *p, const struct trace_scene *s,
                      enum trace_peer_quality quality, bool robust);

/* Bytes that Embree holds, without the vertices and indices, which it shares. */
int64_t trace_peer_bytes(const struct trace_peer *p);

/* SAH cost of the binary tree that rtcBuildBVH (MEDIUM) makes of the boxes of the scene's first
 * mesh, in half areas of the root: one a node, one a leaf of up to four. Negative: it cannot be
 * had, or a mesh is instanced. */
double trace_peer_sah(struct trace_peer *p, const struct trace_scene *s);

void trace_peer_closest(struct trace_peer *p, const float ray[8], struct trace_peer_hit *hit);
bool trace_peer_occluded(struct trace_peer *p, const float ray[8]);

/* Sums over rays [begin, end): how many hit, as the timed loop of the benchmark. */
size_t trace_peer_count(struct trace_peer *p, const struct trace_rays *r, size_t begin, size_t end,
                        bool shadow);

/* Seconds: of one thread's work the processor time of the whole process, which a busy machine
 * disturbs less; of several threads' the time on the clock. */
double trace_seconds(int threads);

#endif
