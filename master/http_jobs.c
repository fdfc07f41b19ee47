/* Jobs over HTTP: submit, list, report, change, picture. See http.h. */
#include <inttypes.h>
#include <microhttpd.h>
#include <stdio.h>
#include <string.h>

#include "common/mem.h"
#include "master/http_impl.h"
#include "master/shots.h"

/* --- The report --------------------------------------------------------- */

static void put_time(struct buf *b, const char *name, int64_t us)
{
    buf_printf(b, ",\"%s\":", name);
    if (us)
        json_put_number(b, (double)us / 1e6);
    else
        buf_printf(b, "null");
}

static void put_number(struct buf *b, const char *name, double v, bool known)
{
    buf_printf(b, "\"%s\":", name);
    if (known)
        json_put_number(b, v);
    else
        buf_printf(b, "null");
}

static void put_left(struct buf *b, const struct sched_job_info *info, bool known)
{
    if (known && info->left_known)
        buf_printf(b, ",\"left_s\":[%.3f,%.3f]", info->left_low_s, info->left_high_s);
    else
        buf_printf(b, ",\"left_s\":null");
}

static void put_samples(struct buf *b, const struct job *job)
{
    const struct job_stats *s = &job->rec.stats;
    const struct job_totals *t = &job->rec.totals;
    bool done = job->rec.state == JOB_STATE_DONE;
    buf_printf(b, ",\"width\":%" PRIu32 ",\"height\":%" PRIu32, job->spec.width, job->spec.height);
    if (done)
        buf_printf(b, ",\"spp_min\":%" PRIu64 ",\"spp_mean\":%.17g,\"spp_max\":%" PRIu64,
                   s->spp_min, s->spp_mean, s->spp_max);
    else
        buf_printf(b, ",\"spp_min\":null,\"spp_mean\":null,\"spp_max\":null");
    buf_printf(b, ",\"samples\":%" PRIu64 ",\"rays\":%" PRIu64 ",\"nonfinite_samples\":%" PRIu64,
               t->samples, t->rays, t->nonfinite);
    if (t->nonfinite > 0 && t->nonfinite_pixel != UINT64_MAX)
        buf_printf(
            b, ",\"nonfinite_first\":{\"x\":%" PRIu64 ",\"y\":%" PRIu64 ",\"sample\":%" PRIu64 "}",
            t->nonfinite_pixel % job->spec.width, t->nonfinite_pixel / job->spec.width,
            t->nonfinite_sample);
    else
        buf_printf(b, ",\"nonfinite_first\":null");
    char hex[DIGEST_HEX_BYTES];
    digest_to_hex(&job->rec.image, hex);
    if (job->rec.has_image)
        buf_printf(b, ",\"image_sha256\":\"%s\"", hex);
    else
        buf_printf(b, ",\"image_sha256\":null");
}

static void put_seconds(struct buf *b, const struct job *job)
{
    const struct job_stats *s = &job->rec.stats;
    bool done = job->rec.state == JOB_STATE_DONE;
    double total = job_state_ended(job->rec.state) ? s->total_s
                   : job->rec.started_us ? (double)(farm_wall_us() - job->rec.started_us) / 1e6
                                         : 0;
    buf_printf(b, ",\"seconds\":{");
    put_number(b, "total", total, job->rec.started_us != 0);
    buf_put_u8(b, ',');
    put_number(b, "load", s->load_s, job->ready_us != 0 || done);
    buf_put_u8(b, ',');
    put_number(b, "build", s->build_s, job->ready_us != 0 || done);
    buf_put_u8(b, ',');
    put_number(b, "render", s->render_s, done);
    buf_put_u8(b, ',');
    put_number(b, "gather", s->gather_s, done);
    buf_put_u8(b, ',');
    put_number(b, "first_result", s->first_result_s, s->first_result_s > 0);
    buf_printf(b, "},\"core_seconds\":");
    json_put_number(b, (double)job->rec.totals.render_us / 1e6);
}

