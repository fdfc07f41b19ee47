#include "worker/session.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>
#include <sys/random.h>
#include <uv.h>

#include "common/log.h"
#include "common/mem.h"
#include "worker/work.h"

enum {
    RECONNECT_MS_MIN = 250,
    RECONNECT_MS_MAX = 500,
    FULL_MS = 2000,            /* before asking a master again that has no room */
    DRAIN_LOST_MS = 10 * 1000, /* a draining worker looks so long for a master that is gone */
    QUEUE_BYTES_MAX = 1 << 20,
};

struct session {
    struct session_options options;
    uv_loop_t *loop;
    struct transport *transport;
    struct conn *conn; /* NULL: none now */
    struct work *work;
    uv_timer_t heartbeat, reconnect;
    uint64_t instance, farm;
    char id[sizeof((tilery_Welcome *)0)->worker_id]; /* in that farm; empty: none yet */
    bool welcomed_once, registered, draining, goodbye, over, closing;
    uint32_t lost_count;    /* attempts since the last registration */
    uint64_t drain_lost_ms; /* when a draining worker lost its master; 0: it has not */
    uint64_t sequence, rtt_us;
    uint64_t jitter;
    uint32_t reconnect_ms_min; /* of the next attempt, as the last Refuse asks */
    int open_handles;
    void (*closed)(void *ctx);
    void *closed_ctx;
};

static void connect_now(struct session *s);

/* --- The end ------------------------------------------------------------------------ */

static void end(struct session *s, int exit_status)
{
    if (s->over)
        return;
    s->over = true;
    (void)uv_timer_stop(&s->reconnect);
    s->options.ended(s->options.ctx, exit_status);
}

/* --- Sending ------------------------------------------------------------------------ */

static enum err send_message(void *ctx, const struct message *m, struct blob *body)
{
    struct session *s = ctx;
    if (!s->conn || !s->registered)
        return ERR_CLOSED;
    enum err e = conn_send(s->conn, m, body);
    /* Results wait in work.h; whatever else finds no room would be lost, so begin anew. */
    if (e != ERR_OK && !(e == ERR_AGAIN && m->type == FRAME_RESULT))
        conn_close(s->conn, e);
    return e;
}

static void say_hello(struct session *s)
{
    const struct session_options *o = &s->options;
    struct message m = {.type = FRAME_HELLO};
    tilery_Hello *h = &m.hello;
    h->protocol_min = PROTOCOL_VERSION_MIN;
    h->protocol_max = PROTOCOL_VERSION_MAX;
    MESSAGE_TEXT(h->build_id, TILERY_VERSION);
    memcpy(h->determinism_id, o->determinism_id.bytes, DIGEST_BYTES);
    MESSAGE_TEXT(h->name, o->name);
    MESSAGE_TEXT(h->host, o->host);
    MESSAGE_TEXT(h->cpu, o->cpu);
    MESSAGE_TEXT(h->token, o->token);
    h->threads = pool_thread_count(o->pool);
    for (uint32_t i = 0; i < o->tag_count; i++)
        MESSAGE_TEXT(h->tags[i], o->tags[i]);
    h->tags_count = (pb_size_t)o->tag_count;
    h->instance = s->instance;
    MESSAGE_TEXT(h->last_id, s->id);
    h->last_farm = s->farm;
    h->held_count = (pb_size_t)work_held(s->work, h->held);
    enum err e = conn_send(s->conn, &m, NULL);
    if (e != ERR_OK)
        conn_close(s->conn, e);
}

static void beat(struct session *s)
{
    struct message m = {.type = FRAME_HEARTBEAT,
                        .heartbeat = {.sequence = ++s->sequence,
                                      .sent_us = uv_hrtime() / 1000,
                                      .rtt_us = s->rtt_us,
                                      .busy_threads = pool_busy(s->options.pool),
                                      .draining = s->draining}};
    enum err ignored = send_message(s, &m, NULL);
    (void)ignored;
    work_flush(s->work);
}

