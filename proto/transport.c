#include "proto/transport.h"

#include <signal.h>
#include <string.h>

#include "common/log.h"
#include "common/mem.h"
#include "proto/transport_impl.h"

enum {
    QUEUE_BYTES_DEFAULT = 1024 * 1024,
    FINISH_MS = 2000, /* conn_finish waits so long for the peer to close */
    SUSPECT_MS = 100, /* after a stall of our own, what came meanwhile is read first */
    KEEPALIVE_SECONDS = 30,
};

enum err transport_error(int uv_status)
{
    switch (uv_status) {
    case UV_EOF:
    case UV_ECONNRESET:
    case UV_EPIPE:
    case UV_ECANCELED:
        return ERR_CLOSED;
    case UV_ETIMEDOUT:
        return ERR_TIMEOUT;
    case UV_EADDRINUSE:
    case UV_EADDRNOTAVAIL:
    case UV_EACCES:
        return ERR_ADDRESS;
    case UV_ENOMEM:
        return ERR_NOMEM;
    default:
        return ERR_IO;
    }
}

/* --- Transport ------------------------------------------------------------------ */

static void on_idle(uv_idle_t *idle);

enum err transport_new(struct uv_loop_s *loop, struct transport **out)
{
    struct transport *t = mem_calloc(1, sizeof *t);
    unsigned char *input = mem_alloc(INPUT_BYTES + PLAIN_BYTES);
    if (!t || !input) {
        mem_free(t);
        mem_free(input);
        return ERR_NOMEM;
    }
    t->loop = loop;
    t->input = input;
    t->plain = input + INPUT_BYTES;
    TAILQ_INIT(&t->conns);
    TAILQ_INIT(&t->waiting);
    TAILQ_INIT(&t->listeners);
    (void)uv_idle_init(loop, &t->idle); /* cannot fail */
    t->idle.data = t;

    /* libuv writes with write(2): a peer that is gone must be an error, not a signal. */
    (void)signal(SIGPIPE, SIG_IGN);
    *out = t;
    return ERR_OK;
}

static void on_idle_closed(uv_handle_t *handle)
{
    struct transport *t = handle->data;
    void (*done)(void *) = t->done;
    void *ctx = t->done_ctx;
    mem_free(t->input);
    mem_free(t);
    if (done)
        done(ctx);
}

void transport_maybe_done(struct transport *t)
{
    if (!t->closing || t->idle_closed || !TAILQ_EMPTY(&t->conns) || !TAILQ_EMPTY(&t->listeners))
        return;
    t->idle_closed = true;
    uv_close((uv_handle_t *)&t->idle, on_idle_closed);
}

void transport_close(struct transport *t, void (*done)(void *ctx), void *ctx)
{
    TL_ASSERT(!t->closing);
    t->closing = true;
    t->done = done;
    t->done_ctx = ctx;
    struct listener *l, *next;
    for (l = TAILQ_FIRST(&t->listeners); l; l = next) {
        next = TAILQ_NEXT(l, in_listeners);
        listener_close(l);
    }
    struct conn *c;
    TAILQ_FOREACH(c, &t->conns, in_conns)
    conn_close(c, ERR_OK);
    transport_maybe_done(t);
}

/* --- Life of a connection ------------------------------------------------------- */

static void on_timer(uv_timer_t *timer);

struct conn *conn_new(struct transport *t, const struct conn_options *options)
{
    struct conn *c = mem_calloc(1, sizeof *c);
    if (!c)
        return NULL;
    c->transport = t;
    c->options = *options;
    if (c->options.handshake_ms == 0)
        c->options.handshake_ms = LIMIT_HANDSHAKE_MS;
    if (c->options.queue_bytes_max == 0)
        c->options.queue_bytes_max = QUEUE_BYTES_DEFAULT;
    c->state = CONN_CONNECTING;
    (void)uv_timer_init(t->loop, &c->timer); /* cannot fail */
    c->timer.data = c;
    c->handles = 1;
    (void)uv_timer_start(&c->timer, on_timer, c->options.handshake_ms, 0);
    TAILQ_INSERT_TAIL(&t->conns, c, in_conns);
    return c;
}

