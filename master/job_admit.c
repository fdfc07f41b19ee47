/* Which jobs are with the scheduler, and what it is told of them: see farm.h.
 *
 * It has places for JOBS_IN_SCHED_MAX. Jobs enter by age; where there is no place left, one that is
 * paused or of lower priority gives way. A job that leaves may enter again from its film. */
#include "common/mem.h"
#include "master/shots.h"
#include "proto/limits.h"

enum {
    JOBS_IN_SCHED_MAX = 1000, /* below the scheduler's job_count_max */
    RETURN_MS = 600,          /* workers find a new master within 500 ms */
};

void jobs_add_counts(const struct farm *f, const struct job *job, struct job_stats *to)
{
    struct sched_job_info info;
    if (!job->in_sched || !sched_job_info(f->sched, job->rec.id, &info))
        return;
    to->retried += info.retried;
    to->speculated += info.speculated;
    to->rejected += info.rejected;
    to->verified += info.verified;
}

struct done_list {
    struct sched_done *items;
    size_t count, capacity;
    bool failed;
};

static void note_done(void *ctx, struct unit run)
{
    struct done_list *l = ctx;
    if (!mem_grow((void **)&l->items, l->count, &l->capacity, sizeof *l->items)) {
        l->failed = true;
        return;
    }
    l->items[l->count++] =
        (struct sched_done){run.cell_begin, run.cell_count, run.block, run.block + 1};
}

static enum err make_tables(struct job *job)
{
    TL_TRY(job_need_grid(job));
    size_t bytes = sched_job_bytes(job->grid.cell_count, job->blocks.count);
    if (bytes == 0)
        return ERR_LIMIT;
    TL_TRY(job_need_provenance(job));
    job->sched_memory = mem_alloc_aligned(bytes, 64);
    return job->sched_memory ? ERR_OK : ERR_NOMEM;
}

static void free_tables(struct job *job)
{
    mem_free(job->sched_memory);
    job->sched_memory = NULL;
}

/* What one result frame can carry. */
static uint32_t cells_per_result(const struct job_spec *spec)
{
    uint64_t side = spec->tile, values = side * side * job_plane_count(spec);
    return values < LIMIT_UNIT_VALUES ? (uint32_t)(LIMIT_UNIT_VALUES / values) : 1;
}

/* What the scheduler is told of a job whose cells get different numbers of blocks. */
static void add_plan(const struct job *job, uint64_t weights[JOB_BLOCKS_MAX],
                     struct sched_job_add *add)
{
    enum { UNIT_MS = 150 /* under a time limit: what is begun ends soon */ };
    if (!job->plan)
        return;
    for (uint32_t b = 0; b < job->blocks.count; b++)
        weights[b] = job_block_at(&job->blocks, b).count;
    add->limits = film_limits(job->film);
    add->open = !job->plan->sealed;
    add->block_weights = weights;
    add->unit_ms = job->spec.stop == JOB_STOP_TIME ? UNIT_MS : 0;
    add->cell_cost = (double)job->spec.crop.width * job->spec.crop.height / job->grid.cell_count;
}

/* How long a job that an earlier life of the master had begun waits for its workers. */
static uint32_t quiet_ms(const struct farm *f, const struct job *job)
{
    uint64_t age_ms = uv_now(f->loop) - f->started_ms;
    return job->rec.state == JOB_STATE_RENDERING && age_ms < RETURN_MS
               ? (uint32_t)(RETURN_MS - age_ms)
               : 0;
}

static enum err admit(struct farm *f, struct job *job)
{
    struct done_list done = {0};
    enum err e = job->plan ? job_need_film(job) : ERR_OK;
    if (e == ERR_OK)
        e = make_tables(job);
    if (e == ERR_OK && job->film)
        film_each_present(job->film, note_done, &done);
    size_t check_count = 0;
    struct sched_open_check *checks = e == ERR_OK ? verify_open_checks(job, &check_count) : NULL;
    if (e == ERR_OK && (done.failed || !checks))
        e = ERR_NOMEM;
    if (e == ERR_OK) {
        uint64_t pixels = (uint64_t)job->spec.crop.width * job->spec.crop.height;
        double samples = (double)pixels * (double)job->spec.spp;
        struct sched_event event = {
            .type = SCHED_JOB_ADD,
            .job = job->rec.id,
            .add = {.cell_count = job->grid.cell_count,
                    .block_count = job->blocks.count,
                    .cell_cost = samples / ((double)job->grid.cell_count * job->blocks.count),
                    .unit_cells_max = cells_per_result(&job->spec),
                    .verify_share = job->spec.verify,
                    .priority = job->rec.priority,
                    .tags = job->tag_bits,
                    .paused = job->rec.state == JOB_STATE_PAUSED,
                    .quiet_ms = quiet_ms(f, job),
                    .memory = job->sched_memory,
                    .done = done.items,
                    .done_count = done.count,
                    .blame = job->blame,
                    .blame_count = job->blame_count,
                    .checks = checks,
                    .check_count = check_count}};
        uint64_t weights[JOB_BLOCKS_MAX];
        add_plan(job, weights, &event.add);
        job->in_sched = true;
        job->sched_done = false;
        f->sched_jobs++;
        farm_feed(f, &event);
        job->held = false;
        job_journal_limit(f, job);
    }
    mem_free(done.items);
    mem_free(checks);
    if (e != ERR_OK)
        free_tables(job);
    return e;
}