static void on_heartbeat_timer(uv_timer_t *timer)
{
    beat(timer->data);
}

/* --- Draining ----------------------------------------------------------------------- */

/* Goodbye, once nothing is held and nothing waits for an acknowledgement. */
static void leave_if_done(struct session *s)
{
    if (!s->draining || s->goodbye || s->over || !work_idle(s->work))
        return;
    s->goodbye = true;
    if (!s->registered) {
        end(s, 0);
        return;
    }
    struct message m = {.type = FRAME_GOODBYE};
    MESSAGE_TEXT(m.goodbye.reason, "drained");
    enum err ignored = send_message(s, &m, NULL);
    (void)ignored;
    log_info("session", "goodbye, all delivered");
    (void)uv_timer_stop(&s->heartbeat);
    conn_finish(s->conn, ERR_OK); /* on_close ends */
}

static void on_settled(void *ctx)
{
    leave_if_done(ctx);
}

void session_drain(struct session *s)
{
    if (s->draining)
        return;
    s->draining = true;
    log_info("session", "draining results=%" PRIu32, work_result_count(s->work));
    work_drain(s->work);
    if (s->registered)
        beat(s);
    else
        s->drain_lost_ms = uv_now(s->loop);
    leave_if_done(s);
}

/* --- Messages ----------------------------------------------------------------------- */

static void on_welcome(struct session *s, const tilery_Welcome *w)
{
    if (w->protocol < PROTOCOL_VERSION_MIN || w->protocol > PROTOCOL_VERSION_MAX) {
        conn_close(s->conn, ERR_VERSION);
        return;
    }
    conn_accept(s->conn);
    conn_set_silence(s->conn, w->heartbeat_ms * LIMIT_MISSED_HEARTBEATS);
    s->registered = true;
    s->lost_count = 0;
    s->drain_lost_ms = 0;
    bool same_farm = s->welcomed_once && s->farm == w->farm;
    s->farm = w->farm;
    (void)snprintf(s->id, sizeof s->id, "%s", w->worker_id);
    log_info("session", "registered master=%s id=%s same_farm=%d results=%" PRIu32,
             conn_peer(s->conn), w->worker_id, same_farm, work_result_count(s->work));
    if (!s->welcomed_once)
        s->options.registered(s->options.ctx, w->worker_id);
    s->welcomed_once = true;
    (void)uv_timer_start(&s->heartbeat, on_heartbeat_timer, 0, w->heartbeat_ms);
    work_connected(s->work, same_farm);
    leave_if_done(s);
}

struct refusal {
    tilery_RefuseReason reason;
    const char *hint, *id;
};

/* Refusals that trying again does not change, and what to do about them. */
static const struct refusal final_refusals[] = {
    {tilery_REFUSE_VERSION, "install the master's version here", "version-mismatch"},
    {tilery_REFUSE_DETERMINISM,
     "its pictures would differ in their bits: build master's and workers' version alike",
     "determinism-mismatch"},
    {tilery_REFUSE_TOKEN, "compare TILERY_TOKEN here with the master's --token-file", "bad-token"},
};

static void on_refuse(struct session *s, const tilery_Refuse *m)
{
    for (size_t i = 0; i < sizeof final_refusals / sizeof *final_refusals; i++) {
        const struct refusal *r = &final_refusals[i];
        if (r->reason != m->reason)
            continue;
        (void)fprintf(stderr,
                      "tilery-worker: the master at %s refused this worker: %s\n"
                      "  this is tilery-worker " TILERY_VERSION ", protocol %d to %d; %s  [%s]\n",
                      s->options.master, m->text, PROTOCOL_VERSION_MIN, PROTOCOL_VERSION_MAX,
                      r->hint, r->id);
        conn_close(s->conn, ERR_REFUSED);
        end(s, err_exit_status(ERR_REFUSED));
        return;
    }
    log_warn("session", "refused, will try again master=%s reason=%d text=\"%s\"",
             s->options.master, (int)m->reason, m->text);
    if (m->reason == tilery_REFUSE_FULL)
        s->reconnect_ms_min = FULL_MS;
    conn_close(s->conn, ERR_REFUSED);
}

