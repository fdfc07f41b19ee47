/* tests/bench/render_peer.h: another renderer in a process beside the benchmark.
 *
 * The peer is a command that loads one scene, warms up, and then answers each line "SPP SEED\n" on
 * its standard input with a line "SECONDS CPU_SECONDS\n" and the picture's pixels, interleaved
 * 32-bit floats RGB, row by row. tests/mitsuba/run bench is one. One thread.
 */
#ifndef TESTS_BENCH_RENDER_PEER_H
#define TESTS_BENCH_RENDER_PEER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

struct render_peer {
    int process; /* id, or 0: none */
    FILE *to, *from;
};

/* Starts `argv` (NULL at its end) and waits until it says "ready\n"; false if it does not. */
bool render_peer_start(struct render_peer *peer, const char *const argv[]);

/* A picture of `pixels` pixels to `rgb`, planar; false if the peer has failed. */
bool render_peer_render(struct render_peer *peer, uint64_t spp, uint64_t seed, size_t pixels,
                        double *rgb, double *seconds, double *cpu_seconds);

/* Ends it; nothing is done when it never started. */
void render_peer_stop(struct render_peer *peer);

#endif
