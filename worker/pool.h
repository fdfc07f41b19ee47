/* worker/pool.h: the threads of a worker, and how work reaches them and comes back.
 *
 * N render threads take render tasks, one service thread takes service tasks (read,
 * check and write chunks, build a scene), each in order of arrival. A task's `run` is
 * called on its thread; its `done` is called on the loop thread afterwards. A service
 * task may spread a loop over the render threads that are free (pool_run), and over helper
 * threads, which do nothing else.
 *
 * A task is embedded in what it is about and must stay valid from pool_submit until
 * `done` or until pool_cancel returned true. The queues are intrusive: submitting
 * allocates nothing and cannot fail; who submits bounds how much.
 *
 * Thread: pool_new, submit, cancel, close: the loop's; pool_run: the service thread's.
 * Nothing global is set on a thread. Tests: test_pool.
 */
#ifndef WORKER_POOL_H
#define WORKER_POOL_H

#include <stdatomic.h>
#include <sys/queue.h>

#include "common/err.h"

struct uv_loop_s;
struct pool; /* opaque */

enum pool_kind { POOL_RENDER, POOL_SERVICE, POOL_HELP /* takes no tasks */, POOL_KIND_COUNT };

enum pool_task_state { POOL_IDLE, POOL_QUEUED, POOL_RUNNING, POOL_DONE };

struct pool_task {
    /* `thread` is 0..N-1 on a render thread and N on the service thread. */
    void (*run)(struct pool_task *task, uint32_t thread);
    void (*done)(struct pool_task *task);
    enum pool_kind kind;
    enum pool_task_state state; /* the pool's */
    TAILQ_ENTRY(pool_task) in_queue;
};

/* `spread_count` (at least thread_count): threads that a spread loop may take, the caller's among
 * them. ERR_NOMEM: also when a thread cannot be made. */
TL_NODISCARD enum err pool_new(struct uv_loop_s *loop, uint32_t thread_count, uint32_t spread_count,
                               struct pool **out);

/* Cancels what is queued without `done`, waits for what runs (set its stop flag before), and frees
 * the pool once the loop has turned; then `closed` (may be NULL) is called. */
void pool_close(struct pool *p, void (*closed)(void *ctx), void *ctx);

void pool_submit(struct pool *p, struct pool_task *task);

/* True if the task had not begun: it will not, and `done` is not called. */
TL_NODISCARD bool pool_cancel(struct pool *p, struct pool_task *task);

uint32_t pool_thread_count(const struct pool *p); /* of render threads */
uint32_t pool_spread_count(const struct pool *p);

/* Render threads that are inside a task now. */
uint32_t pool_busy(const struct pool *p);

/* The service thread is inside a task: pool_close would wait for it, perhaps for a whole build. */
bool pool_serving(const struct pool *p);

/* Calls fn(arg, i) for all i < count, on the calling thread and on others that are free, and
 * returns when all are done: an accel_runner whose ctx is the pool. */
void pool_run(void *pool, size_t count, void (*fn)(void *arg, size_t index), void *arg);

#endif
