/* worker/session.h: a worker's life with its master.
 *
 *   connecting --Hello--> waiting for Welcome --> registered --> lost --> connecting ...
 *                              |                      |
 *                              Refuse                 Goodbye (drained)
 *
 * Connects, says Hello, keeps the heartbeat, comes back by itself: at once when a
 * connection is lost, then every 250 to 500 ms. Only a refusal that will not change
 * (version, determinism id, token; a certificate, as long as it has never been registered) ends
 * it; then `ended` says so with exit status 4.
 * The work itself (leases, results, scenes) is in work.h and outlives connections.
 *
 * Thread: the loop's. Tests: tests/e2e/test_worker_wire.py.
 */
#ifndef WORKER_SESSION_H
#define WORKER_SESSION_H

#include "common/digest.h"
#include "worker/chunk_cache.h"
#include "worker/pool.h"

struct session; /* opaque */

struct session_options {
    const char *master;          /* transport_host_port_valid */
    const struct tls_party *tls; /* NULL: in clear */
    const char *name, *host, *cpu, *token;
    const char *const *tags;
    uint32_t tag_count; /* at most LIMIT_TAGS */
    digest determinism_id;
    struct pool *pool;
    struct chunk_cache *cache;
    uint64_t scene_bytes_max;
    bool eager; /* work.h */

    /* The first Welcome: the id this worker has. */
    void (*registered)(void *ctx, const char *worker_id);

    /* The session is over: close it, then exit with this status. Called once. */
    void (*ended)(void *ctx, int exit_status);
    void *ctx;
};

/* Borrows all of the options until session_close is done. ERR_NOMEM, ERR_IO. */
TL_NODISCARD enum err session_new(struct uv_loop_s *loop, const struct session_options *options,
                                  struct session **out);

/* Finishes what is held, delivers it, says Goodbye, then calls `ended` with 0. */
void session_drain(struct session *s);

/* Stops the units that run, so that pool_close does not wait long, and closes the connection;
 * `closed` is called when nothing of the session is on the loop any more. */
void session_close(struct session *s, void (*closed)(void *ctx), void *ctx);

/* After pool_close is done. */
void session_free(struct session *s);

#endif
