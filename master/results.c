/* A result's way: see farm.h. What a worker says is checked here before anything believes it. */
#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "common/log.h"
#include "common/mem.h"
#include "master/farm.h"
#include "proto/tile_codec.h"

/* One result from its arrival until it is acknowledged. */
struct result {
    uv_work_t request;
    struct farm *farm;
    uint64_t worker;
    struct journal_result record;
    unsigned char *body;   /* owned until it is handed to the store */
    float *values;         /* owned until it is handed to the film */
    uint64_t *cell_hash;   /* owned; per cell of the unit */
    uint32_t *cell_pixels; /* owned */
    uint64_t pixels;
    uint32_t planes;
    uint64_t hash;
    enum err error;
    const char *what;   /* is wrong with it */
    uint32_t runs_open; /* handed to the store and not answered */
    bool answered;      /* the scheduler has said all */
    bool failed;        /* the store would not take a part */
};

static void result_free(struct result *r)
{
    mem_free(r->body);
    mem_free(r->values);
    mem_free(r->cell_hash);
    mem_free(r->cell_pixels);
    mem_free(r);
}

/* Whatever became of the result, its worker may forget it. */
static void acknowledge(struct farm *f, uint64_t worker, const struct journal_result *record)
{
    struct message m = {.type = FRAME_RESULT_ACK};
    m.result_ack.job = record->job;
    m.result_ack.epoch = record->epoch;
    workers_send(f, worker, &m);
}

/* Acknowledges and frees the result once nothing of it is under way. */
static void settle(struct result *r)
{
    if (!r->answered || r->runs_open > 0)
        return;
    if (!r->failed)
        acknowledge(r->farm, r->worker, &r->record);
    result_free(r);
}

/* --- Decoding, on the pool or the loop ---------------------------------- */

/* A hash of the bits of one cell of a run of `pixels`, which begins at pixel `first`. */
static uint64_t hash_cell(const float *values, uint32_t planes, uint64_t pixels, uint64_t first,
                          uint64_t cell_pixels)
{
    struct digest_ctx c;
    if (digest_begin(&c) != ERR_OK)
        return 0; /* not known: never compared */
    for (uint64_t plane = 0; plane < planes; plane++)
        digest_add(&c, values + plane * pixels + first, cell_pixels * sizeof(float));
    digest d = digest_end(&c);
    uint64_t hash;
    memcpy(&hash, d.bytes, sizeof hash);
    return hash | 1; /* 0 means: not known */
}

static void decode(struct result *r)
{
    size_t value_count = (size_t)r->pixels * r->planes;
    r->error = tile_codec_decode(r->body, r->record.body_bytes, r->values, value_count);
    if (r->error != ERR_OK) {
        r->what = "pixels that do not decode";
        return;
    }
    for (size_t i = 0; i < value_count; i++)
        if (!isfinite(r->values[i])) {
            r->error = ERR_CORRUPT;
            r->what = "a pixel that is not finite";
            return;
        }
    uint64_t first = 0;
    for (uint32_t i = 0; i < r->record.unit.cell_count; i++) {
        r->cell_hash[i] = hash_cell(r->values, r->planes, r->pixels, first, r->cell_pixels[i]);
        r->hash = provenance_fold(r->hash, r->cell_hash[i]);
        first += r->cell_pixels[i];
    }
}

static void decode_run(uv_work_t *request)
{
    decode(request->data);
}

/* --- Checking ----------------------------------------------------------- */

static void refuse(struct farm *f, uint64_t worker, const struct journal_result *record,
                   const char *what)
{
    struct job *job = farm_job(f, record->job);
    f->counters.results_refused++;
    log_warn("results", "refused worker=w%" PRIu64 " job=j%" PRIu64 " what=\"%s\"", worker,
             record->job, what);
    if (job) {
        job->rec.stats.rejected++;
        jobs_log(f, job, "result of w%" PRIu64 " refused: %s", worker, what);
    }
    struct sched_event event = {
        .type = SCHED_UNIT_FAILED, .worker = worker, .job = record->job, .epoch = record->epoch};
    farm_feed(f, &event);
    acknowledge(f, worker, record);
}

