/* Connections of workers: see farm.h and proto/transport.h.
 *
 * A connection has no worker until its Hello was accepted. A worker whose connection is
 * gone stays in the table as lost; the same process (same instance number) takes its
 * place again, others get a new id. After a restart of the master the table is empty: then a
 * process gets the id back that this farm gave it before, as its Hello says. */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "common/json_put.h"
#include "common/log.h"
#include "common/mem.h"
#include "master/farm.h"

enum {
    QUEUE_BYTES_EARLY = 64 * 1024,
    CHUNKS_QUEUED_BYTES_MAX = 256 << 20, /* chunks waiting for one worker's socket */
    UNITS_UNKNOWN = -1,
};

/* A chunk that a worker asked for while much was queued for it, or while it is being read. */
struct chunk_wait {
    struct chunk_wait *next;
    struct farm *farm;
    uint64_t worker;
    uint32_t conns; /* of the worker when it asked: on another connection it has not */
    digest name;
};

struct worker *farm_worker(const struct farm *f, uint64_t id)
{
    size_t low = 0, high = f->worker_count;
    while (low < high) {
        size_t middle = (low + high) / 2;
        if (f->workers[middle]->id < id)
            low = middle + 1;
        else
            high = middle;
    }
    return low < f->worker_count && f->workers[low]->id == id ? f->workers[low] : NULL;
}

/* --- News --------------------------------------------------------------- */

enum sched_worker_state workers_state(const struct farm *f, const struct worker *w,
                                      struct sched_worker_info *info)
{
    *info = (struct sched_worker_info){.state = SCHED_WORKER_GONE};
    if (!sched_worker_info(f->sched, w->id, info))
        info->state = SCHED_WORKER_GONE;
    if (info->state == SCHED_WORKER_GONE)
        return SCHED_WORKER_GONE;
    return w->draining && info->state != SCHED_WORKER_QUARANTINED ? SCHED_WORKER_DRAINING
                                                                  : info->state;
}

/* An event about one worker: to followers of the farm, or of any job too (`all`). */
static void put_event(struct farm *f, struct worker *w, const char *state, int64_t units_returned,
                      bool all)
{
    struct buf b;
    buf_init(&b);
    buf_printf(&b, "[{\"id\":\"w%" PRIu64 "\",\"name\":", w->id);
    json_put_text(&b, w->name);
    buf_printf(&b, ",\"state\":\"%s\",\"units_returned\":", state);
    if (units_returned >= 0)
        buf_printf(&b, "%" PRId64, units_returned);
    else
        buf_printf(&b, "null");
    buf_printf(&b, ",\"threads\":%" PRIu32 ",\"note\":", w->threads);
    json_put_text(&b, w->note);
    buf_printf(&b, "}]");
    buf_put_u8(&b, '\0');
    if (buf_status(&b) == ERR_OK)
        events_add(f->events, all ? EVENTS_ALL_JOBS : 0, "workers", (const char *)b.data);
    buf_release(&b);
}

/* It joined, left, was lost, set aside, or drains: what followers of a job want to know. */
static void tell(struct farm *f, struct worker *w, const char *state, uint32_t units_returned)
{
    struct sched_worker_info info;
    w->told = workers_state(f, w, &info);
    put_event(f, w, state, units_returned, true);
}

void workers_changed(struct farm *f, struct worker *w)
{
    struct sched_worker_info info;
    enum sched_worker_state state = workers_state(f, w, &info), before = w->told;
    w->told = state;
    bool liar = state == SCHED_WORKER_QUARANTINED && before != state;
    put_event(f, w, sched_worker_state_name(state), liar ? UNITS_UNKNOWN : 0, liar);
}

/* A line in the log of every job that is being rendered. */
static void tell_jobs(struct farm *f, const char *text)
{
    for (size_t i = 0; i < f->job_count; i++)
        if (f->jobs[i]->rec.state == JOB_STATE_RENDERING)
            jobs_log(f, f->jobs[i], "%s", text);
}

