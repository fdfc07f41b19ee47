/* Idempotency keys: see farm.h. */
#include <string.h>

#include "common/mem.h"
#include "master/farm.h"

enum { KEYS_MAX = 10000 };

struct job_key {
    char *key; /* owned */
    digest body;
    uint64_t job;
    int64_t at_us;
};

struct job *jobs_by_key(const struct farm *f, const char *key, const digest *body, bool *conflict)
{
    *conflict = false;
    for (size_t i = 0; i < f->keys.count; i++) {
        if (strcmp(f->keys.items[i].key, key) != 0)
            continue;
        *conflict = !digest_equal(&f->keys.items[i].body, body);
        return farm_job(f, f->keys.items[i].job);
    }
    return NULL;
}

enum err job_keys_note(struct farm *f, const char *key, const digest *body, uint64_t job,
                       int64_t at_us)
{
    struct job_keys *k = &f->keys;
    if (k->count >= KEYS_MAX) {
        mem_free(k->items[0].key);
        memmove(k->items, k->items + 1, --k->count * sizeof *k->items);
    }
    if (!mem_grow((void **)&k->items, k->count, &k->capacity, sizeof *k->items))
        return ERR_NOMEM;
    char *copy = mem_strdup(key);
    if (!copy)
        return ERR_NOMEM;
    k->items[k->count].key = copy;
    k->items[k->count].body = *body;
    k->items[k->count].job = job;
    k->items[k->count].at_us = at_us;
    k->count++;
    return ERR_OK;
}

void job_keys_release(struct farm *f)
{
    for (size_t i = 0; i < f->keys.count; i++)
        mem_free(f->keys.items[i].key);
    mem_free(f->keys.items);
}
