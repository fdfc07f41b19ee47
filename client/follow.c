#include "client/follow.h"

#include <math.h>
#include <poll.h>
#include <string.h>
#include <time.h>

#include "client/human.h"
#include "client/sse.h"
#include "common/json_put.h"

enum { WAIT_MS = 200 };

#define POLL_STREAMING_S 5.0 /* the stream tells everything; this only mends a lost event */
#define POLL_ALONE_S     0.5
#define REOPEN_S         1.0
#define HELD_S           0.3 /* what belongs together comes together */

double follow_now_s(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* One wait's state beside what the caller gave. */
struct watch {
    struct follow *f;
    struct http_stream *stream;
    struct sse sse;
    struct progress_now now;
    double idle_since_s; /* nobody works at it since; NaN: someone does */
    double next_poll_s, next_open_s, last_answer_s;
    bool silent_said;
    char held[400]; /* a line of the log that may be told by an event, too */
    double held_s;
};

static bool is_over(const char *state)
{
    return strcmp(state, "done") == 0 || strcmp(state, "failed") == 0 ||
           strcmp(state, "cancelled") == 0;
}

/* Takes what a job object of the API says; keys that are missing leave what was known. */
static void take_job(struct watch *w, const struct json *job)
{
    struct progress_now *n = &w->now;
    double now_s = follow_now_s();
    (void)snprintf(n->state, sizeof n->state, "%s", reply_text(job, "state", n->state));
    (void)snprintf(n->note, sizeof n->note, "%s", cli_safe(reply_text(job, "note", n->note)));
    n->done = reply_number(job, "done", n->done);
    n->has_left = reply_range(job, "left_s", n->left_s);
    const struct json *error = json_get_member(job, "error");
    n->relmse = error && error->type == JSON_OBJECT
                    ? reply_number(error, "relmse", n->relmse)
                    : reply_number(job, "relmse", reply_number(job, "error", n->relmse));
    n->rays_s = reply_number(job, "rays_s", n->rays_s);
    /* In a report `workers` counts all that ever helped. */
    double workers = reply_number(job, "workers_now", reply_number(job, "workers", n->workers));
    n->workers = workers >= 0 && workers < 1e9 ? (uint32_t)workers : 0;
    bool idle = n->workers == 0 && !is_over(n->state) && strcmp(n->state, "paused") != 0;
    if (!idle)
        w->idle_since_s = (double)NAN;
    else if (isnan(w->idle_since_s))
        w->idle_since_s = now_s;
    n->waiting_s = idle ? now_s - w->idle_since_s : 0;
    if (strcmp(n->state, "done") == 0)
        n->done = 1;
    (void)snprintf(w->f->state, sizeof w->f->state, "%s", n->state);
    if (!is_over(n->state) || n->done >= 1)
        progress_update(w->f->progress, n, now_s);
    if (w->f->on_news)
        w->f->on_news(w->f->ctx, now_s);
}

/* What became of a worker, for programs. */
static void put_worker(struct watch *w, const struct json *worker)
{
    struct buf members;
    buf_init(&members);
    buf_printf(&members, "\"id\":");
    json_put_text(&members, cli_safe(reply_text(worker, "id", "")));
    buf_printf(&members, ",\"state\":");
    json_put_text(&members, cli_safe(reply_text(worker, "state", "")));
    buf_printf(&members, ",\"units_returned\":");
    json_put_number(&members, reply_number(worker, "units_returned", (double)NAN));
    buf_put_u8(&members, '\0');
    if (buf_status(&members) == ERR_OK)
        progress_json(w->f->progress, "worker", (const char *)members.data, follow_now_s());
    buf_release(&members);
}

static void take_workers(struct watch *w, const struct json *list)
{
    for (const struct json *v = list->type == JSON_ARRAY ? list->first : NULL; v; v = v->next) {
        if (v->type != JSON_OBJECT)
            continue;
        put_worker(w, v);
        if (w->f->joins_expected > 0 && strcmp(reply_text(v, "state", ""), "joined") == 0) {
            w->f->joins_expected--;
            w->held[0] = '\0';
        }
    }
}

static void release_line(struct watch *w)
{
    if (w->held[0])
        progress_event(w->f->progress, w->held, follow_now_s());
    w->held[0] = '\0';
}

/* The log has a line about a worker that joins right before the event. */
static void take_line(struct watch *w, const char *line)
{
    release_line(w);
    (void)snprintf(w->held, sizeof w->held, "%s", line);
    w->held_s = follow_now_s();
    if (w->f->joins_expected == 0)
        release_line(w);
}

static void on_event(void *ctx, const char *name, const char *data, size_t bytes)
{
    struct watch *w = ctx;
    struct json_get g;
    struct diag_list problems;
    w->last_answer_s = follow_now_s();
    diag_init(&problems);
    if (json_get_open(&g, data, bytes, "event", &problems) == ERR_OK) {
        bool ours = strcmp(reply_text(g.root, "id", reply_text(g.root, "job", "")), w->f->job) == 0;
        if (strcmp(name, "job") == 0 && ours)
            take_job(w, g.root);
        else if (strcmp(name, "log") == 0 && ours)
            take_line(w, reply_text(g.root, "line", ""));
        else if (strcmp(name, "workers") == 0)
            take_workers(w, g.root);
        else if (strcmp(name, "reset") == 0 || strcmp(name, "hello") == 0)
            w->next_poll_s = 0;
        json_get_close(&g);
    }
    diag_release(&problems);
}

static void on_bytes(void *ctx, const char *data, size_t bytes)
{
    struct watch *w = ctx;
    w->last_answer_s = follow_now_s();
    sse_feed(&w->sse, data, bytes);
}

static void open_stream(struct watch *w)
{
    char path[FARM_PATH_BYTES];
    (void)snprintf(path, sizeof path, "/api/v1/events?job=%s", w->f->job);
    sse_restart(&w->sse);
    w->next_open_s = follow_now_s() + REOPEN_S;
    if (http_stream_open(w->f->farm->http, path, w->sse.last_id, on_bytes, w, &w->stream) != ERR_OK)
        w->stream = NULL;
}

/* Asks for the job's state. False: stop, and why has been said. */
static bool poll_job(struct watch *w)
{
    char path[FARM_PATH_BYTES];
    struct farm_json reply;
    (void)snprintf(path, sizeof path, "/api/v1/jobs/%s", w->f->job);
    enum err e = farm_try(w->f->farm, "GET", path, &reply);
    double now_s = follow_now_s();
    w->next_poll_s = now_s + (w->stream ? POLL_STREAMING_S : POLL_ALONE_S);
    if (e == ERR_OK && w->f->farm->reply.status == 200) {
        take_job(w, reply.json.root);
        farm_json_release(&reply);
        w->last_answer_s = now_s;
        w->silent_said = false;
        return true;
    }
    bool final = (e == ERR_OK && w->f->farm->reply.status < 500) || e == ERR_CORRUPT;
    if (final || now_s - w->last_answer_s > w->f->patience_s) {
        progress_end(w->f->progress);
        (void)farm_explain(w->f->farm, e);
        return false;
    }
    if (!w->silent_said && now_s - w->last_answer_s > 1) {
        progress_event(w->f->progress, "no answer from the master; trying on", now_s);
        w->silent_said = true;
    }
    return true;
}

static void wait_once(struct watch *w)
{
    if (w->stream && !http_stream_wait(w->stream, w->f->wake_fd, WAIT_MS)) {
        http_stream_close(w->stream);
        w->stream = NULL;
        w->next_poll_s = 0;
    } else if (!w->stream) {
        struct pollfd fd = {.fd = w->f->wake_fd, .events = POLLIN};
        (void)poll(&fd, 1, WAIT_MS);
        if (follow_now_s() >= w->next_open_s)
            open_stream(w);
    }
}

static enum follow_end run(struct watch *w)
{
    open_stream(w);
    while (!is_over(w->now.state)) {
        if (w->f->on_wake && w->f->on_wake(w->f->ctx))
            return FOLLOW_STOPPED;
        double now_s = follow_now_s();
        if (now_s >= w->next_poll_s && !poll_job(w))
            return w->f->farm->reply.status == 0 && w->f->on_wake && w->f->on_wake(w->f->ctx)
                       ? FOLLOW_STOPPED
                       : FOLLOW_FARM_LOST;
        if (is_over(w->now.state))
            break;
        if (w->f->pause_ends && strcmp(w->now.state, "paused") == 0)
            return FOLLOW_PAUSED;
        if (!isnan(w->idle_since_s)) {
            w->now.waiting_s = now_s - w->idle_since_s;
            w->f->progress->now.waiting_s = w->now.waiting_s;
        }
        if (now_s - w->held_s > HELD_S)
            release_line(w);
        progress_tick(w->f->progress, now_s);
        wait_once(w);
    }
    return strcmp(w->now.state, "done") == 0 ? FOLLOW_DONE : FOLLOW_FAILED;
}

enum follow_end follow_job(struct follow *f)
{
    struct watch w = {.f = f, .idle_since_s = (double)NAN, .last_answer_s = follow_now_s()};
    sse_init(&w.sse, on_event, &w);
    w.now.relmse = (double)NAN;
    w.now.advice = f->progress->now.advice;
    (void)snprintf(w.now.job, sizeof w.now.job, "%s", f->job);
    enum follow_end end = run(&w);
    release_line(&w);
    http_stream_close(w.stream);
    sse_release(&w.sse);
    return end;
}