/* The next pause is longer, also after a restart of the master. */
static void keep_pause(struct farm *f, const struct worker *w, uint64_t seconds)
{
    struct sched_worker_info info;
    if (sched_worker_info(f->sched, w->id, &info))
        verify_keep_past(
            f, &(struct worker_past){.id = w->id,
                                     .pauses = info.pauses,
                                     .until_us = farm_wall_us() + (int64_t)seconds * 1000000});
}

void workers_news(struct farm *f, const struct sched_action *a)
{
    struct worker *w = farm_worker(f, a->worker);
    if (!w)
        return;
    if (a->type == SCHED_DRAINED) {
        log_info("workers", "drained id=w%" PRIu64, w->id);
        workers_changed(f, w);
    } else if (a->state == SCHED_WORKER_SET_ASIDE) {
        uint64_t now = uv_now(f->loop);
        uint64_t left = a->until_ms > now ? (a->until_ms - now + 999) / 1000 : 0;
        (void)snprintf(w->note, sizeof w->note, "failed often; set aside for %" PRIu64 " s", left);
        log_warn("workers", "set aside id=w%" PRIu64 " seconds=%" PRIu64, w->id, left);
        keep_pause(f, w, left);
        if (w->conn) /* else it is being lost, which comes next */
            tell(f, w, "set-aside", a->losses);
    } else if (a->state == SCHED_WORKER_GONE) {
        char text[160];
        (void)snprintf(text, sizeof text,
                       "w%" PRIu64 " (%s) lost: its %" PRIu32
                       " units go to others, finished work stays",
                       w->id, w->name, a->losses);
        log_info("workers", "%s id=w%" PRIu64 " name=%s units=%" PRIu32 " why=\"%s\"",
                 w->said_goodbye ? "left" : "lost", w->id, w->name, a->losses, w->note);
        if (a->losses > 0)
            tell_jobs(f, text);
        tell(f, w, w->said_goodbye ? "left" : "lost", a->losses);
        jobs_keep_counts(f);
    } else {
        w->note[0] = '\0';
        workers_changed(f, w);
    }
}

/* --- Sending ------------------------------------------------------------ */

static void send_to(struct worker *w, const struct message *m, struct blob *body)
{
    if (!w->conn)
        return;
    enum err e = conn_send(w->conn, m, body);
    if (e == ERR_OK || e == ERR_CLOSED)
        return;
    log_warn("workers", "cannot send id=w%" PRIu64 " error=\"%s\"", w->id, err_text(e));
    conn_close(w->conn, e);
}

void workers_send(struct farm *f, uint64_t worker, const struct message *m)
{
    struct worker *w = farm_worker(f, worker);
    if (w)
        send_to(w, m, NULL);
}

void workers_open_job(struct farm *f, uint64_t worker, uint64_t job_id)
{
    struct worker *w = farm_worker(f, worker);
    struct job *job = farm_job(f, job_id);
    if (!w || !job)
        return;
    struct message m = {.type = FRAME_JOB_INFO};
    m.job_info.job = job_id;
    memcpy(m.job_info.package, job->rec.package.bytes, DIGEST_BYTES);
    size_t bytes = strlen(job->rec.spec_json);
    TL_ASSERT(bytes <= sizeof m.job_info.spec_json.bytes); /* checked at submission */
    memcpy(m.job_info.spec_json.bytes, job->rec.spec_json, bytes);
    m.job_info.spec_json.size = (pb_size_t)bytes;
    send_to(w, &m, NULL);
}

/* --- Chunks ------------------------------------------------------------- */

