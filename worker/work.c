#include "worker/work.h"

#include <inttypes.h>
#include <time.h>

#include "common/log.h"
#include "common/mem.h"
#include "proto/tile_codec.h"
#include "worker/job_table.h"

/* A master gives threads + LIMIT_HELD leases; the slack is for those it has revoked or written off
 * and that have not ended here. */
enum { LEASE_SLACK = 64, RESULT_BYTES_MAX = 256 << 20 };

/* Runs of a unit that end for lack of pictures; then all that are missing are fetched before the
 * next. */
enum { RUNS_IN_VAIN_MAX = 8 };

enum lease_state { LEASE_WAITING, LEASE_POOLED };

struct lease {
    struct pool_task task;
    struct work *work;
    struct worker_job *job;
    struct unit unit;
    uint64_t epoch;
    enum lease_state state;
    bool unwanted;
    atomic_bool stop;

    /* Written by the render thread, read by the loop in `done`. */
    enum err error;
    struct render_counters counters;
    uint64_t render_us;
    uint32_t raw_bytes;
    struct blob *body;
    uint32_t lacks[RENDER_LACKS_MAX]; /* what it needs to run again: numbers of scene_late.h */
    size_t lack_count;
    uint32_t runs_in_vain;
    TAILQ_ENTRY(lease) in_leases;
};

struct result {
    tilery_Result meta;
    struct blob *body;
    bool sent; /* on this connection */
    TAILQ_ENTRY(result) in_results;
};

struct work {
    struct work_options options;
    struct job_table *jobs;
    struct render_scratch **scratch; /* of each render thread */
    uint32_t thread_count;
    TAILQ_HEAD(, lease) leases;
    uint32_t lease_count;
    TAILQ_HEAD(, result) results;
    uint32_t result_count;
    uint64_t result_bytes;
    bool connected, draining;
    /* What the last Hello said it holds: a lease among it that has gone since is told of. */
    tilery_Held told[LIMIT_HELD_TOLD];
    uint32_t told_count;
};

/* --- Results ------------------------------------------------------------------------ */

static void free_result(struct work *w, struct result *r)
{
    TAILQ_REMOVE(&w->results, r, in_results);
    w->result_count--;
    w->result_bytes -= blob_bytes(r->body);
    blob_unref(r->body);
    mem_free(r);
}

void work_flush(struct work *w)
{
    if (!w->connected)
        return;
    struct result *r;
    TAILQ_FOREACH(r, &w->results, in_results)
    {
        if (r->sent)
            continue;
        struct message m = {.type = FRAME_RESULT, .result = r->meta};
        if (w->options.outlet.send(w->options.outlet.ctx, &m, r->body) != ERR_OK)
            return;
        r->sent = true;
    }
}

static void say_unit_failed(struct work *w, uint64_t job, uint64_t epoch, enum err error,
                            const char *text)
{
    log_warn("unit", "failed job=%" PRIu64 " epoch=%" PRIu64 " error=\"%s\"", job, epoch,
             err_text(error));
    struct message m = {.type = FRAME_UNIT_FAILED, .unit_failed = {.job = job, .epoch = epoch}};
    MESSAGE_TEXT(m.unit_failed.error, err_name(error));
    MESSAGE_TEXT(m.unit_failed.text, text);
    enum err ignored = w->options.outlet.send(w->options.outlet.ctx, &m, NULL);
    (void)ignored; /* without a connection it is told when there is one, by told_gone */
}

static bool keep_result(struct work *w, struct lease *lease)
{
    struct result *r = mem_calloc(1, sizeof *r);
    if (!r)
        return false;
    const struct render_counters *c = &lease->counters;
    bool black = c->nonfinite > 0;
    r->meta = (tilery_Result){.job = lease->job->id,
                              .cell_begin = lease->unit.cell_begin,
                              .cell_count = lease->unit.cell_count,
                              .block = lease->unit.block,
                              .epoch = lease->epoch,
                              .samples = c->samples,
                              .rays = c->rays,
                              .nonfinite = c->nonfinite,
                              .nonfinite_pixel = black ? c->nonfinite_pixel : 0,
                              .nonfinite_sample = black ? c->nonfinite_sample : 0,
                              .render_us = lease->render_us,
                              .raw_bytes = lease->raw_bytes};
    r->body = blob_ref(lease->body);
    TAILQ_INSERT_TAIL(&w->results, r, in_results);
    w->result_count++;
    w->result_bytes += blob_bytes(r->body);
    work_flush(w);
    return true;
}

/* --- Leases ------------------------------------------------------------------------- */

