/* A job's film: see farm.h. What takes long runs on the pool or the store thread, with
 * film_read_begin held; the loop goes on meanwhile. */
#include <inttypes.h>
#include <string.h>

#include "common/log.h"
#include "common/mem.h"
#include "common/parallel.h"
#include "master/farm.h"

enum { CHECKPOINT_AGAIN_MS = 5000 };           /* after one that failed: a film is not small */
#define FILM_CACHE_BYTES (UINT64_C(512) << 20) /* of finished jobs' films kept in memory */

enum err job_need_grid(struct job *job)
{
    if (job->grid_ready)
        return ERR_OK;
    TL_TRY(grid_init(&job->grid, &job->spec));
    job->grid_ready = true;
    return ERR_OK;
}

enum err job_need_provenance(struct job *job)
{
    if (job->provenance.cell_count > 0)
        return ERR_OK;
    return provenance_init(&job->provenance, job->grid.cell_count, job->blocks.count);
}

enum err job_need_film(struct job *job)
{
    if (job->film)
        return ERR_OK;
    TL_ASSERT(!job->has_stored);
    TL_TRY(job_need_grid(job));
    TL_TRY(job_need_provenance(job));
    TL_TRY(film_new(&job->grid, &job->blocks, &job->film));
    job_plan_apply(job, job->film);
    return ERR_OK;
}

enum err job_load_film(struct farm *f, struct job *job)
{
    TL_ASSERT(!job->film);
    TL_TRY(job_need_grid(job));
    struct job_loading loading = {.job = job};
    struct checkpoint *at = &loading.at;
    struct job_totals before = job->rec.totals;
    job->rec.totals = (struct job_totals){.nonfinite_pixel = UINT64_MAX};
    enum err e = store_load_film(f->store, job->rec.id, &job->grid, &job->blocks, results_replay,
                                 results_replay_note, &loading, &job->film, at, &job->sequence);
    if (e != ERR_OK) {
        job->rec.totals = before;
        return e;
    }
    job_plan_apply(job, job->film);
    /* The replay has added what lies behind the checkpoint. */
    struct job_totals *t = &job->rec.totals;
    job->provenance = at->provenance;
    t->units += at->totals.units;
    t->samples += at->totals.samples;
    t->rays += at->totals.rays;
    t->render_us += at->totals.render_us;
    t->nonfinite += at->totals.nonfinite;
    t->result_bytes += at->totals.result_bytes;
    if (at->totals.nonfinite_pixel != UINT64_MAX) {
        t->nonfinite_pixel = at->totals.nonfinite_pixel;
        t->nonfinite_sample = at->totals.nonfinite_sample;
    }
    job->settled = job->sequence;
    job->has_stored = true;
    return ERR_OK;
}

void job_film_hold(struct job *job)
{
    film_read_begin(job->film);
    job->film_users++;
}

void job_film_let_go(struct farm *f, struct job *job)
{
    TL_ASSERT(job->film_users > 0);
    film_read_end(job->film);
    job->film_users--;
    job->film_used_at = (uint64_t)farm_now_ms(f);
    job_pictures_start(f);
}

/* --- Checkpoint --------------------------------------------------------- */

/* A job as the context of what outlives the call; the job may not. */
struct job_ref {
    struct farm *farm;
    uint64_t job;
    uint64_t journal_bytes;
};

static void checkpoint_done(void *ctx, enum err e)
{
    struct job_ref *ref = ctx;
    struct farm *f = ref->farm;
    struct job *job = farm_job(f, ref->job);
    TL_ASSERT(job && job->checkpointing); /* film_users kept it */
    job_film_let_go(f, job);
    job->checkpointing = false;
    job->checkpoint_failed_ms = e == ERR_OK ? 0 : farm_now_ms(f);
    if (e == ERR_OK) {
        job->journal_bytes -= ref->journal_bytes;
        job_journal_limit(f, job);
        job->final_stored = job_state_ended(job->rec.state) && job->in_store == 0;
        log_debug("jobs", "checkpoint job=j%" PRIu64, job->rec.id);
    } else if (!job_state_ended(job->rec.state)) {
        jobs_disk_trouble(f, job, e);
    }
    mem_free(ref);
    if (!f->stopping)
        job_film_changed(f, job);
}