/* Counters that no honest worker can give. */
static const char *implausible(const struct job *job, const struct journal_result *r,
                               uint64_t pixels)
{
    struct job_block block = job_block_at(&job->blocks, r->unit.block);
    if (r->samples != pixels * block.count)
        return "a number of samples that is not the unit's";
    if (r->raw_bytes != pixels * job->grid.plane_count * sizeof(float))
        return "a size that is not the unit's";
    if (r->nonfinite > r->samples)
        return "more bad samples than samples";
    if (r->nonfinite > 0 && (r->nonfinite_pixel >= (uint64_t)job->spec.width * job->spec.height ||
                             r->nonfinite_sample >= job->spec.spp))
        return "a bad sample outside the picture";
    return NULL;
}

static void take_decoded(struct result *r)
{
    struct farm *f = r->farm;
    if (r->error != ERR_OK || f->stopping) {
        if (!f->stopping)
            refuse(f, r->worker, &r->record, r->what);
        result_free(r);
        return;
    }
    struct worker *w = farm_worker(f, r->worker);
    f->counters.results++;
    f->counters.samples += r->record.samples;
    f->counters.rays += r->record.rays;
    struct job *job = farm_job(f, r->record.job);
    if (job)
        rate_add(&job->rate, farm_now_ms(f), r->record.rays);
    if (w)
        w->rays += r->record.rays;
    if (w && r->record.render_us > 0) {
        double speed = (double)r->record.rays * 1e6 / (double)r->record.render_us * w->threads;
        w->speed_rays_s = w->speed_rays_s > 0 ? 0.8 * w->speed_rays_s + 0.2 * speed : speed;
    }
    struct sched_event event = {.type = SCHED_RESULT,
                                .worker = r->worker,
                                .job = r->record.job,
                                .result = {.unit = r->record.unit,
                                           .epoch = r->record.epoch,
                                           .samples = r->record.samples,
                                           .render_us = r->record.render_us,
                                           .digest = r->hash}};
    TL_ASSERT(!f->draining_actions);
    f->answering = r;
    farm_feed(f, &event);
    r->answered = true;
    settle(r);
}

static void decode_after(uv_work_t *request, int status)
{
    struct result *r = request->data;
    if (status != 0)
        r->error = ERR_CANCELLED;
    take_decoded(r);
}

/* Memory for a unit that lies in the grid. */
static struct result *result_new(struct farm *f, const struct job *job, uint64_t worker,
                                 const struct journal_result *record)
{
    struct result *r = mem_calloc(1, sizeof *r);
    if (!r)
        return NULL;
    r->request.data = r;
    r->farm = f;
    r->worker = worker;
    r->record = *record;
    r->planes = job->grid.plane_count;
    r->cell_hash = mem_calloc(record->unit.cell_count, sizeof *r->cell_hash);
    r->cell_pixels = mem_calloc(record->unit.cell_count, sizeof *r->cell_pixels);
    if (r->cell_hash && r->cell_pixels) {
        for (uint32_t i = 0; i < record->unit.cell_count; i++) {
            struct grid_rect rect = grid_cell(&job->grid, record->unit.cell_begin + i);
            r->cell_pixels[i] = rect.width * rect.height;
            r->pixels += r->cell_pixels[i];
        }
        r->values = mem_alloc_array((size_t)r->pixels, r->planes * sizeof(float));
    }
    if (!r->values) {
        result_free(r);
        return NULL;
    }
    return r;
}

