#include "worker/job_table.h"

#include <inttypes.h>
#include <stdio.h>

#include "common/log.h"
#include "common/mem.h"

enum { TEXT_BYTES = 256 };

struct job_table {
    struct scene_fetcher *loader;
    struct outlet outlet;
    struct job_table_handlers handlers;
    void *ctx;
    uint64_t scene_bytes_max;
    uint64_t clock; /* counts uses */
    uint32_t count;
    TAILQ_HEAD(, worker_job) jobs;
};

/* --- Scenes and memory -------------------------------------------------------------- */

/* How many of the trees that wait for a ray have met one. */
static void log_trees(const struct worker_job *job)
{
    struct accel_stats stats;
    render_scene_stats(job->loaded.scene, &stats);
    if (stats.lazy_count > 0)
        log_info(
            "job", "trees met by rays job=%" PRIu64 " built=%" PRIu64 " of=%" PRIu64 " bytes=%zu",
            job->id, stats.lazy_built, stats.lazy_count, render_scene_bytes(job->loaded.scene));
    size_t late = render_scene_late_count(job->loaded.scene);
    if (late > 0)
        log_info("job", "pictures and pieces that nothing met job=%" PRIu64 " count=%zu of=%zu",
                 job->id, late, render_scene_late_end(job->loaded.scene));
}

/* What the scenes take now: trees may have been built since they were ready. A scene that jobs
 * share counts once. */
static uint64_t scene_bytes(const struct job_table *t)
{
    uint64_t bytes = 0;
    const struct worker_job *job;
    TAILQ_FOREACH(job, &t->jobs, in_jobs)
    if (job->loaded.scene)
        bytes += render_scene_bytes(job->loaded.scene) / render_scene_sharers(job->loaded.scene);
    return bytes;
}

static void drop_scene(struct job_table *t, struct worker_job *job)
{
    TL_ASSERT(job->state == WORKER_JOB_READY || job->state == WORKER_JOB_FAILING);
    scene_fetcher_forget(t->loader, job);
    (void)render_scene_free(job->loaded.scene); /* other jobs may share it */
    job->loaded = (struct loaded_scene){0};
    job->state = WORKER_JOB_IDLE;
}

static void free_job(struct job_table *t, struct worker_job *job)
{
    TL_ASSERT(job->users == 0);
    if (job->state == WORKER_JOB_LOADING)
        scene_fetcher_cancel(t->loader, job->id);
    if (job->loaded.scene)
        drop_scene(t, job);
    TAILQ_REMOVE(&t->jobs, job, in_jobs);
    t->count--;
    grid_release(&job->grid);
    mem_free(job);
}

/* True if `a` is to go before `b`. */
static bool goes_before(const struct worker_job *a, const struct worker_job *b)
{
    return a->ended != b->ended ? a->ended : a->used < b->used;
}

/* The unused job that is to go first; of those with a scene only when `ready`. */
static struct worker_job *first_to_go(struct job_table *t, bool ready)
{
    struct worker_job *job, *first = NULL;
    TAILQ_FOREACH(job, &t->jobs, in_jobs)
    {
        bool may = job->users == 0 && (ready ? job->state == WORKER_JOB_READY : job->ended);
        if (may && (!first || goes_before(job, first)))
            first = job;
    }
    return first;
}

static void make_room(struct job_table *t)
{
    while (scene_bytes(t) > t->scene_bytes_max) {
        struct worker_job *job = first_to_go(t, true);
        if (!job)
            return; /* all in use: the leases of this moment need them */
        log_info("job", "scene dropped, memory is wanted job=%" PRIu64 " bytes=%" PRIu64, job->id,
                 job->loaded.scene_bytes);
        if (job->ended || job->gone)
            free_job(t, job);
        else
            drop_scene(t, job);
    }
}

/* --- Telling the master --------------------------------------------------------------- */

static void say_ready(struct job_table *t, struct worker_job *job)
{
    struct message m = {.type = FRAME_JOB_READY,
                        .job_ready = {.job = job->id,
                                      .load_seconds = job->loaded.load_seconds,
                                      .build_seconds = job->loaded.build_seconds,
                                      .scene_bytes = job->loaded.scene_bytes,
                                      .received_bytes = job->loaded.received_bytes}};
    /* Said again when reconnected; the bytes count once. */
    if (t->outlet.send(t->outlet.ctx, &m, NULL) == ERR_OK)
        job->loaded.received_bytes = 0;
}

