/* proto/transport_impl.h: what transport.c (frames of open connections) and
 * transport_connect.c (how connections come about) share. Nobody else includes it.
 *
 * A conn has up to two libuv handles (socket, timer) and perhaps a name being
 * resolved. on_close is called when both handles are closed, the memory is freed when the
 * resolver has let go too.
 */
#ifndef PROTO_TRANSPORT_IMPL_H
#define PROTO_TRANSPORT_IMPL_H

#include <sys/queue.h>
#include <uv.h>

#include "proto/transport.h"

enum {
    INPUT_BYTES = 64 * 1024,               /* of one read */
    PLAIN_BYTES = INPUT_BYTES + 20 * 1024, /* of one read and a TLS record begun before it */
    PEER_BYTES = 128,
    HOST_BYTES = 256,
};

enum conn_state { CONN_CONNECTING, CONN_SHAKING, CONN_OPEN, CONN_FINISHING, CONN_CLOSING };

struct conn {
    struct transport *transport;
    struct listener
        *listener; /* that it counts for; NULL: connected by us, or the listener closed */
    struct conn_options options;
    enum conn_state state;
    enum err why; /* for on_close */
    bool accepted, paused, suspect;
    struct tls_link *link; /* NULL: in clear, or not connected yet */

    uv_tcp_t tcp;
    uv_timer_t timer;
    bool tcp_live; /* initialised, uv_close not called yet */
    int handles;   /* whose close callback is still to come, or live */
    uv_shutdown_t shutdown;

    /* Connecting. */
    uv_getaddrinfo_t resolve;
    bool resolving;
    uv_connect_t connect;
    struct addrinfo *addresses, *address_next;
    char host[HOST_BYTES]; /* that was dialled: what the master's certificate must bear */

    /* Receiving. */
    struct frame_decoder decoder;
    bool in_message;        /* conn_take_body is legal */
    unsigned char *pending; /* read but not decoded yet: PLAIN_BYTES at most; owned */
    size_t pending_at, pending_bytes;
    uint32_t turn_frames, turn_bytes;
    size_t early_bytes;
    uint64_t heard_ms;
    bool waiting; /* in the transport's queue for the next turn */
    bool ended;   /* the peer sends no more, but what is pending comes first */

    /* Sending. */
    size_t queue_bytes;
    bool queue_full;

    struct conn_counts counts;
    char peer[PEER_BYTES];
    TAILQ_ENTRY(conn) in_conns, in_waiting;
};

struct listener {
    struct transport *transport;
    struct conn_options options;
    uv_tcp_t tcp;
    bool closing;
    uint32_t conn_max, conn_count;
    int reserve_fd; /* given up to hang up on a newcomer when no other descriptor is left */
    char address[PEER_BYTES];
    TAILQ_ENTRY(listener) in_listeners;
};

struct transport {
    uv_loop_t *loop;
    uv_idle_t idle;       /* runs while someone waits for the next turn */
    unsigned char *input; /* what was just read: INPUT_BYTES */
    unsigned char *plain; /* the same decrypted: PLAIN_BYTES */
    TAILQ_HEAD(, conn) conns;
    TAILQ_HEAD(, conn) waiting;
    size_t waiting_count;
    TAILQ_HEAD(, listener) listeners;
    bool closing, idle_closed;
    void (*done)(void *ctx);
    void *done_ctx;
};

/* A conn with its timer started and no socket yet; options are copied. NULL: out of memory. */
struct conn *conn_new(struct transport *t, const struct conn_options *options);

/* The socket is there: sets its options and starts reading. */
void conn_opened(struct conn *c);

/* Something of the conn (a handle, the resolver) is gone; on_close and freeing follow. */
void conn_part_gone(struct conn *c);

/* The transport is closing and the last conn or listener may be gone. */
void transport_maybe_done(struct transport *t);

/* "ADDR:PORT" of a socket address. */
void transport_address_text(const struct sockaddr *address, char *out, size_t bytes);

/* The kind of a libuv error. */
enum err transport_error(int uv_status);

#endif