void job_checkpoint(struct farm *f, struct job *job)
{
    /* What another reader holds up is settled but would not be in the file: when that reader ends,
     * job_film_changed comes again. */
    if (job->checkpointing || !job->film || film_holds(job->film))
        return;
    if (job->checkpoint_failed_ms != 0 &&
        farm_now_ms(f) - job->checkpoint_failed_ms < CHECKPOINT_AGAIN_MS)
        return; /* jobs_tick comes again */
    struct job_ref *ref = mem_alloc(sizeof *ref);
    struct checkpoint c = {.job = job->rec.id,
                           .covered_sequence = job->settled,
                           .totals = job->rec.totals,
                           .stats = job->rec.stats};
    if (!ref)
        return; /* the next result tries again */
    *ref = (struct job_ref){f, job->rec.id, job->journal_bytes};
    /* Of a finished job nothing is compared any more. */
    if (job->rec.state != JOB_STATE_DONE && job->provenance.cell_count > 0 &&
        provenance_copy(&job->provenance, &c.provenance) != ERR_OK) {
        mem_free(ref);
        return;
    }
    job_film_hold(job);
    if (store_put_checkpoint(f->store, &c, job->film, checkpoint_done, ref) != ERR_OK) {
        job_film_let_go(f, job);
        provenance_release(&c.provenance);
        mem_free(ref);
        return;
    }
    job->checkpointing = true;
}

void job_journal_limit(struct farm *f, struct job *job)
{
    bool hold = job->journal_bytes + job->in_store_bytes >= FARM_HOLD_BYTES;
    if (hold == job->held)
        return;
    job->held = hold;
    log_debug("jobs", "%s job=j%" PRIu64, hold ? "held" : "let go", job->rec.id);
    struct sched_event event = {.type = SCHED_JOB_HOLD, .job = job->rec.id, .hold = hold};
    farm_feed(f, &event);
}

/* --- Reading back -------------------------------------------------------- */

struct fetch {
    uv_work_t request;
    struct farm *farm;
    uint64_t job;
    const struct grid *grid; /* the job's */
    struct job_blocks blocks;
    char *path; /* owned */
    struct film *film;
    struct checkpoint at;
    enum err result;
};

static void fetch_run(uv_work_t *request)
{
    struct fetch *w = request->data;
    w->result = checkpoint_read(w->path, w->job, w->grid, &w->blocks, &w->at, &w->film);
}

static void fetch_after(uv_work_t *request, int status)
{
    struct fetch *w = request->data;
    struct farm *f = w->farm;
    struct job *job = farm_job(f, w->job);
    TL_ASSERT(job && job->loading && !job->film);
    job->loading = false;
    job->film_users--;
    enum err e = status == 0 ? w->result : ERR_CANCELLED;
    if (e == ERR_OK) {
        job->film = w->film;
        provenance_release(&job->provenance);
        job->provenance = w->at.provenance;
        job->rec.totals = w->at.totals; /* of the same results as the film */
        /* A master that started after the job had ended does not know how far it had counted. */
        if (job->sequence < w->at.covered_sequence)
            job->sequence = job->settled = w->at.covered_sequence;
        job_plan_apply(job, job->film);
    } else if (!f->stopping)
        jobs_fail(f, job, e == ERR_NOMEM ? "out of memory" : "its checkpoint cannot be read");
    f->admit_due = true;
    mem_free(w->path);
    mem_free(w);
}

enum err job_fetch_film(struct farm *f, struct job *job)
{
    TL_ASSERT(!job->film && job->has_stored);
    if (job->loading)
        return ERR_OK;
    TL_TRY(job_need_grid(job));
    struct fetch *w = mem_calloc(1, sizeof *w);
    if (!w)
        return ERR_NOMEM;
    *w = (struct fetch){.farm = f,
                        .job = job->rec.id,
                        .grid = &job->grid,
                        .blocks = job->blocks,
                        .path = store_film_path(f->store, job->rec.id)};
    w->request.data = w;
    if (!w->path || uv_queue_work(f->loop, &w->request, fetch_run, fetch_after) != 0) {
        mem_free(w->path);
        mem_free(w);
        return ERR_NOMEM;
    }
    job->loading = true;
    job->film_users++;
    return ERR_OK;
}

/* --- The error so far ----------------------------------------------------- */

struct estimate {
    uv_work_t request;
    struct farm *farm;
    uint64_t job;
    const struct film *film;
    struct film_error error;
    uint64_t took_ns;
};

static void estimate_run(uv_work_t *request)
{
    struct estimate *w = request->data;
    uint64_t begin = uv_hrtime();
    film_error_estimate(w->film, &w->error);
    w->took_ns = uv_hrtime() - begin;
}