static void put_farm(struct buf *b, const struct job *job, const struct sched_job_info *info)
{
    const struct job_stats *s = &job->rec.stats;
    const struct job_totals *t = &job->rec.totals;
    buf_printf(b,
               ",\"workers\":%" PRIu64 ",\"units\":{\"total\":%" PRIu64 ",\"retried\":%" PRIu64
               ",\"speculated\":%" PRIu64 ",\"rejected\":%" PRIu64 ",\"verified\":%" PRIu64 "}"
               ",\"bytes\":{\"scene_sent\":%" PRIu64 ",\"results_received\":%" PRIu64 "}",
               s->workers, t->units, s->retried + info->retried, s->speculated + info->speculated,
               s->rejected + info->rejected, s->verified + info->verified, s->scene_sent_bytes,
               t->result_bytes);
    bool known = s->error_known != 0;
    buf_printf(b, ",\"error\":{");
    put_number(b, "relmse", s->relmse, known);
    buf_put_u8(b, ',');
    put_number(b, "relmse_low", s->relmse_low, known);
    buf_put_u8(b, ',');
    put_number(b, "relmse_high", s->relmse_high, known);
    buf_put_u8(b, ',');
    put_number(b, "mean_low", s->mean_low, known);
    buf_put_u8(b, ',');
    put_number(b, "mean_high", s->mean_high, known);
    buf_put_u8(b, ',');
    put_number(b, "effective_size", s->effective, known);
    if (known)
        buf_printf(b, ",\"heavy_tail\":%s,\"worst_cell\":{\"x\":%.0f,\"y\":%.0f,\"relmse\":",
                   s->relmse > 0 && s->effective < FILM_EFFECTIVE_MIN ? "true" : "false",
                   s->worst_x, s->worst_y);
    else
        buf_printf(b, ",\"heavy_tail\":null,\"worst_cell\":null");
    if (known)
        json_put_number(b, s->worst_relmse);
    buf_printf(b, known ? "}}" : "}");
}

/* What ended the job, and the plan that it followed. */
static void put_plan(struct buf *b, const struct job *job)
{
    const struct job_plan *p = job->plan;
    unsigned end = (unsigned)job->rec.stats.stopped_by;
    bool done = job->rec.state == JOB_STATE_DONE;
    if (done && end > JOB_END_NONE && end < JOB_END_COUNT)
        buf_printf(b, ",\"stopped_by\":\"%s\"", job_end_names[end]);
    else
        buf_printf(b, ",\"stopped_by\":null");
    buf_printf(b, ",\"plan\":");
    if (p && p->sealed && job->grid_ready)
        sample_plan_put(b, &job->grid, &job->blocks, p->limits, p->pilot == FILM_PILOT_KEPT);
    else
        buf_printf(b, "null");
    buf_printf(b, ",\"adaptive_gain\":");
    if (p && p->gain > 0)
        json_put_number(b, p->gain);
    else
        buf_printf(b, "null");
}

static void put_events(struct buf *b, const struct job *job)
{
    uint32_t kept = job->event_count < FARM_EVENTS_SHOWN ? job->event_count : FARM_EVENTS_SHOWN;
    buf_printf(b, ",\"events\":[");
    for (uint32_t i = 0; i < kept; i++) {
        const struct job_event *event =
            &job->events[(job->event_count - kept + i) % FARM_EVENTS_SHOWN];
        buf_printf(b, "%s{\"t\":%.3f,\"text\":", i ? "," : "",
                   (double)(event->at_us - job->rec.created_us) / 1e6);
        json_put_text(b, event->text);
        buf_put_u8(b, '}');
    }
    buf_put_u8(b, ']');
}

/* Which frame of which shot; nulls for a job that is none. */
static void put_frame(struct buf *b, const struct job *job)
{
    if (job->rec.shot)
        buf_printf(b, ",\"shot\":\"j%" PRIu64 "\",\"frame\":%" PRIu64, job->rec.shot,
                   job->rec.frame);
    else
        buf_printf(b, ",\"shot\":null,\"frame\":null");
}

/* Of the first frame's report: how its shot is. */
static void put_shot(struct buf *b, const struct farm *f, const struct job *job)
{
    uint64_t counts[JOB_STATE_COUNT], total = 0;
    if (job->rec.shot != job->rec.id)
        return;
    shots_count(f, job->rec.shot, counts);
    buf_printf(b, ",\"frames\":{");
    for (int i = 0; i < JOB_STATE_COUNT; i++) {
        buf_printf(b, "\"%s\":%" PRIu64 ",", job_state_names[i], counts[i]);
        total += counts[i];
    }
    buf_printf(b, "\"total\":%" PRIu64 "}", total);
}

