/* master/sched/slotmap.h: a fixed table's slots, found by 64-bit key.
 *
 * Hands out slots [0, capacity) and finds them again by their key in constant
 * time; the caller keeps its records in an array of its own. Memory comes from
 * an arena once. Keys are unique and never 0. Pure; tests/unit/test_sched_parts.c.
 */
#ifndef MASTER_SCHED_SLOTMAP_H
#define MASTER_SCHED_SLOTMAP_H

#include "common/mem.h"
#include "master/sched/chain.h"

struct slotmap {
    uint64_t *keys;    /* by slot; 0: free */
    uint32_t *next;    /* by slot: in its bucket, or in the free list */
    uint32_t *buckets; /* first slot, or SLOT_NONE */
    uint32_t bucket_bits;
    uint32_t free_head;
    uint32_t capacity, count;
};

/* `capacity` 1..2^30. */
TL_NODISCARD enum err slotmap_init(struct slotmap *m, struct arena *arena, uint32_t capacity);

/* The slot of a new key; SLOT_NONE when full. A key that is present is a bug. */
TL_NODISCARD uint32_t slotmap_add(struct slotmap *m, uint64_t key);

/* The slot of a key, or SLOT_NONE. */
uint32_t slotmap_find(const struct slotmap *m, uint64_t key);

void slotmap_remove(struct slotmap *m, uint32_t slot);

static inline bool slotmap_used(const struct slotmap *m, uint32_t slot)
{
    return slot < m->capacity && m->keys[slot] != 0;
}

#endif