void job_error_put(struct job_stats *s, const struct film_error *e)
{
    s->error_known = e->known;
    s->relmse = e->relmse;
    s->relmse_low = e->relmse_low;
    s->relmse_high = e->relmse_high;
    s->mean_low = e->mean_low;
    s->mean_high = e->mean_high;
    s->effective = e->effective;
    s->worst_relmse = e->worst_relmse;
    s->worst_x = e->worst_x;
    s->worst_y = e->worst_y;
}

static void estimate_after(uv_work_t *request, int status)
{
    struct estimate *w = request->data;
    struct job *job = farm_job(w->farm, w->job);
    TL_ASSERT(job && job->estimating);
    job->estimating = false;
    job_film_let_go(w->farm, job);
    if (status == 0 && job->rec.state != JOB_STATE_DONE)
        job_error_put(&job->rec.stats, &w->error);
    job->estimated_ms = farm_now_ms(w->farm);
    job->estimate_took_ms = (int64_t)(w->took_ns / 1000000);
    if (!w->farm->stopping)
        job_film_changed(w->farm, job);
    mem_free(w);
}

void job_estimate(struct farm *f, struct job *job)
{
    enum { REST_MS = 2000, REST_FACTOR = 500 };
    int64_t rest_ms = REST_MS + REST_FACTOR * job->estimate_took_ms;
    if (!job->film || job->estimating || job->finishing || job->checkpointing ||
        job->estimated_count == film_present_count(job->film) ||
        farm_now_ms(f) - job->estimated_ms < rest_ms)
        return;
    struct estimate *w = mem_calloc(1, sizeof *w);
    if (!w)
        return;
    *w = (struct estimate){.farm = f, .job = job->rec.id, .film = job->film};
    w->request.data = w;
    job_film_hold(job);
    job->estimating = true;
    job->estimated_count = film_present_count(job->film);
    if (uv_queue_work(f->loop, &w->request, estimate_run, estimate_after) != 0) {
        job->estimating = false;
        job_film_let_go(f, job);
        mem_free(w);
    }
}

/* --- Finishing ---------------------------------------------------------- */

struct finish {
    uv_work_t request;
    struct farm *farm;
    uint64_t job;
    const struct film *film;
    uint64_t pixels;
    enum err result;
    digest image;
    int64_t finished_us;
    struct film_error error;
    uint64_t spp_min, spp_max;
    double spp_mean;
};

/* What the whole film says, in two turns: its hash, its error. */
static void finish_turn(void *arg, size_t i)
{
    struct finish *w = arg;
    if (i == 1) {
        film_error_estimate(w->film, &w->error);
        film_samples(w->film, &w->spp_min, &w->spp_mean, &w->spp_max);
        return;
    }
    float *rgb = mem_alloc_array(w->pixels, FILM_CHANNELS * sizeof(float));
    if (!rgb) {
        w->result = ERR_NOMEM;
        return;
    }
    film_picture(w->film, rgb);
    w->image = digest_of(rgb, w->pixels * FILM_CHANNELS * sizeof(float));
    mem_free(rgb);
    w->result = ERR_OK;
}

/* Whoever asked waits for this alone: on a farm of one machine its processors are idle now. */
static void finish_run(uv_work_t *request)
{
    parallel_for(2, finish_turn, request->data);
}

/* The row of the job once it is finished so. */
static void fill_row(const struct job *job, const struct finish *w, struct job_record *row)
{
    struct job_stats *s = &row->stats;
    row->state = JOB_STATE_DONE;
    row->finished_us = w->finished_us;
    row->image = w->image;
    row->has_image = true;
    row->note[0] = '\0';
    s->spp_min = w->spp_min;
    s->spp_mean = w->spp_mean;
    s->spp_max = w->spp_max;
    s->stopped_by = (double)(job->plan ? job->plan->end : JOB_END_SPP);
    job_error_put(s, &w->error);
    int64_t begin = job->rec.started_us, ready = job->ready_us ? job->ready_us : begin;
    int64_t last = job->last_result_us ? job->last_result_us : w->finished_us;
    s->total_s = (double)(w->finished_us - begin) / 1e6;
    s->render_s = (double)(last - ready) / 1e6;
    s->gather_s = (double)(w->finished_us - last) / 1e6;
}

void job_finish_put(const struct job *job, struct job_record *row)
{
    if (job->finish)
        fill_row(job, job->finish, row);
}