/* False: the jobs of the scheduler ask for too many words; it waits until one of them ends. */
static bool take_tags(struct farm *f, struct job *job)
{
    bool moved;
    if (!tag_table_take(&f->tag_table, &job->spec.tags, &job->tag_bits, &moved))
        return false;
    if (moved)
        workers_retag(f);
    return true;
}

/* The job that can best do without its place with the scheduler: one that is paused and has
 * nothing out, else the one of lowest priority that has not begun. NULL: none can. */
static struct job *least_needed(const struct farm *f)
{
    struct job *least = NULL;
    for (size_t i = f->job_count; i-- > 0;) {
        struct job *job = f->jobs[i];
        struct sched_job_info info;
        if (!job->in_sched || job->in_store > 0)
            continue;
        if (job->rec.state == JOB_STATE_PAUSED && sched_job_info(f->sched, job->rec.id, &info) &&
            info.leases == 0)
            return job;
        if (job->rec.state == JOB_STATE_QUEUED &&
            (!least || job->rec.priority < least->rec.priority))
            least = job;
    }
    return least;
}

/* True if this job needs a place more. */
static bool gives_way(const struct job *job, const struct job *to)
{
    return job && (job->rec.state == JOB_STATE_PAUSED || job->rec.priority < to->rec.priority);
}

static bool wants_in(const struct job *job)
{
    return !job->in_sched && !job->unstored && job->in_store == 0 && !job->finishing &&
           !job->loading &&
           (job->rec.state == JOB_STATE_QUEUED || job->rec.state == JOB_STATE_RENDERING);
}

void jobs_admit(struct farm *f)
{
    f->admit_due = false;
    struct job *least = NULL;
    bool looked = false;    /* for the one that gives way */
    uint64_t shot_full = 0; /* the last found whose frames must wait: shots can be long */
    for (size_t i = 0; i < f->job_count; i++) {
        struct job *job = f->jobs[i];
        bool full = f->sched_jobs >= JOBS_IN_SCHED_MAX;
        if (full && !looked)
            least = least_needed(f);
        looked |= full;
        if (!wants_in(job) || (full && !gives_way(least, job)) ||
            (job->rec.shot != 0 && job->rec.shot == shot_full))
            continue;
        if (!shots_may_enter(f, job)) {
            shot_full = job->rec.shot;
            continue;
        }
        if (verify_reset_liars(f, job))
            continue; /* goes on when that is stored */
        if (job->film && film_complete(job->film) && job->provenance.check_count == 0 &&
            (!job->plan || job->plan->sealed)) {
            job->sched_done = true;
            job_film_changed(f, job);
            continue;
        }
        if (!take_tags(f, job))
            continue;
        if (full) {
            jobs_leave_sched(f, least);
            looked = false;
        }
        enum err e = admit(f, job);
        if (e != ERR_OK) {
            tag_table_give(&f->tag_table, job->tag_bits);
            jobs_fail(f, job, err_text(e));
        } else if (job->plan && film_complete(job->film))
            job_film_changed(f, job); /* the pilot or a stage was over when the master ended */
    }
}

void jobs_leave_sched(struct farm *f, struct job *job)
{
    if (!job->in_sched)
        return;
    job->done_share = jobs_done_share(f, job);
    jobs_add_counts(f, job, &job->rec.stats);
    job->in_sched = false;
    f->sched_jobs--;
    tag_table_give(&f->tag_table, job->tag_bits);
    struct sched_event cancel = {.type = SCHED_JOB_CANCEL, .job = job->rec.id};
    struct sched_event remove = {.type = SCHED_JOB_REMOVE, .job = job->rec.id};
    farm_feed(f, &cancel);
    farm_feed(f, &remove);
    f->admit_due = true;
}

void jobs_left_sched(struct job *job)
{
    if (!job->in_sched)
        free_tables(job);
}
