/* proto/transport.h: connections between a master and its workers.
 *
 * Frames in, frames out, over TCP on a libuv loop: the one door to libuv below
 * the daemons. A connection decodes what arrives into checked messages, calls
 * back, and keeps a bounded queue of what is to be sent. TCP_NODELAY always.
 *
 *   conn_connect ----> CONNECTING --on_open--> OPEN --conn_accept--> ACCEPTED
 *   listener ----------------------on_open--^    |                     |
 *                                                +---> CLOSING <-------+
 *                                                    on_close, once, last
 *
 * With TLS (conn_options.tls) a connection is open once both sides have shaken hands.
 *
 * Before conn_accept a connection may send and receive nothing but Hello, Welcome
 * and Refuse, may make us hold LIMIT_EARLY_BYTES at most, and is closed with
 * ERR_TIMEOUT after handshake_ms. After it, silence of silence_ms closes it.
 * Per turn of the loop a connection is served LIMIT_TURN_FRAMES frames or
 * LIMIT_TURN_BYTES bytes, then the others have theirs.
 *
 * Life: a struct conn is the transport's. It is marked by conn_close and freed
 * after on_close returned, never inside another of its callbacks; every function
 * here may be called from any callback until then, and on a closing connection
 * does nothing (conn_send: ERR_CLOSED). Thread: the loop's. struct blob: any.
 *
 * Tests: test_wire_conn, tests/e2e/test_e2e_tls.py.
 */
#ifndef PROTO_TRANSPORT_H
#define PROTO_TRANSPORT_H

#include "proto/message.h"
#include "proto/transport_tls.h"

struct uv_loop_s;

/* --- Blob: bytes shared by several frames or threads, counted --------------- */

struct blob; /* opaque */

/* Owns `data` (of mem_alloc) from now on; one reference is yours. NULL: out of memory, and `data`
 * is still yours. */
TL_NODISCARD struct blob *blob_new(unsigned char *data, size_t bytes);
struct blob *blob_ref(struct blob *b);
void blob_unref(struct blob *b); /* NULL is fine */
const unsigned char *blob_data(const struct blob *b);
size_t blob_bytes(const struct blob *b);

/* --- Transport: what the connections of one loop share ---------------------- */

struct transport; /* opaque */

/* Borrows the loop. Ignores SIGPIPE in this process. ERR_NOMEM, ERR_IO. */
TL_NODISCARD enum err transport_new(struct uv_loop_s *loop, struct transport **out);

/* Closes every connection and listener. on_close of each and then `done` (may be NULL) are called
 * from later turns of the loop; the transport frees itself after that. */
void transport_close(struct transport *t, void (*done)(void *ctx), void *ctx);

/* libuv starts its threads with the first work, in the midst of things, and aborts where it cannot
 * have them. This starts them now, at the start of a program, and has as many before: glibc keeps
 * the memory of threads that have ended for the next. ERR_NOMEM: there is no room for them. */
TL_NODISCARD enum err transport_start_pool(struct uv_loop_s *loop);

/* Where a bound TCP socket is, as "127.0.0.1:7000"; false: it is none. */
bool transport_socket_address(int fd, char *out, size_t bytes);

/* True for "HOST:PORT" and "[v6]:PORT", as conn_connect and listener_new take them. */
bool transport_host_port_valid(const char *host_port);

/* --- Connections ------------------------------------------------------------ */

struct conn; /* opaque */

struct conn_handlers {
    /* The socket is connected; may be NULL. For a listener's connection: who just came. */
    void (*on_open)(void *ctx, struct conn *c);

    /* One checked message of a type that the peer may send. `body` is valid during the call;
     * conn_take_body keeps it. */
    void (*on_message)(void *ctx, struct conn *c, const struct message *m,
                       const unsigned char *body, size_t body_bytes);

    /* Asked when the meta of a frame with a body has come and no memory was taken for the body;
     * anything but ERR_OK closes with that error. NULL: all bodies within their type's limit. */
    enum err (*body_wanted)(void *ctx, struct conn *c, const struct message *m,
                            uint32_t body_bytes);

    /* The queue has sunk below half after a conn_send returned ERR_AGAIN; may be NULL. */
    void (*on_writable)(void *ctx, struct conn *c);