static void free_conn(struct conn *c)
{
    struct transport *t = c->transport;
    TAILQ_REMOVE(&t->conns, c, in_conns);
    if (c->listener)
        c->listener->conn_count--;
    uv_freeaddrinfo(c->addresses);
    frame_decoder_release(&c->decoder);
    tls_link_free(c->link);
    mem_free(c->pending);
    mem_free(c);
    transport_maybe_done(t);
}

void conn_part_gone(struct conn *c)
{
    if (c->state != CONN_CLOSING || c->handles > 0)
        return;
    if (c->options.handlers.on_close) {
        void (*on_close)(void *, struct conn *, enum err) = c->options.handlers.on_close;
        c->options.handlers.on_close = NULL;
        on_close(c->options.ctx, c, c->why);
    }
    if (!c->resolving)
        free_conn(c);
}

static void on_handle_closed(uv_handle_t *handle)
{
    struct conn *c = handle->data;
    c->handles--;
    conn_part_gone(c);
}

static void leave_waiting(struct conn *c)
{
    if (!c->waiting)
        return;
    struct transport *t = c->transport;
    TAILQ_REMOVE(&t->waiting, c, in_waiting);
    c->waiting = false;
    t->waiting_count--;
    if (t->waiting_count == 0)
        (void)uv_idle_stop(&t->idle);
}

static void enter_waiting(struct conn *c)
{
    if (c->waiting)
        return;
    struct transport *t = c->transport;
    TAILQ_INSERT_TAIL(&t->waiting, c, in_waiting);
    c->waiting = true;
    t->waiting_count++;
    (void)uv_idle_start(&t->idle, on_idle);
}

void conn_close(struct conn *c, enum err why)
{
    if (c->state == CONN_CLOSING)
        return;
    c->state = CONN_CLOSING;
    c->why = why;
    leave_waiting(c);
    if (c->resolving)
        (void)uv_cancel((uv_req_t *)&c->resolve);
    if (c->tcp_live) {
        c->tcp_live = false;
        uv_close((uv_handle_t *)&c->tcp, on_handle_closed);
    }
    uv_close((uv_handle_t *)&c->timer, on_handle_closed);
}

static bool is_open(const struct conn *c)
{
    return c->state == CONN_OPEN;
}

/* Arms the one timer for what is due next in this state. */
static void arm_timer(struct conn *c, uint64_t ms)
{
    (void)uv_timer_start(&c->timer, on_timer, ms, 0);
}

static void arm_silence(struct conn *c)
{
    if (c->options.silence_ms == 0) {
        (void)uv_timer_stop(&c->timer);
        return;
    }
    uint64_t silent = uv_now(c->transport->loop) - c->heard_ms;
    uint64_t ms = silent < c->options.silence_ms ? c->options.silence_ms - silent : 1;
    arm_timer(c, ms);
}

static void on_timer(uv_timer_t *timer)
{
    struct conn *c = timer->data;
    if (c->state == CONN_CLOSING)
        return;
    if (c->state == CONN_FINISHING) {
        conn_close(c, c->why);
        return;
    }
    if (!c->accepted) {
        conn_close(c, c->state == CONN_CONNECTING ? ERR_UNREACHABLE : ERR_TIMEOUT);
        return;
    }
    uint64_t now = uv_now(c->transport->loop);
    if (c->paused)
        c->heard_ms = now;
    if (now - c->heard_ms < c->options.silence_ms) {
        arm_silence(c);
        return;
    }
    /* Timers run before sockets: if it was us who slept, the peer's words are there already. */
    if (!c->suspect) {
        c->suspect = true;
        arm_timer(c, SUSPECT_MS);
        return;
    }
    conn_close(c, ERR_TIMEOUT);
}

/* --- Receiving ------------------------------------------------------------------ */

/* What may be said before the handshake is done, and only then. */
static bool type_timely(const struct conn *c, enum frame_type type)
{
    bool shake = type == FRAME_HELLO || type == FRAME_WELCOME;
    return c->accepted ? !shake : shake || type == FRAME_REFUSE;
}

