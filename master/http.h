/* master/http.h: the API, the metrics and the page, over HTTP/1.1.
 *
 * libmicrohttpd without a thread of its own: its epoll descriptor is watched by the libuv
 * loop. A request that must wait (for the disk, the pool) is suspended and answered later.
 * Every error is problem+json (RFC 9457). Loop thread only.
 *
 * Refused before anything else: a Host that is none of ours while bound to loopback (DNS
 * rebinding), a foreign Origin on a request that changes something, a missing or wrong token
 * where one is set, a body over the route's limit.
 *
 * Tests: tests/e2e/test_master_http.py.
 */
#ifndef MASTER_HTTP_H
#define MASTER_HTTP_H

#include "master/farm.h"
#include "proto/transport_tls.h"

enum { HTTP_IDLE_S = 60 };

struct http; /* opaque */

struct http_options {
    const char *address;  /* "ADDR:PORT"; port 0: any */
    const char *token;    /* borrowed; NULL: none asked */
    struct tls_files tls; /* certificate NULL: in clear; `ca` is for workers and not used here */
};

/* Binds and serves. What went wrong was logged as an error. ERR_USAGE, ERR_ADDRESS, ERR_INPUT (a
 * PEM file), ERR_NOMEM. */
TL_NODISCARD enum err http_start(struct farm *f, const struct http_options *options,
                                 struct http **out);

/* "127.0.0.1:8080", with the port really bound. */
const char *http_address(const struct http *h);

/* Answers what waits with 503, closes every connection; frees itself on a later turn of the loop.
 */
void http_stop(struct http *h);

#endif
