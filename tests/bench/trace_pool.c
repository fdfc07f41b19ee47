#include "tests/bench/trace_pool.h"

#include <pthread.h>
#include <stdbool.h>

struct loop {
    size_t count;
    void (*fn)(void *arg, size_t index);
    void *arg;
    size_t next;
};

/* A loop is offered to the helper; whoever is first takes it from the desk: the helper to work on
 * it, or the caller who is through with it alone. */
static struct {
    pthread_mutex_t lock;
    pthread_cond_t offered, done;
    struct loop *offer;
    bool working;
} desk = {PTHREAD_MUTEX_INITIALIZER, PTHREAD_COND_INITIALIZER, PTHREAD_COND_INITIALIZER, NULL,
          false};

static void loop_work(struct loop *l)
{
    size_t i;
    while ((i = __atomic_fetch_add(&l->next, 1, __ATOMIC_RELAXED)) < l->count)
        l->fn(l->arg, i);
}

static void *helper_run(void *unused)
{
    pthread_mutex_lock(&desk.lock);
    for (;;) {
        while (!desk.offer)
            pthread_cond_wait(&desk.offered, &desk.lock);
        struct loop *l = desk.offer;
        desk.offer = NULL;
        desk.working = true;
        pthread_mutex_unlock(&desk.lock);
        loop_work(l);
        pthread_mutex_lock(&desk.lock);
        desk.working = false;
        pthread_cond_signal(&desk.done);
    }
    return unused;
}

void trace_pool_run(void *ctx, size_t count, void (*fn)(void *arg, size_t index), void *arg)
{
    static bool helped;
    pthread_t helper;
    struct loop loop = {count, fn, arg, 0};
    (void)ctx;
    helped = helped || pthread_create(&helper, NULL, helper_run, NULL) == 0;
    pthread_mutex_lock(&desk.lock);
    desk.offer = &loop;
    pthread_cond_signal(&desk.offered);
    pthread_mutex_unlock(&desk.lock);
    loop_work(&loop);
    pthread_mutex_lock(&desk.lock);
    desk.offer = NULL;
    while (desk.working)
        pthread_cond_wait(&desk.done, &desk.lock);
    pthread_mutex_unlock(&desk.lock);
}
