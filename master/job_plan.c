#include "master/job_plan.h"

#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "common/log.h"
#include "common/mem.h"
#include "master/allocate.h"
#include "master/claim.h"
#include "master/farm.h"

const char *const job_end_names[JOB_END_COUNT] = {
    [JOB_END_NONE] = "none",       [JOB_END_SPP] = "spp",   [JOB_END_ERROR] = "error",
    [JOB_END_MAX_SPP] = "max-spp", [JOB_END_TIME] = "time", [JOB_END_PLAN] = "plan",
    [JOB_END_PILOT] = "pilot",
};

/* --- Constants, with where they come from (docs/ERROR.md) ------------------ */

/* Of a time limit that a pilot may take and be dropped. */
static const double PILOT_SHARE = 0.12;
/* From stage to stage of a job with a time limit. */
static const double STAGE_GROWTH = 1.25;
static const double STAGE_FIRST_SPP = 8;
/* Kept for the last units and the picture: seconds, and of the last estimate's time. */
static const double RESERVE_S = 0.45, RESERVE_ESTIMATES = 1.5;

/* --- Life ---------------------------------------------------------------- */

enum { PLAN_VERSION = 1 };

/* As stored, followed by limits and shares. */
struct plan_head {
    uint32_t version, cell_count;
    uint8_t begun, sealed, pilot, end;
    uint32_t looks;
    double mean_spp, gain;
};
_Static_assert(sizeof(struct plan_head) == 32, "written as it lies");

static enum err plan_alloc(struct job *job)
{
    TL_TRY(job_need_grid(job));
    struct job_plan *p = mem_calloc(1, sizeof *p);
    if (!p)
        return ERR_NOMEM;
    uint32_t cells = job->grid.cell_count;
    p->limits = mem_alloc_array(cells, sizeof *p->limits);
    p->shares = mem_alloc_array(cells, sizeof *p->shares);
    if (!p->limits || !p->shares) {
        job_plan_free(p);
        return ERR_NOMEM;
    }
    for (uint32_t cell = 0; cell < cells; cell++) {
        p->limits[cell] = (uint16_t)job->blocks.pilot;
        p->shares[cell] = 1;
    }
    job->plan = p;
    return ERR_OK;
}

enum err job_plan_new(struct job *job, const struct sample_plan *given)
{
    if (job->spec.stop == JOB_STOP_SPP)
        return given ? ERR_INPUT : ERR_OK;
    TL_TRY(plan_alloc(job));
    if (job->spec.stop != JOB_STOP_PLAN)
        return given ? ERR_INPUT : ERR_OK;
    uint32_t x, y;
    if (!given || given->max_spp != job->spec.spp ||
        !sample_plan_limits(given, &job->grid, &job->blocks, job->plan->limits, &x, &y))
        return ERR_INPUT;
    job->plan->begun = job->plan->sealed = true;
    job->plan->pilot = given->pilot_kept ? FILM_PILOT_KEPT : FILM_PILOT_SKIPPED;
    job->plan->end = JOB_END_PLAN;
    return ERR_OK;
}

void job_plan_free(struct job_plan *p)
{
    if (!p)
        return;
    mem_free(p->limits);
    mem_free(p->shares);
    mem_free(p);
}

static void plan_key(const struct job *job, char out[32])
{
    (void)snprintf(out, 32, "plan.%" PRIu64, job->rec.id);
}

enum err job_plan_store(struct farm *f, struct job *job)
{
    const struct job_plan *p = job->plan;
    char key[32];
    struct buf b;
    uint32_t cells = job->grid.cell_count;
    struct plan_head head = {.version = PLAN_VERSION,
                             .cell_count = cells,
                             .begun = p->begun,
                             .sealed = p->sealed,
                             .pilot = (uint8_t)p->pilot,
                             .end = (uint8_t)p->end,
                             .looks = p->looks,
                             .mean_spp = p->mean_spp,
                             .gain = p->gain};
    plan_key(job, key);
    buf_init(&b);
    buf_put(&b, &head, sizeof head);
    buf_put(&b, p->limits, cells * sizeof *p->limits);
    buf_put(&b, p->shares, cells * sizeof *p->shares);
    enum err e = buf_status(&b);
    if (e == ERR_OK)
        e = store_put_value(f->store, key, b.data, b.bytes);
    buf_release(&b);
    return e;
}

static bool head_valid(const struct plan_head *h, uint32_t cells)
{
    return h->version == PLAN_VERSION && h->cell_count == cells && h->pilot <= FILM_PILOT_SKIPPED &&
           h->end < JOB_END_COUNT && h->sealed <= h->begun && h->begun <= 1 &&
           isfinite(h->mean_spp) && isfinite(h->gain);
}