static void chunk_ready(void *ctx, enum err e, const digest *name, struct blob *frame,
                        uint64_t raw_bytes)
{
    struct chunk_wait *wait = ctx;
    struct farm *f = wait->farm;
    struct worker *w = farm_worker(f, wait->worker);
    bool asked = w && w->conns == wait->conns;
    mem_free(wait);
    if (!asked || f->stopping)
        return;
    struct message m = {0};
    if (e == ERR_OK) {
        m.type = FRAME_CHUNK_DATA;
        memcpy(m.chunk_data.sha256, name->bytes, DIGEST_BYTES);
        m.chunk_data.raw_bytes = raw_bytes;
        f->counters.scene_bytes += blob_bytes(frame);
    } else {
        m.type = FRAME_CHUNK_MISSING;
        memcpy(m.chunk_missing.sha256, name->bytes, DIGEST_BYTES);
    }
    send_to(w, &m, frame);
}

static void serve_chunks(struct farm *f, struct worker *w)
{
    while (w->conn && w->chunk_waits && conn_queued_bytes(w->conn) < CHUNKS_QUEUED_BYTES_MAX) {
        struct chunk_wait *wait = w->chunk_waits;
        w->chunk_waits = wait->next;
        digest name = wait->name;
        chunks_get(f->chunks, &name, chunk_ready, wait);
    }
}

static void ask_chunk(struct farm *f, struct worker *w, const tilery_ChunkRequest *m)
{
    struct chunk_wait *wait = mem_calloc(1, sizeof *wait);
    if (!wait) {
        conn_close(w->conn, ERR_NOMEM);
        return;
    }
    *wait = (struct chunk_wait){.farm = f, .worker = w->id, .conns = w->conns};
    memcpy(wait->name.bytes, m->sha256, DIGEST_BYTES);
    struct chunk_wait **end = &w->chunk_waits;
    while (*end)
        end = &(*end)->next;
    *end = wait;
    serve_chunks(f, w);
    struct sched_event event = {.type = SCHED_WORKER_ASKS, .worker = w->id};
    farm_feed(f, &event);
}

static void drop_chunk_waits(struct worker *w)
{
    while (w->chunk_waits) {
        struct chunk_wait *next = w->chunk_waits->next;
        mem_free(w->chunk_waits);
        w->chunk_waits = next;
    }
}

/* --- Hello -------------------------------------------------------------- */

static void refuse(struct farm *f, struct conn *c, tilery_RefuseReason reason, const char *text)
{
    log_warn("workers", "refused peer=%s why=\"%s\"", conn_peer(c), text);
    f->counters.handshakes_refused++;
    struct message m = {.type = FRAME_REFUSE};
    m.refuse.reason = reason;
    MESSAGE_TEXT(m.refuse.text, text);
    if (conn_send(c, &m, NULL) == ERR_OK)
        conn_finish(c, ERR_REFUSED);
    else
        conn_close(c, ERR_REFUSED);
}

/* Takes as long for a wrong token as for the right one. */
static bool token_equal(const char *given, const char *asked)
{
    digest a = digest_of(given, strlen(given)), b = digest_of(asked, strlen(asked));
    unsigned difference = 0;
    for (int i = 0; i < DIGEST_BYTES; i++)
        difference |= (unsigned)(a.bytes[i] ^ b.bytes[i]);
    return difference == 0;
}

/* NULL, or why this worker may not join. */
static const char *hello_problem(struct farm *f, const tilery_Hello *h, tilery_RefuseReason *reason,
                                 char *text, size_t text_bytes)
{
    *reason = tilery_RefuseReason_REFUSE_VERSION;
    if (h->protocol_min > PROTOCOL_VERSION_MAX || h->protocol_max < PROTOCOL_VERSION_MIN) {
        (void)snprintf(text, text_bytes,
                       "master speaks protocol %d to %d, this worker %" PRIu32 " to %" PRIu32
                       "; master is %s, worker is %s",
                       (int)PROTOCOL_VERSION_MIN, (int)PROTOCOL_VERSION_MAX, h->protocol_min,
                       h->protocol_max, TILERY_VERSION, h->build_id);
        return text;
    }
    *reason = tilery_RefuseReason_REFUSE_TOKEN;
    if (f->token && !token_equal(h->token, f->token))
        return "wrong or missing token; compare TILERY_TOKEN with the master's --token-file";
    *reason = tilery_RefuseReason_REFUSE_DETERMINISM;
    if (f->determinism_known &&
        memcmp(h->determinism_id, f->determinism.bytes, DIGEST_BYTES) != 0) {
        digest given;
        char ours[DIGEST_HEX_BYTES], theirs[DIGEST_HEX_BYTES];
        memcpy(given.bytes, h->determinism_id, DIGEST_BYTES);
        digest_to_hex(&f->determinism, ours);
        digest_to_hex(&given, theirs);
        (void)snprintf(text, text_bytes,
                       "this worker's pictures would differ: determinism id %.12s, the farm's is "
                       "%.12s; build %s",
                       theirs, ours, h->build_id);
        return text;
    }
    return NULL;
}