/* Nothing was taken out of the film since the picture was made of it: a liar may have been found.
 */
static bool still_complete(const struct job *job)
{
    return !job_state_ended(job->rec.state) && job->in_store == 0 && film_complete(job->film);
}

/* The end is on disk: it is told. */
static void finish_stored(void *ctx, enum err e)
{
    struct finish *w = ctx;
    struct farm *f = w->farm;
    struct job *job = farm_job(f, w->job);
    TL_ASSERT(job && job->finish == w); /* `finishing` kept it */
    job->finish = NULL;
    job->finishing = false;
    if (f->stopping) {
        mem_free(w);
        return;
    }
    if (e != ERR_OK) {
        jobs_disk_trouble(f, job, e);
    } else if (still_complete(job)) {
        fill_row(job, w, &job->rec);
        job->done_share = 1;
        provenance_release(&job->provenance);
        log_info("jobs", "done job=j%" PRIu64 " seconds=%.3f", job->rec.id, job->rec.stats.total_s);
        jobs_changed(f, job, true);
        job_checkpoint(f, job);
        job_films_evict(f);
    } else {
        jobs_store_record(f, job); /* over the row that says done */
    }
    f->admit_due = true;
    mem_free(w);
}

static void finish_after(uv_work_t *request, int status)
{
    struct finish *w = request->data;
    struct farm *f = w->farm;
    struct job *job = farm_job(f, w->job);
    TL_ASSERT(job && job->finishing);
    job_film_let_go(f, job);
    enum err e = status == 0 ? w->result : ERR_CANCELLED;
    if (e == ERR_OK && still_complete(job) && !f->stopping) {
        w->finished_us = farm_wall_us();
        job->finish = w;
        e = jobs_when_stored(f, job, finish_stored, w);
        if (e == ERR_OK)
            return;
        job->finish = NULL;
    }
    job->finishing = false;
    f->admit_due = true;
    if (e == ERR_NOMEM)
        jobs_fail(f, job, "out of memory while making the picture");
    mem_free(w);
}

static void start_finish(struct farm *f, struct job *job)
{
    struct finish *w = mem_calloc(1, sizeof *w);
    if (!w) {
        jobs_fail(f, job, "out of memory while making the picture");
        return;
    }
    *w = (struct finish){
        .farm = f,
        .job = job->rec.id,
        .film = job->film,
        .pixels = (uint64_t)job->spec.crop.width * job->spec.crop.height,
    };
    w->request.data = w;
    job_film_hold(job);
    job->finishing = true;
    if (uv_queue_work(f->loop, &w->request, finish_run, finish_after) != 0) {
        job_film_let_go(f, job);
        job->finishing = false;
        mem_free(w);
        jobs_fail(f, job, "out of memory while making the picture");
    }
}

void job_film_changed(struct farm *f, struct job *job)
{
    if (!job->film || f->stopping)
        return;
    if (job->plan && !job_state_ended(job->rec.state) && !job->finishing)
        job_plan_step(f, job);
    bool ended = job_state_ended(job->rec.state);
    if (!ended && job->sched_done && job->in_store == 0 && film_complete(job->film) &&
        !job->finishing) {
        start_finish(f, job);
        return;
    }
    if (job->journal_bytes >= FARM_CHECKPOINT_BYTES ||
        (ended && job->journal_bytes > 0 && job->in_store == 0))
        job_checkpoint(f, job);
}

void job_films_evict(struct farm *f)
{
    uint64_t total = 0;
    for (size_t i = 0; i < f->job_count; i++)
        if (f->jobs[i]->film && job_state_ended(f->jobs[i]->rec.state))
            total += film_bytes_of(&f->jobs[i]->spec);
    while (total > FILM_CACHE_BYTES) {
        struct job *oldest = NULL;
        for (size_t i = 0; i < f->job_count; i++) {
            struct job *job = f->jobs[i];
            if (job->film && job->final_stored && job->film_users == 0 && job->in_store == 0 &&
                !job->in_sched && (!oldest || job->film_used_at < oldest->film_used_at))
                oldest = job;
        }
        if (!oldest)
            return;
        total -= film_bytes_of(&oldest->spec);
        film_free(oldest->film);
        oldest->film = NULL;
        provenance_release(&oldest->provenance);
        if (oldest->plan)
            continue; /* its report tells the plan by the grid */
        grid_release(&oldest->grid);
        oldest->grid_ready = false;
    }
}
