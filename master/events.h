/* master/events.h: what the event stream tells, kept for late readers.
 *
 * A ring of the last events, each with an id "epoch-sequence" (the epoch differs for every
 * start of the master). A reader that asks for what the ring has lost gets `reset`.
 * Loop thread only.
 */
#ifndef MASTER_EVENTS_H
#define MASTER_EVENTS_H

#include "common/buf.h"

enum { EVENTS_KEPT = 4096, EVENTS_BYTES_KEPT = 1 << 20 };

/* For events_add: concerns readers of any job. */
#define EVENTS_ALL_JOBS UINT64_MAX

struct events; /* opaque */

/* `wake` is called after each new event. */
TL_NODISCARD enum err events_new(uint64_t epoch, struct events **out);
void events_free(struct events *e);
void events_on_new(struct events *e, void (*wake)(void *ctx), void *ctx);

/* Adds an event; `job` 0 when it concerns none. Out of memory it is lost, and readers get a reset.
 */
void events_add(struct events *e, uint64_t job, const char *type, const char *data);

uint64_t events_epoch(const struct events *e);
/* Sequence of the newest event. */
uint64_t events_newest(const struct events *e);

/* Appends the next event after *sequence that concerns `job` (0: all) in wire form; false when
 * there is none. What was lost meanwhile gives a reset. */
bool events_next(const struct events *e, uint64_t *sequence, uint64_t job, struct buf *out);

#endif