static enum err body_wanted(void *ctx, const struct frame *frame)
{
    struct conn *c = ctx;
    if (!type_timely(c, frame->header.type))
        return ERR_CORRUPT;
    struct message m;
    TL_TRY(message_decode(frame->header.type, frame->meta, frame->header.meta_bytes, &m));
    const struct conn_handlers *h = &c->options.handlers;
    return h->body_wanted ? h->body_wanted(c->options.ctx, c, &m, frame->header.body_bytes)
                          : ERR_OK;
}

static enum err deliver(struct conn *c, const struct frame *frame)
{
    if (!type_timely(c, frame->header.type))
        return ERR_CORRUPT;
    struct message m;
    TL_TRY(message_decode(frame->header.type, frame->meta, frame->header.meta_bytes, &m));
    c->counts.frames_in++;
    c->in_message = true;
    c->options.handlers.on_message(c->options.ctx, c, &m, frame->body, frame->header.body_bytes);
    c->in_message = false;
    return ERR_OK;
}

unsigned char *conn_take_body(struct conn *c)
{
    TL_ASSERT(c->in_message);
    return frame_decoder_take_body(&c->decoder);
}

static bool turn_over(const struct conn *c)
{
    return c->turn_frames >= LIMIT_TURN_FRAMES || c->turn_bytes >= LIMIT_TURN_BYTES;
}

/* Decodes and delivers until the bytes, the turn or the connection ends; says how many it took. */
static size_t decode(struct conn *c, const unsigned char *data, size_t bytes)
{
    size_t at = 0;
    while (at < bytes && is_open(c) && !c->paused && !turn_over(c)) {
        size_t used;
        bool ready;
        struct frame frame;
        bool early = !c->accepted;
        enum err e = frame_decoder_feed(&c->decoder, data + at, bytes - at, &used, &ready, &frame);
        at += used;
        c->turn_bytes += (uint32_t)used;
        if (early && e == ERR_OK && (c->early_bytes += used) > LIMIT_EARLY_BYTES)
            e = ERR_LIMIT;
        if (e == ERR_OK && ready) {
            c->turn_frames++;
            e = deliver(c, &frame);
        }
        if (e != ERR_OK)
            conn_close(c, e);
    }
    return at;
}

/* Keeps what was read but must wait, and stops reading until its turn comes. */
static void hold_back(struct conn *c, const unsigned char *rest, size_t bytes)
{
    (void)uv_read_stop((uv_stream_t *)&c->tcp);
    if (bytes > 0) {
        TL_ASSERT(c->pending_bytes == 0 && bytes <= PLAIN_BYTES);
        c->pending = mem_alloc(bytes);
        if (!c->pending) {
            conn_close(c, ERR_NOMEM);
            return;
        }
        memcpy(c->pending, rest, bytes);
        c->pending_at = 0;
        c->pending_bytes = bytes;
    }
    if (!c->paused)
        enter_waiting(c);
}

/* All input passes here, from the socket or from its decryption to the decoder. */
static void take_input(struct conn *c, const unsigned char *data, size_t bytes)
{
    if (c->state == CONN_FINISHING)
        return;
    size_t used = decode(c, data, bytes);
    if (is_open(c) && (used < bytes || turn_over(c) || c->paused))
        hold_back(c, data + used, bytes - used);
}

static void on_alloc(uv_handle_t *handle, size_t suggested, uv_buf_t *out)
{
    (void)suggested;
    struct conn *c = handle->data;
    *out = uv_buf_init((char *)c->transport->input, INPUT_BYTES);
}

/* The peer sends no more: `status` is UV_EOF, or what broke. */
static void input_ended(struct conn *c, int status)
{
    if (c->state == CONN_FINISHING)
        conn_close(c, c->why);
    else if (status == UV_EOF && is_open(c) && frame_decoder_idle(&c->decoder))
        conn_close(c, ERR_OK);
    else
        conn_close(c, transport_error(status));
}

static enum err send_sealed(struct conn *c);
static void conn_ready(struct conn *c);