static void forget(struct farm *f, size_t at)
{
    drop_chunk_waits(f->workers[at]);
    mem_free(f->workers[at]);
    f->worker_count--;
    memmove(f->workers + at, f->workers + at + 1, (f->worker_count - at) * sizeof *f->workers);
}

/* Makes room in a full table: forgets the worker that is lost for longest. */
static bool forget_one(struct farm *f)
{
    size_t oldest = f->worker_count;
    for (size_t i = 0; i < f->worker_count; i++) {
        struct worker *w = f->workers[i];
        if (!w->conn && (oldest == f->worker_count || w->seen_ms < f->workers[oldest]->seen_ms))
            oldest = i;
    }
    if (oldest == f->worker_count)
        return false;
    forget(f, oldest);
    return true;
}

/* The id that this farm gave the process in an earlier life, if it can have it; else 0. One
 * slightly beyond worker_next is true as well: a kill can come before that was on disk. */
static uint64_t id_of_before(const struct farm *f, const tilery_Hello *h)
{
    const char *digits = h->last_id + 1;
    if (h->instance == 0 || h->last_farm != f->id || h->last_id[0] != 'w' || digits[0] < '1')
        return 0;
    uint64_t id = 0, limit = f->worker_next + FARM_WORKERS_MAX;
    for (; *digits >= '0' && *digits <= '9' && id < limit; digits++)
        id = id * 10 + (uint64_t)(*digits - '0');
    return *digits || id >= limit || id > UINT32_MAX || farm_worker(f, id) ? 0 : id;
}

/* Puts it where its id belongs; there is room. */
static void insert_worker(struct farm *f, struct worker *w)
{
    size_t at = f->worker_count++;
    for (; at > 0 && f->workers[at - 1]->id > w->id; at--)
        f->workers[at] = f->workers[at - 1];
    f->workers[at] = w;
}

/* The worker of this process, or a new one; NULL: no room. */
static struct worker *worker_of(struct farm *f, const tilery_Hello *h)
{
    for (size_t i = f->worker_count; i-- > 0;)
        if (f->workers[i]->instance == h->instance && h->instance != 0)
            return f->workers[i];
    if (f->worker_count >= FARM_WORKERS_MAX && !forget_one(f))
        return NULL;
    struct worker *w = mem_calloc(1, sizeof *w);
    if (!w ||
        !mem_grow((void **)&f->workers, f->worker_count, &f->worker_capacity, sizeof *f->workers)) {
        mem_free(w);
        return NULL;
    }
    w->farm = f;
    w->id = id_of_before(f, h);
    w->instance = h->instance;
    if (w->id == 0)
        w->id = f->worker_next;
    insert_worker(f, w);
    if (w->id < f->worker_next)
        return w;
    f->worker_next = w->id + 1;
    if (store_put_value(f->store, "worker_next", &f->worker_next, sizeof f->worker_next) != ERR_OK)
        log_warn("workers", "worker number not stored id=w%" PRIu64, w->id);
    return w;
}