static struct journal_result record_of(const struct worker *w, const tilery_Result *m,
                                       size_t body_bytes)
{
    return (struct journal_result){
        .job = m->job,
        .unit = {m->cell_begin, m->cell_count, m->block},
        .worker = (uint32_t)w->id,
        .epoch = m->epoch,
        .samples = m->samples,
        .rays = m->rays,
        .nonfinite = m->nonfinite,
        .nonfinite_pixel = m->nonfinite ? m->nonfinite_pixel : UINT64_MAX,
        .nonfinite_sample = m->nonfinite_sample,
        .render_us = m->render_us,
        .raw_bytes = m->raw_bytes,
        .body_bytes = (uint32_t)body_bytes,
    };
}

/* True for a job that has ended and of which nothing is kept that a result could be held against: a
 * worker that was away did not know. */
static bool is_gone(const struct farm *f, const struct job *job, uint64_t id)
{
    return job ? job_state_ended(job->rec.state) && !job->grid_ready : id > 0 && id < f->job_next;
}

void results_take(struct farm *f, struct worker *w, const tilery_Result *m, unsigned char *body,
                  size_t body_bytes)
{
    struct journal_result record = record_of(w, m, body_bytes);
    struct job *job = farm_job(f, record.job);
    f->counters.result_bytes += body_bytes;
    if (is_gone(f, job, record.job)) {
        mem_free(body);
        acknowledge(f, w->id, &record);
        return;
    }
    const char *what = NULL;
    if (!job || !job->grid_ready)
        what = "no such job is being rendered";
    else if (body_bytes > JOURNAL_BODY_BYTES_MAX ||
             !grid_has_unit(&job->grid, &job->blocks, record.unit))
        what = "not a unit of this job";
    else
        what = implausible(job, &record,
                           grid_pixels(&job->grid, record.unit.cell_begin, record.unit.cell_count));
    struct result *r = what ? NULL : result_new(f, job, w->id, &record);
    if (!r) {
        mem_free(body);
        refuse(f, w->id, &record, what ? what : "out of memory");
        return;
    }
    job->rec.totals.result_bytes += body_bytes;
    r->body = body;
    if (record.raw_bytes <= FARM_INLINE_BYTES ||
        uv_queue_work(f->loop, &r->request, decode_run, decode_after) != 0) {
        decode(r);
        take_decoded(r);
    }
}

/* --- Storing ------------------------------------------------------------ */

/* An accepted run on its way to the disk. */
struct storing {
    struct result *result;
    struct journal_result record;
    float *values; /* owned */
};

static void add_totals(struct job *job, const struct journal_result *r)
{
    struct job_totals *t = &job->rec.totals;
    bool pictured = !job->plan || !job->plan->begun || job->plan->pilot == FILM_PILOT_KEPT ||
                    r->unit.block >= job->blocks.pilot;
    t->units++;
    t->samples += r->samples;
    t->rays += r->rays;
    t->render_us += r->render_us;
    if (!pictured)
        return;
    if (r->nonfinite > 0 && t->nonfinite_pixel == UINT64_MAX) {
        t->nonfinite_pixel = r->nonfinite_pixel;
        t->nonfinite_sample = r->nonfinite_sample;
    }
    t->nonfinite += r->nonfinite;
}

static void note_contributor(struct job *job, uint32_t worker)
{
    for (uint64_t i = 0; i < job->contributors; i++)
        if (job->seen[i] == worker)
            return;
    if (!mem_grow((void **)&job->seen, job->contributors, &job->seen_capacity, sizeof *job->seen))
        return;
    job->seen[job->contributors++] = worker;
    if (job->contributors > job->rec.stats.workers)
        job->rec.stats.workers = job->contributors;
}