/* Brings the TLS handshake on; true once the connection is open. */
static bool shake(struct conn *c, size_t bytes)
{
    enum err e = tls_link_shake(c->link);
    enum err sent = send_sealed(c);
    if (e == ERR_AGAIN && (c->early_bytes += bytes) > LIMIT_EARLY_BYTES)
        e = ERR_LIMIT;
    else if (e == ERR_AGAIN)
        e = ERR_OK;
    else if (e == ERR_OK)
        conn_ready(c);
    else
        log_warn("transport", "tls failed peer=%s why=\"%s\"", c->peer, tls_link_problem(c->link));
    if (c->state != CONN_CLOSING && (e != ERR_OK || sent != ERR_OK))
        conn_close(c, e != ERR_OK ? e : sent);
    return is_open(c);
}

/* What a socket with TLS has read. */
static void take_sealed(struct conn *c, const unsigned char *data, size_t bytes)
{
    unsigned char *plain = c->transport->plain;
    size_t plain_bytes;
    tls_link_feed(c->link, data, bytes);
    if (c->state == CONN_SHAKING && !shake(c, bytes))
        return;
    enum err e = tls_link_open(c->link, plain, PLAIN_BYTES, &plain_bytes);
    enum err sent = send_sealed(c); /* a changed key is answered */
    if (plain_bytes > 0)
        take_input(c, plain, plain_bytes);
    if (c->state == CONN_CLOSING)
        return;
    if (e == ERR_CLOSED && c->pending_bytes > 0)
        c->ended = true;
    else if (e == ERR_CLOSED)
        input_ended(c, UV_EOF);
    else if (e != ERR_OK || sent != ERR_OK)
        conn_close(c, e != ERR_OK ? e : sent);
}

static void on_read(uv_stream_t *stream, ssize_t bytes, const uv_buf_t *input)
{
    struct conn *c = stream->data;
    if (c->state == CONN_CLOSING || bytes == 0)
        return;
    if (bytes < 0) {
        input_ended(c, (int)bytes);
        return;
    }
    c->counts.bytes_in += (size_t)bytes;
    c->heard_ms = uv_now(c->transport->loop);
    c->suspect = false;
    if (c->link)
        take_sealed(c, (const unsigned char *)input->base, (size_t)bytes);
    else
        take_input(c, (const unsigned char *)input->base, (size_t)bytes);
}

static void start_reading(struct conn *c)
{
    int status = uv_read_start((uv_stream_t *)&c->tcp, on_alloc, on_read);
    if (status < 0 && status != UV_EALREADY)
        conn_close(c, transport_error(status));
}

/* The next turn of a connection that was held back. */
static void resume(struct conn *c)
{
    c->turn_frames = c->turn_bytes = 0;
    if (c->pending_bytes > 0) {
        size_t used = decode(c, c->pending + c->pending_at, c->pending_bytes);
        c->pending_at += used;
        c->pending_bytes -= used;
    }
    if (!is_open(c) || c->paused)
        return;
    if (c->pending_bytes > 0) {
        enter_waiting(c);
        return;
    }
    mem_free(c->pending);
    c->pending = NULL;
    if (c->ended)
        input_ended(c, UV_EOF);
    else
        start_reading(c);
}

static void on_idle(uv_idle_t *idle)
{
    struct transport *t = idle->data;
    for (size_t left = t->waiting_count; left > 0 && t->waiting_count > 0; left--) {
        struct conn *c = TAILQ_FIRST(&t->waiting);
        leave_waiting(c);
        resume(c);
    }
}

void conn_pause(struct conn *c, bool paused)
{
    if (c->paused == paused)
        return;
    c->paused = paused;
    if (!is_open(c))
        return;
    if (paused) {
        leave_waiting(c);
        (void)uv_read_stop((uv_stream_t *)&c->tcp);
    } else {
        c->heard_ms = uv_now(c->transport->loop);
        enter_waiting(c);
    }
}

