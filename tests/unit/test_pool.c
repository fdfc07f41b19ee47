/* The worker's threads: every task runs once, comes back to the loop, and can be cancelled before
 * it runs; loops are spread over who is free. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <unistd.h>
#include <uv.h>

#include "worker/pool.h"

enum { TASKS = 200, THREADS = 3, SPREAD = 6 };

struct job {
    struct pool_task task;
    atomic_int ran;
    int done;
    uint32_t thread;
};

static uv_loop_t loop;
static struct pool *pool;
static int done_count;
static atomic_bool gate;

static void run(struct pool_task *task, uint32_t thread)
{
    struct job *job = (struct job *)task;
    while (atomic_load(&gate))
        (void)usleep(100);
    job->thread = thread;
    atomic_fetch_add(&job->ran, 1);
}

static void done(struct pool_task *task)
{
    ((struct job *)task)->done++;
    done_count++;
}

static int open_pool(void **state)
{
    (void)state;
    done_count = 0;
    atomic_store(&gate, false);
    return uv_loop_init(&loop) < 0 || pool_new(&loop, THREADS, SPREAD, &pool) != ERR_OK;
}

static int close_pool(void **state)
{
    (void)state;
    pool_close(pool, NULL, NULL);
    (void)uv_run(&loop, UV_RUN_DEFAULT);
    return uv_loop_close(&loop);
}

static void submit(struct job *job, enum pool_kind kind)
{
    job->task = (struct pool_task){.run = run, .done = done, .kind = kind};
    pool_submit(pool, &job->task);
}

static void turn_until(int count)
{
    while (done_count < count)
        (void)uv_run(&loop, UV_RUN_ONCE);
}

static void every_task_runs_once(void **state)
{
    (void)state;
    static struct job jobs[TASKS];
    for (int i = 0; i < TASKS; i++) {
        jobs[i] = (struct job){0};
        submit(&jobs[i], i % 4 == 0 ? POOL_SERVICE : POOL_RENDER);
    }
    turn_until(TASKS);
    for (int i = 0; i < TASKS; i++) {
        assert_int_equal(atomic_load(&jobs[i].ran), 1);
        assert_int_equal(jobs[i].done, 1);
        assert_true(i % 4 == 0 ? jobs[i].thread == THREADS : jobs[i].thread < THREADS);
    }
    assert_int_equal(pool_busy(pool), 0);
}

static void what_waits_can_be_cancelled(void **state)
{
    (void)state;
    struct job jobs[THREADS + 2] = {0};
    atomic_store(&gate, true);
    for (int i = 0; i < THREADS + 2; i++)
        submit(&jobs[i], POOL_RENDER);
    while (pool_busy(pool) < THREADS)
        (void)usleep(100);
    assert_false(pool_cancel(pool, &jobs[0].task));
    assert_true(pool_cancel(pool, &jobs[THREADS].task));
    atomic_store(&gate, false);
    turn_until(THREADS + 1);
    assert_int_equal(atomic_load(&jobs[THREADS].ran), 0);
    assert_int_equal(jobs[THREADS + 1].done, 1);
    assert_false(pool_cancel(pool, &jobs[0].task));
}

struct spread {
    struct pool_task task;
    atomic_int counts[1000];
};

static void count_one(void *arg, size_t index)
{
    atomic_fetch_add(&((struct spread *)arg)->counts[index], 1);
}

static void done_spread(struct pool_task *task)
{
    (void)task;
    done_count++;
}

static void run_spread(struct pool_task *task, uint32_t thread)
{
    (void)thread;
    for (int round = 0; round < 20; round++)
        pool_run(pool, 1000, count_one, task);
    pool_run(pool, 0, count_one, task);
    pool_run(pool, 1, count_one, task);
}

static void a_loop_is_spread_while_others_render(void **state)
{
    (void)state;
    static struct spread s;
    static struct job jobs[50];
    s = (struct spread){.task = {.run = run_spread, .done = done_spread, .kind = POOL_SERVICE}};
    pool_submit(pool, &s.task);
    for (int i = 0; i < 50; i++) {
        jobs[i] = (struct job){0};
        submit(&jobs[i], POOL_RENDER);
    }
    turn_until(51);
    for (int i = 1; i < 1000; i++)
        assert_int_equal(atomic_load(&s.counts[i]), 20);
    assert_int_equal(atomic_load(&s.counts[0]), 21);
}

/* As many threads at once as `at_once`: else this never returns. */
struct meeting {
    struct pool_task task;
    atomic_int here;
    int at_once;
};

static void meet(void *arg, size_t index)
{
    (void)index;
    struct meeting *m = arg;
    atomic_fetch_add(&m->here, 1);
    while (atomic_load(&m->here) < m->at_once)
        (void)usleep(100);
}

static void run_meeting(struct pool_task *task, uint32_t thread)
{
    (void)thread;
    struct meeting *m = (struct meeting *)task;
    pool_run(pool, (size_t)m->at_once, meet, m);
}

static void helpers_take_part(void **state)
{
    (void)state;
    struct meeting m = {.task = {.run = run_meeting, .done = done_spread, .kind = POOL_SERVICE},
                        .at_once = SPREAD};
    pool_submit(pool, &m.task);
    turn_until(1);

    /* The render threads are busy: the helpers and the caller are left. */
    struct job jobs[THREADS] = {0};
    struct meeting fewer = m;
    fewer.at_once = SPREAD - THREADS;
    atomic_store(&fewer.here, 0);
    atomic_store(&gate, true);
    for (int i = 0; i < THREADS; i++)
        submit(&jobs[i], POOL_RENDER);
    while (pool_busy(pool) < THREADS)
        (void)usleep(100);
    pool_submit(pool, &fewer.task);
    turn_until(2);
    atomic_store(&gate, false);
    turn_until(2 + THREADS);
}

static void closing_with_tasks_queued(void **state)
{
    (void)state;
    static struct job jobs[20];
    for (int i = 0; i < 20; i++) {
        jobs[i] = (struct job){0};
        submit(&jobs[i], POOL_RENDER);
    }
}

int main(void)
{
#define WITH_POOL(test) cmocka_unit_test_setup_teardown(test, open_pool, close_pool)
    const struct CMUnitTest tests[] = {
        WITH_POOL(every_task_runs_once),
        WITH_POOL(what_waits_can_be_cancelled),
        WITH_POOL(a_loop_is_spread_while_others_render),
        WITH_POOL(helpers_take_part),
        WITH_POOL(closing_with_tasks_queued),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
