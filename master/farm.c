#include "master/farm.h"

#include <fcntl.h>
#include <inttypes.h>
#include <string.h>
#include <sys/random.h>
#include <sys/resource.h>
#include <time.h>

#include "common/file_io.h"
#include "common/log.h"
#include "common/mem.h"

enum {
    TICK_MS = 500,
    STOP_MS = 50,              /* between the last word to workers and closing their connections */
    EPOCHS_RESERVED = 1 << 20, /* numbers of leases per write to the disk */
};

void farm_connection_limits(uint32_t people_max, uint32_t *people, uint32_t *workers)
{
    struct rlimit limit;
    uint64_t files = getrlimit(RLIMIT_NOFILE, &limit) == 0 ? limit.rlim_cur : 1024;
    const uint64_t least = FARM_DESCRIPTORS_OWN + 2 * FARM_PEOPLE_MIN;
    uint64_t left = (files > least ? files : least) - FARM_DESCRIPTORS_OWN;
    uint64_t share = left / 4 > FARM_PEOPLE_MIN ? left / 4 : FARM_PEOPLE_MIN;
    *people = share < people_max ? (uint32_t)share : people_max;
    left -= *people;
    *workers = left < FARM_CONNECTIONS_MAX ? (uint32_t)left : FARM_CONNECTIONS_MAX;
}

int64_t farm_now_ms(const struct farm *f)
{
    return (int64_t)uv_now(f->loop);
}

static int64_t clock_us(clockid_t clock)
{
    struct timespec t;
    (void)clock_gettime(clock, &t);
    return (int64_t)t.tv_sec * 1000000 + t.tv_nsec / 1000;
}

int64_t farm_wall_us(void)
{
    static int64_t offset_us; /* from the time since boot, which nobody sets */
    int64_t boot_us = clock_us(CLOCK_BOOTTIME);
    if (offset_us == 0)
        offset_us = clock_us(CLOCK_REALTIME) - boot_us;
    return boot_us + offset_us;
}

/* --- Scheduler ---------------------------------------------------------- */

static void send_lease(struct farm *f, const struct sched_action *a)
{
    struct job *job = farm_job(f, a->job);
    if (job) {
        jobs_started(f, job);
        rate_begin(&job->rate, farm_now_ms(f));
    }
    struct message m = {.type = FRAME_LEASE};
    m.lease = (tilery_Lease){.job = a->job,
                             .cell_begin = a->unit.cell_begin,
                             .cell_count = a->unit.cell_count,
                             .block = a->unit.block,
                             .epoch = a->epoch};
    workers_send(f, a->worker, &m);
}

static void send_short(struct farm *f, const struct sched_action *a)
{
    struct message m = {0};
    if (a->type == SCHED_CLOSE_JOB) {
        m.type = FRAME_JOB_END;
        m.job_end.job = a->job;
    } else {
        m.type = FRAME_REVOKE;
        m.revoke.job = a->job;
        m.revoke.epoch = a->epoch;
    }
    workers_send(f, a->worker, &m);
}

static void tell_unit_lost(struct farm *f, const struct sched_action *a)
{
    struct job *job = farm_job(f, a->job);
    if (!job)
        return;
    jobs_log(f, job,
             "cells %" PRIu32 "-%" PRIu32 " block %" PRIu32 " lost with w%" PRIu64 " (%" PRIu32
             " so far%s); others take them",
             a->unit.cell_begin, a->unit.cell_begin + a->unit.cell_count - 1, a->unit.block,
             a->worker, a->losses, a->alone ? ", alone" : "");
    verify_keep_blame(f, job, a);
    jobs_changed(f, job, false);
}

static void tell_failed(struct farm *f, const struct sched_action *a)
{
    struct job *job = farm_job(f, a->job);
    char why[JOB_NOTE_BYTES];
    if (!job)
        return;
    if (a->unit.cell_count > 0)
        (void)snprintf(why, sizeof why, "%s: cells %" PRIu32 "-%" PRIu32 ", block %" PRIu32,
                       sched_why_text(a->why), a->unit.cell_begin,
                       a->unit.cell_begin + a->unit.cell_count - 1, a->unit.block);
    else
        (void)snprintf(why, sizeof why, "%s", sched_why_text(a->why));
    jobs_sched_failed(f, job, why);
}

static void act(struct farm *f, const struct sched_action *a)
{
    struct job *job;
    switch (a->type) {
    case SCHED_OPEN_JOB:
        workers_open_job(f, a->worker, a->job);
        break;
    case SCHED_LEASE:
        send_lease(f, a);
        break;
    case SCHED_CLOSE_JOB:
    case SCHED_REVOKE:
        send_short(f, a);
        break;
    case SCHED_ACCEPT:
        results_accept(f, a);
        break;
    case SCHED_COMPARE:
        verify_compare(f, a);
        break;
    case SCHED_CHECK_OPENED:
    case SCHED_CHECK_CLOSED:
        verify_check(f, a);
        break;
    case SCHED_VOTE:
    case SCHED_IGNORE:
        break; /* acknowledged with the rest of the result */
    case SCHED_JOB_DONE:
        job = farm_job(f, a->job);
        if (job)
            jobs_sched_done(f, job);
        break;
    case SCHED_JOB_FAILED:
        tell_failed(f, a);
        break;
    case SCHED_WORKER_NEWS:
    case SCHED_DRAINED:
        workers_news(f, a);
        break;
    case SCHED_UNIT_LOST:
        tell_unit_lost(f, a);
        break;
    case SCHED_LIAR:
        verify_liar(f, a);
        break;
    }
}

