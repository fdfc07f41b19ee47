/* common/parallel.h: a loop whose turns run side by side.
 *
 * For short work of a process that otherwise waits (a picture that a client asked for); rendering
 * has threads of its own (worker/pool.h).
 */
#ifndef COMMON_PARALLEL_H
#define COMMON_PARALLEL_H

#include <stddef.h>

enum { PARALLEL_THREADS_MAX = 8 };

/* Calls turn(arg, i) once for each i of [0, count), on the calling thread and on so many others
 * that at most PARALLEL_THREADS_MAX and no more than the machine has processors work; returns when
 * all are over. Turns are begun in the order of i, so that a turn may wait for an earlier one. A
 * thread that the system refuses is done without. Any thread. */
void parallel_for(size_t count, void (*turn)(void *arg, size_t i), void *arg);

#endif