    /* Called exactly once, last. ERR_OK: closed by conn_close(ERR_OK) or by the peer between
     * frames; ERR_CORRUPT, ERR_LIMIT, ERR_VERSION: the peer broke the protocol; ERR_UNREACHABLE: no
     * connection could be made; ERR_UNTRUSTED: one side did not accept the other's certificate
     * (conn_problem says why); ERR_TIMEOUT; ERR_CLOSED: reset or cut off within a frame; ... */
    void (*on_close)(void *ctx, struct conn *c, enum err why);
};

struct conn_options {
    int peer_side; /* enum frame_side: FRAME_SIDE_WORKER on a master */
    struct conn_handlers handlers;
    void *ctx;                   /* of the handlers, until conn_set_ctx changes it */
    uint32_t handshake_ms;       /* 0: LIMIT_HANDSHAKE_MS */
    uint32_t silence_ms;         /* 0: silence is never fatal; conn_set_silence changes it */
    size_t queue_bytes_max;      /* to be sent; 0: 1 MiB. One frame more than it fits is still taken
                                  * when the queue is empty, so that any one frame can be sent. */
    const struct tls_party *tls; /* NULL: in clear; outlives the transport */
};

/* Starts to resolve and connect to "HOST:PORT" ("[v6]:PORT"), every address in turn. ERR_USAGE: not
 * such a text; ERR_NOMEM. Whatever happens later is told by on_open or on_close. */
TL_NODISCARD enum err conn_connect(struct transport *t, const char *host_port,
                                   const struct conn_options *options, struct conn **out);

/* Lifts the limits of the time before the handshake. */
void conn_accept(struct conn *c);
bool conn_accepted(const struct conn *c);

/* Queues one frame; takes a reference of `body` (may be NULL) of its own. ERR_AGAIN: the queue is
 * full and nothing was queued: wait for on_writable, or close. ERR_LIMIT: message or body over its
 * limits; ERR_STATE: not open yet; ERR_NOMEM; ERR_CLOSED. */
TL_NODISCARD enum err conn_send(struct conn *c, const struct message *m, struct blob *body);

/* Closes now; what is queued is dropped. `why` is handed to on_close. */
void conn_close(struct conn *c, enum err why);

/* Sends what is queued, says end of file, discards what still comes in, and closes once the peer
 * has closed or after two seconds: so that a Refuse or a Goodbye is read. No message is delivered
 * from now on. */
void conn_finish(struct conn *c, enum err why);

/* Stops or starts delivering messages; the kernel then holds the peer back. Silence does not count
 * while paused. */
void conn_pause(struct conn *c, bool paused);

/* Only within on_message: the body becomes yours (mem_free). */
TL_NODISCARD unsigned char *conn_take_body(struct conn *c);

void conn_set_ctx(struct conn *c, void *ctx);
void *conn_ctx(const struct conn *c);
void conn_set_silence(struct conn *c, uint32_t silence_ms);

/* "127.0.0.1:40512", or the text given to conn_connect until it is open. */
const char *conn_peer(const struct conn *c);

/* What was wrong with TLS, in words; "" when nothing was. */
const char *conn_problem(const struct conn *c);

size_t conn_queued_bytes(const struct conn *c);

struct conn_counts {
    uint64_t bytes_in, bytes_out; /* handed over by and to the kernel */
    uint64_t frames_in, frames_out;
};
void conn_counts_get(const struct conn *c, struct conn_counts *out);

/* --- Listener --------------------------------------------------------------- */

struct listener; /* opaque; closed by listener_close or transport_close */

/* Binds "ADDR:PORT" (0: any port) and accepts connections with these options, at most conn_max at a
 * time (others are closed at once; 0: no limit). Out of file descriptors, it hangs up on newcomers.
 * ERR_USAGE: not an address; ERR_ADDRESS: cannot be bound; ERR_NOMEM. */
TL_NODISCARD enum err listener_new(struct transport *t, const char *addr_port, uint32_t conn_max,
                                   const struct conn_options *options, struct listener **out);
/* The same on a bound socket, which becomes the listener's whatever happens; ERR_ADDRESS: it is
 * none. Who connected before finds its place in the queue. */
TL_NODISCARD enum err listener_adopt(struct transport *t, int fd, uint32_t conn_max,
                                     const struct conn_options *options, struct listener **out);
void listener_close(struct listener *l);

/* "127.0.0.1:7000", with the port really bound. */
const char *listener_address(const struct listener *l);

#endif