static void free_lease(struct lease *lease)
{
    struct work *w = lease->work;
    TAILQ_REMOVE(&w->leases, lease, in_leases);
    w->lease_count--;
    blob_unref(lease->body);
    job_table_release(w->jobs, lease->job);
    mem_free(lease);
}

static uint64_t now_us(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000 + (uint64_t)now.tv_nsec / 1000;
}

static void note_lacks(struct lease *lease, const struct render_scratch *scratch)
{
    const uint32_t *numbers;
    lease->lack_count = render_lacks(scratch, &numbers);
    for (size_t i = 0; i < lease->lack_count; i++)
        lease->lacks[i] = numbers[i];
}

static enum err render_and_encode(struct lease *lease, struct render_scratch *scratch, float *rgb,
                                  size_t value_count)
{
    const struct worker_job *job = lease->job;
    uint64_t begun = now_us();
    enum err e = render_unit(job->loaded.scene, &job->grid, lease->unit, scratch, &lease->stop, rgb,
                             &lease->counters);
    if (e == ERR_NOT_FOUND)
        note_lacks(lease, scratch);
    TL_TRY(e);
    lease->render_us = now_us() - begun;
    unsigned char *encoded;
    size_t encoded_bytes;
    TL_TRY(tile_codec_encode(rgb, value_count, &encoded, &encoded_bytes));
    lease->body = blob_new(encoded, encoded_bytes);
    if (!lease->body) {
        mem_free(encoded);
        return ERR_NOMEM;
    }
    return ERR_OK;
}

/* On a render thread. */
static void run_unit(struct pool_task *task, uint32_t thread)
{
    struct lease *lease = (struct lease *)task;
    size_t value_count =
        lease->job->grid.plane_count *
        (size_t)grid_pixels(&lease->job->grid, lease->unit.cell_begin, lease->unit.cell_count);
    lease->raw_bytes = (uint32_t)(value_count * sizeof(float));
    float *rgb = mem_alloc_array(value_count, sizeof *rgb);
    lease->error =
        rgb ? render_and_encode(lease, lease->work->scratch[thread], rgb, value_count) : ERR_NOMEM;
    mem_free(rgb);
}

static void feed_pool(struct work *w);

/* --- Late pictures -------------------------------------------------------------------- */

/* What the lease needs to run again is asked for, whoever asked before. */
static enum err bring_lacks(struct work *w, struct lease *lease)
{
    if (lease->runs_in_vain >= RUNS_IN_VAIN_MAX)
        return job_table_bring_all(w->jobs, lease->job);
    return job_table_bring(w->jobs, lease->job, lease->lacks, lease->lack_count);
}

static bool has_pictures(const struct lease *lease)
{
    const struct render_scene *scene = lease->job->loaded.scene;
    struct picture_need need;
    if (lease->runs_in_vain >= RUNS_IN_VAIN_MAX)
        return render_scene_late_count(scene) == 0;
    for (size_t i = 0; i < lease->lack_count; i++)
        if (render_scene_need(scene, lease->lacks[i], &need))
            return false;
    return true;
}

/* The unit met pictures that are not there: it waits for them and runs again. */
static enum err wait_for_pictures(struct work *w, struct lease *lease)
{
    lease->state = LEASE_WAITING;
    lease->runs_in_vain++;
    log_debug("unit", "lacks pictures job=%" PRIu64 " epoch=%" PRIu64 " count=%zu runs=%" PRIu32,
              lease->job->id, lease->epoch, lease->lack_count, lease->runs_in_vain);
    return bring_lacks(w, lease);
}

/* A job that asked for pictures is gone: leases of others that wait for the same ask for
 * themselves. No memory: their deadlines give them to others. */
static void bring_all_lacks(struct work *w)
{
    struct lease *lease;
    TAILQ_FOREACH(lease, &w->leases, in_leases)
    {
        if (lease->state != LEASE_WAITING || lease->lack_count == 0 ||
            lease->job->state != WORKER_JOB_READY)
            continue;
        enum err ignored = bring_lacks(w, lease);
        (void)ignored;
    }
}

