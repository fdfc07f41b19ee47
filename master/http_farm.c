/* Chunks, workers, farm, session, health and metrics over HTTP. See http.h. */
#include <inttypes.h>
#include <microhttpd.h>
#include <stdio.h>
#include <string.h>

#include "common/mem.h"
#include "master/http_impl.h"

static void reply_text(struct request *r, unsigned status, const char *type, const char *text)
{
    struct buf b;
    buf_init(&b);
    buf_put(&b, text, strlen(text));
    request_reply(r, status, type, &b);
}

/* --- Chunks -------------------------------------------------------------- */

void http_post_missing(struct request *r)
{
    static const char *const keys[] = {"sha256"};
    struct json_get g;
    struct diag_list problems;
    if (!request_json(r, &g, &problems, keys, 1))
        return;
    struct buf names, b;
    buf_init(&names);
    buf_init(&b);
    buf_printf(&b, "{\"missing\":[");
    enum err e = http_body_digests(&g, &names);
    bool first = true;
    for (size_t at = 0; e == ERR_OK && at + sizeof(digest) <= names.bytes; at += sizeof(digest)) {
        digest name;
        char hex[DIGEST_HEX_BYTES];
        memcpy(&name, names.data + at, sizeof name);
        if (chunks_has(r->farm->chunks, &name))
            continue;
        digest_to_hex(&name, hex);
        buf_printf(&b, "%s\"%s\"", first ? "" : ",", hex);
        first = false;
    }
    buf_printf(&b, "]}\n");
    buf_release(&names);
    if (e == ERR_OK) {
        request_reply(r, MHD_HTTP_OK, "application/json", &b);
    } else {
        buf_release(&b);
        if (e == ERR_NOMEM)
            request_error(r, e);
        else
            request_problems(r, MHD_HTTP_UNPROCESSABLE_CONTENT, "bad-request",
                             "sha256 must be a list of digests", &problems);
    }
    json_get_close(&g);
    diag_release(&problems);
}

static void chunk_stored(void *ctx, enum err e)
{
    struct request *r = request_of(ctx);
    if (!r)
        return;
    if (e == ERR_OK)
        reply_text(r, MHD_HTTP_CREATED, "application/json", "{\"stored\":true}\n");
    else if (e == ERR_CORRUPT)
        request_problem(r, MHD_HTTP_UNPROCESSABLE_CONTENT, "bad-chunk",
                        "the body is not one zstd frame whose contents have this SHA-256");
    else
        request_error(r, e);
}

void http_put_chunk(struct request *r)
{
    digest name;
    if (!digest_from_hex(r->param, &name)) {
        request_problem(r, MHD_HTTP_BAD_REQUEST, "bad-digest",
                        "a chunk is named by 64 hexadecimal digits");
        return;
    }
    if (chunks_has(r->farm->chunks, &name)) {
        reply_text(r, MHD_HTTP_OK, "application/json", "{\"stored\":true}\n");
        return;
    }
    struct later *later = request_later(r);
    if (!later)
        return;
    enum err e = chunks_put(r->farm->chunks, &name, &r->body, chunk_stored, later);
    if (e == ERR_OK) {
        request_wait(r);
        return;
    }
    (void)request_of(later);
    request_error(r, e);
}

/* --- Workers ------------------------------------------------------------- */

static void put_worker(struct buf *b, struct farm *f, const struct worker *w)
{
    struct sched_worker_info info;
    enum sched_worker_state state = workers_state(f, w, &info);
    buf_printf(b, "{\"id\":\"w%" PRIu64 "\",\"name\":", w->id);
    json_put_text(b, w->name);
    buf_printf(b, ",\"host\":");
    json_put_text(b, w->host);
    buf_printf(b, ",\"state\":\"%s\",\"job\":", sched_worker_state_name(state));
    if (info.job)
        buf_printf(b, "\"j%" PRIu64 "\"", info.job);
    else
        buf_printf(b, "null");
    buf_printf(b,
               ",\"threads\":%" PRIu32 ",\"speed_rays_s\":%.0f,\"units\":%" PRIu64
               ",\"lost\":%" PRIu64 ",\"failed\":%" PRIu64 ",\"leases\":%" PRIu32
               ",\"seen_s\":%.1f,\"rtt_ms\":%.3f,\"note\":",
               w->threads, w->speed_rays_s, info.units, info.lost, info.failed, info.leases,
               (double)(farm_now_ms(f) - w->seen_ms) / 1e3, (double)w->rtt_us / 1e3);
    json_put_text(b, w->note);
    buf_printf(b, ",\"cpu\":");
    json_put_text(b, w->cpu);
    buf_printf(b, ",\"build\":");
    json_put_text(b, w->build);
    buf_printf(b, ",\"tags\":[");
    for (uint32_t i = 0; i < w->tags.count; i++) {
        if (i > 0)
            buf_put_u8(b, ',');
        json_put_text(b, w->tags.words[i]);
    }
    buf_printf(b, "]}");
}