static void on_heartbeat(struct session *s, const tilery_Heartbeat *h)
{
    uint64_t now = uv_hrtime() / 1000;
    if (h->sequence == s->sequence && h->sent_us <= now)
        s->rtt_us = now - h->sent_us;
}

static void on_message(void *ctx, struct conn *c, const struct message *m,
                       const unsigned char *body, size_t body_bytes)
{
    struct session *s = ctx;
    enum err e = ERR_OK;
    switch (m->type) {
    case FRAME_WELCOME:
        on_welcome(s, &m->welcome);
        break;
    case FRAME_REFUSE:
        on_refuse(s, &m->refuse);
        break;
    case FRAME_HEARTBEAT:
        on_heartbeat(s, &m->heartbeat);
        break;
    case FRAME_DRAIN:
        log_info("session", "the master asks to drain reason=\"%s\"", m->drain.reason);
        session_drain(s);
        break;
    default:
        e = work_message(s->work, m, body ? conn_take_body(c) : NULL, body_bytes);
    }
    if (e != ERR_OK)
        conn_close(c, e);
}

static enum err on_body_wanted(void *ctx, struct conn *c, const struct message *m,
                               uint32_t body_bytes)
{
    (void)c;
    struct session *s = ctx;
    return work_body_wanted(s->work, m, body_bytes);
}

/* --- Connecting --------------------------------------------------------------------- */

static void on_open(void *ctx, struct conn *c)
{
    (void)c;
    say_hello(ctx);
}

/* So that a thousand workers do not come back in the same millisecond. */
static uint64_t next_jitter(struct session *s, uint64_t below)
{
    s->jitter = s->jitter * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (s->jitter >> 33) % below;
}

static void on_reconnect_timer(uv_timer_t *timer)
{
    connect_now(timer->data);
}

static void connect_later(struct session *s, bool at_once)
{
    uint64_t ms = 0;
    if (!at_once)
        ms = RECONNECT_MS_MIN + next_jitter(s, RECONNECT_MS_MAX - RECONNECT_MS_MIN);
    if (ms < s->reconnect_ms_min)
        ms = s->reconnect_ms_min;
    s->reconnect_ms_min = 0;
    (void)uv_timer_start(&s->reconnect, on_reconnect_timer, ms, 0);
}

/* What has said nothing, or something else than a master says to workers. */
static bool is_stranger(enum err why)
{
    return why == ERR_TIMEOUT || why == ERR_CORRUPT;
}

/* One line when it begins, not one an attempt. */
static void log_loss(struct session *s, bool was_registered, enum err why)
{
    if (was_registered)
        log_warn("session", "connection lost master=%s why=\"%s\" results=%" PRIu32,
                 s->options.master, why == ERR_OK ? "closed by the master" : err_text(why),
                 work_result_count(s->work));
    else if (s->lost_count == 1)
        log_warn("session", "cannot register master=%s why=\"%s%s\", trying on every %d ms",
                 s->options.master, err_text(why),
                 is_stranger(why) ? "; is that the master's --listen address?" : "",
                 RECONNECT_MS_MAX);
    else
        log_debug("session", "cannot register master=%s why=\"%s\"", s->options.master,
                  err_text(why));
}

static void end_untrusted(struct session *s, const char *problem)
{
    (void)fprintf(stderr,
                  "tilery-worker: no trust between this worker and the master at %s: %s\n"
                  "  compare --tls-ca here with the master's --tls-cert, and --tls-cert here with "
                  "its --tls-client-ca  [untrusted]\n",
                  s->options.master, problem);
    end(s, err_exit_status(ERR_UNTRUSTED));
}