static void done_unit(struct pool_task *task)
{
    struct lease *lease = (struct lease *)task;
    struct work *w = lease->work;
    bool heard = w->connected || !w->draining;
    if (!lease->unwanted && lease->error == ERR_NOT_FOUND && heard) {
        lease->error = wait_for_pictures(w, lease);
        if (lease->error == ERR_OK) {
            feed_pool(w);
            return;
        }
    }
    if (!lease->unwanted) {
        enum err e = lease->error;
        if (e == ERR_OK && !keep_result(w, lease))
            e = ERR_NOMEM;
        if (e != ERR_OK)
            say_unit_failed(w, lease->job->id, lease->epoch, e, err_text(e));
    }
    log_debug("unit", "done job=%" PRIu64 " epoch=%" PRIu64 " us=%" PRIu64 " unwanted=%d",
              lease->job->id, lease->epoch, lease->render_us, lease->unwanted);
    free_lease(lease);
    feed_pool(w);
    w->options.settled(w->options.ctx);
}

/* Hands over every lease whose scene is ready, unless too many results wait for the master, or
 * there is none, who may have given it to others. */
static void feed_pool(struct work *w)
{
    if (w->result_bytes > RESULT_BYTES_MAX || !w->connected)
        return;
    struct lease *lease;
    TAILQ_FOREACH(lease, &w->leases, in_leases)
    {
        if (lease->state != LEASE_WAITING || lease->job->state != WORKER_JOB_READY ||
            !has_pictures(lease))
            continue;
        lease->state = LEASE_POOLED;
        lease->task = (struct pool_task){.run = run_unit, .done = done_unit, .kind = POOL_RENDER};
        pool_submit(w->options.pool, &lease->task);
    }
}

/* Drops a lease that has not begun; with `stop`, also one that has: it ends soon, unheard. */
static void drop(struct lease *lease, bool stop)
{
    if (lease->state == LEASE_WAITING || pool_cancel(lease->work->options.pool, &lease->task)) {
        free_lease(lease);
    } else if (stop) {
        lease->unwanted = true;
        atomic_store(&lease->stop, true);
    }
}

/* Drops all leases, or those of one job. */
static void drop_all(struct work *w, const struct worker_job *job, bool stop)
{
    struct lease *lease, *next;
    for (lease = TAILQ_FIRST(&w->leases); lease; lease = next) {
        next = TAILQ_NEXT(lease, in_leases);
        if (!job || lease->job == job)
            drop(lease, stop);
    }
}

static void drop_results(struct work *w, const uint64_t *job)
{
    struct result *r, *next;
    for (r = TAILQ_FIRST(&w->results); r; r = next) {
        next = TAILQ_NEXT(r, in_results);
        if (!job || r->meta.job == *job)
            free_result(w, r);
    }
}

/* --- Messages ----------------------------------------------------------------------- */

static enum err on_lease(struct work *w, const tilery_Lease *m)
{
    if (w->draining)
        return ERR_OK;
    if (w->lease_count >= w->thread_count + LIMIT_HELD + LEASE_SLACK)
        return ERR_LIMIT;
    struct worker_job *job = job_table_find(w->jobs, m->job);
    struct unit unit = {
        .cell_begin = m->cell_begin, .cell_count = m->cell_count, .block = m->block};
    if (!job) {
        say_unit_failed(w, m->job, m->epoch, ERR_NOT_FOUND, "no such job on this worker");
        return ERR_OK;
    }
    if (job->state == WORKER_JOB_FAILED || job->state == WORKER_JOB_FAILING)
        return ERR_OK; /* JobFailed returns it */
    if (!grid_has_unit(&job->grid, &job->blocks, unit) ||
        job->grid.plane_count * grid_pixels(&job->grid, unit.cell_begin, unit.cell_count) >
            LIMIT_UNIT_VALUES) {
        say_unit_failed(w, m->job, m->epoch, ERR_INPUT, "no unit of this job");
        return ERR_OK;
    }
    struct lease *lease = mem_calloc(1, sizeof *lease);
    if (!lease)
        return ERR_NOMEM;
    job_table_hold(w->jobs, job);
    *lease = (struct lease){.work = w, .job = job, .unit = unit, .epoch = m->epoch};
    TAILQ_INSERT_TAIL(&w->leases, lease, in_leases);
    w->lease_count++;
    if (job->state == WORKER_JOB_FAILED)
        free_lease(lease);
    else
        feed_pool(w);
    return ERR_OK;
}

static void on_revoke(struct work *w, const tilery_Revoke *m)
{
    struct lease *lease;
    TAILQ_FOREACH(lease, &w->leases, in_leases)
    if (lease->epoch == m->epoch && !lease->unwanted)
        break;
    if (lease)
        drop(lease, true);
    struct result *r;
    TAILQ_FOREACH(r, &w->results, in_results)
    if (r->meta.epoch == m->epoch)
        break;
    if (r)
        free_result(w, r);
    feed_pool(w);
}

