#include "worker/pool.h"

#include <pthread.h>
#include <string.h>
#include <uv.h>

#include "common/mem.h"

enum { STACK_BYTES = 8 * 1024 * 1024 };

TAILQ_HEAD(task_queue, pool_task);

/* A loop that is spread over threads: each takes the next index until none is left. */
struct spread {
    void (*fn)(void *arg, size_t index);
    void *arg;
    size_t count;
    atomic_size_t next;
    uint32_t helpers; /* inside it now; under the pool's lock */
};

struct thread {
    struct pool *pool;
    uint32_t number;
    enum pool_kind kind;
    pthread_t handle;
};

struct pool {
    pthread_mutex_t lock;
    pthread_cond_t work[POOL_KIND_COUNT];
    pthread_cond_t helped; /* a helper has left the spread */
    struct task_queue queues[POOL_KIND_COUNT], finished;
    struct spread *spread; /* NULL: none, or all its indices are taken */
    bool stopping;
    atomic_uint busy[POOL_KIND_COUNT];
    uv_async_t wake;
    void (*closed)(void *ctx);
    void *closed_ctx;
    uint32_t thread_count; /* of render threads; one more serves, the others help */
    uint32_t spread_count;
    uint32_t all_count, started;
    struct thread threads[];
};

static void lock(struct pool *p)
{
    TL_ASSERT(pthread_mutex_lock(&p->lock) == 0);
}

static void unlock(struct pool *p)
{
    TL_ASSERT(pthread_mutex_unlock(&p->lock) == 0);
}

/* --- Threads -------------------------------------------------------------------- */

static void work_off(struct spread *s)
{
    for (;;) {
        size_t i = atomic_fetch_add_explicit(&s->next, 1, memory_order_relaxed);
        if (i >= s->count)
            return;
        s->fn(s->arg, i);
    }
}

/* Holding the lock: helps the spread until its indices are taken. */
static void help(struct pool *p, struct spread *s)
{
    s->helpers++;
    unlock(p);
    work_off(s);
    lock(p);
    if (p->spread == s)
        p->spread = NULL;
    s->helpers--;
    (void)pthread_cond_signal(&p->helped);
}

static void run_task(struct thread *t, struct pool_task *task)
{
    struct pool *p = t->pool;
    TAILQ_REMOVE(&p->queues[t->kind], task, in_queue);
    task->state = POOL_RUNNING;
    unlock(p);
    atomic_fetch_add(&p->busy[t->kind], 1);
    task->run(task, t->number);
    atomic_fetch_sub(&p->busy[t->kind], 1);
    lock(p);
    task->state = POOL_DONE;
    TAILQ_INSERT_TAIL(&p->finished, task, in_queue);
    (void)uv_async_send(&p->wake);
}

static void *thread_main(void *arg)
{
    struct thread *t = arg;
    struct pool *p = t->pool;
    lock(p);
    while (!p->stopping) {
        struct pool_task *task = TAILQ_FIRST(&p->queues[t->kind]);
        /* Whoever can help makes the scene ready sooner, which all wait for. The service thread is
         * at it too. */
        bool helps =
            t->kind != POOL_SERVICE && p->spread && p->spread->helpers + 1 < p->spread_count;
        if (helps)
            help(p, p->spread);
        else if (task)
            run_task(t, task);
        else
            (void)pthread_cond_wait(&p->work[t->kind], &p->lock);
    }
    unlock(p);
    return NULL;
}

void pool_run(void *pool, size_t count, void (*fn)(void *arg, size_t index), void *arg)
{
    struct pool *p = pool;
    struct spread s = {.fn = fn, .arg = arg, .count = count};
    if (count > 1) {
        lock(p);
        p->spread = &s;
        (void)pthread_cond_broadcast(&p->work[POOL_RENDER]);
        (void)pthread_cond_broadcast(&p->work[POOL_HELP]);
        unlock(p);
    }
    work_off(&s);

    lock(p);
    if (p->spread == &s)
        p->spread = NULL;
    while (s.helpers > 0)
        (void)pthread_cond_wait(&p->helped, &p->lock);
    unlock(p);
}

/* --- Loop side ------------------------------------------------------------------ */

static void on_wake(uv_async_t *wake)
{
    struct pool *p = wake->data;
    for (;;) {
        lock(p);
        struct pool_task *task = TAILQ_FIRST(&p->finished);
        if (task) {
            TAILQ_REMOVE(&p->finished, task, in_queue);
            task->state = POOL_IDLE;
        }
        unlock(p);
        if (!task)
            return;
        task->done(task);
    }
}