static void put_report(struct buf *b, struct farm *f, const struct job *job)
{
    struct sched_job_info info = {0};
    bool known = job->in_sched && sched_job_info(f->sched, job->rec.id, &info);
    jobs_left(job, &info);
    buf_printf(b, "{\"job\":\"j%" PRIu64 "\",\"id\":\"j%" PRIu64 "\",\"name\":", job->rec.id,
               job->rec.id);
    json_put_text(b, job->rec.name);
    buf_printf(b, ",\"state\":\"%s\",\"priority\":%" PRId32 ",\"note\":",
               job_state_names[job->rec.state], job->rec.priority);
    json_put_text(b, jobs_note(f, job));
    buf_printf(b, ",\"rev\":%" PRIu64 ",\"done\":", job->rev);
    json_put_number(b, jobs_done_share(f, job));
    put_left(b, &info, known && !job_state_ended(job->rec.state));
    put_time(b, "created", job->rec.created_us);
    put_time(b, "started", job->rec.started_us);
    put_time(b, "finished", job->rec.finished_us);
    char hex[DIGEST_HEX_BYTES];
    digest_to_hex(&job->rec.package, hex);
    buf_printf(b, ",\"package\":\"%s\",\"spec\":%s", hex, job->rec.spec_json);
    put_samples(b, job);
    put_seconds(b, job);
    put_farm(b, job, &info);
    put_plan(b, job);
    buf_printf(b, ",\"workers_now\":%" PRIu32, info.workers);
    put_frame(b, job);
    put_shot(b, f, job);
    put_events(b, job);
    buf_printf(b, "}\n");
}

static struct job *job_of(struct request *r)
{
    struct job *job = farm_job(r->farm, http_id(r->param, 'j'));
    if (!job)
        request_problem(r, MHD_HTTP_NOT_FOUND, "unknown-job", "no job \"%s\"", r->param);
    return job;
}

/* Names the job as it is: changes are counted by each master anew. */
enum { ETAG_BYTES = 48 };
static void job_etag(struct request *r, const struct job *job, char out[ETAG_BYTES])
{
    (void)snprintf(out, ETAG_BYTES, "\"%" PRIu64 "-r%" PRIu64 "\"", events_epoch(r->farm->events),
                   job->rev);
}

static void reply_report(struct request *r, const struct job *job, unsigned status)
{
    char tag[ETAG_BYTES];
    struct buf b;
    buf_init(&b);
    put_report(&b, r->farm, job);
    request_reply(r, status, "application/json", &b);
    job_etag(r, job, tag);
    request_header(r, "ETag", tag);
}

void http_get_job(struct request *r)
{
    struct job *job = job_of(r);
    if (job)
        reply_report(r, job, MHD_HTTP_OK);
}

/* --- The list ------------------------------------------------------------ */

static void put_item(struct buf *b, struct farm *f, const struct job *job)
{
    struct sched_job_info info = {0};
    bool known = job->in_sched && sched_job_info(f->sched, job->rec.id, &info);
    buf_printf(b, "{\"id\":\"j%" PRIu64 "\",\"name\":", job->rec.id);
    json_put_text(b, job->rec.name);
    buf_printf(b, ",\"state\":\"%s\",\"done\":", job_state_names[job->rec.state]);
    json_put_number(b, jobs_done_share(f, job));
    buf_put_u8(b, ',');
    put_number(b, "error", job->rec.stats.relmse, job->rec.stats.error_known != 0);
    put_left(b, &info, known && !job_state_ended(job->rec.state));
    buf_printf(b,
               ",\"workers\":%" PRIu32 ",\"priority\":%" PRId32 ",\"age_s\":%.0f,\"rev\":%" PRIu64
               ",\"note\":",
               info.workers, job->rec.priority,
               (double)(farm_wall_us() - job->rec.created_us) / 1e6, job->rev);
    json_put_text(b, jobs_note(f, job));
    put_frame(b, job);
    buf_put_u8(b, '}');
}

void http_get_frames(struct request *r)
{
    const struct job *job = job_of(r);
    if (!job)
        return;
    struct buf b;
    buf_init(&b);
    buf_printf(&b, "{\"items\":[");
    bool any = false;
    for (size_t i = 0; job->rec.shot && i < r->farm->job_count; i++) {
        const struct job *frame = r->farm->jobs[i];
        if (frame->rec.shot != job->rec.shot)
            continue;
        buf_printf(&b, any ? "," : "");
        put_item(&b, r->farm, frame);
        any = true;
    }
    buf_printf(&b, "]}\n");
    request_reply(r, MHD_HTTP_OK, "application/json", &b);
}