static void on_sched_timer(uv_timer_t *timer)
{
    struct farm *f = timer->data;
    struct sched_event tick = {.type = SCHED_TICK};
    farm_feed(f, &tick);
}

static void arm_sched_timer(struct farm *f)
{
    if (f->stopping)
        return;
    uint64_t deadline = sched_deadline_ms(f->sched), now = uv_now(f->loop);
    if (deadline == UINT64_MAX)
        (void)uv_timer_stop(&f->sched_timer);
    else
        (void)uv_timer_start(&f->sched_timer, on_sched_timer, deadline > now ? deadline - now : 0,
                             0);
}

/* One event and all its actions. */
static void feed_one(struct farm *f, const struct sched_event *event)
{
    struct sched_action action;
    (void)sched_feed(f->sched, uv_now(f->loop), event);
    while (sched_next(f->sched, &action))
        act(f, &action);
    struct job *job = event->type == SCHED_JOB_REMOVE ? farm_job(f, event->job) : NULL;
    if (job)
        jobs_left_sched(job);
}

void farm_feed(struct farm *f, const struct sched_event *event)
{
    if (f->draining_actions) {
        if (!mem_grow((void **)&f->later, f->later_count, &f->later_capacity, sizeof *f->later)) {
            log_error("farm", "out of memory: event for the scheduler lost type=%d", event->type);
            return;
        }
        f->later[f->later_count++] = *event;
        return;
    }
    f->draining_actions = true;
    feed_one(f, event);
    f->answering = NULL; /* what follows is not about the result any more */
    for (size_t i = 0; i < f->later_count; i++) {
        struct sched_event next = f->later[i];
        feed_one(f, &next);
    }
    f->later_count = 0;
    f->draining_actions = false;
    arm_sched_timer(f);
    /* Numbers of leases must never be used again after a restart. */
    if (sched_epoch_next(f->sched) + EPOCHS_RESERVED / 2 > f->epoch_limit) {
        f->epoch_limit += EPOCHS_RESERVED;
        if (store_put_value(f->store, "epoch_limit", &f->epoch_limit, sizeof f->epoch_limit) !=
            ERR_OK)
            f->epoch_limit -= EPOCHS_RESERVED; /* the next event tries again */
    }
}

/* --- Time and store ------------------------------------------------------ */

static void on_settle(uv_prepare_t *prepare)
{
    struct farm *f = prepare->data;
    if (f->admit_due && !f->stopping)
        jobs_admit(f);
}

static void on_tick(uv_timer_t *timer)
{
    struct farm *f = timer->data;
    workers_tick(f);
    jobs_tick(f);
    job_plans_tick(f);
}

static void on_store(uv_async_t *async)
{
    struct farm *f = async->data;
    store_poll(f->store);
}

/* On the store thread. */
static void wake_loop(void *ctx)
{
    struct farm *f = ctx;
    (void)uv_async_send(&f->store_wake);
}

/* --- Start and stop ------------------------------------------------------ */

/* A value that is drawn at random once and kept. */
static enum err kept_random(struct farm *f, const char *key, uint64_t *out, bool *fresh)
{
    enum err e = store_load_value(f->store, key, out, sizeof *out);
    *fresh = e == ERR_NOT_FOUND;
    if (!*fresh)
        return e;
    return getrandom(out, sizeof *out, 0) == (ssize_t)sizeof *out ? ERR_OK : ERR_IO;
}

static enum err start_sched(struct farm *f, uint64_t seed)
{
    uint64_t first = 1;
    enum err e = store_load_value(f->store, "epoch_limit", &first, sizeof first);
    if (e != ERR_OK && e != ERR_NOT_FOUND)
        return e;
    f->epoch_limit = first + EPOCHS_RESERVED;
    struct sched_limits limits;
    sched_limits_init(&limits);
    limits.seed = seed;
    arena_init(&f->arena);
    return sched_new(&f->arena, &limits, first, &f->sched);
}

static enum err load_determinism(struct farm *f, const struct farm_options *o)
{
    if (o->determinism_pinned) {
        f->determinism = o->determinism;
        f->determinism_known = true;
        return ERR_OK;
    }
    enum err e = store_load_value(f->store, "determinism", f->determinism.bytes,
                                  sizeof f->determinism.bytes);
    f->determinism_known = e == ERR_OK;
    return e == ERR_NOT_FOUND ? ERR_OK : e;
}

