/* tests/bench/trace_pool.h: two threads, the caller's and one that waits.
 *
 * The second one is made by the first call and stays, as Embree's and a worker's do: a thread made
 * for each of some hundred short loops is not looked at by a busy machine's scheduler before its
 * next tick, which took longer than the loops.
 */
#ifndef TESTS_BENCH_TRACE_POOL_H
#define TESTS_BENCH_TRACE_POOL_H

#include <stddef.h>

/* Calls fn(arg, i) once for each i of [0, count), as accel_runner wants it; `ctx` is not used. One
 * thread at a time may call. */
void trace_pool_run(void *ctx, size_t count, void (*fn)(void *arg, size_t index), void *arg);

#endif