void http_get_workers(struct request *r)
{
    const char *wanted = request_query(r, "state");
    struct buf b;
    buf_init(&b);
    buf_printf(&b, "{\"items\":[");
    bool first = true;
    for (size_t i = 0; i < r->farm->worker_count; i++) {
        struct sched_worker_info info;
        const struct worker *w = r->farm->workers[i];
        const char *state = sched_worker_state_name(workers_state(r->farm, w, &info));
        if (wanted && strcmp(wanted, state) != 0)
            continue;
        if (!first)
            buf_put_u8(&b, ',');
        first = false;
        put_worker(&b, r->farm, w);
    }
    buf_printf(&b, "],\"next\":null}\n");
    request_reply(r, MHD_HTTP_OK, "application/json", &b);
}

void http_patch_worker(struct request *r)
{
    static const char *const keys[] = {"state"};
    static const char *const states[] = {"draining"};
    struct worker *w = farm_worker(r->farm, http_id(r->param, 'w'));
    struct json_get g;
    struct diag_list problems;
    if (!w) {
        request_problem(r, MHD_HTTP_NOT_FOUND, "unknown-worker", "no worker \"%s\"", r->param);
        return;
    }
    if (!request_json(r, &g, &problems, keys, 1))
        return;
    int choice = -1;
    (void)json_value_choice(&g, json_get_required(&g, g.root, "state"), states, 1, &choice);
    if (problems.error_count > 0) {
        request_problems(r, MHD_HTTP_UNPROCESSABLE_CONTENT, "bad-change", "nothing was changed",
                         &problems);
    } else if (workers_drain(r->farm, w) != ERR_OK) {
        request_problem(r, MHD_HTTP_CONFLICT, "wrong-state", "not possible: w%" PRIu64 " is gone",
                        w->id);
    } else {
        struct buf b;
        buf_init(&b);
        put_worker(&b, r->farm, w);
        buf_put_u8(&b, '\n');
        request_reply(r, MHD_HTTP_OK, "application/json", &b);
    }
    json_get_close(&g);
    diag_release(&problems);
}

/* --- Farm ---------------------------------------------------------------- */

static void count_jobs(const struct farm *f, uint64_t counts[JOB_STATE_COUNT])
{
    memset(counts, 0, JOB_STATE_COUNT * sizeof *counts);
    for (size_t i = 0; i < f->job_count; i++)
        counts[f->jobs[i]->rec.state]++;
}

static uint32_t connected(const struct farm *f, uint32_t *threads)
{
    uint32_t count = 0;
    *threads = 0;
    for (size_t i = 0; i < f->worker_count; i++)
        if (f->workers[i]->conn) {
            count++;
            *threads += f->workers[i]->threads;
        }
    return count;
}

static double rays_s(const struct farm *f)
{
    double sum = 0;
    for (size_t i = 0; i < f->job_count; i++)
        sum += jobs_rays_s(f, f->jobs[i]);
    return sum;
}

void http_get_farm(struct request *r)
{
    uint64_t counts[JOB_STATE_COUNT];
    uint32_t threads, workers = connected(r->farm, &threads);
    struct buf b;
    buf_init(&b);
    count_jobs(r->farm, counts);
    buf_printf(&b, "{\"version\":\"%s\",\"jobs\":{", TILERY_VERSION);
    for (int i = 0; i < JOB_STATE_COUNT; i++)
        buf_printf(&b, "%s\"%s\":%" PRIu64, i ? "," : "", job_state_names[i], counts[i]);
    buf_printf(&b, "},\"workers\":%" PRIu32 ",\"threads\":%" PRIu32 ",\"rays_s\":%.0f,\"listen\":",
               workers, threads, rays_s(r->farm));
    json_put_text(&b, listener_address(r->farm->listener));
    buf_printf(&b, ",\"chunks\":%zu}\n", chunks_count(r->farm->chunks));
    request_reply(r, MHD_HTTP_OK, "application/json", &b);
}

void http_get_health(struct request *r)
{
    reply_text(r, MHD_HTTP_OK, "application/json", "{\"ok\":true}\n");
}

void http_post_session(struct request *r)
{
    static const char *const keys[] = {"token"};
    struct json_get g;
    struct diag_list problems;
    const char *token = "";
    if (!request_json(r, &g, &problems, keys, 1))
        return;
    (void)json_get_text(&g, g.root, "token", &token);
    if (http_token_good(r->http, token)) {
        char cookie[DIGEST_HEX_BYTES + 64];
        (void)snprintf(cookie, sizeof cookie, "tilery=%s; Path=/; HttpOnly; SameSite=Strict%s",
                       r->http->session, r->http->secure ? "; Secure" : "");
        reply_text(r, MHD_HTTP_OK, "application/json", "{\"ok\":true}\n");
        request_header(r, "Set-Cookie", cookie);
    } else {
        request_problem(r, MHD_HTTP_UNAUTHORIZED, "bad-token", "that is not this farm's token");
    }
    json_get_close(&g);
    diag_release(&problems);
}