static enum err plan_take(struct job *job, const unsigned char *data)
{
    struct job_plan *p = job->plan;
    uint32_t cells = job->grid.cell_count;
    struct plan_head head;
    memcpy(&head, data, sizeof head);
    if (!head_valid(&head, cells))
        return ERR_CORRUPT;
    memcpy(p->limits, data + sizeof head, cells * sizeof *p->limits);
    memcpy(p->shares, data + sizeof head + cells * sizeof *p->limits, cells * sizeof *p->shares);
    for (uint32_t cell = 0; cell < cells; cell++)
        if (p->limits[cell] == 0 || p->limits[cell] > job->blocks.count ||
            !(p->shares[cell] > 0 && isfinite(p->shares[cell])))
            return ERR_CORRUPT;
    p->begun = head.begun;
    p->sealed = head.sealed;
    p->pilot = (enum film_pilot)head.pilot;
    p->end = (enum job_end)head.end;
    p->looks = head.looks;
    p->mean_spp = head.mean_spp;
    p->gain = head.gain;
    return ERR_OK;
}

enum err job_plan_load(struct farm *f, struct job *job)
{
    if (job->spec.stop == JOB_STOP_SPP)
        return ERR_OK;
    TL_TRY(plan_alloc(job));
    size_t bytes = sizeof(struct plan_head) +
                   job->grid.cell_count * (sizeof *job->plan->limits + sizeof *job->plan->shares);
    unsigned char *data = mem_alloc(bytes);
    char key[32];
    if (!data)
        return ERR_NOMEM;
    plan_key(job, key);
    enum err e = store_load_value(f->store, key, data, bytes);
    if (e == ERR_OK)
        e = plan_take(job, data);
    mem_free(data);
    /* Without one the job is still at its pilot. */
    return e == ERR_NOT_FOUND ? ERR_OK : e;
}

void job_plan_apply(const struct job *job, struct film *film)
{
    const struct job_plan *p = job->plan;
    if (p && p->begun && !film_plan(film, p->limits, p->pilot))
        TL_ASSERT(false); /* nobody reads a film that was just made */
}

/* --- Going on ------------------------------------------------------------- */

/* Gives film and scheduler the limits of the plan. False: readers are at the film. */
static bool hand_out(struct farm *f, struct job *job)
{
    struct job_plan *p = job->plan;
    bool first = !film_planned(job->film);
    if (!film_plan(job->film, p->limits, p->pilot)) {
        p->due = true;
        return false;
    }
    p->due = false;
    if (first && p->pilot != FILM_PILOT_KEPT)
        job->rec.totals.nonfinite = 0; /* they are not in the picture */
    enum err e = job_plan_store(f, job);
    if (e != ERR_OK) {
        jobs_fail(f, job, err_text(e));
        return true;
    }
    struct sched_event event = {.type = SCHED_JOB_LIMITS,
                                .job = job->rec.id,
                                .limits = {.limits = p->limits, .final = p->sealed}};
    if (job->in_sched)
        farm_feed(f, &event);
    return true;
}

/* The limits are final. */
static void seal(struct job_plan *p, enum job_end end)
{
    p->sealed = true;
    p->end = end;
}

/* What the pool works out. */
struct judgement {
    uv_work_t request;
    struct farm *farm;
    uint64_t job;
    const struct film *film;
    const struct grid *grid;
    struct film_error error;
    double *terms, *squares; /* of each cell, one allocation; NULL: not wanted */
    bool failed;
};

/* Of each cell: the sum of its pixels' terms, and that of their squares. */
static void sum_terms(struct judgement *w)
{
    const struct job_crop *crop = &w->grid->crop;
    float *pixels = mem_alloc_array((size_t)crop->width * crop->height, sizeof *pixels);
    w->failed = !pixels || !film_error_pixels(w->film, pixels);
    for (uint32_t cell = 0; !w->failed && cell < w->grid->cell_count; cell++) {
        struct grid_rect r = grid_cell(w->grid, cell);
        w->terms[cell] = w->squares[cell] = 0;
        for (uint32_t y = r.y - crop->y; y < r.y - crop->y + r.height; y++) {
            for (uint32_t x = r.x - crop->x; x < r.x - crop->x + r.width; x++) {
                double term = (double)pixels[(size_t)y * crop->width + x];
                w->terms[cell] += term;
                w->squares[cell] += term * term;
            }
        }
    }
    mem_free(pixels);
}

static void judge_run(uv_work_t *request)
{
    struct judgement *w = request->data;
    film_error_estimate(w->film, &w->error);
    if (w->terms)
        sum_terms(w);
}

/* The pilot's proportions. False: out of memory. */
static bool take_shares(struct job *job, const struct judgement *w)
{
    struct job_plan *p = job->plan;
    float *scratch = mem_alloc_array(job->grid.cell_count, sizeof *scratch);
    if (!scratch)
        return false;
    allocate_shares(&job->grid, w->terms, w->squares, p->shares, scratch);
    p->gain = allocate_gain(&job->grid, w->terms, p->shares);
    mem_free(scratch);
    return true;
}