static void on_close(void *ctx, struct conn *c, enum err why)
{
    struct session *s = ctx;
    bool was_registered = s->registered;
    s->conn = NULL;
    s->registered = false;
    (void)uv_timer_stop(&s->heartbeat);
    if (s->closing || s->over)
        return;
    if (was_registered)
        work_disconnected(s->work);
    else
        s->lost_count++;
    if (s->goodbye) {
        end(s, 0);
        return;
    }
    if (why == ERR_UNTRUSTED && !s->welcomed_once) {
        end_untrusted(s, conn_problem(c));
        return;
    }
    log_loss(s, was_registered, why);
    if (s->draining) {
        uint64_t now = uv_now(s->loop);
        if (s->drain_lost_ms == 0)
            s->drain_lost_ms = now;
        leave_if_done(s);
        if (!s->over && now - s->drain_lost_ms > DRAIN_LOST_MS) {
            log_warn("session", "the master is gone: results undelivered=%" PRIu32,
                     work_result_count(s->work));
            end(s, 0);
        }
        if (s->over)
            return;
    }
    connect_later(s, was_registered);
}

static void connect_now(struct session *s)
{
    struct conn_options options = {
        .peer_side = FRAME_SIDE_MASTER,
        .handlers = {.on_open = on_open,
                     .on_message = on_message,
                     .body_wanted = on_body_wanted,
                     .on_close = on_close},
        .ctx = s,
        .tls = s->options.tls,
        .queue_bytes_max = QUEUE_BYTES_MAX,
    };
    TL_ASSERT(!s->conn && !s->over);
    if (conn_connect(s->transport, s->options.master, &options, &s->conn) != ERR_OK)
        connect_later(s, false); /* out of memory now; the text was checked by session_new */
}

/* --- Life --------------------------------------------------------------------------- */

enum err session_new(struct uv_loop_s *loop, const struct session_options *options,
                     struct session **out)
{
    struct session *s = mem_calloc(1, sizeof *s);
    if (!s)
        return ERR_NOMEM;
    s->options = *options;
    s->loop = loop;
    if (getrandom(&s->instance, sizeof s->instance, 0) != sizeof s->instance)
        s->instance = uv_hrtime();
    s->jitter = s->instance;
    struct work_options work = {.pool = options->pool,
                                .cache = options->cache,
                                .scene_bytes_max = options->scene_bytes_max,
                                .eager = options->eager,
                                .outlet = {.send = send_message, .ctx = s},
                                .settled = on_settled,
                                .ctx = s};
    enum err e = work_new(&work, &s->work);
    if (e == ERR_OK)
        e = transport_new(loop, &s->transport);
    if (e != ERR_OK) {
        work_free(s->work);
        mem_free(s);
        return e;
    }
    (void)uv_timer_init(loop, &s->heartbeat); /* cannot fail */
    (void)uv_timer_init(loop, &s->reconnect);
    s->heartbeat.data = s->reconnect.data = s;
    s->open_handles = 3; /* the two and the transport */
    connect_now(s);
    *out = s;
    return ERR_OK;
}

static void one_closed(struct session *s)
{
    if (--s->open_handles == 0 && s->closed)
        s->closed(s->closed_ctx);
}

static void on_timer_closed(uv_handle_t *handle)
{
    one_closed(handle->data);
}

static void on_transport_closed(void *ctx)
{
    one_closed(ctx);
}

void session_close(struct session *s, void (*closed)(void *ctx), void *ctx)
{
    TL_ASSERT(!s->closing);
    s->closing = s->over = true;
    s->closed = closed;
    s->closed_ctx = ctx;
    work_stop(s->work);
    uv_close((uv_handle_t *)&s->heartbeat, on_timer_closed);
    uv_close((uv_handle_t *)&s->reconnect, on_timer_closed);
    transport_close(s->transport, on_transport_closed, s);
}

void session_free(struct session *s)
{
    if (!s)
        return;
    work_free(s->work);
    mem_free(s);
}