/* The store works in order: this is on disk before any result of the worker is. */
static void keep_determinism(struct farm *f, const tilery_Hello *h)
{
    if (f->determinism_known)
        return;
    memcpy(f->determinism.bytes, h->determinism_id, DIGEST_BYTES);
    f->determinism_known = true;
    if (store_put_value(f->store, "determinism", f->determinism.bytes, DIGEST_BYTES) != ERR_OK)
        log_warn("workers", "determinism id not stored");
}

static void fill_worker(struct worker *w, const tilery_Hello *h)
{
    (void)snprintf(w->name, sizeof w->name, "%s", h->name);
    (void)snprintf(w->host, sizeof w->host, "%s", h->host);
    (void)snprintf(w->cpu, sizeof w->cpu, "%s", h->cpu);
    (void)snprintf(w->build, sizeof w->build, "%s", h->build_id);
    w->tags.count = h->tags_count;
    for (uint32_t i = 0; i < w->tags.count; i++)
        (void)snprintf(w->tags.words[i], TAG_BYTES, "%s", h->tags[i]);
    w->threads = h->threads;
    w->draining = false;
    w->said_goodbye = false;
    w->note[0] = '\0';
    w->joined_us = farm_wall_us();
}

/* Tells the scheduler that it is here, and which leases of this farm it has brought along. */
static void join(struct farm *f, struct worker *w, const tilery_Hello *h)
{
    static const enum sched_held_state states[] = {
        [tilery_HELD_WAITING] = SCHED_HELD_WAITING,
        [tilery_HELD_BEGUN] = SCHED_HELD_BEGUN,
        [tilery_HELD_RESULT] = SCHED_HELD_RESULT,
    };
    struct sched_held held[LIMIT_HELD_TOLD];
    size_t count = h->last_farm == f->id ? h->held_count : 0;
    for (size_t i = 0; i < count; i++) {
        const tilery_Held *from = &h->held[i];
        held[i] = (struct sched_held){.job = from->job,
                                      .epoch = from->epoch,
                                      .unit = {from->cell_begin, from->cell_count, from->block},
                                      .state = states[from->state]};
    }
    w->tag_bits = tag_table_bits(&f->tag_table, &w->tags);
    struct sched_event event = {
        .type = SCHED_WORKER_JOIN,
        .worker = w->id,
        .join = {.threads = w->threads, .tags = w->tag_bits, .held = held, .held_count = count}};
    farm_feed(f, &event);
}

void workers_retag(struct farm *f)
{
    for (size_t i = 0; i < f->worker_count; i++) {
        struct worker *w = f->workers[i];
        uint64_t bits = tag_table_bits(&f->tag_table, &w->tags);
        if (!w->conn || bits == w->tag_bits)
            continue;
        w->tag_bits = bits;
        struct sched_event event = {.type = SCHED_WORKER_TAGS, .worker = w->id, .tags = bits};
        farm_feed(f, &event);
    }
}

/* Its connection is not its own any more. */
static void take_conn(struct worker *w)
{
    struct conn_counts counts;
    conn_counts_get(w->conn, &counts);
    w->bytes_in += counts.bytes_in;
    w->bytes_out += counts.bytes_out;
    w->frames_in += counts.frames_in;
    w->frames_out += counts.frames_out;
    w->conn = NULL;
    drop_chunk_waits(w);
}

static void tell_joined(struct farm *f, struct worker *w, bool back, uint32_t held)
{
    log_info(
        "workers", "%s id=w%" PRIu64 " name=%s host=%s threads=%" PRIu32 " peer=%s held=%" PRIu32,
        back ? "back" : "joined", w->id, w->name, w->host, w->threads, conn_peer(w->conn), held);
    if (back) {
        workers_changed(f, w);
        return;
    }
    char line[160];
    (void)snprintf(line, sizeof line, "w%" PRIu64 " (%s) joined, %" PRIu32 " thread%s", w->id,
                   w->name, w->threads, w->threads == 1 ? "" : "s");
    tell_jobs(f, line);
    tell(f, w, "joined", 0);
}