static void on_stored(void *ctx, enum err e)
{
    struct storing *s = ctx;
    struct result *r = s->result;
    struct farm *f = r->farm;
    struct job *job = farm_job(f, s->record.job);
    const uint64_t bytes = JOURNAL_HEADER_BYTES + (uint64_t)s->record.body_bytes;
    TL_ASSERT(job && job->in_store > 0);
    job->in_store--;
    job->in_store_bytes -= bytes;
    job->settled = s->record.sequence;
    if (e == ERR_OK) {
        job->has_stored = true;
        job->journal_bytes += bytes;
        e = film_add(job->film, s->record.unit, s->values);
        if (e == ERR_OK) {
            s->values = NULL;
            job->last_result_us = farm_wall_us();
            if (job->rec.totals.units == 0)
                job->rec.stats.first_result_s =
                    (double)(job->last_result_us - job->rec.started_us) / 1e6;
            add_totals(job, &s->record);
            note_contributor(job, s->record.worker);
        } else {
            log_error("results", "stored result not added job=j%" PRIu64 " error=\"%s\"",
                      s->record.job, err_text(e));
        }
        if (e == ERR_NOMEM)
            jobs_fail(f, job, "out of memory");
    } else {
        r->failed = true;
        jobs_disk_trouble(f, job, e);
    }
    mem_free(s->values);
    mem_free(s);
    r->runs_open--;
    settle(r);
    if (f->stopping)
        return;
    jobs_changed(f, job, false);
    job_plan_more(f, job);
    job_film_changed(f, job);
    job_journal_limit(f, job);
    f->admit_due |= !job->in_sched;
}

/* Planes of a part of the unit's cells. */
static float *cut_pixels(const struct result *r, uint32_t skip, uint32_t count, uint64_t *pixels)
{
    uint64_t first = 0, length = 0;
    for (uint32_t i = 0; i < skip + count; i++)
        *(i < skip ? &first : &length) += r->cell_pixels[i];
    float *values = mem_alloc_array((size_t)length, r->planes * sizeof(float));
    for (uint64_t plane = 0; values && plane < r->planes; plane++)
        memcpy(values + plane * length, r->values + plane * r->pixels + first,
               length * sizeof(float));
    *pixels = length;
    return values;
}

/* The record of a run: the whole result's, or its share. */
static enum err cut_record(struct result *r, struct unit run, struct storing *s,
                           unsigned char **body)
{
    s->record = r->record;
    if (run.cell_count == r->record.unit.cell_count) {
        s->values = r->values;
        *body = r->body;
        r->values = NULL;
        r->body = NULL;
        return ERR_OK;
    }
    uint64_t pixels = 0;
    size_t bytes = 0;
    s->values = cut_pixels(r, run.cell_begin - r->record.unit.cell_begin, run.cell_count, &pixels);
    if (!s->values)
        return ERR_NOMEM;
    enum err e = tile_codec_encode(s->values, (size_t)pixels * r->planes, body, &bytes);
    if (e != ERR_OK) {
        mem_free(s->values);
        return e;
    }
    double share = (double)pixels / (double)r->pixels;
    s->record.unit = run;
    s->record.samples = r->record.samples / r->pixels * pixels;
    s->record.rays = (uint64_t)((double)r->record.rays * share);
    s->record.render_us = (uint64_t)((double)r->record.render_us * share);
    s->record.raw_bytes = (uint32_t)(pixels * r->planes * sizeof(float));
    s->record.body_bytes = (uint32_t)bytes;
    /* Bad samples are told once, with the first part. */
    r->record.nonfinite = 0;
    return ERR_OK;
}

void results_accept(struct farm *f, const struct sched_action *a)
{
    struct result *r = f->answering;
    struct job *job = farm_job(f, a->job);
    TL_ASSERT(r && job);
    if (!job->in_sched) { /* it failed over an earlier part of this result */
        r->failed = true;
        return;
    }
    struct storing *s = mem_calloc(1, sizeof *s);
    unsigned char *body = NULL;
    enum err e = s ? job_need_film(job) : ERR_NOMEM;
    if (e == ERR_OK)
        e = cut_record(r, a->unit, s, &body);
    if (e != ERR_OK) {
        mem_free(s);
        r->failed = true;
        jobs_fail(f, job, err_text(e));
        return;
    }
    provenance_note(&job->provenance, a->unit, r->record.worker,
                    r->cell_hash + (a->unit.cell_begin - r->record.unit.cell_begin));
    s->result = r;
    s->record.sequence = ++job->sequence;
    r->runs_open++;
    const uint64_t bytes = JOURNAL_HEADER_BYTES + (uint64_t)s->record.body_bytes;
    job->in_store++;
    job->in_store_bytes += bytes;
    e = store_put_result(f->store, &s->record, body, on_stored, s);
    if (e == ERR_OK) {
        job_journal_limit(f, job);
    } else {
        /* Nothing was queued, so no answer will come. */
        r->runs_open--;
        job->in_store--;
        job->in_store_bytes -= bytes;
        r->failed = true;
        mem_free(s->values);
        mem_free(s);
        jobs_fail(f, job, err_text(e));
    }
}