/* What an earlier life left, before the store's thread runs. */
static enum err load(struct farm *f, const struct farm_options *o, bool *fresh)
{
    uint64_t seed = 0, ignored = 0;
    bool fresh_seed = false;
    TL_TRY(kept_random(f, "farm", &f->id, fresh));
    TL_TRY(kept_random(f, "seed", &seed, &fresh_seed));
    enum err e = store_load_value(f->store, "worker_next", &ignored, sizeof ignored);
    if (e != ERR_OK && e != ERR_NOT_FOUND)
        return e;
    f->worker_next = e == ERR_OK ? ignored : 1;
    TL_TRY(load_determinism(f, o));
    TL_TRY(start_sched(f, seed));
    TL_TRY(jobs_load(f));
    /* Before the first lease, or a kill would have its number given again. */
    TL_TRY(store_set_value(f->store, "epoch_limit", &f->epoch_limit, sizeof f->epoch_limit));
    TL_TRY(store_start(f->store, wake_loop, f));
    f->running = true;
    if (fresh_seed)
        TL_TRY(store_put_value(f->store, "seed", &seed, sizeof seed));
    return *fresh ? store_put_value(f->store, "farm", &f->id, sizeof f->id) : ERR_OK;
}

static void start_handles(struct farm *f)
{
    (void)uv_timer_init(f->loop, &f->sched_timer);
    (void)uv_timer_init(f->loop, &f->tick_timer);
    (void)uv_timer_init(f->loop, &f->cut_timer);
    (void)uv_prepare_init(f->loop, &f->settle);
    f->sched_timer.data = f;
    f->tick_timer.data = f;
    f->cut_timer.data = f;
    f->settle.data = f;
    f->store_wake.data = f;
    (void)uv_timer_start(&f->tick_timer, on_tick, TICK_MS, TICK_MS);
    (void)uv_prepare_start(&f->settle, on_settle);
    f->handles_open = 5;
}

enum err farm_start(struct farm *f, uv_loop_t *loop, const struct farm_options *o)
{
    *f = (struct farm){.loop = loop,
                       .token = o->token,
                       .tls = o->tls,
                       .retention_s = o->retention_s,
                       .keep_lost_s = o->keep_lost_s,
                       .started_ms = uv_now(loop)};
    enum err e = store_open(o->data_dir, &f->store);
    if (e != ERR_OK) {
        log_error("master", "cannot use data folder=%s error=\"%s\"", o->data_dir,
                  e == ERR_STATE ? "another master uses it" : file_folder_why(o->data_dir, e));
        return e;
    }
    uint64_t epoch = 0;
    bool fresh = false;
    if (getrandom(&epoch, sizeof epoch, 0) != (ssize_t)sizeof epoch)
        return ERR_IO;
    TL_TRY(events_new(epoch >> 32, &f->events));
    TL_TRY(chunks_open(loop, o->data_dir, &f->chunks));
    if (uv_async_init(loop, &f->store_wake, on_store) != 0)
        return ERR_IO;
    start_handles(f);
    e = load(f, o, &fresh);
    if (e != ERR_OK) {
        log_error("master", "cannot read data folder=%s error=\"%s\"", o->data_dir, err_text(e));
        return e;
    }
    TL_TRY(transport_new(loop, &f->transport));
    return workers_listen(f, o->listen, o->listen_socket);
}

static void on_handle_closed(uv_handle_t *handle)
{
    struct farm *f = handle->data;
    if (--f->handles_open > 0)
        return;
    if (f->stopped)
        f->stopped(f->stopped_ctx);
}

static void close_handles(struct farm *f)
{
    uv_close((uv_handle_t *)&f->sched_timer, on_handle_closed);
    uv_close((uv_handle_t *)&f->tick_timer, on_handle_closed);
    uv_close((uv_handle_t *)&f->cut_timer, on_handle_closed);
    uv_close((uv_handle_t *)&f->settle, on_handle_closed);
    uv_close((uv_handle_t *)&f->store_wake, on_handle_closed);
}

/* Connections are gone: what they handed over is stored, then the rest is closed. */
static void on_transport_closed(void *ctx)
{
    struct farm *f = ctx;
    f->transport = NULL;
    close_handles(f);
}

/* Workers had their moment to read why. */
static void on_stop_timer(uv_timer_t *timer)
{
    struct farm *f = timer->data;
    transport_close(f->transport, on_transport_closed, f);
}

void farm_stop(struct farm *f, void (*done)(void *ctx), void *ctx)
{
    f->stopped = done;
    f->stopped_ctx = ctx;
    for (size_t i = 0; f->running && i < f->job_count; i++) {
        struct job *job = f->jobs[i];
        if (job->film && job->journal_bytes > 0)
            job_checkpoint(f, job);
        if (!job_state_ended(job->rec.state) && !job->unstored)
            jobs_store_record(f, job);
    }
    f->stopping = true;
    if (f->transport) {
        workers_stop(f);
        (void)uv_timer_start(&f->sched_timer, on_stop_timer, STOP_MS, 0);
    } else if (f->handles_open > 0) {
        close_handles(f);
    } else if (done) {
        done(ctx);
    }
}

void farm_release(struct farm *f)
{
    f->stopping = true;
    store_close(f->store);
    workers_release(f);
    jobs_release(f);
    chunks_close(f->chunks);
    events_free(f->events);
    arena_release(&f->arena);
    mem_free(f->later);
    mem_free(f->pasts);
}