static void hello(struct farm *f, struct conn *c, const tilery_Hello *h)
{
    tilery_RefuseReason reason;
    char text[sizeof((struct message *)0)->refuse.text];
    const char *problem = hello_problem(f, h, &reason, text, sizeof text);
    if (problem) {
        refuse(f, c, reason, problem);
        return;
    }
    struct worker *w = worker_of(f, h);
    if (!w) {
        refuse(f, c, tilery_RefuseReason_REFUSE_FULL, "the worker table is full; try again later");
        return;
    }
    if (w->conn) {
        /* The same process came back before its old connection was known to be dead. */
        struct conn *old = w->conn;
        take_conn(w);
        conn_set_ctx(old, NULL);
        conn_close(old, ERR_CLOSED);
    }
    struct sched_worker_info info;
    bool back = workers_state(f, w, &info) != SCHED_WORKER_GONE; /* before it was lost */
    keep_determinism(f, h);
    fill_worker(w, h);
    w->conn = c;
    w->conns++;
    w->seen_ms = farm_now_ms(f);
    conn_set_ctx(c, w);
    conn_accept(c);
    conn_set_silence(c, LIMIT_MISSED_HEARTBEATS * FARM_HEARTBEAT_MS);
    struct message m = {.type = FRAME_WELCOME};
    m.welcome.protocol =
        h->protocol_max < PROTOCOL_VERSION_MAX ? h->protocol_max : PROTOCOL_VERSION_MAX;
    m.welcome.heartbeat_ms = FARM_HEARTBEAT_MS;
    m.welcome.farm = f->id;
    (void)snprintf(m.welcome.worker_id, sizeof m.welcome.worker_id, "w%" PRIu64, w->id);
    send_to(w, &m, NULL);
    verify_tell_past(f, w->id);
    join(f, w, h);
    tell_joined(f, w, back, h->held_count);
}

/* --- Messages ----------------------------------------------------------- */

static void heartbeat(struct farm *f, struct worker *w, const tilery_Heartbeat *m)
{
    struct message answer = {.type = FRAME_HEARTBEAT, .heartbeat = *m};
    if (conn_queued_bytes(w->conn) < QUEUE_BYTES_EARLY)
        send_to(w, &answer, NULL);
    serve_chunks(f, w);
    if (m->draining && !w->draining) {
        w->draining = true;
        struct sched_event event = {.type = SCHED_WORKER_DRAIN, .worker = w->id};
        farm_feed(f, &event);
        tell(f, w, "draining", 0);
    }
    if (m->rtt_us > 0 && m->rtt_us != w->rtt_us) {
        w->rtt_us = m->rtt_us;
        struct sched_event event = {.type = SCHED_WORKER_RTT, .worker = w->id, .rtt_us = m->rtt_us};
        farm_feed(f, &event);
    }
}

static void job_ready(struct farm *f, struct worker *w, const tilery_JobReady *m)
{
    struct job *job = farm_job(f, m->job);
    if (job) {
        struct job_stats *s = &job->rec.stats;
        s->load_s = m->load_seconds > s->load_s ? m->load_seconds : s->load_s;
        s->build_s = m->build_seconds > s->build_s ? m->build_seconds : s->build_s;
        s->scene_sent_bytes += m->received_bytes;
        if (job->ready_us == 0)
            job->ready_us = farm_wall_us();
        if (m->received_bytes > 0)
            jobs_store_record(f, job); /* once per worker and job: a restart must not forget it */
    }
    struct sched_event event = {.type = SCHED_JOB_READY, .worker = w->id, .job = m->job};
    farm_feed(f, &event);
}

static void job_failed(struct farm *f, struct worker *w, const tilery_JobFailed *m)
{
    struct job *job = farm_job(f, m->job);
    log_warn("workers",
             "job refused by worker id=w%" PRIu64 " job=j%" PRIu64 " error=%s text=\"%s\"", w->id,
             m->job, m->error, m->text);
    if (job)
        jobs_log(f, job, "w%" PRIu64 " (%s) cannot render this job: %s", w->id, w->name, m->text);
    struct sched_event event = {.type = SCHED_JOB_UNFIT, .worker = w->id, .job = m->job};
    farm_feed(f, &event);
}

