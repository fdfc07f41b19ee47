#include "worker/scene/scene_locks.h"

#include <pthread.h>

#include "common/mem.h"

enum { LOCKS = 64 }; /* more than threads that build at once */

struct scene_locks {
    pthread_mutex_t mutexes[LOCKS];
};

struct scene_locks *scene_locks_new(void)
{
    struct scene_locks *l = mem_alloc(sizeof *l);
    for (int i = 0; l && i < LOCKS; i++)
        TL_ASSERT(pthread_mutex_init(&l->mutexes[i], NULL) == 0);
    return l;
}

void scene_locks_free(struct scene_locks *l)
{
    for (int i = 0; l && i < LOCKS; i++)
        (void)pthread_mutex_destroy(&l->mutexes[i]);
    mem_free(l);
}

static void lock(void *ctx, uint32_t object)
{
    struct scene_locks *l = ctx;
    TL_ASSERT(pthread_mutex_lock(&l->mutexes[object % LOCKS]) == 0);
}

static void unlock(void *ctx, uint32_t object)
{
    struct scene_locks *l = ctx;
    TL_ASSERT(pthread_mutex_unlock(&l->mutexes[object % LOCKS]) == 0);
}

struct accel_locks scene_locks_of(struct scene_locks *l)
{
    return (struct accel_locks){.lock = lock, .unlock = unlock, .ctx = l};
}