static void on_ack(struct work *w, const tilery_ResultAck *m)
{
    struct result *r;
    TAILQ_FOREACH(r, &w->results, in_results)
    if (r->meta.epoch == m->epoch && r->meta.job == m->job)
        break;
    if (r)
        free_result(w, r);
    work_flush(w);
    feed_pool(w);
}

static void on_job_end(struct work *w, uint64_t id)
{
    struct worker_job *job = job_table_find(w->jobs, id);
    drop_results(w, &id);
    if (!job)
        return;
    job->users++; /* its last lease must not free it under our hands */
    drop_all(w, job, true);
    job_table_end(w->jobs, job);
    job_table_release(w->jobs, job);
    bring_all_lacks(w);
    feed_pool(w);
}

static digest digest_from(const pb_byte_t bytes[DIGEST_BYTES])
{
    digest d;
    for (size_t i = 0; i < DIGEST_BYTES; i++)
        d.bytes[i] = bytes[i];
    return d;
}

enum err work_body_wanted(const struct work *w, const struct message *m, uint32_t body_bytes)
{
    if (m->type != FRAME_CHUNK_DATA)
        return ERR_CORRUPT;
    digest name = digest_from(m->chunk_data.sha256);
    return scene_fetcher_wants(job_table_loader(w->jobs), &name, m->chunk_data.raw_bytes,
                               body_bytes);
}

static enum err on_chunk(struct work *w, const tilery_ChunkData *m, unsigned char *body,
                         size_t body_bytes)
{
    digest name = digest_from(m->sha256);
    if (!body)
        return ERR_CORRUPT;
    scene_fetcher_chunk(job_table_loader(w->jobs), &name, body, body_bytes);
    return ERR_OK;
}

enum err work_message(struct work *w, const struct message *m, unsigned char *body,
                      size_t body_bytes)
{
    enum err e = ERR_OK;
    digest name;
    switch (m->type) {
    case FRAME_CHUNK_DATA:
        return on_chunk(w, &m->chunk_data, body, body_bytes);
    case FRAME_CHUNK_MISSING:
        name = digest_from(m->chunk_missing.sha256);
        e = scene_fetcher_missing(job_table_loader(w->jobs), &name);
        break;
    case FRAME_JOB_INFO:
        if (!w->draining)
            e = job_table_announce(w->jobs, &m->job_info);
        break;
    case FRAME_JOB_END:
        on_job_end(w, m->job_end.job);
        break;
    case FRAME_LEASE:
        e = on_lease(w, &m->lease);
        break;
    case FRAME_REVOKE:
        on_revoke(w, &m->revoke);
        break;
    case FRAME_RESULT_ACK:
        on_ack(w, &m->result_ack);
        break;
    default:
        e = ERR_CORRUPT;
    }
    mem_free(body);
    w->options.settled(w->options.ctx);
    return e;
}

/* --- Connections -------------------------------------------------------------------- */

static bool tell_held(struct work *w, uint64_t job, struct unit unit, uint64_t epoch,
                      tilery_HeldState state)
{
    if (w->told_count == LIMIT_HELD_TOLD)
        return false;
    w->told[w->told_count++] = (tilery_Held){.job = job,
                                             .cell_begin = unit.cell_begin,
                                             .cell_count = unit.cell_count,
                                             .block = unit.block,
                                             .epoch = epoch,
                                             .state = state};
    return true;
}

uint32_t work_held(struct work *w, tilery_Held held[LIMIT_HELD_TOLD])
{
    w->told_count = 0;
    struct result *r;
    TAILQ_FOREACH(r, &w->results, in_results)
    {
        struct unit unit = {r->meta.cell_begin, r->meta.cell_count, r->meta.block};
        (void)tell_held(w, r->meta.job, unit, r->meta.epoch, tilery_HELD_RESULT);
    }
    struct lease *lease, *next;
    TAILQ_FOREACH(lease, &w->leases, in_leases)
    if (lease->state == LEASE_POOLED && !lease->unwanted)
        (void)tell_held(w, lease->job->id, lease->unit, lease->epoch, tilery_HELD_BEGUN);
    for (lease = TAILQ_FIRST(&w->leases); lease; lease = next) {
        next = TAILQ_NEXT(lease, in_leases);
        if (lease->state == LEASE_WAITING &&
            !tell_held(w, lease->job->id, lease->unit, lease->epoch, tilery_HELD_WAITING))
            free_lease(lease); /* the master cannot know of it */
    }
    for (uint32_t i = 0; i < w->told_count; i++)
        held[i] = w->told[i];
    return w->told_count;
}

