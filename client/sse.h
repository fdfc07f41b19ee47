/* client/sse.h: server-sent events out of bytes, in any split.
 *
 * The WHATWG event-stream format: event, data, id; comments and retry are skipped. An event
 * whose data passes SSE_BYTES_MAX is dropped whole. Pure apart from memory; one thread.
 */
#ifndef CLIENT_SSE_H
#define CLIENT_SSE_H

#include "common/buf.h"

enum { SSE_BYTES_MAX = 16 << 20, SSE_NAME_BYTES = 64, SSE_ID_BYTES = 64 };

/* `data` ends with a NUL that is not counted. */
typedef void sse_event(void *ctx, const char *name, const char *data, size_t bytes);

struct sse {
    sse_event *on_event;
    void *ctx;
    struct buf line, data;
    char name[SSE_NAME_BYTES];
    char last_id[SSE_ID_BYTES]; /* of the last whole event; "" before the first */
    char id[SSE_ID_BYTES];
    bool after_cr, too_long;
};

void sse_init(struct sse *s, sse_event *on_event, void *ctx);
void sse_release(struct sse *s);

/* Forgets a half-read event, keeps last_id: for a new connection. */
void sse_restart(struct sse *s);

void sse_feed(struct sse *s, const char *bytes, size_t count);

#endif