/* After the pilot of a job with a target: its proportions, and how far to the first look. */
static void begin_target(struct job *job, const struct judgement *w)
{
    struct job_plan *p = job->plan;
    double target = job->spec.target_error;
    p->looks++;
    if (claim_stands(&w->error, target)) {
        p->pilot = FILM_PILOT_KEPT;
        seal(p, JOB_END_ERROR);
        return;
    }
    p->pilot = FILM_PILOT_DROPPED;
    p->mean_spp = claim_first(&job->grid, &job->blocks, w->terms, p->shares, target, p->limits);
}

/* All cells have reached their limits: enough, or how much more. */
static void look_again(struct job *job, const struct judgement *w)
{
    struct job_plan *p = job->plan;
    double target = job->spec.target_error;
    p->looks++;
    if (claim_stands(&w->error, target)) {
        log_info("jobs", "error is reached job=j%" PRIu64 " looks=%" PRIu32 " relmse=%g upper=%g",
                 job->rec.id, p->looks, w->error.relmse, claim_upper(&w->error));
        seal(p, JOB_END_ERROR);
        return;
    }
    if (!claim_more(&job->grid, &job->blocks, p->shares, &w->error, target, &p->mean_spp,
                    p->limits))
        seal(p, JOB_END_MAX_SPP);
}

static void judge_after(uv_work_t *request, int status)
{
    struct judgement *w = request->data;
    struct farm *f = w->farm;
    struct job *job = farm_job(f, w->job);
    TL_ASSERT(job && job->plan->judging);
    struct job_plan *p = job->plan;
    p->judging = false;
    job_film_let_go(f, job);
    bool ended = job_state_ended(job->rec.state) || f->stopping || status != 0;
    bool failed = w->failed || (w->terms && !w->failed && !take_shares(job, w));
    if (!ended && failed) {
        jobs_fail(f, job, err_text(ERR_NOMEM));
    } else if (!ended) {
        job_error_put(&job->rec.stats, &w->error);
        bool first = !p->begun;
        p->begun = true;
        if (job->spec.stop == JOB_STOP_PILOT) {
            p->pilot = FILM_PILOT_KEPT;
            seal(p, JOB_END_PILOT);
        } else if (job->spec.stop == JOB_STOP_TIME) {
            p->pilot = FILM_PILOT_DROPPED;
            p->mean_spp = STAGE_FIRST_SPP;
            (void)allocate_limits(&job->grid, &job->blocks, p->shares, p->mean_spp, 4, p->limits);
        } else if (first) {
            begin_target(job, w);
        } else {
            look_again(job, w);
        }
        p->due = true;
        job_film_changed(f, job);
    }
    mem_free(w->terms);
    mem_free(w);
}

/* Has the error worked out on the pool; by cell too when the pilot is over. */
static void judge(struct farm *f, struct job *job)
{
    struct judgement *w = mem_calloc(1, sizeof *w);
    if (!w) {
        jobs_fail(f, job, err_text(ERR_NOMEM));
        return;
    }
    *w = (struct judgement){.farm = f, .job = job->rec.id, .film = job->film, .grid = &job->grid};
    if (!job->plan->begun) {
        w->terms = mem_calloc(2 * (size_t)job->grid.cell_count, sizeof *w->terms);
        w->squares = w->terms ? w->terms + job->grid.cell_count : NULL;
    }
    w->request.data = w;
    bool ready = job->plan->begun || w->terms;
    job_film_hold(job);
    job->plan->judging = true;
    if (ready && uv_queue_work(f->loop, &w->request, judge_run, judge_after) == 0)
        return;
    job->plan->judging = false;
    job_film_let_go(f, job);
    mem_free(w->terms);
    mem_free(w);
    jobs_fail(f, job, err_text(ERR_NOMEM));
}

static double elapsed_s(const struct job *job)
{
    return job->rec.started_us ? (double)(farm_wall_us() - job->rec.started_us) / 1e6 : 0;
}

void job_plan_step(struct farm *f, struct job *job)
{
    struct job_plan *p = job->plan;
    if (p->judging || job_state_ended(job->rec.state))
        return;
    if (p->due && !hand_out(f, job))
        return;
    if (p->sealed || job->in_store > 0 || !film_complete(job->film))
        return;
    bool timed = job->spec.stop == JOB_STOP_TIME;
    if (timed && p->begun) {
        job_plan_more(f, job);
        return;
    }
    if (timed && elapsed_s(job) > PILOT_SHARE * job->spec.time_limit_s) {
        p->begun = true;
        p->pilot = FILM_PILOT_KEPT;
        p->mean_spp = STAGE_FIRST_SPP;
        (void)allocate_limits(&job->grid, &job->blocks, p->shares, p->mean_spp, 4, p->limits);
        (void)hand_out(f, job);
        return;
    }
    judge(f, job);
}