static bool holds(const struct work *w, uint64_t epoch)
{
    const struct lease *lease;
    TAILQ_FOREACH(lease, &w->leases, in_leases)
    if (lease->epoch == epoch && !lease->unwanted)
        return true;
    const struct result *r;
    TAILQ_FOREACH(r, &w->results, in_results)
    if (r->meta.epoch == epoch)
        return true;
    return false;
}

/* What has failed or was dropped between Hello and Welcome must not be waited for. */
static void told_gone(struct work *w)
{
    for (uint32_t i = 0; i < w->told_count; i++)
        if (!holds(w, w->told[i].epoch))
            say_unit_failed(w, w->told[i].job, w->told[i].epoch, ERR_CANCELLED,
                            "given up while there was no connection");
    w->told_count = 0;
}

void work_connected(struct work *w, bool same_farm)
{
    w->connected = true;
    if (!same_farm) {
        drop_all(w, NULL, true);
        drop_results(w, NULL);
        job_table_forget(w->jobs);
        w->told_count = 0;
    }
    told_gone(w);
    struct result *r;
    TAILQ_FOREACH(r, &w->results, in_results)
    r->sent = false;
    work_flush(w);
    scene_fetcher_connected(job_table_loader(w->jobs));
    feed_pool(w);
}

/* Takes back from the threads what none has begun. */
static void unpool_all(struct work *w)
{
    struct lease *lease;
    TAILQ_FOREACH(lease, &w->leases, in_leases)
    if (lease->state == LEASE_POOLED && pool_cancel(w->options.pool, &lease->task))
        lease->state = LEASE_WAITING;
}

void work_disconnected(struct work *w)
{
    w->connected = false;
    if (w->draining)
        drop_all(w, NULL, false);
    else
        unpool_all(w);
    scene_fetcher_disconnected(job_table_loader(w->jobs));
}

void work_drain(struct work *w)
{
    w->draining = true;
    if (!w->connected)
        drop_all(w, NULL, false);
    struct lease *lease, *next;
    for (lease = TAILQ_FIRST(&w->leases); lease; lease = next) {
        next = TAILQ_NEXT(lease, in_leases);
        if (lease->state == LEASE_WAITING && lease->job->state != WORKER_JOB_READY)
            free_lease(lease);
    }
    job_table_stop_loading(w->jobs);
}

bool work_idle(const struct work *w)
{
    return w->lease_count == 0 && w->result_count == 0;
}

uint32_t work_result_count(const struct work *w)
{
    return w->result_count;
}

/* --- Jobs say ----------------------------------------------------------------------- */

static void on_job_ready(void *ctx, struct worker_job *job)
{
    (void)job;
    feed_pool(ctx);
}

static void on_job_failed(void *ctx, struct worker_job *job)
{
    struct work *w = ctx;
    drop_all(w, job, true);
    bring_all_lacks(w);
    w->options.settled(w->options.ctx);
}

/* --- Life --------------------------------------------------------------------------- */

void work_stop(struct work *w)
{
    struct lease *lease;
    TAILQ_FOREACH(lease, &w->leases, in_leases)
    atomic_store(&lease->stop, true);
}

void work_free(struct work *w)
{
    if (!w)
        return;
    while (!TAILQ_EMPTY(&w->leases))
        free_lease(TAILQ_FIRST(&w->leases));
    drop_results(w, NULL);
    job_table_free(w->jobs);
    for (uint32_t i = 0; w->scratch && i < w->thread_count; i++)
        render_scratch_free(w->scratch[i]);
    mem_free(w->scratch);
    mem_free(w);
}

enum err work_new(const struct work_options *options, struct work **out)
{
    struct work *w = mem_calloc(1, sizeof *w);
    if (!w)
        return ERR_NOMEM;
    w->options = *options;
    w->thread_count = pool_thread_count(options->pool);
    TAILQ_INIT(&w->leases);
    TAILQ_INIT(&w->results);
    w->scratch = mem_calloc(w->thread_count, sizeof(struct render_scratch *));
    enum err e = w->scratch ? ERR_OK : ERR_NOMEM;
    for (uint32_t i = 0; e == ERR_OK && i < w->thread_count; i++)
        e = render_scratch_new(&w->scratch[i]);
    struct job_table_handlers on = {.ready = on_job_ready, .failed = on_job_failed};
    if (e == ERR_OK)
        e = job_table_new(options->pool, options->cache, options->scene_bytes_max, options->eager,
                          &options->outlet, &on, w, &w->jobs);
    if (e != ERR_OK) {
        work_free(w);
        return e;
    }
    *out = w;
    return ERR_OK;
}