const uint64_t *results_answering(const struct farm *f, struct unit run, uint64_t *worker)
{
    const struct result *r = f->answering;
    TL_ASSERT(r && run.cell_begin >= r->record.unit.cell_begin);
    *worker = r->worker;
    return r->cell_hash + (run.cell_begin - r->record.unit.cell_begin);
}

/* --- Replaying ---------------------------------------------------------- */

/* Whose bits they are, as when they came. */
static enum err note_replayed(struct job *job, struct provenance *p, const struct journal_result *r,
                              const float *values, uint64_t pixels)
{
    if (p->cell_count == 0)
        TL_TRY(provenance_init(p, job->grid.cell_count, job->blocks.count));
    uint64_t first = 0;
    for (uint32_t i = 0; i < r->unit.cell_count; i++) {
        uint32_t cell = r->unit.cell_begin + i;
        uint64_t cell_pixels = grid_pixels(&job->grid, cell, 1);
        uint64_t hash = hash_cell(values, job->grid.plane_count, pixels, first, cell_pixels);
        provenance_note(p, (struct unit){cell, 1, r->unit.block}, r->worker, &hash);
        first += cell_pixels;
    }
    return ERR_OK;
}

enum err results_replay(void *ctx, struct film *film, const struct journal_result *r,
                        const unsigned char *body)
{
    struct job_loading *loading = ctx;
    struct job *job = loading->job;
    if (!grid_has_unit(&job->grid, &job->blocks, r->unit))
        return ERR_CORRUPT;
    if (job->plan && job->plan->begun && !film_planned(film))
        job_plan_apply(job, film); /* the checkpoint is of before the plan, the result may not be */
    uint64_t pixels = grid_pixels(&job->grid, r->unit.cell_begin, r->unit.cell_count);
    uint32_t planes = job->grid.plane_count;
    float *values = mem_alloc_array((size_t)pixels, planes * sizeof(float));
    if (!values)
        return ERR_NOMEM;
    enum err e = tile_codec_decode(body, r->body_bytes, values, (size_t)pixels * planes);
    if (e == ERR_OK)
        e = note_replayed(job, &loading->at.provenance, r, values, pixels);
    if (e == ERR_OK)
        e = film_add(film, r->unit, values);
    if (e != ERR_OK) {
        mem_free(values);
        return e;
    }
    add_totals(job, r);
    note_contributor(job, r->worker);
    job->rec.totals.result_bytes += r->body_bytes;
    return ERR_OK;
}

enum err results_replay_note(void *ctx, enum store_step_kind kind, struct unit unit)
{
    struct job_loading *loading = ctx;
    struct job *job = loading->job;
    struct provenance *p = &loading->at.provenance;
    if (!grid_has_unit(&job->grid, &job->blocks, unit))
        return ERR_CORRUPT;
    if (p->cell_count == 0)
        TL_TRY(provenance_init(p, job->grid.cell_count, job->blocks.count));
    if (kind == STORE_STEP_CHECK_OPENED)
        return provenance_open_check(p, unit);
    if (kind == STORE_STEP_CHECK_CLOSED)
        provenance_close_check(p, unit);
    else
        provenance_reset(p, unit.cell_begin, unit.cell_count);
    return ERR_OK;
}
