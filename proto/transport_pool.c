/* The threads on which libuv works. */
#include <uv.h>

#include "proto/transport.h"

enum { POOL_THREADS = 4 }; /* of libuv, unless UV_THREADPOOL_SIZE says otherwise */

static void wait_at(void *gate)
{
    uv_mutex_lock(gate);
    uv_mutex_unlock(gate);
}

/* As many threads at once as the pool has, then none. */
static enum err try_threads(void)
{
    uv_mutex_t gate;
    uv_thread_t threads[POOL_THREADS];
    int count = 0;
    if (uv_mutex_init(&gate) != 0)
        return ERR_NOMEM;
    uv_mutex_lock(&gate);
    while (count < POOL_THREADS && uv_thread_create(&threads[count], wait_at, &gate) == 0)
        count++;
    uv_mutex_unlock(&gate);
    for (int i = 0; i < count; i++)
        (void)uv_thread_join(&threads[i]);
    uv_mutex_destroy(&gate);
    return count == POOL_THREADS ? ERR_OK : ERR_NOMEM;
}

static void do_nothing(uv_work_t *work)
{
    (void)work;
}

static void done_nothing(uv_work_t *work, int status)
{
    (void)work;
    (void)status;
}

enum err transport_start_pool(uv_loop_t *loop)
{
    static uv_work_t work;
    TL_TRY(try_threads());
    return uv_queue_work(loop, &work, do_nothing, done_nothing) == 0 ? ERR_OK : ERR_NOMEM;
}