void conn_opened(struct conn *c)
{
    TL_ASSERT(c->state == CONN_CONNECTING);
    (void)uv_tcp_nodelay(&c->tcp, 1);
    (void)uv_tcp_keepalive(&c->tcp, 1, KEEPALIVE_SECONDS);
    struct sockaddr_storage address = {0};
    int address_bytes = sizeof address;
    if (uv_tcp_getpeername(&c->tcp, (struct sockaddr *)&address, &address_bytes) == 0)
        transport_address_text((struct sockaddr *)&address, c->peer, sizeof c->peer);
    c->heard_ms = uv_now(c->transport->loop);
    if (!c->options.tls) {
        conn_ready(c);
        return;
    }
    c->state = CONN_SHAKING;
    const char *host = c->options.peer_side == FRAME_SIDE_MASTER ? c->host : NULL;
    enum err e = tls_link_new(c->options.tls, host, &c->link);
    if (e != ERR_OK) {
        conn_close(c, e);
        return;
    }
    start_reading(c);
    if (c->state == CONN_SHAKING)
        (void)shake(c, 0); /* the worker speaks first */
}

/* Frames may come and go from now on. */
static void conn_ready(struct conn *c)
{
    c->state = CONN_OPEN;
    struct frame_rules rules = {
        .peer_side = c->options.peer_side, .body_wanted = body_wanted, .ctx = c};
    frame_decoder_init(&c->decoder, &rules);
    start_reading(c);
    if (is_open(c) && c->options.handlers.on_open)
        c->options.handlers.on_open(c->options.ctx, c);
}

/* --- Sending -------------------------------------------------------------------- */

/* One frame on its way: header and meta at the end of the struct, body shared; under TLS all of
 * it encrypted, or what the handshake says, in `sealed`. */
struct send {
    uv_write_t request;
    struct conn *conn;
    struct blob *body;
    unsigned char *sealed; /* owned */
    size_t bytes;
    uint32_t frames; /* 1, or 0 for bytes of TLS's own */
    unsigned char head[];
};

static void send_free(struct send *s)
{
    blob_unref(s->body);
    mem_free(s->sealed);
    mem_free(s);
}

static void on_written(uv_write_t *request, int status)
{
    struct send *s = request->data;
    struct conn *c = s->conn;
    c->queue_bytes -= s->bytes;
    if (status == 0) {
        c->counts.frames_out += s->frames;
        c->counts.bytes_out += s->bytes;
    }
    send_free(s);
    if (status < 0 && c->state != CONN_CLOSING) {
        conn_close(c, transport_error(status));
        return;
    }
    if (c->queue_full && c->queue_bytes < c->options.queue_bytes_max / 2) {
        c->queue_full = false;
        if (is_open(c) && c->options.handlers.on_writable)
            c->options.handlers.on_writable(c->options.ctx, c);
    }
}

/* All output passes here, from the queue to the socket. Takes `s`, whatever happens. */
static enum err put_output(struct conn *c, struct send *s, uv_buf_t *parts, unsigned count)
{
    s->request.data = s;
    s->conn = c;
    s->bytes = 0;
    for (unsigned i = 0; i < count; i++)
        s->bytes += parts[i].len;
    int status = uv_write(&s->request, (uv_stream_t *)&c->tcp, parts, count, on_written);
    if (status < 0) {
        send_free(s);
        return transport_error(status);
    }
    c->queue_bytes += s->bytes;
    return ERR_OK;
}

/* Hands what TLS has ready to the socket. Takes `s`. */
static enum err put_sealed(struct conn *c, struct send *s)
{
    struct buf *output = tls_link_output(c->link);
    uv_buf_t part = uv_buf_init((char *)output->data, (unsigned)output->bytes);
    s->sealed = output->data;
    buf_init(output);
    return put_output(c, s, &part, 1);
}

/* The same for bytes of TLS's own: of the handshake, a changed key, the end. */
static enum err send_sealed(struct conn *c)
{
    if (tls_link_output(c->link)->bytes == 0)
        return ERR_OK;
    struct send *s = mem_calloc(1, sizeof *s);
    return s ? put_sealed(c, s) : ERR_NOMEM;
}

/* Takes `s`. A record that was numbered but not sent would break all that follow it: then the
 * connection is closed. */
static enum err put_frame_sealed(struct conn *c, struct send *s, size_t head_bytes)
{
    enum err e = tls_link_seal(c->link, s->head, head_bytes);
    if (e == ERR_OK && s->body)
        e = tls_link_seal(c->link, blob_data(s->body), blob_bytes(s->body));
    blob_unref(s->body);
    s->body = NULL;
    if (e == ERR_OK)
        return put_sealed(c, s);
    send_free(s);
    conn_close(c, e);
    return e;
}

