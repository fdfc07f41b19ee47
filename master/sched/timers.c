#include "master/sched/timers.h"

enum err timers_init(struct timers *t, struct arena *arena, uint32_t capacity)
{
    *t = (struct timers){.capacity = capacity};
    t->due_ms = arena_alloc(arena, capacity, sizeof *t->due_ms);
    t->place = arena_alloc(arena, capacity, sizeof *t->place);
    t->heap = arena_alloc(arena, capacity, sizeof *t->heap);
    if (!t->due_ms || !t->place || !t->heap)
        return ERR_NOMEM;
    for (uint32_t i = 0; i < capacity; i++)
        t->place[i] = UINT32_MAX;
    return ERR_OK;
}

static bool earlier(const struct timers *t, uint32_t a, uint32_t b)
{
    return t->due_ms[a] != t->due_ms[b] ? t->due_ms[a] < t->due_ms[b] : a < b;
}

static void put(struct timers *t, uint32_t place, uint32_t id)
{
    t->heap[place] = id;
    t->place[id] = place;
}

static void sift_up(struct timers *t, uint32_t place)
{
    uint32_t id = t->heap[place];
    while (place > 0) {
        uint32_t parent = (place - 1) / 2;
        if (!earlier(t, id, t->heap[parent]))
            break;
        put(t, place, t->heap[parent]);
        place = parent;
    }
    put(t, place, id);
}

static void sift_down(struct timers *t, uint32_t place)
{
    uint32_t id = t->heap[place];
    for (;;) {
        uint32_t child = 2 * place + 1;
        if (child >= t->count)
            break;
        if (child + 1 < t->count && earlier(t, t->heap[child + 1], t->heap[child]))
            child++;
        if (!earlier(t, t->heap[child], id))
            break;
        put(t, place, t->heap[child]);
        place = child;
    }
    put(t, place, id);
}

void timers_set(struct timers *t, uint32_t id, uint64_t due_ms)
{
    TL_ASSERT(id < t->capacity);
    if (due_ms == UINT64_MAX) {
        timers_stop(t, id);
        return;
    }
    t->due_ms[id] = due_ms;
    if (!timers_running(t, id))
        put(t, t->count++, id);
    sift_up(t, t->place[id]);
    sift_down(t, t->place[id]);
}

void timers_stop(struct timers *t, uint32_t id)
{
    TL_ASSERT(id < t->capacity);
    uint32_t place = t->place[id];
    if (place == UINT32_MAX)
        return;
    t->place[id] = UINT32_MAX;
    uint32_t last = t->heap[--t->count];
    if (last == id)
        return;
    put(t, place, last);
    sift_up(t, place);
    sift_down(t, t->place[last]);
}

uint32_t timers_pop(struct timers *t, uint64_t now_ms)
{
    if (timers_due_ms(t) > now_ms || t->count == 0)
        return UINT32_MAX;
    uint32_t id = t->heap[0];
    timers_stop(t, id);
    return id;
}

void timers_check(const struct timers *t)
{
    TL_ASSERT(t->count <= t->capacity);
    for (uint32_t i = 0; i < t->count; i++) {
        TL_ASSERT(t->place[t->heap[i]] == i);
        TL_ASSERT(i == 0 || !earlier(t, t->heap[i], t->heap[(i - 1) / 2]));
    }
}