/* --- Metrics -------------------------------------------------------------- */

static void metric(struct buf *b, const char *name, const char *type, const char *help, double v)
{
    buf_printf(b, "# HELP tilery_%s %s\n# TYPE tilery_%s %s\ntilery_%s %.17g\n", name, help, name,
               type, name, v);
}

static void put_job_metrics(struct buf *b, const struct farm *f)
{
    uint64_t counts[JOB_STATE_COUNT], film_bytes = 0, waiting = 0;
    count_jobs(f, counts);
    buf_printf(b, "# HELP tilery_jobs Jobs by state.\n# TYPE tilery_jobs gauge\n");
    for (int i = 0; i < JOB_STATE_COUNT; i++)
        buf_printf(b, "tilery_jobs{state=\"%s\"} %" PRIu64 "\n", job_state_names[i], counts[i]);
    for (size_t i = 0; i < f->job_count; i++)
        if (f->jobs[i]->film) {
            film_bytes += film_bytes_of(&f->jobs[i]->spec);
            waiting += film_waiting_bytes(f->jobs[i]->film);
        }
    metric(b, "film_bytes", "gauge", "Memory of films.", (double)film_bytes);
    metric(b, "film_waiting_bytes", "gauge", "Results that wait for an earlier sample block.",
           (double)waiting);
}

static void put_wire_metrics(struct buf *b, const struct farm *f)
{
    uint64_t in = 0, out = 0, frames_in = 0, frames_out = 0;
    for (size_t i = 0; i < f->worker_count; i++) {
        const struct worker *w = f->workers[i];
        struct conn_counts c = {0};
        if (w->conn)
            conn_counts_get(w->conn, &c);
        in += w->bytes_in + c.bytes_in;
        out += w->bytes_out + c.bytes_out;
        frames_in += w->frames_in + c.frames_in;
        frames_out += w->frames_out + c.frames_out;
    }
    metric(b, "wire_received_bytes_total", "counter", "Bytes from workers.", (double)in);
    metric(b, "wire_sent_bytes_total", "counter", "Bytes to workers.", (double)out);
    metric(b, "wire_received_frames_total", "counter", "Frames from workers.", (double)frames_in);
    metric(b, "wire_sent_frames_total", "counter", "Frames to workers.", (double)frames_out);
    metric(b, "connections_total", "counter", "Connections taken on the worker port.",
           (double)f->counters.connections);
    metric(b, "handshakes_refused_total", "counter", "Workers refused.",
           (double)f->counters.handshakes_refused);
}

void http_get_metrics(struct request *r)
{
    const struct farm *f = r->farm;
    uint32_t threads, workers = connected(f, &threads);
    struct buf b;
    buf_init(&b);
    buf_printf(&b,
               "# HELP tilery_build_info Version.\n# TYPE tilery_build_info gauge\n"
               "tilery_build_info{version=\"%s\"} 1\n",
               TILERY_VERSION);
    put_job_metrics(&b, f);
    metric(&b, "workers", "gauge", "Workers connected.", workers);
    metric(&b, "worker_threads", "gauge", "Their render threads.", threads);
    struct sched_farm_info info;
    sched_farm_info(f->sched, &info);
    metric(&b, "leases", "gauge", "Leases out.", info.leases);
    metric(&b, "results_total", "counter", "Results taken.", (double)f->counters.results);
    metric(&b, "results_refused_total", "counter", "Results that were damaged or impossible.",
           (double)f->counters.results_refused);
    metric(&b, "result_bytes_total", "counter", "Bytes of results.",
           (double)f->counters.result_bytes);
    metric(&b, "scene_bytes_total", "counter", "Bytes of scene chunks sent to workers.",
           (double)f->counters.scene_bytes);
    metric(&b, "samples_total", "counter", "Samples taken.", (double)f->counters.samples);
    metric(&b, "rays_total", "counter", "Rays traced by workers.", (double)f->counters.rays);
    metric(&b, "store_waiting_bytes", "gauge", "Results that wait for the disk.",
           (double)store_waiting_bytes(f->store));
    metric(&b, "chunks", "gauge", "Scene chunks on disk.", (double)chunks_count(f->chunks));
    put_wire_metrics(&b, f);
    metric(&b, "http_requests_total", "counter", "HTTP requests.",
           (double)r->http->counters.requests);
    metric(&b, "http_problems_total", "counter", "HTTP requests answered with an error.",
           (double)r->http->counters.problems);
    request_reply(r, MHD_HTTP_OK, "text/plain; version=0.0.4", &b);
}