void http_get_jobs(struct request *r)
{
    const char *state = request_query(r, "state"), *limit_text = request_query(r, "limit");
    const char *cursor_text = request_query(r, "cursor");
    unsigned states = state ? http_query_states(state) : ~0U;
    uint64_t limit = HTTP_LIST_DEFAULT, cursor = UINT64_MAX;
    if (states == 0 || (limit_text && !http_query_count(limit_text, HTTP_LIST_MAX, &limit)) ||
        (cursor_text && !http_query_count(cursor_text, UINT64_MAX / 100, &cursor))) {
        request_problem(r, MHD_HTTP_BAD_REQUEST, "bad-query",
                        "state is a list of job states, limit 1 to %d, cursor as given by next",
                        (int)HTTP_LIST_MAX);
        return;
    }
    struct buf b;
    buf_init(&b);
    buf_printf(&b, "{\"items\":[");
    uint64_t count = 0, last = 0;
    size_t i = r->farm->job_count;
    while (i > 0 && count < limit) { /* newest first */
        const struct job *job = r->farm->jobs[--i];
        if (job->rec.id >= cursor || !(states >> job->rec.state & 1))
            continue;
        if (count++ > 0)
            buf_put_u8(&b, ',');
        put_item(&b, r->farm, job);
        last = job->rec.id;
    }
    if (count == limit && i > 0)
        buf_printf(&b, "],\"next\":\"%" PRIu64 "\"}\n", last);
    else
        buf_printf(&b, "],\"next\":null}\n");
    request_reply(r, MHD_HTTP_OK, "application/json", &b);
}

/* --- Submitting ---------------------------------------------------------- */

/* What a submission carries while its package is checked. */
struct submission {
    struct later *later;
    struct http_job_body asked;
    char key[128];
    bool has_key;
    digest body;
    uint64_t job;
};

static void submission_free(struct submission *s)
{
    if (s)
        http_body_job_release(&s->asked);
    mem_free(s);
}

static void submit_stored(void *ctx, enum err e)
{
    struct submission *s = ctx;
    struct request *r = request_of(s->later);
    struct job *job = r ? farm_job(r->farm, s->job) : NULL;
    if (r && e != ERR_OK) {
        request_error(r, e);
    } else if (job) {
        char location[48];
        struct buf b;
        buf_init(&b);
        put_report(&b, r->farm, job);
        (void)snprintf(location, sizeof location, "/api/v1/jobs/j%" PRIu64, job->rec.id);
        request_reply(r, MHD_HTTP_CREATED, "application/json", &b);
        request_header(r, "Location", location);
    } else if (r) {
        request_error(r, ERR_CANCELLED);
    }
    submission_free(s);
}

static void reply_missing(struct request *r, const struct buf *missing)
{
    struct diag_list problems;
    diag_init(&problems);
    for (size_t at = 0; at + sizeof(digest) <= missing->bytes; at += sizeof(digest)) {
        digest name;
        char hex[DIGEST_HEX_BYTES];
        memcpy(&name, missing->data + at, sizeof name);
        digest_to_hex(&name, hex);
        diag_add(&problems, DIAG_ERROR, (struct diag_place){.path = "$.package"}, "missing-chunk",
                 "PUT it to /api/v1/chunks/SHA256", "no chunk %s", hex);
    }
    request_problems(r, MHD_HTTP_UNPROCESSABLE_CONTENT, "missing-chunk",
                     "the package is not here whole", &problems);
    diag_release(&problems);
}

/* The key was used before: true, and the submission is taken. Its job is told once that is on disk,
 * for it may be the one of a request that still waits. */
static bool settle_by_key(struct request *r, struct submission *s)
{
    bool conflict = false;
    struct job *job = s->has_key ? jobs_by_key(r->farm, s->key, &s->body, &conflict) : NULL;
    if (!job && !conflict)
        return false;
    enum err e = ERR_OK;
    if (conflict) {
        request_problem(r, MHD_HTTP_UNPROCESSABLE_CONTENT, "key-reused",
                        "this Idempotency-Key came with another body");
    } else {
        s->job = job->rec.id;
        e = jobs_when_stored(r->farm, job, submit_stored, s);
        if (e == ERR_OK)
            return true; /* submit_stored answers */
        request_error(r, e);
    }
    (void)request_of(s->later);
    submission_free(s);
    return true;
}