static void unit_failed(struct farm *f, struct worker *w, const tilery_UnitFailed *m)
{
    struct job *job = farm_job(f, m->job);
    log_warn("workers", "unit failed id=w%" PRIu64 " job=j%" PRIu64 " error=%s text=\"%s\"", w->id,
             m->job, m->error, m->text);
    if (job)
        jobs_log(f, job, "a unit failed on w%" PRIu64 " (%s): %s", w->id, w->name, m->text);
    struct sched_event event = {
        .type = SCHED_UNIT_FAILED, .worker = w->id, .job = m->job, .epoch = m->epoch};
    farm_feed(f, &event);
}

static void on_message(void *ctx, struct conn *c, const struct message *m,
                       const unsigned char *body, size_t body_bytes)
{
    (void)body;
    if (!conn_accepted(c)) {
        if (m->type == FRAME_HELLO)
            hello(ctx, c, &m->hello);
        else
            refuse(ctx, c, tilery_RefuseReason_REFUSE_PROTOCOL,
                   "the first message must be a Hello");
        return;
    }
    struct worker *w = ctx;
    struct farm *f = w->farm;
    w->seen_ms = farm_now_ms(f);
    switch (m->type) {
    case FRAME_HEARTBEAT:
        heartbeat(f, w, &m->heartbeat);
        break;
    case FRAME_JOB_READY:
        job_ready(f, w, &m->job_ready);
        break;
    case FRAME_JOB_FAILED:
        job_failed(f, w, &m->job_failed);
        break;
    case FRAME_CHUNK_REQUEST:
        ask_chunk(f, w, &m->chunk_request);
        break;
    case FRAME_RESULT: {
        unsigned char *taken = conn_take_body(c);
        if (!f->stopping)
            results_take(f, w, &m->result, taken, body_bytes);
        else
            mem_free(taken);
        break;
    }
    case FRAME_UNIT_FAILED:
        unit_failed(f, w, &m->unit_failed);
        break;
    case FRAME_GOODBYE:
        w->said_goodbye = true;
        conn_close(c, ERR_OK);
        break;
    default:
        conn_close(c, ERR_CORRUPT);
        break;
    }
}

/* Of registered workers alone, and no longer than their encoder can make of so many values. Memory
 * is taken as the bytes come; whether it is a unit of ours is looked at when they are there, since
 * a late result of a job that is gone is no fault of its worker. */
static enum err body_wanted(void *ctx, struct conn *c, const struct message *m, uint32_t body_bytes)
{
    (void)ctx;
    if (!conn_accepted(c) || m->type != FRAME_RESULT)
        return ERR_CORRUPT;
    uint64_t raw = m->result.raw_bytes;
    return body_bytes <= raw + raw / 128 + 1024 ? ERR_OK : ERR_LIMIT;
}

/* --- Losing ------------------------------------------------------------- */

static void detach(struct farm *f, struct worker *w, enum err why)
{
    take_conn(w);
    if (f->stopping)
        return;
    bool left = w->said_goodbye;
    (void)snprintf(w->note, sizeof w->note, "%s",
                   left                 ? "left"
                   : why == ERR_TIMEOUT ? "silent for 3 s"
                   : why == ERR_OK      ? "connection closed"
                                        : err_text(why));
    log_debug("workers", "connection lost id=w%" PRIu64 " name=%s why=\"%s\"", w->id, w->name,
              w->note);
    struct sched_event event = {.type = left ? SCHED_WORKER_LEFT : SCHED_WORKER_AWAY,
                                .worker = w->id};
    farm_feed(f, &event); /* once it is gone, news of it come */
}