static void say_failed(struct job_table *t, uint64_t job, enum err error, const char *text)
{
    char line[TEXT_BYTES];
    (void)snprintf(line, sizeof line, "%s: %s", text, err_text(error));
    log_warn("job", "cannot be rendered here job=%" PRIu64 " error=\"%s\" text=\"%s\"", job,
             err_text(error), line);
    struct message m = {.type = FRAME_JOB_FAILED, .job_failed = {.job = job}};
    MESSAGE_TEXT(m.job_failed.error, err_name(error));
    MESSAGE_TEXT(m.job_failed.text, line);
    enum err ignored = t->outlet.send(t->outlet.ctx, &m, NULL);
    (void)ignored;
}

static void fail(struct job_table *t, struct worker_job *job, enum err error, const char *text)
{
    job->state = WORKER_JOB_FAILED;
    say_failed(t, job->id, error, text);
    t->handlers.failed(t->ctx, job);
}

/* --- Loading -------------------------------------------------------------------------- */

static struct worker_job *find_any(struct job_table *t, uint64_t id)
{
    struct worker_job *job;
    TAILQ_FOREACH(job, &t->jobs, in_jobs)
    if (job->id == id && !job->gone)
        return job;
    return NULL;
}

/* Gives the job the scene that another job on the same package has built, if it can use it. */
static bool share(struct job_table *t, struct worker_job *job)
{
    struct worker_job *other;
    TAILQ_FOREACH(other, &t->jobs, in_jobs)
    {
        struct render_scene *scene;
        if (other->state != WORKER_JOB_READY || !digest_equal(&other->package, &job->package) ||
            (job->eager && render_scene_late_count(other->loaded.scene) > 0) ||
            render_scene_share(other->loaded.scene, &job->spec, &scene) != ERR_OK)
            continue;
        job->loaded =
            (struct loaded_scene){.scene = scene, .scene_bytes = other->loaded.scene_bytes};
        job->state = WORKER_JOB_READY;
        job->used = ++t->clock;
        log_info("job", "scene shared job=%" PRIu64 " with=%" PRIu64, job->id, other->id);
        return true;
    }
    return false;
}

static void tell_ready(struct job_table *t, struct worker_job *job)
{
    say_ready(t, job);
    t->handlers.ready(t->ctx, job);
}

/* The scene just built serves those that wait for the same package, too. */
static void share_with_waiting(struct job_table *t)
{
    struct worker_job *job;
    TAILQ_FOREACH(job, &t->jobs, in_jobs)
    {
        if (job->state != WORKER_JOB_LOADING || job->gone || !share(t, job))
            continue;
        scene_fetcher_cancel(t->loader, job->id);
        tell_ready(t, job);
    }
}

static void load(struct job_table *t, struct worker_job *job)
{
    if (share(t, job)) {
        tell_ready(t, job);
        return;
    }
    enum err e = scene_fetcher_start(t->loader, job->id, &job->package, &job->spec, job->eager);
    job->state = WORKER_JOB_LOADING;
    if (e != ERR_OK)
        fail(t, job, e, "cannot start to load the scene");
}

static void on_finished(void *ctx, uint64_t id, enum err error, const char *text,
                        const struct loaded_scene *scene)
{
    struct job_table *t = ctx;
    struct worker_job *job = find_any(t, id);
    if (!job || job->state != WORKER_JOB_LOADING) {
        (void)render_scene_free(scene->scene);
        return;
    }
    if (error != ERR_OK) {
        fail(t, job, error, text);
        return;
    }
    job->state = WORKER_JOB_READY;
    job->loaded = *scene;
    job->used = ++t->clock;
    log_info(
        "job",
        "scene ready job=%" PRIu64 " load_s=%.3f build_s=%.3f bytes=%" PRIu64 " received=%" PRIu64,
        id, scene->load_seconds, scene->build_seconds, scene->scene_bytes, scene->received_bytes);
    job->users++; /* not the one to go */
    make_room(t);
    job->users--;
    tell_ready(t, job);
    share_with_waiting(t);
}

/* --- Late pictures ---------------------------------------------------------------------- */

static void finish_failing(struct job_table *t, struct worker_job *job)
{
    drop_scene(t, job);
    job->state = WORKER_JOB_FAILED;
    job->eager = true;
    if (!job->gone && !job->ended)
        say_failed(t, job->id, job->error, job->why);
}

/* A READY job cannot go on. Its scene goes, and the master hears of it, when the last of its units
 * has ended. */
