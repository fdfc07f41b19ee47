/* Server-sent events: GET /events[?job=ID], resumed by Last-Event-ID. See events.h. */
#include <inttypes.h>
#include <microhttpd.h>
#include <stdio.h>
#include <string.h>

#include "common/mem.h"
#include "master/http_impl.h"

enum {
    COMMENT_MS = 15000,       /* of silence, after which a comment shows that we are there */
    STREAM_BYTES = 64 * 1024, /* written ahead for one reader */
    RESUME_EVENTS_MAX = EVENTS_KEPT,
};

struct stream {
    struct http *http;
    struct MHD_Connection *connection;
    struct stream *previous, *next;
    uint64_t job;      /* 0: all */
    uint64_t sequence; /* of the last event written */
    struct buf out;
    size_t out_used;
    int64_t last_ms;
    bool suspended, ending;
};

static void fill(struct stream *s)
{
    buf_clear(&s->out);
    s->out_used = 0;
    while (s->out.bytes < STREAM_BYTES &&
           events_next(s->http->farm->events, &s->sequence, s->job, &s->out))
        ;
    if (s->out.bytes == 0 && farm_now_ms(s->http->farm) - s->last_ms >= COMMENT_MS)
        buf_printf(&s->out, ": here\n\n");
}

static ssize_t on_read(void *ctx, uint64_t at, char *out, size_t bytes)
{
    (void)at;
    struct stream *s = ctx;
    if (s->ending)
        return MHD_CONTENT_READER_END_OF_STREAM;
    if (s->out_used == s->out.bytes)
        fill(s);
    if (buf_status(&s->out) != ERR_OK)
        return MHD_CONTENT_READER_END_WITH_ERROR;
    size_t left = s->out.bytes - s->out_used, n = left < bytes ? left : bytes;
    if (n == 0) {
        s->suspended = true;
        MHD_suspend_connection(s->connection);
        return 0;
    }
    memcpy(out, s->out.data + s->out_used, n);
    s->out_used += n;
    s->last_ms = farm_now_ms(s->http->farm);
    return (ssize_t)n;
}

static void on_free(void *ctx)
{
    struct stream *s = ctx;
    if (s->previous)
        s->previous->next = s->next;
    else
        s->http->streams = s->next;
    if (s->next)
        s->next->previous = s->previous;
    buf_release(&s->out);
    mem_free(s);
}

static void wake(struct stream *s)
{
    if (!s->suspended)
        return;
    s->suspended = false;
    MHD_resume_connection(s->connection);
    http_kick(s->http);
}

void http_streams_wake(void *http)
{
    struct http *h = http;
    for (struct stream *s = h->streams; s; s = s->next)
        wake(s);
}

void http_streams_tick(struct http *h)
{
    int64_t now = farm_now_ms(h->farm);
    for (struct stream *s = h->streams; s; s = s->next)
        if (now - s->last_ms >= COMMENT_MS)
            wake(s);
}

static void end(struct stream *s)
{
    s->ending = true;
    if (s->suspended) {
        s->suspended = false;
        MHD_resume_connection(s->connection);
    }
}

void http_streams_close(struct http *h)
{
    for (struct stream *s = h->streams; s; s = s->next)
        end(s);
}

void http_streams_end_one(struct http *h)
{
    struct stream *oldest = NULL;
    for (struct stream *s = h->streams; s; s = s->next)
        if (!s->ending)
            oldest = s;
    if (!oldest)
        return;
    end(oldest);
    http_kick(h);
}

/* Where a reader that comes back goes on: after its last event if that was of this life. */
static uint64_t resume_at(struct request *r, bool *lost)
{
    const char *id = request_head(r, "Last-Event-ID");
    uint64_t epoch = 0, sequence = 0;
    struct events *events = r->farm->events;
    *lost = false;
    if (!id)
        return events_newest(events);
    if (sscanf(id, "%" SCNu64 "-%" SCNu64, &epoch, &sequence) == 2 &&
        epoch == events_epoch(events) && sequence <= events_newest(events))
        return sequence;
    *lost = true;
    return events_newest(events);
}

void http_get_events(struct request *r)
{
    const char *job = request_query(r, "job");
    struct stream *s = mem_calloc(1, sizeof *s);
    bool lost = false;
    if (!s) {
        request_error(r, ERR_NOMEM);
        return;
    }
    buf_init(&s->out);
    s->http = r->http;
    s->connection = r->connection;
    s->last_ms = farm_now_ms(r->farm);
    s->job = job ? http_id(job, 'j') : 0;
    if (job && !farm_job(r->farm, s->job)) {
        mem_free(s);
        request_problem(r, MHD_HTTP_NOT_FOUND, "unknown-job", "no job \"%.40s\"", job);
        return;
    }
    s->sequence = resume_at(r, &lost);
    buf_printf(&s->out,
               "retry: 1000\nid: %" PRIu64 "-%" PRIu64 "\nevent: hello\ndata: {\"epoch\":%" PRIu64
               ",\"version\":\"%s\"}\n\n",
               events_epoch(r->farm->events), s->sequence, events_epoch(r->farm->events),
               TILERY_VERSION);
    if (lost)
        buf_printf(&s->out, "event: reset\ndata: {}\n\n");
    struct MHD_Response *response =
        MHD_create_response_from_callback(MHD_SIZE_UNKNOWN, 16 * 1024, on_read, s, on_free);
    if (!response) {
        buf_release(&s->out);
        mem_free(s);
        request_error(r, ERR_NOMEM);
        return;
    }
    /* Its end is that of the connection: one that is ended makes room (http_streams_end_one). */
    (void)MHD_add_response_header(response, "Connection", "close");
    s->next = r->http->streams;
    if (s->next)
        s->next->previous = s;
    r->http->streams = s;
    request_stream(r, response);
}