void pool_submit(struct pool *p, struct pool_task *task)
{
    TL_ASSERT(task->state == POOL_IDLE && task->kind < POOL_HELP);
    lock(p);
    task->state = POOL_QUEUED;
    TAILQ_INSERT_TAIL(&p->queues[task->kind], task, in_queue);
    (void)pthread_cond_signal(&p->work[task->kind]);
    unlock(p);
}

bool pool_cancel(struct pool *p, struct pool_task *task)
{
    lock(p);
    bool queued = task->state == POOL_QUEUED;
    if (queued) {
        TAILQ_REMOVE(&p->queues[task->kind], task, in_queue);
        task->state = POOL_IDLE;
    }
    unlock(p);
    return queued;
}

uint32_t pool_thread_count(const struct pool *p)
{
    return p->thread_count;
}

uint32_t pool_spread_count(const struct pool *p)
{
    return p->spread_count;
}

uint32_t pool_busy(const struct pool *p)
{
    return atomic_load(&p->busy[POOL_RENDER]);
}

bool pool_serving(const struct pool *p)
{
    return atomic_load(&p->busy[POOL_SERVICE]) > 0;
}

/* --- Life ----------------------------------------------------------------------- */

static void join_all(struct pool *p)
{
    lock(p);
    p->stopping = true;
    for (int kind = 0; kind < POOL_KIND_COUNT; kind++)
        (void)pthread_cond_broadcast(&p->work[kind]);
    unlock(p);
    for (uint32_t i = 0; i < p->started; i++)
        (void)pthread_join(p->threads[i].handle, NULL);
}

static void on_wake_closed(uv_handle_t *handle)
{
    struct pool *p = handle->data;
    void (*closed)(void *) = p->closed;
    void *ctx = p->closed_ctx;
    for (int kind = 0; kind < POOL_KIND_COUNT; kind++)
        (void)pthread_cond_destroy(&p->work[kind]);
    (void)pthread_cond_destroy(&p->helped);
    (void)pthread_mutex_destroy(&p->lock);
    mem_free(p);
    if (closed)
        closed(ctx);
}

void pool_close(struct pool *p, void (*closed)(void *ctx), void *ctx)
{
    join_all(p);
    p->closed = closed;
    p->closed_ctx = ctx;
    uv_close((uv_handle_t *)&p->wake, on_wake_closed);
}

/* Signals are for the loop: a render thread takes none. */
static bool start_threads(struct pool *p)
{
    pthread_attr_t attributes;
    sigset_t all, before;
    if (pthread_attr_init(&attributes) != 0)
        return false;
    (void)pthread_attr_setstacksize(&attributes, STACK_BYTES);
    (void)sigfillset(&all);
    (void)pthread_sigmask(SIG_SETMASK, &all, &before);
    for (uint32_t i = 0; i < p->all_count; i++) {
        struct thread *t = &p->threads[i];
        *t = (struct thread){.pool = p,
                             .number = i,
                             .kind = i < p->thread_count    ? POOL_RENDER
                                     : i == p->thread_count ? POOL_SERVICE
                                                            : POOL_HELP};
        if (pthread_create(&t->handle, &attributes, thread_main, t) != 0)
            break;
        p->started++;
    }
    (void)pthread_sigmask(SIG_SETMASK, &before, NULL);
    (void)pthread_attr_destroy(&attributes);
    return p->started == p->all_count;
}

enum err pool_new(struct uv_loop_s *loop, uint32_t thread_count, uint32_t spread_count,
                  struct pool **out)
{
    TL_ASSERT(thread_count > 0 && spread_count >= thread_count);
    /* The render threads and the one that serves can be at a loop already. */
    uint32_t serving = thread_count + 1;
    uint32_t all_count = spread_count > serving ? spread_count : serving;
    struct pool *p = mem_calloc(1, sizeof *p + all_count * sizeof(struct thread));
    if (!p)
        return ERR_NOMEM;
    p->thread_count = thread_count;
    p->spread_count = spread_count;
    p->all_count = all_count;
    TAILQ_INIT(&p->finished);
    TL_ASSERT(pthread_mutex_init(&p->lock, NULL) == 0);
    TL_ASSERT(pthread_cond_init(&p->helped, NULL) == 0);
    for (int kind = 0; kind < POOL_KIND_COUNT; kind++) {
        TAILQ_INIT(&p->queues[kind]);
        TL_ASSERT(pthread_cond_init(&p->work[kind], NULL) == 0);
    }
    if (uv_async_init(loop, &p->wake, on_wake) < 0) {
        mem_free(p);
        return ERR_NOMEM;
    }
    p->wake.data = p;
    if (!start_threads(p)) {
        pool_close(p, NULL, NULL);
        return ERR_NOMEM;
    }
    *out = p;
    return ERR_OK;
}