static void fail_ready(struct job_table *t, struct worker_job *job, enum err error,
                       const char *text)
{
    job->state = WORKER_JOB_FAILING;
    job->error = error;
    (void)snprintf(job->why, sizeof job->why, "%s", text);
    scene_fetcher_forget(t->loader, job);
    job->users++;
    t->handlers.failed(t->ctx, job);
    job_table_release(t, job);
}

static void on_brought(void *ctx, void *owner, enum err error, const char *text,
                       uint64_t received_bytes)
{
    struct job_table *t = ctx;
    struct worker_job *job = owner;
    TL_ASSERT(job->state == WORKER_JOB_READY);
    job->loaded.received_bytes += received_bytes;
    if (error != ERR_OK) {
        fail_ready(t, job, error, text);
        return;
    }
    job->loaded.scene_bytes = render_scene_bytes(job->loaded.scene);
    job->users++;
    make_room(t);
    job->users--;
    /* Once for all that its units wait for: the master takes it that none waits any more. */
    if (scene_fetcher_bringing(t->loader, job) == 0 && !job->gone)
        say_ready(t, job);
    t->handlers.ready(t->ctx, job);
}

enum err job_table_bring(struct job_table *t, struct worker_job *job, const uint32_t *numbers,
                         size_t count)
{
    TL_ASSERT(job->state == WORKER_JOB_READY);
    for (size_t i = 0; i < count; i++)
        TL_TRY(scene_fetcher_bring(t->loader, job, job->loaded.scene, numbers[i]));
    return ERR_OK;
}

enum err job_table_bring_all(struct job_table *t, struct worker_job *job)
{
    TL_ASSERT(job->state == WORKER_JOB_READY);
    for (uint32_t i = 0; i < render_scene_late_end(job->loaded.scene); i++)
        TL_TRY(scene_fetcher_bring(t->loader, job, job->loaded.scene, i));
    return ERR_OK;
}

/* --- Requests to the master --------------------------------------------------------------- */

static bool on_request(void *ctx, const digest *chunk)
{
    struct job_table *t = ctx;
    struct message m = {.type = FRAME_CHUNK_REQUEST};
    for (size_t i = 0; i < DIGEST_BYTES; i++)
        m.chunk_request.sha256[i] = chunk->bytes[i];
    return t->outlet.send(t->outlet.ctx, &m, NULL) == ERR_OK;
}

/* --- Messages ------------------------------------------------------------------------- */

/* Reads and checks what a JobInfo asks for. */
static enum err new_job(struct job_table *t, const tilery_JobInfo *info, struct diag_list *problems,
                        struct worker_job **out)
{
    struct worker_job *job = mem_calloc(1, sizeof *job);
    if (!job)
        return ERR_NOMEM;
    job->id = info->job;
    for (size_t i = 0; i < DIGEST_BYTES; i++)
        job->package.bytes[i] = info->package[i];
    job->spec_digest = digest_of(info->spec_json.bytes, info->spec_json.size);
    enum err e = job_spec_from_json((const char *)info->spec_json.bytes, info->spec_json.size,
                                    &job->spec, problems);
    if (e == ERR_OK)
        e = grid_init(&job->grid, &job->spec);
    if (e != ERR_OK) {
        mem_free(job);
        return e;
    }
    job->blocks = job_spec_blocks(&job->spec);
    TAILQ_INSERT_TAIL(&t->jobs, job, in_jobs);
    t->count++;
    *out = job;
    return ERR_OK;
}

/* The same job as before: told of again after a reconnect, or revived after its end. */
static bool same_job(const struct worker_job *job, const tilery_JobInfo *info)
{
    digest spec = digest_of(info->spec_json.bytes, info->spec_json.size), package;
    for (size_t i = 0; i < DIGEST_BYTES; i++)
        package.bytes[i] = info->package[i];
    return digest_equal(&spec, &job->spec_digest) && digest_equal(&package, &job->package);
}

static void begone(struct job_table *t, struct worker_job *job)
{
    if (job->state == WORKER_JOB_LOADING) {
        scene_fetcher_cancel(t->loader, job->id);
        job->state = WORKER_JOB_IDLE;
    }
    job->gone = job->ended = true;
    if (job->users == 0)
        free_job(t, job);
}