static void on_close(void *ctx, struct conn *c, enum err why)
{
    if (!conn_accepted(c)) {
        log_debug("workers", "connection ended peer=%s why=\"%s\"", conn_peer(c), err_text(why));
        return;
    }
    struct worker *w = ctx;
    if (w && w->conn == c) /* not when the worker came back by another one */
        detach(w->farm, w, why);
}

static void on_open(void *ctx, struct conn *c)
{
    struct farm *f = ctx;
    f->counters.connections++;
    log_debug("workers", "connection peer=%s", conn_peer(c));
}

/* --- Start and stop ------------------------------------------------------ */

enum err workers_listen(struct farm *f, const char *address, int fd)
{
    struct conn_options options = {
        .peer_side = FRAME_SIDE_WORKER,
        .handlers = {.on_open = on_open,
                     .on_message = on_message,
                     .body_wanted = body_wanted,
                     .on_close = on_close},
        .ctx = f,
        .tls = f->tls,
        .handshake_ms = LIMIT_HANDSHAKE_MS,
        /* Any chunk fits beside what must not wait for it; see CHUNKS_QUEUED_BYTES_MAX. */
        .queue_bytes_max = (size_t)LIMIT_CHUNK_BODY_BYTES + CHUNKS_QUEUED_BYTES_MAX * 2,
    };
    uint32_t people, connections;
    farm_connection_limits(FARM_PEOPLE_MAX, &people, &connections);
    enum err e = fd >= 0 ? listener_adopt(f->transport, fd, connections, &options, &f->listener)
                         : listener_new(f->transport, address, connections, &options, &f->listener);
    if (e != ERR_OK)
        log_error("master", "cannot listen for workers address=%s error=\"%s\"", address,
                  e == ERR_USAGE ? "not an ADDRESS:PORT" : err_text(e));
    return e;
}

void workers_stop(struct farm *f)
{
    if (f->listener)
        listener_close(f->listener);
    f->listener = NULL;
    struct message m = {.type = FRAME_REFUSE};
    m.refuse.reason = tilery_RefuseReason_REFUSE_SHUTDOWN;
    MESSAGE_TEXT(m.refuse.text, "the master stops; come back later");
    for (size_t i = 0; i < f->worker_count; i++) {
        struct worker *w = f->workers[i];
        if (!w->conn)
            continue;
        send_to(w, &m, NULL);
        if (w->conn)
            conn_finish(w->conn, ERR_OK);
    }
}

void workers_release(struct farm *f)
{
    for (size_t i = 0; i < f->worker_count; i++) {
        drop_chunk_waits(f->workers[i]);
        mem_free(f->workers[i]);
    }
    mem_free(f->workers);
}

enum err workers_drain(struct farm *f, struct worker *w)
{
    if (!w->conn)
        return ERR_STATE;
    if (w->draining)
        return ERR_OK;
    w->draining = true;
    struct sched_event event = {.type = SCHED_WORKER_DRAIN, .worker = w->id};
    farm_feed(f, &event);
    struct message m = {.type = FRAME_DRAIN};
    MESSAGE_TEXT(m.drain.reason, "asked for");
    send_to(w, &m, NULL);
    tell(f, w, "draining", 0);
    return ERR_OK;
}

/* Those that left or were lost long ago are of no interest to people any more. One that returns
 * after that brings its id along. */
static void forget_old(struct farm *f)
{
    for (size_t i = f->worker_count; i-- > 0;) {
        struct worker *w = f->workers[i];
        struct sched_worker_info info;
        if (!w->conn && farm_now_ms(f) - w->seen_ms > (int64_t)f->keep_lost_s * 1000 &&
            workers_state(f, w, &info) == SCHED_WORKER_GONE)
            forget(f, i);
    }
}

void workers_tick(struct farm *f)
{
    for (size_t i = 0; i < f->worker_count; i++) {
        struct worker *w = f->workers[i];
        struct sched_worker_info info;
        if (w->conn && workers_state(f, w, &info) != w->told)
            workers_changed(f, w);
    }
    forget_old(f);
}
