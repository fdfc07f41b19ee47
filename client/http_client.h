/* client/http_client.h: HTTP calls to a master, and its stream of events. The one door to libcurl.
 *
 * Blocking calls over one kept-alive connection, and beside them at most one open stream
 * that the caller waits on together with a descriptor of its own. Redirects are not followed;
 * the token goes only to the base URL's host and is never part of an error text.
 * One thread. A client that is interrupted (flag) fails its call with ERR_CANCELLED.
 */
#ifndef CLIENT_HTTP_CLIENT_H
#define CLIENT_HTTP_CLIENT_H

#include <signal.h>

#include "common/buf.h"

struct http_client; /* opaque */

struct http_client_options {
    const char *base_url; /* "http://host:port", copied; no path */
    const char *token;    /* bearer token, copied; NULL: none */
    const char *ca_file;  /* PEM: trust this authority alone, copied; NULL: the system's */
    bool direct;          /* ignore the environment's proxies: the farm is our own child */
    const volatile sig_atomic_t *interrupted; /* may be NULL; outlives the client */
};

/* ERR_INPUT: not a URL of that form; ERR_NOMEM. */
TL_NODISCARD enum err http_client_new(const struct http_client_options *options,
                                      struct http_client **out);
void http_client_free(struct http_client *c);

/* The base URL as it is used: scheme added when missing, no slash at the end. */
const char *http_client_url(const struct http_client *c);

struct http_request {
    const char *method, *path; /* "GET", "/api/v1/jobs" */
    const void *body;          /* NULL: none; borrowed for the call */
    size_t body_bytes;
    const char *content_type; /* of the body */
    const char *header;       /* one more header line, or NULL */
    int body_fd;              /* 0: reply into memory; else a 2xx reply is written there */
    const char *reply_header; /* name of a header line of the reply that is wanted, or NULL */
};

struct http_reply {
    long status;
    struct buf body; /* NUL-terminated, the NUL not counted; empty when it went to body_fd */
    char header[80]; /* the value of the wanted header line; empty if there was none */
};

void http_reply_init(struct http_reply *r);
void http_reply_release(struct http_reply *r);

/* Any status is ERR_OK; the errors are those of the connection: ERR_UNREACHABLE, ERR_TIMEOUT,
 * ERR_CLOSED, ERR_CANCELLED, ERR_NOMEM, ERR_LIMIT (reply over 256 MB), ERR_NOSPACE and ERR_IO
 * (of body_fd). The reply is reused: its old contents are dropped. */
TL_NODISCARD enum err http_call(struct http_client *c, const struct http_request *request,
                                struct http_reply *reply);

/* What the last failed call said, e.g. "connection refused"; for people. */
const char *http_client_error(const struct http_client *c);

/* --- A stream ----------------------------------------------------------- */

typedef void http_stream_bytes(void *ctx, const char *data, size_t bytes);

struct http_stream; /* opaque */

/* Starts GET `path`; bytes arrive within http_stream_wait. `last_event_id` may be NULL. */
TL_NODISCARD enum err http_stream_open(struct http_client *c, const char *path,
                                       const char *last_event_id, http_stream_bytes *on_bytes,
                                       void *ctx, struct http_stream **out);
void http_stream_close(struct http_stream *s);

/* Waits until bytes came, `fd` (-1: none) is readable, or the time is over. True while the stream
 * is open or opening; false once it has ended, whatever the reason. */
bool http_stream_wait(struct http_stream *s, int fd, int timeout_ms);

/* HTTP status, or 0 while no answer has come. */
long http_stream_status(const struct http_stream *s);

#endif
