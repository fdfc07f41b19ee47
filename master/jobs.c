/* The table of jobs: see farm.h.
 *
 *            first lease            every sum in, picture made
 *   QUEUED -------------> RENDERING ---------------------------> DONE
 *     |  ^                  |   |  ^
 *     |  +---- resume ------+   |  | retry
 *     +---> PAUSED <--- pause --+  +--- FAILED, CANCELLED <--- from any that has not ended
 */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "common/log.h"
#include "common/mem.h"
#include "master/farm.h"

enum {
    SPEC_BYTES_MAX = sizeof((tilery_JobInfo *)0)->spec_json.bytes,
};

/* --- Finding ------------------------------------------------------------ */

/* Where it is in the table, or would be. */
static size_t index_of(const struct farm *f, uint64_t id)
{
    size_t low = 0, high = f->job_count;
    while (low < high) {
        size_t middle = (low + high) / 2;
        if (f->jobs[middle]->rec.id < id)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

struct job *farm_job(const struct farm *f, uint64_t id)
{
    size_t at = index_of(f, id);
    return at < f->job_count && f->jobs[at]->rec.id == id ? f->jobs[at] : NULL;
}

/* --- Storing ------------------------------------------------------------ */

/* One row on its way to the disk, and who wants to know. */
struct storing {
    struct farm *farm;
    uint64_t job;
    store_done *done;
    void *ctx;
};

static void record_stored(void *ctx, enum err e)
{
    struct storing *s = ctx;
    struct job *job = farm_job(s->farm, s->job);
    if (job && e != ERR_OK)
        job->record_dirty = true;
    if (job && !s->farm->stopping)
        jobs_changed(s->farm, job, true);
    if (s->done)
        s->done(s->ctx, e);
    mem_free(s);
}

static uint64_t count_sum(const struct job_stats *s)
{
    return s->retried + s->speculated + s->rejected + s->verified;
}

static enum err store_record(struct farm *f, struct job *job, store_done *done, void *ctx)
{
    struct storing *s = mem_alloc(sizeof *s);
    if (!s)
        return ERR_NOMEM;
    *s = (struct storing){f, job->rec.id, done, ctx};
    struct job_record record = job->rec;
    jobs_add_counts(f, job, &record.stats);
    job_finish_put(job, &record);
    job->counts_stored = count_sum(&record.stats);
    enum err e = store_put_job(f->store, &record, record_stored, s);
    if (e != ERR_OK)
        mem_free(s);
    else
        job->record_dirty = false;
    return e;
}

enum err jobs_when_stored(struct farm *f, struct job *job, store_done *done, void *ctx)
{
    return store_record(f, job, done, ctx); /* the store works in order */
}

void jobs_store_record(struct farm *f, struct job *job)
{
    if (store_record(f, job, NULL, NULL) != ERR_OK)
        job->record_dirty = true;
}

void jobs_keep_counts(struct farm *f)
{
    for (size_t i = 0; i < f->job_count; i++) {
        struct job *job = f->jobs[i];
        if (!job->in_sched)
            continue;
        struct job_stats now = job->rec.stats;
        jobs_add_counts(f, job, &now);
        if (count_sum(&now) != job->counts_stored)
            jobs_store_record(f, job);
    }
}

/* --- Making ------------------------------------------------------------- */

static void job_free(struct job *job)
{
    if (!job)
        return;
    mem_free(job->rec.spec_json);
    film_free(job->film);
    job_plan_free(job->plan);
    if (job->grid_ready)
        grid_release(&job->grid);
    mem_free(job->sched_memory);
    provenance_release(&job->provenance);
    mem_free(job->blame);
    mem_free(job->seen);
    mem_free(job);
}

static enum err add_job(struct farm *f, struct job *job)
{
    if (!mem_grow((void **)&f->jobs, f->job_count, &f->job_capacity, sizeof *f->jobs))
        return ERR_NOMEM;
    f->jobs[f->job_count++] = job;
    return ERR_OK;
}

static void remove_job(struct farm *f, size_t index)
{
    job_free(f->jobs[index]);
    f->job_count--;
    memmove(f->jobs + index, f->jobs + index + 1, (f->job_count - index) * sizeof *f->jobs);
}

/* Followers hear that it is gone. */
static void drop_job(struct farm *f, size_t index)
{
    uint64_t id = f->jobs[index]->rec.id;
    char text[64];
    (void)snprintf(text, sizeof text, "{\"jobs\":[\"j%" PRIu64 "\"]}", id);
    events_add(f->events, id, "gone", text);
    remove_job(f, index);
}

/* A submission's row is on disk, or cannot be: then there was no job. */
static void submission_stored(void *ctx, enum err e)
{
    struct storing *s = ctx;
    struct farm *f = s->farm;
    struct job *job = farm_job(f, s->job);
    TL_ASSERT(job && job->unstored); /* nothing else takes such a job away */
    job->unstored = false;
    if (e == ERR_OK && !f->stopping) {
        jobs_admit(f); /* so that the first report tells whether somebody will render it */
        jobs_changed(f, job, true);
    } else if (e != ERR_OK) {
        log_warn("jobs", "submission not stored job=j%" PRIu64 " error=\"%s\"", s->job,
                 err_text(e));
        /* What was put on its way for it meanwhile must not come back. */
        if (!f->stopping && store_delete_job(f->store, s->job) != ERR_OK)
            log_warn("jobs", "rests may stay job=j%" PRIu64, s->job);
        drop_job(f, index_of(f, s->job));
    }
    if (s->done)
        s->done(s->ctx, e);
    mem_free(s);
}

/* Puts the row of a new job on its way, and its key. */
static enum err store_submission(struct farm *f, struct job *job, const struct job_request *r,
                                 store_done *done, void *ctx)
{
    if (r->key)
        TL_TRY(job_keys_note(f, r->key, &r->body, job->rec.id, job->rec.created_us));
    struct storing *s = mem_alloc(sizeof *s);
    if (!s)
        return ERR_NOMEM;
    *s = (struct storing){f, job->rec.id, done, ctx};
    enum err e = store_put_new_job(f->store, &job->rec, r->key, &r->body, submission_stored, s);
    if (e != ERR_OK)
        mem_free(s);
    job->unstored = e == ERR_OK;
    return e;
}

enum err jobs_submit(struct farm *f, const struct job_request *r, store_done *done, void *ctx,
                     struct job **out)
{
    if (f->job_count >= FARM_JOBS_MAX ||
        film_bytes_of(r->spec) / 1024 > (uint64_t)FARM_PICTURE_BYTES_MAX)
        return ERR_LIMIT;
    struct job *job = mem_calloc(1, sizeof *job);
    if (!job)
        return ERR_NOMEM;
    job->rec = (struct job_record){.id = f->job_next,
                                   .state = JOB_STATE_QUEUED,
                                   .priority = r->priority,
                                   .shot = !r->is_frame ? 0
                                           : r->shot    ? r->shot
                                                        : f->job_next,
                                   .frame = r->frame,
                                   .package = r->package,
                                   .spec_json = job_spec_to_json(r->spec),
                                   .created_us = farm_wall_us(),
                                   .totals.nonfinite_pixel = UINT64_MAX};
    (void)snprintf(job->rec.name, sizeof job->rec.name, "%s", r->name);
    job->spec = *r->spec;
    job->blocks = job_spec_blocks(r->spec);
    enum err e = job->rec.spec_json ? ERR_OK : ERR_NOMEM;
    if (e == ERR_OK && strlen(job->rec.spec_json) > SPEC_BYTES_MAX)
        e = ERR_LIMIT;
    if (e == ERR_OK)
        e = job_plan_new(job, r->plan);
    if (e == ERR_OK && job->plan && job->plan->begun)
        e = job_plan_store(f, job);
    if (e == ERR_OK)
        e = add_job(f, job);
    if (e != ERR_OK) {
        job_free(job);
        return e;
    }
    f->job_next++;
    e = store_submission(f, job, r, done, ctx);
    if (e != ERR_OK) {
        remove_job(f, f->job_count - 1);
        return e;
    }
    log_info("jobs", "submitted job=j%" PRIu64 " size=%" PRIu32 "x%" PRIu32 " spp=%" PRIu64,
             job->rec.id, job->spec.width, job->spec.height, job->spec.spp);
    jobs_changed(f, job, true);
    *out = job;
    return ERR_OK;
}

/* --- The scheduler's news ------------------------------------------------ */

void jobs_started(struct farm *f, struct job *job)
{
    if (job->rec.state != JOB_STATE_QUEUED)
        return;
    job->rec.state = JOB_STATE_RENDERING;
    if (job->rec.started_us == 0)
        job->rec.started_us = farm_wall_us();
    jobs_store_record(f, job);
    jobs_changed(f, job, true);
}

void jobs_sched_done(struct farm *f, struct job *job)
{
    jobs_leave_sched(f, job);
    job->sched_done = true;
    job_film_changed(f, job);
}

/* Ends a job other than by finishing it. */
static void end_job(struct farm *f, struct job *job, enum job_state state, const char *note)
{
    jobs_leave_sched(f, job);
    job->rec.state = state;
    job->rec.finished_us = farm_wall_us();
    (void)snprintf(job->rec.note, sizeof job->rec.note, "%s", note);
    if (job->rec.started_us)
        job->rec.stats.total_s = (double)(job->rec.finished_us - job->rec.started_us) / 1e6;
    /* With nothing new in its film, what is on disk is its last. */
    job->final_stored = job->journal_bytes == 0 && job->in_store == 0;
    job_film_changed(f, job);
}

void jobs_fail(struct farm *f, struct job *job, const char *why)
{
    if (job_state_ended(job->rec.state))
        return;
    log_warn("jobs", "failed job=j%" PRIu64 " why=\"%s\"", job->rec.id, why);
    end_job(f, job, JOB_STATE_FAILED, why);
    jobs_log(f, job, "failed: %s", why);
    jobs_store_record(f, job);
    jobs_changed(f, job, true);
}

void jobs_sched_failed(struct farm *f, struct job *job, const char *why)
{
    jobs_fail(f, job, why);
}

void jobs_disk_trouble(struct farm *f, struct job *job, enum err e)
{
    if (job_state_ended(job->rec.state) || job->rec.state == JOB_STATE_PAUSED)
        return;
    jobs_leave_sched(f, job);
    job->rec.state = JOB_STATE_PAUSED;
    (void)snprintf(job->rec.note, sizeof job->rec.note,
                   "master: %s; make room, then resume: what is stored is kept", err_text(e));
    log_error("jobs", "paused job=j%" PRIu64 " error=\"%s\"", job->rec.id, err_text(e));
    jobs_log(f, job, "paused: the master's disk: %s", err_text(e));
    jobs_store_record(f, job);
    jobs_changed(f, job, true);
}

/* --- What people ask for ------------------------------------------------ */

static enum err ask_pause(struct farm *f, struct job *job)
{
    if (job->rec.state != JOB_STATE_QUEUED && job->rec.state != JOB_STATE_RENDERING)
        return ERR_STATE;
    struct sched_event event = {.type = SCHED_JOB_PAUSE, .job = job->rec.id};
    if (job->in_sched)
        farm_feed(f, &event);
    job->rec.state = JOB_STATE_PAUSED;
    return ERR_OK;
}

static enum err ask_queue(struct farm *f, struct job *job)
{
    if (job->rec.state == JOB_STATE_DONE || job->rec.state == JOB_STATE_QUEUED ||
        job->rec.state == JOB_STATE_RENDERING)
        return ERR_STATE;
    if (job->has_stored && !job->film)
        TL_TRY(job_fetch_film(f, job)); /* it had left memory */
    if (job_state_ended(job->rec.state))
        verify_forget_blame(f, job);
    job->rec.state = JOB_STATE_QUEUED;
    job->rec.note[0] = '\0';
    job->rec.finished_us = 0;
    job->final_stored = false;
    struct sched_event event = {.type = SCHED_JOB_RESUME, .job = job->rec.id};
    if (job->in_sched) {
        job->rec.state = job->rec.totals.units ? JOB_STATE_RENDERING : JOB_STATE_QUEUED;
        farm_feed(f, &event);
    }
    f->admit_due = true;
    return ERR_OK;
}

enum err jobs_set_state(struct farm *f, struct job *job, enum job_state to, store_done *done,
                        void *ctx)
{
    enum job_state from = job->rec.state;
    if (to == JOB_STATE_CANCELLED) {
        if (job_state_ended(from) || job->finishing)
            return ERR_STATE;
        end_job(f, job, JOB_STATE_CANCELLED, "");
    } else if (to == JOB_STATE_PAUSED) {
        TL_TRY(ask_pause(f, job));
    } else if (to == JOB_STATE_QUEUED) {
        TL_TRY(ask_queue(f, job));
    } else {
        return ERR_STATE;
    }
    jobs_log(f, job, "%s",
             to == JOB_STATE_CANCELLED ? "cancelled"
             : to == JOB_STATE_PAUSED  ? "paused"
             : job_state_ended(from)   ? "to be tried again"
                                       : "resumed");
    return store_record(f, job, done, ctx);
}

enum err jobs_set_priority(struct farm *f, struct job *job, int32_t priority, store_done *done,
                           void *ctx)
{
    if (job_state_ended(job->rec.state))
        return ERR_STATE;
    job->rec.priority = priority;
    f->admit_due |= !job->in_sched;
    struct sched_event event = {
        .type = SCHED_JOB_PRIORITY, .job = job->rec.id, .priority = priority};
    if (job->in_sched)
        farm_feed(f, &event);
    return store_record(f, job, done, ctx);
}

/* --- Loading ------------------------------------------------------------ */

/* The clock was set back while there was no master: what happened in the future did just now, in
 * the same distances. */
static void bring_back(struct job_record *rec)
{
    int64_t *const stamps[] = {&rec->created_us, &rec->started_us, &rec->finished_us};
    int64_t ahead_us = 0, now_us = farm_wall_us();
    for (int i = 0; i < 3; i++)
        if (*stamps[i] - now_us > ahead_us)
            ahead_us = *stamps[i] - now_us;
    for (int i = 0; i < 3; i++)
        if (*stamps[i] != 0)
            *stamps[i] -= ahead_us;
}

static enum err load_job(void *ctx, struct job_record *record)
{
    struct farm *f = ctx;
    struct job *job = mem_calloc(1, sizeof *job);
    if (!job || f->job_count >= FARM_JOBS_MAX) {
        mem_free(record->spec_json);
        mem_free(job);
        return job ? ERR_LIMIT : ERR_NOMEM;
    }
    job->rec = *record;
    bring_back(&job->rec);
    struct diag_list problems;
    diag_init(&problems);
    enum err e =
        job_spec_from_json(record->spec_json, strlen(record->spec_json), &job->spec, &problems);
    diag_release(&problems);
    if (e != ERR_OK) {
        log_error("jobs", "unreadable, skipped job=j%" PRIu64 " error=\"%s\"", record->id,
                  err_text(e));
        f->job_next = record->id + 1;
        job_free(job);
        return e == ERR_NOMEM ? e : ERR_OK;
    }
    job->blocks = job_spec_blocks(&job->spec);
    e = add_job(f, job);
    if (e != ERR_OK) {
        job_free(job);
        return e;
    }
    f->job_next = record->id + 1;
    return ERR_OK;
}

static enum err load_event(void *ctx, uint64_t job_id, int64_t at_us, const char *text)
{
    struct job *job = farm_job(ctx, job_id);
    struct job_event *event = &job->events[job->event_count++ % FARM_EVENTS_SHOWN];
    int64_t now_us = farm_wall_us();
    event->at_us = at_us < now_us ? at_us : now_us;
    (void)snprintf(event->text, sizeof event->text, "%s", text ? text : "");
    return ERR_OK;
}

static enum err load_key(void *ctx, const char *key, const digest *body, uint64_t job,
                         int64_t at_us)
{
    int64_t now_us = farm_wall_us();
    return job_keys_note(ctx, key, body, job, at_us < now_us ? at_us : now_us);
}

/* What an earlier life left of one job's film. */
static enum err load_film(struct farm *f, struct job *job)
{
    TL_TRY(job_plan_load(f, job));
    bool journal = store_has_journal(f->store, job->rec.id);
    job->has_stored = journal || store_has_checkpoint(f->store, job->rec.id);
    bool ended = job_state_ended(job->rec.state);
    if (ended && !journal) {
        job->final_stored = true;
        return ERR_OK;
    }
    if (!job->has_stored)
        return ERR_OK;
    TL_TRY(job_load_film(f, job));
    job->journal_bytes = journal ? FARM_CHECKPOINT_BYTES : 0; /* begin with a checkpoint */
    job->done_share = (double)film_present_count(job->film) / (double)film_total_count(job->film);
    log_info("jobs", "resumed job=j%" PRIu64 " state=%s done=%.3f", job->rec.id,
             job_state_names[job->rec.state], job->done_share);
    return ERR_OK;
}

enum err jobs_load(struct farm *f)
{
    f->job_next = 1;
    uint64_t next;
    enum err e = store_load_value(f->store, "job_next", &next, sizeof next);
    struct store_visitor v = {f,        load_job,          load_event,
                              load_key, verify_load_blame, verify_load_past};
    TL_TRY(store_load(f->store, &v));
    if (e == ERR_OK && next > f->job_next)
        f->job_next = next;
    for (size_t i = 0; i < f->job_count; i++) {
        struct job *job = f->jobs[i];
        TL_TRY(store_load_events(f->store, job->rec.id, FARM_EVENTS_SHOWN, &v));
        TL_TRY(load_film(f, job));
    }
    f->admit_due = true;
    return ERR_OK;
}

void jobs_release(struct farm *f)
{
    for (size_t i = 0; i < f->job_count; i++)
        job_free(f->jobs[i]);
    mem_free(f->jobs);
    job_keys_release(f);
}

/* --- Time --------------------------------------------------------------- */

/* Forgets a job that ended longer ago than the retention limit. */
static bool expire(struct farm *f, size_t index)
{
    struct job *job = f->jobs[index];
    int64_t age_us = farm_wall_us() - job->rec.finished_us;
    if (f->retention_s == 0 || !job_state_ended(job->rec.state) ||
        age_us < (int64_t)f->retention_s * 1000000 || job->film_users > 0 || job->in_store > 0 ||
        job->finishing || job->checkpointing || job->loading || job->unstored)
        return false;
    /* The highest id ever given is kept, so that none is given twice. */
    uint64_t next = f->job_next;
    if (store_put_value(f->store, "job_next", &next, sizeof next) != ERR_OK ||
        store_delete_job(f->store, job->rec.id) != ERR_OK)
        return false;
    log_info("jobs", "retention over, removed job=j%" PRIu64, job->rec.id);
    drop_job(f, index);
    return true;
}

void jobs_tick(struct farm *f)
{
    for (size_t i = f->job_count; i-- > 0;) {
        struct job *job = f->jobs[i];
        if (job->record_dirty)
            jobs_store_record(f, job);
        if (job->checkpoint_failed_ms != 0 || job->held)
            job_film_changed(f, job);
        job_news_tick(f, job);
        if (job->rec.state == JOB_STATE_RENDERING)
            job_estimate(f, job);
        (void)expire(f, i);
    }
    jobs_keep_counts(f);
    job_films_evict(f);
    sweep_chunks(f);
    if (f->admit_due)
        jobs_admit(f);
}