/* The package is whole: makes the job. False: answered. */
static bool make_job(struct request *r, struct submission *s)
{
    struct job_request asked = {.name = s->asked.name,
                                .spec = &s->asked.spec,
                                .package = s->asked.package,
                                .priority = s->asked.priority,
                                .is_frame = s->asked.is_frame,
                                .shot = s->asked.shot,
                                .frame = s->asked.frame,
                                .plan = s->asked.has_plan ? &s->asked.plan : NULL,
                                .key = s->has_key ? s->key : NULL,
                                .body = s->body};
    struct job *job = NULL;
    if (asked.shot && !shots_begins(r->farm, asked.shot)) {
        request_problem(r, MHD_HTTP_UNPROCESSABLE_CONTENT, "unknown-job",
                        "no shot begins with job j%" PRIu64, asked.shot);
        return false;
    }
    enum err e = jobs_submit(r->farm, &asked, submit_stored, s, &job);
    if (e != ERR_OK) {
        if (e == ERR_LIMIT)
            request_problem(r, MHD_HTTP_UNPROCESSABLE_CONTENT, "over-limit",
                            "too many jobs, or too large a picture");
        else if (e == ERR_INPUT)
            request_problem(r, MHD_HTTP_UNPROCESSABLE_CONTENT, "bad-plan",
                            "the plan does not fit: it must cover the picture, come with "
                            "\"stop\": \"plan\", spp must be its max_spp and its numbers those "
                            "of blocks");
        else
            request_error(r, e);
        return false;
    }
    s->job = job->rec.id;
    return true;
}

static void package_checked(void *ctx, enum err e, struct buf *missing)
{
    struct submission *s = ctx;
    struct request *r = s->later->request;
    if (r && e == ERR_OK && missing->bytes == 0 && (settle_by_key(r, s) || make_job(r, s)))
        return; /* submit_stored answers */
    if (r && !r->answered) {
        if (e == ERR_OK)
            reply_missing(r, missing);
        else if (e == ERR_CORRUPT || e == ERR_LIMIT || e == ERR_VERSION)
            request_problem(r, MHD_HTTP_UNPROCESSABLE_CONTENT, "bad-package",
                            "the chunk named is no package: %s", err_text(e));
        else
            request_error(r, e);
    }
    (void)request_of(s->later);
    submission_free(s);
}

/* The members of the body and the key. ERR_INPUT: problems were added; ERR_NOMEM. */
static enum err read_submission(struct request *r, struct json_get *g, struct submission *s)
{
    enum err e = http_body_job(g, &s->asked);
    const char *key = request_head(r, "Idempotency-Key");
    if (key && (strlen(key) == 0 || strlen(key) >= sizeof s->key))
        json_get_problem(g, DIAG_ERROR, g->root, "bad-key", NULL,
                         "Idempotency-Key must have 1 to %zu characters", sizeof s->key - 1);
    else if (key)
        (void)snprintf(s->key, sizeof s->key, "%s", key);
    s->has_key = key != NULL;
    s->body = digest_of(r->body.data, r->body.bytes);
    if (e == ERR_NOMEM)
        return e;
    return g->problems->error_count == 0 ? ERR_OK : ERR_INPUT;
}

void http_post_jobs(struct request *r)
{
    struct json_get g;
    struct diag_list problems;
    if (!request_json(r, &g, &problems, http_job_keys, HTTP_JOB_KEYS))
        return;
    struct submission *s = mem_calloc(1, sizeof *s);
    enum err e = s ? read_submission(r, &g, s) : ERR_NOMEM;
    json_get_close(&g);
    if (e == ERR_NOMEM)
        request_error(r, e);
    else if (e != ERR_OK)
        request_problems(r, MHD_HTTP_UNPROCESSABLE_CONTENT, "bad-job", "the job cannot be made",
                         &problems);
    diag_release(&problems);
    if (e == ERR_OK)
        s->later = request_later(r);
    if (e != ERR_OK || !s->later) {
        submission_free(s);
        return;
    }
    if (settle_by_key(r, s)) {
        request_wait(r);
        return;
    }
    e = chunks_check_package(r->farm->chunks, &s->asked.package, package_checked, s);
    if (e == ERR_OK) {
        request_wait(r);
        return;
    }
    struct buf missing;
    buf_init(&missing);
    buf_put(&missing, &s->asked.package, sizeof s->asked.package);
    if (e == ERR_NOT_FOUND)
        reply_missing(r, &missing);
    else
        request_error(r, e);
    buf_release(&missing);
    (void)request_of(s->later);
    submission_free(s);
}

/* --- Changing ------------------------------------------------------------ */