enum err job_table_announce(struct job_table *t, const tilery_JobInfo *info)
{
    struct worker_job *job = find_any(t, info->job);
    if (job && !same_job(job, info)) {
        begone(t, job);
        job = NULL;
    }
    if (!job && t->count >= JOBS_MAX) {
        struct worker_job *oldest = first_to_go(t, false);
        if (!oldest)
            return ERR_LIMIT;
        free_job(t, oldest);
    }
    if (!job) {
        struct diag_list problems;
        diag_init(&problems);
        enum err e = new_job(t, info, &problems, &job);
        if (e != ERR_OK && e != ERR_NOMEM)
            say_failed(t, info->job, e,
                       problems.count > 0 ? problems.items[0].text
                                          : "the job's settings cannot be used");
        diag_release(&problems);
        if (e != ERR_OK)
            return e == ERR_NOMEM ? e : ERR_OK;
    }
    job->ended = false;
    job->used = ++t->clock;
    if (job->state == WORKER_JOB_READY)
        say_ready(t, job);
    else if (job->state != WORKER_JOB_LOADING && job->state != WORKER_JOB_FAILING)
        load(t, job); /* FAILING: JobFailed follows */
    return ERR_OK;
}

struct worker_job *job_table_find(struct job_table *t, uint64_t id)
{
    struct worker_job *job = find_any(t, id);
    return job && !job->ended ? job : NULL;
}

void job_table_end(struct job_table *t, struct worker_job *job)
{
    job->ended = true;
    if (job->state == WORKER_JOB_READY) {
        if (job->loaded.received_bytes > 0)
            say_ready(t, job); /* the last pictures */
        scene_fetcher_forget(t->loader, job);
        log_trees(job);
    }
    if (job->state == WORKER_JOB_LOADING) {
        scene_fetcher_cancel(t->loader, job->id);
        job->state = WORKER_JOB_IDLE;
    }
    if (job->users == 0 && job->state != WORKER_JOB_READY)
        free_job(t, job);
}

void job_table_hold(struct job_table *t, struct worker_job *job)
{
    job->users++;
    job->used = ++t->clock;
    if (job->state == WORKER_JOB_IDLE)
        load(t, job);
}

void job_table_release(struct job_table *t, struct worker_job *job)
{
    TL_ASSERT(job->users > 0);
    job->users--;
    if (job->users > 0)
        return;
    if (job->state == WORKER_JOB_FAILING)
        finish_failing(t, job);
    if (job->gone || (job->ended && job->state != WORKER_JOB_READY))
        free_job(t, job);
    else
        make_room(t);
}

void job_table_forget(struct job_table *t)
{
    struct worker_job *job, *next;
    for (job = TAILQ_FIRST(&t->jobs); job; job = next) {
        next = TAILQ_NEXT(job, in_jobs);
        if (!job->gone)
            begone(t, job);
    }
}

void job_table_stop_loading(struct job_table *t)
{
    struct worker_job *job;
    TAILQ_FOREACH(job, &t->jobs, in_jobs)
    {
        if (job->state != WORKER_JOB_LOADING)
            continue;
        scene_fetcher_cancel(t->loader, job->id);
        job->state = WORKER_JOB_IDLE;
    }
}

struct scene_fetcher *job_table_loader(struct job_table *t)
{
    return t->loader;
}

/* --- Life ------------------------------------------------------------------------------- */

enum err job_table_new(struct pool *pool, struct chunk_cache *cache, uint64_t scene_bytes_max,
                       bool eager, const struct outlet *outlet,
                       const struct job_table_handlers *handlers, void *ctx, struct job_table **out)
{
    struct job_table *t = mem_calloc(1, sizeof *t);
    if (!t)
        return ERR_NOMEM;
    t->outlet = *outlet;
    t->handlers = *handlers;
    t->ctx = ctx;
    t->scene_bytes_max = scene_bytes_max;
    TAILQ_INIT(&t->jobs);
    struct scene_fetcher_handlers on = {
        .request = on_request, .finished = on_finished, .brought = on_brought};
    enum err e = scene_fetcher_new(pool, cache, eager, &on, t, &t->loader);
    if (e != ERR_OK) {
        mem_free(t);
        return e;
    }
    *out = t;
    return ERR_OK;
}

void job_table_free(struct job_table *t)
{
    if (!t)
        return;
    struct worker_job *job;
    while ((job = TAILQ_FIRST(&t->jobs)) != NULL) {
        job->users = 0;
        if (job->state == WORKER_JOB_LOADING)
            job->state = WORKER_JOB_IDLE;
        free_job(t, job);
    }
    scene_fetcher_free(t->loader);
    mem_free(t);
}
