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

static struct job_key *find(const struct job_keys *keys, const char *key)
{
    for (size_t i = 0; i < keys->count; i++)
        if (strcmp(keys->items[i].key, key) == 0)
            return &keys->items[i];
    return NULL;
}

struct job *jobs_by_key(const struct farm *f, const char *key, const digest *body, bool *conflict)
{
    const struct job_key *k = find(&f->keys, key);
    *conflict = false;
    if (!k || farm_wall_us() - k->at_us > STORE_KEY_LIFE_US)
        return NULL;
    *conflict = !digest_equal(&k->body, body);
    return farm_job(f, k->job);
}

/* Takes out one; the rest stay in their order. */
static void drop(struct job_keys *keys, struct job_key *k)
{
    mem_free(k->key);
    keys->count--;
    memmove(k, k + 1, (size_t)(keys->items + keys->count - k) * sizeof *k);
}

enum err job_keys_note(struct farm *f, const char *key, const digest *body, uint64_t job,
                       int64_t at_us)
{
    struct job_keys *k = &f->keys;
    struct job_key *before = find(k, key);
    if (before)
        drop(k, before);
    if (k->count >= KEYS_MAX)
        drop(k, k->items);
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