static enum err put_frame(struct conn *c, struct send *s, size_t head_bytes)
{
    if (c->link)
        return put_frame_sealed(c, s, head_bytes);
    uv_buf_t parts[2] = {uv_buf_init((char *)s->head, (unsigned)head_bytes)};
    unsigned count = 1;
    if (s->body && blob_bytes(s->body) > 0)
        parts[count++] =
            uv_buf_init((char *)(uintptr_t)blob_data(s->body), (unsigned)blob_bytes(s->body));
    return put_output(c, s, parts, count);
}

enum err conn_send(struct conn *c, const struct message *m, struct blob *body)
{
    if (!is_open(c))
        return c->state < CONN_OPEN ? ERR_STATE : ERR_CLOSED;
    unsigned char meta[MESSAGE_BYTES_MAX];
    size_t meta_bytes, body_bytes = body ? blob_bytes(body) : 0;
    TL_TRY(message_encode(m, meta, &meta_bytes));
    if (body_bytes > frame_type_body_max((int)m->type))
        return ERR_LIMIT;

    size_t bytes = FRAME_HEADER_BYTES + meta_bytes + body_bytes;
    size_t most = c->accepted ? c->options.queue_bytes_max : LIMIT_EARLY_BYTES;
    if (c->queue_bytes > 0 && c->queue_bytes + bytes > most) {
        c->queue_full = true;
        return ERR_AGAIN;
    }
    struct send *s = mem_alloc(sizeof *s + FRAME_HEADER_BYTES + meta_bytes);
    if (!s)
        return ERR_NOMEM;
    *s = (struct send){.frames = 1, .body = body ? blob_ref(body) : NULL};
    struct frame_header header = {
        .type = m->type, .meta_bytes = (uint32_t)meta_bytes, .body_bytes = (uint32_t)body_bytes};
    frame_header_encode(&header, s->head);
    memcpy(s->head + FRAME_HEADER_BYTES, meta, meta_bytes);
    return put_frame(c, s, FRAME_HEADER_BYTES + meta_bytes);
}

static void on_shutdown(uv_shutdown_t *request, int status)
{
    struct conn *c = request->data;
    if (status < 0 && c->state != CONN_CLOSING)
        conn_close(c, c->why);
}

void conn_finish(struct conn *c, enum err why)
{
    if (c->state < CONN_OPEN) {
        conn_close(c, why);
        return;
    }
    if (!is_open(c))
        return;
    c->state = CONN_FINISHING;
    c->why = why;
    leave_waiting(c);
    if (c->link) {
        tls_link_bye(c->link);
        enum err ignored = send_sealed(c); /* the frames before it say all that counts */
        (void)ignored;
    }
    c->shutdown.data = c;
    if (uv_shutdown(&c->shutdown, (uv_stream_t *)&c->tcp, on_shutdown) < 0) {
        conn_close(c, why);
        return;
    }
    start_reading(c);
    arm_timer(c, FINISH_MS);
}

/* --- Small things --------------------------------------------------------------- */

void conn_accept(struct conn *c)
{
    if (c->accepted || !is_open(c))
        return;
    c->accepted = true;
    arm_silence(c);
}

bool conn_accepted(const struct conn *c)
{
    return c->accepted;
}

void conn_set_silence(struct conn *c, uint32_t silence_ms)
{
    c->options.silence_ms = silence_ms;
    if (is_open(c) && c->accepted)
        arm_silence(c);
}

void conn_set_ctx(struct conn *c, void *ctx)
{
    c->options.ctx = ctx;
}

void *conn_ctx(const struct conn *c)
{
    return c->options.ctx;
}

const char *conn_peer(const struct conn *c)
{
    return c->peer;
}

const char *conn_problem(const struct conn *c)
{
    return c->link ? tls_link_problem(c->link) : "";
}

size_t conn_queued_bytes(const struct conn *c)
{
    return c->queue_bytes;
}

void conn_counts_get(const struct conn *c, struct conn_counts *out)
{
    *out = c->counts;
}
