/* master/sched/timers.h: the earliest of many deadlines (a binary heap).
 *
 * Every id in [0, capacity) has at most one deadline. Setting, moving and
 * stopping cost O(log n). Pure; tests/unit/test_sched_parts.c.
 */
#ifndef MASTER_SCHED_TIMERS_H
#define MASTER_SCHED_TIMERS_H

#include "common/mem.h"

struct timers {
    uint64_t *due_ms; /* by id */
    uint32_t *place;  /* by id: its index in heap, or UINT32_MAX */
    uint32_t *heap;   /* ids; the earliest first; equal times by id */
    uint32_t count, capacity;
};

TL_NODISCARD enum err timers_init(struct timers *t, struct arena *arena, uint32_t capacity);

/* Sets or moves the deadline of `id`; UINT64_MAX stops it. */
void timers_set(struct timers *t, uint32_t id, uint64_t due_ms);
void timers_stop(struct timers *t, uint32_t id);

static inline bool timers_running(const struct timers *t, uint32_t id)
{
    return t->place[id] != UINT32_MAX;
}

/* The earliest; UINT64_MAX when none runs. */
static inline uint64_t timers_due_ms(const struct timers *t)
{
    return t->count ? t->due_ms[t->heap[0]] : UINT64_MAX;
}

/* Takes the earliest id if it is due; UINT32_MAX when none is. */
uint32_t timers_pop(struct timers *t, uint64_t now_ms);

/* Asserts the order of the heap. */
void timers_check(const struct timers *t);

#endif
