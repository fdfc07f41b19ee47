#include "common/name_table.h"

#include <string.h>

#include "common/mem.h"

enum { SLOTS_MIN = 64 };

void name_table_init(struct name_table *t)
{
    *t = (struct name_table){0};
}

void name_table_release(struct name_table *t)
{
    for (size_t i = 0; i < t->count; i++)
        mem_free(t->names[i]);
    mem_free(t->names);
    mem_free(t->slots);
    name_table_init(t);
}

/* FNV-1a. */
static size_t hash(const char *name, size_t bytes)
{
    uint64_t h = UINT64_C(0xcbf29ce484222325);
    for (size_t i = 0; i < bytes; i++)
        h = (h ^ (unsigned char)name[i]) * UINT64_C(0x100000001b3);
    return (size_t)(h ^ (h >> 32));
}

/* The slot that holds the name, or the free one where it would go. */
static size_t find_slot(const struct name_table *t, const char *name, size_t bytes)
{
    size_t mask = t->slot_count - 1, slot = hash(name, bytes) & mask;
    for (; t->slots[slot]; slot = (slot + 1) & mask) {
        const char *other = t->names[t->slots[slot] - 1];
        if (strncmp(other, name, bytes) == 0 && other[bytes] == '\0')
            break;
    }
    return slot;
}

uint32_t name_table_find(const struct name_table *t, const char *name, size_t bytes)
{
    if (!t->slot_count)
        return UINT32_MAX;
    uint32_t found = t->slots[find_slot(t, name, bytes)];
    return found ? found - 1 : UINT32_MAX;
}

/* At most half full. */
static bool make_room(struct name_table *t)
{
    if (t->slot_count && 2 * (t->count + 1) <= t->slot_count)
        return true;
    size_t wanted = t->slot_count ? 2 * t->slot_count : SLOTS_MIN;
    uint32_t *slots = mem_calloc(wanted, sizeof *slots);
    if (!slots)
        return false;
    mem_free(t->slots);
    t->slots = slots;
    t->slot_count = wanted;
    for (size_t i = 0; i < t->count; i++)
        slots[find_slot(t, t->names[i], strlen(t->names[i]))] = (uint32_t)i + 1;
    return true;
}

enum err name_table_add(struct name_table *t, const char *name, size_t bytes, uint32_t *out)
{
    bytes = strnlen(name, bytes);
    uint32_t found = name_table_find(t, name, bytes);
    if (found != UINT32_MAX) {
        *out = found;
        return ERR_OK;
    }
    if (!make_room(t) || !mem_grow((void **)&t->names, t->count, &t->capacity, sizeof *t->names))
        return ERR_NOMEM;
    char *copy = mem_strndup(name, bytes);
    if (!copy)
        return ERR_NOMEM;
    t->slots[find_slot(t, name, bytes)] = (uint32_t)t->count + 1;
    *out = (uint32_t)t->count;
    t->names[t->count++] = copy;
    return ERR_OK;
}
