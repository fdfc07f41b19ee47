/* master/http_impl.h: what the files of the HTTP side share. See http.h. */
#ifndef MASTER_HTTP_IMPL_H
#define MASTER_HTTP_IMPL_H

#include "common/json_get.h"
#include "common/json_put.h"
#include "master/http.h"
#include "master/http_body.h"

#include <microhttpd.h>

enum {
    HTTP_BODY_BYTES_MAX = 1 << 20, /* of a JSON body */
    HTTP_LIST_MAX = 1000,          /* items of one page */
    HTTP_LIST_DEFAULT = 50,
    HTTP_PARAM_BYTES = 80,
    HTTP_PROGRESS_BYTES = 1 << 16, /* of a body, for which its sender is as a newcomer again */
    HTTP_TICK_MS = 5000,           /* between looks for silent event streams */
};
#define HTTP_CHUNK_BYTES_MAX  (UINT64_C(1) << 30) /* of one chunk as sent */
#define HTTP_UPLOAD_BYTES_MAX (UINT64_C(4) << 30) /* of all bodies in memory at once */

struct request;

struct route {
    const char *method, *path; /* "{}" stands for one segment: request.param */
    void (*handle)(struct request *r);
    uint64_t body_max; /* 0: no body is read */
    bool open;         /* asks for no token */
};

struct request {
    struct http *http;
    struct farm *farm;
    struct MHD_Connection *connection;
    const struct route *route; /* NULL: refused before it was found */
    const char *path;          /* valid while the request is handled */
    char param[HTTP_PARAM_BYTES];
    struct buf body;
    uint64_t body_counted;  /* of http.body_bytes */
    uint64_t body_progress; /* since it was as a newcomer */
    bool handled, waiting, answered, streams;
    struct later *later;             /* what an operation under way holds of it */
    struct request *previous, *next; /* of http.requests */

    /* The answer. */
    unsigned status;
    struct MHD_Response *response;
};

struct guest_list {
    struct guest *first, *last;
};

struct http {
    struct farm *farm;
    const char *token;              /* borrowed */
    bool secure;                    /* over TLS */
    char session[DIGEST_HEX_BYTES]; /* cookie of a browser that gave the token */
    bool loopback;
    char address[64];
    struct MHD_Daemon *daemon;
    uv_poll_t poll;
    uv_timer_t timer, tick;
    int handles_open;
    bool kicked, running, stopping;
    uint64_t stall_ms;        /* until its next turn when it asks for one and nothing has arrived */
    struct request *requests; /* all that are known to us */
    struct stream *streams;   /* open event streams, newest first */
    uint64_t body_bytes;
    struct {
        struct guest_list idle, reading; /* longest so first */
        uint32_t count, count_max;       /* all connections */
    } guests;
    struct {
        uint64_t requests, problems, bytes_out;
    } counters;
};

/* --- Answering (http.c) --------------------------------------------------- */

/* Answers with the buffer's contents (of `type`; NULL: there are none) and takes them. At most once
 * per request; later calls of a request that waited resume it. */
void request_reply(struct request *r, unsigned status, const char *type, struct buf *body);
/* A header of the answer given just before (while still in the handler) or NULL response. */
void request_header(struct request *r, const char *name, const char *value);

/* Answers with a stream (takes the response). */
void request_stream(struct request *r, struct MHD_Response *response);
/* True if this is the farm's token, or none is asked for. */
bool http_token_good(const struct http *h, const char *token);

/* Answers with problem+json: id is an anchor of docs/ERRORS.md ("unknown-job"). */
void request_problem(struct request *r, unsigned status, const char *id, const char *format, ...)
    TL_PRINTF(4, 5);
/* The same with the list of problems. */
void request_problems(struct request *r, unsigned status, const char *id, const char *detail,
                      const struct diag_list *problems);
/* What an error of ours means to the client. */
void request_error(struct request *r, enum err e);

/* For an operation that answers later: its context, which outlives the request. NULL: out of
 * memory, answered so. The operation's callback must call request_of exactly once; it gives the
 * request, or NULL when that is gone. Call request_wait after the operation was started. */
struct later {
    struct request *request;
};
struct later *request_later(struct request *r);
struct request *request_of(struct later *later);
void request_wait(struct request *r);

/* A query argument or header; NULL: absent. */
const char *request_query(struct request *r, const char *key);
const char *request_head(struct request *r, const char *key);

/* Opens the body as a JSON object with only these keys; false: answered with a problem. */
bool request_json(struct request *r, struct json_get *g, struct diag_list *problems,
                  const char *const *keys, size_t key_count);

/* Something was resumed or changed outside of libmicrohttpd's turn. */
void http_kick(struct http *h);

/* --- Connections (http_guard.c) ------------------------------------------- */

/* Who holds a connection and asks nothing (never did, was refused, or not since its last answer),
 * or has sent less than HTTP_PROGRESS_BYTES of a body since, is hung up on, longest so first, when
 * as many are open as may be; then who has been reading an answer for longest; then the oldest
 * event stream is ended, whose reader comes back after its last event. So strangers keep nobody
 * out. Requests that are worked on stay. For MHD_OPTION_NOTIFY_CONNECTION, with the http as
 * context. */
void http_guest_notify(void *http, struct MHD_Connection *c, void **context,
                       enum MHD_ConnectionNotificationCode code);
/* A request of this connection is worked on; was answered, broken off, or has sent a good part of
 * its body; is sent its answer. */
void http_guest_busy(struct MHD_Connection *c);
void http_guest_idle(struct http *h, struct MHD_Connection *c);
void http_guest_reads(struct http *h, struct MHD_Connection *c);

/* False: two Hosts, or two statements of where the body ends. A proxy may have read such a request
 * another way than libmicrohttpd does (RFC 9112, 3.2 and 6.3). */
bool http_framing_clear(struct MHD_Connection *c);

/* --- Streams (http_events.c) ---------------------------------------------- */

void http_get_events(struct request *r);
void http_streams_wake(void *http); /* a new event */
void http_streams_close(struct http *h);
void http_streams_end_one(struct http *h); /* the oldest: its reader may come back (retry) */
void http_streams_tick(struct http *h);

/* --- Routes --------------------------------------------------------------- */

/* http_jobs.c */
void http_post_jobs(struct request *r);
void http_get_jobs(struct request *r);
void http_get_frames(struct request *r);
void http_get_job(struct request *r);
void http_patch_job(struct request *r);
void http_get_exr(struct request *r);
void http_get_png(struct request *r);
/* http_farm.c */
void http_post_missing(struct request *r);
void http_put_chunk(struct request *r);
void http_get_workers(struct request *r);
void http_patch_worker(struct request *r);
void http_get_farm(struct request *r);
void http_post_session(struct request *r);
void http_get_health(struct request *r);
void http_get_metrics(struct request *r);
/* http_page.c */
void http_get_page(struct request *r);
void http_get_script(struct request *r);
void http_get_viewer(struct request *r);
void http_get_icon(struct request *r);
void http_get_style(struct request *r);
void http_get_openapi(struct request *r);
void http_get_errors(struct request *r);

#endif
