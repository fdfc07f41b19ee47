#include "common/parallel.h"

#include <pthread.h>
#include <stdatomic.h>
#include <unistd.h>

struct loop {
    void (*turn)(void *arg, size_t i);
    void *arg;
    size_t count;
    atomic_size_t next;
};

static void *take_turns(void *arg)
{
    struct loop *l = arg;
    for (size_t i; (i = atomic_fetch_add(&l->next, 1)) < l->count;)
        l->turn(l->arg, i);
    return NULL;
}

static size_t threads_for(size_t count)
{
    long processors = sysconf(_SC_NPROCESSORS_ONLN);
    size_t most = processors > 1 ? (size_t)processors : 1;
    if (most > PARALLEL_THREADS_MAX)
        most = PARALLEL_THREADS_MAX;
    return most < count ? most : count;
}

void parallel_for(size_t count, void (*turn)(void *arg, size_t i), void *arg)
{
    struct loop l = {.turn = turn, .arg = arg, .count = count};
    pthread_t helpers[PARALLEL_THREADS_MAX];
    size_t wanted = threads_for(count), started = 0;
    while (started + 1 < wanted && pthread_create(&helpers[started], NULL, take_turns, &l) == 0)
        started++;
    (void)take_turns(&l);
    for (size_t i = 0; i < started; i++)
        (void)pthread_join(helpers[i], NULL);
}
