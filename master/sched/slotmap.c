#include "master/sched/slotmap.h"

static uint32_t bucket_of(const struct slotmap *m, uint64_t key)
{
    /* Fibonacci hashing: keys are mostly consecutive numbers. */
    return (uint32_t)((key * UINT64_C(0x9E3779B97F4A7C15)) >> (64 - m->bucket_bits));
}

enum err slotmap_init(struct slotmap *m, struct arena *arena, uint32_t capacity)
{
    TL_ASSERT(capacity > 0 && capacity <= UINT32_C(1) << 30);
    uint32_t bits = 1;
    while (UINT32_C(1) << bits < capacity)
        bits++;
    *m = (struct slotmap){.bucket_bits = bits, .capacity = capacity};
    m->keys = arena_alloc(arena, capacity, sizeof *m->keys);
    m->next = arena_alloc(arena, capacity, sizeof *m->next);
    m->buckets = arena_alloc(arena, (size_t)1 << bits, sizeof *m->buckets);
    if (!m->keys || !m->next || !m->buckets)
        return ERR_NOMEM;
    for (uint32_t i = 0; i < UINT32_C(1) << bits; i++)
        m->buckets[i] = SLOT_NONE;
    for (uint32_t i = 0; i < capacity; i++)
        m->next[i] = i + 1 < capacity ? i + 1 : SLOT_NONE;
    return ERR_OK;
}

uint32_t slotmap_add(struct slotmap *m, uint64_t key)
{
    TL_ASSERT(key != 0 && slotmap_find(m, key) == SLOT_NONE);
    uint32_t slot = m->free_head;
    if (slot == SLOT_NONE)
        return SLOT_NONE;
    uint32_t b = bucket_of(m, key);
    m->free_head = m->next[slot];
    m->keys[slot] = key;
    m->next[slot] = m->buckets[b];
    m->buckets[b] = slot;
    m->count++;
    return slot;
}

uint32_t slotmap_find(const struct slotmap *m, uint64_t key)
{
    if (key == 0)
        return SLOT_NONE;
    uint32_t slot = m->buckets[bucket_of(m, key)];
    while (slot != SLOT_NONE && m->keys[slot] != key)
        slot = m->next[slot];
    return slot;
}

void slotmap_remove(struct slotmap *m, uint32_t slot)
{
    TL_ASSERT(slotmap_used(m, slot));
    uint32_t *at = &m->buckets[bucket_of(m, m->keys[slot])];
    while (*at != slot) {
        TL_ASSERT(*at != SLOT_NONE);
        at = &m->next[*at];
    }
    *at = m->next[slot];
    m->keys[slot] = 0;
    m->next[slot] = m->free_head;
    m->free_head = slot;
    m->count--;
}