static void change_stored(void *ctx, enum err e)
{
    struct request *r = request_of(ctx);
    if (!r)
        return;
    struct job *job = farm_job(r->farm, http_id(r->param, 'j'));
    if (e != ERR_OK || !job)
        request_error(r, e != ERR_OK ? e : ERR_CANCELLED);
    else
        reply_report(r, job, MHD_HTTP_OK);
}

/* Carries out one change; answers at once when it cannot be. */
static void change(struct request *r, struct job *job, const struct http_change_body *to)
{
    struct later *later = request_later(r);
    if (!later)
        return;
    enum err e = to->has_priority
                     ? jobs_set_priority(r->farm, job, to->priority, change_stored, later)
                     : jobs_set_state(r->farm, job, to->state, change_stored, later);
    if (e == ERR_OK) {
        request_wait(r);
        return;
    }
    (void)request_of(later);
    if (e == ERR_STATE)
        request_problem(r, MHD_HTTP_CONFLICT, "wrong-state", "not possible: j%" PRIu64 " is %s",
                        job->rec.id, job_state_names[job->rec.state]);
    else
        request_error(r, e);
}

void http_patch_job(struct request *r)
{
    static const char *const keys[] = {"state", "priority"};
    struct job *job = job_of(r);
    struct json_get g;
    struct diag_list problems;
    if (!job || !request_json(r, &g, &problems, keys, 2))
        return;
    struct http_change_body to;
    enum err e = http_body_change(&g, &to);
    const char *tag = request_head(r, "If-Match");
    char current[ETAG_BYTES];
    job_etag(r, job, current);
    if (e != ERR_OK)
        request_problems(r, MHD_HTTP_UNPROCESSABLE_CONTENT, "bad-change", "nothing was changed",
                         &problems);
    else if (tag && strcmp(tag, current) != 0 && strcmp(tag, "*") != 0)
        request_problem(r, MHD_HTTP_PRECONDITION_FAILED, "stale",
                        "the job has changed; read it again");
    else
        change(r, job, &to);
    json_get_close(&g);
    diag_release(&problems);
}

/* --- Pictures ------------------------------------------------------------ */

/* ?key=1 */
static bool wants(struct request *r, const char *key)
{
    const char *value = request_query(r, key);
    return value && strcmp(value, "1") == 0;
}

static void picture_made(void *ctx, enum err e, struct buf *file, uint64_t clamped)
{
    struct request *r = request_of(ctx);
    if (!r)
        return;
    if (e != ERR_OK) {
        request_error(r, e);
        return;
    }
    struct job *job = farm_job(r->farm, http_id(r->param, 'j'));
    bool exr = strstr(r->route->path, ".exr") != NULL;
    request_reply(r, MHD_HTTP_OK, exr ? "image/x-exr" : "image/png", file);
    if (job && job->rec.has_image) {
        char hex[DIGEST_HEX_BYTES], tag[DIGEST_HEX_BYTES + 24];
        digest_to_hex(&job->rec.image, hex);
        (void)snprintf(tag, sizeof tag, "\"sha256-%s%s\"", hex,
                       exr && wants(r, "half") ? "-half" : "");
        request_header(r, "ETag", tag);
    }
    if (exr && wants(r, "half")) {
        char count[24];
        (void)snprintf(count, sizeof count, "%" PRIu64, clamped);
        request_header(r, "X-Tilery-Clamped", count);
    }
}

static void get_picture(struct request *r, enum picture_format format)
{
    struct job *job = job_of(r);
    if (!job)
        return;
    if (job->rec.state != JOB_STATE_DONE && !wants(r, "partial")) {
        request_problem(r, MHD_HTTP_CONFLICT, "unfinished",
                        job_state_ended(job->rec.state)
                            ? "the job was %s at %.1f %%; there is no finished picture"
                            : "the job is %s, %.1f %% done; its picture is not finished",
                        job->rec.state == JOB_STATE_FAILED ? "ended by a failure"
                                                           : job_state_names[job->rec.state],
                        100 * jobs_done_share(r->farm, job));
        return;
    }
    struct later *later = request_later(r);
    if (!later)
        return;
    enum err e = job_picture(r->farm, job, format, picture_made, later);
    if (e == ERR_OK) {
        request_wait(r);
        return;
    }
    (void)request_of(later);
    request_error(r, e);
}

void http_get_exr(struct request *r)
{
    get_picture(r, wants(r, "half") ? PICTURE_EXR_HALF : PICTURE_EXR);
}

void http_get_png(struct request *r)
{
    get_picture(r, PICTURE_PNG);
}