/* --- Time ----------------------------------------------------------------- */

void job_plan_more(struct farm *f, struct job *job)
{
    struct job_plan *p = job->plan;
    if (!p || job->spec.stop != JOB_STOP_TIME || !p->begun || p->sealed || p->due ||
        !job->in_sched || !job->film)
        return;
    uint64_t before = film_total_count(job->film);
    while (sched_waiting(f->sched, job->rec.id) < job->grid.cell_count) {
        bool more = false;
        for (uint32_t cell = 0; cell < job->grid.cell_count; cell++)
            more |= p->limits[cell] < job->blocks.count;
        if (!more) {
            seal(p, JOB_END_MAX_SPP);
            (void)hand_out(f, job);
            return;
        }
        p->mean_spp *= STAGE_GROWTH;
        (void)allocate_limits(&job->grid, &job->blocks, p->shares, p->mean_spp, 4, p->limits);
        uint64_t total = 0;
        for (uint32_t cell = 0; cell < job->grid.cell_count; cell++)
            total += p->limits[cell];
        if (total == before)
            continue;
        (void)hand_out(f, job);
        return;
    }
}

/* When what is not begun is taken back, in seconds from the job's start. */
static double cut_s(const struct job *job)
{
    double reserve = RESERVE_S + RESERVE_ESTIMATES * (double)job->estimate_took_ms / 1e3;
    double limit = job->spec.time_limit_s;
    return reserve < 0.5 * limit ? limit - reserve : 0.5 * limit;
}

/* No cell stays with less than four samples. */
static uint16_t least_limit(const struct job *job)
{
    return job->plan->pilot == FILM_PILOT_KEPT ? 4 : (uint16_t)(job->blocks.pilot + 2);
}

static void cut(struct farm *f, struct job *job)
{
    struct job_plan *p = job->plan;
    if (!p->begun) /* the pilot took all the time: it is the picture */
        p->pilot = FILM_PILOT_KEPT;
    p->begun = true;
    seal(p, JOB_END_TIME);
    for (uint32_t cell = 0; cell < job->grid.cell_count; cell++)
        p->limits[cell] = least_limit(job);
    struct sched_event event = {
        .type = SCHED_JOB_LIMITS, .job = job->rec.id, .limits = {.limits = p->limits, .cut = true}};
    farm_feed(f, &event);
    if (!sched_limits_get(f->sched, job->rec.id, p->limits))
        return;
    p->due = true;
    log_info("jobs", "time is up job=j%" PRIu64, job->rec.id);
    job_film_changed(f, job);
}

static bool cut_pending(const struct job *job)
{
    const struct job_plan *p = job->plan;
    return p && job->spec.stop == JOB_STOP_TIME && !p->sealed && job->in_sched && job->film &&
           job->rec.started_us != 0 && !p->judging && !p->due;
}

static void on_cut_timer(uv_timer_t *timer)
{
    job_plans_tick(timer->data);
}

void job_plans_tick(struct farm *f)
{
    double next_s = INFINITY;
    for (size_t i = 0; i < f->job_count; i++) {
        struct job *job = f->jobs[i];
        if (!cut_pending(job) || f->draining_actions)
            continue;
        double left_s = cut_s(job) - elapsed_s(job);
        if (left_s <= 0)
            cut(f, job);
        else if (left_s < next_s)
            next_s = left_s;
    }
    if (next_s < 3600 && !f->stopping)
        (void)uv_timer_start(&f->cut_timer, on_cut_timer, (uint64_t)(1e3 * next_s) + 1, 0);
}

/* --- What people see -------------------------------------------------------- */

double job_plan_share(const struct job *job)
{
    enum { PILOT_PERCENT = 10 };
    struct job_plan *p = job->plan;
    double share = 0;
    if (job->spec.stop == JOB_STOP_TIME) {
        share = elapsed_s(job) / job->spec.time_limit_s;
    } else if (job->film) {
        double here = (double)film_present_count(job->film) / (double)film_total_count(job->film);
        double pilot = job->spec.stop == JOB_STOP_PLAN ? 0 : PILOT_PERCENT / 100.0;
        share = p->begun ? pilot + (1 - pilot) * here : pilot * here;
    }
    share = share < 0.999 ? share : 0.999;
    p->shown = share > p->shown ? share : p->shown;
    return p->shown;
}

bool job_plan_left(const struct job *job, double *seconds)
{
    if (!job->plan || job->spec.stop != JOB_STOP_TIME || job->rec.started_us == 0)
        return false;
    double left = job->spec.time_limit_s - elapsed_s(job);
    *seconds = left > 0 ? left : 0;
    return true;
}
