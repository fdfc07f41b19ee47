/* worker/work.h: the leases a worker holds and the results it has not yet been thanked for.
 *
 *   Lease --> WAITING (for the scene) --> POOLED (queued or on a thread) --> result
 *                |        ^                   |       |                        |
 *                |        +- connection lost -+       |                sent, sent again
 *                |           (not if begun)           |                after a reconnect,
 *                +---- Revoke, JobEnd ----------------+                until ResultAck
 *
 * What outlives a connection is here; the session (session.h) knows connections only. Without one
 * nothing is begun; the next Hello tells the master what is held, and it revokes what it does not
 * want (PROTOCOL.md, "Leases outlive connections").
 * Bounded: leases by what a master may give (over it, the connection is broken off),
 * results by RESULT_BYTES_MAX, over which no further unit is begun.
 *
 * Thread: the loop's; render threads run the units and encode their pixels.
 */
#ifndef WORKER_WORK_H
#define WORKER_WORK_H

#include "worker/chunk_cache.h"
#include "worker/outlet.h"
#include "worker/pool.h"

struct work; /* opaque */

struct work_options {
    struct pool *pool;
    struct chunk_cache *cache;
    uint64_t scene_bytes_max;
    bool eager; /* a scene is fetched and built whole before its first unit */
    struct outlet outlet;
    void (*settled)(void *ctx); /* a lease or a result has gone: perhaps all is done */
    void *ctx;
};

/* ERR_NOMEM. */
TL_NODISCARD enum err work_new(const struct work_options *options, struct work **out);

/* Sets the stop flags of what runs, so that pool_close need not wait for whole units. */
void work_stop(struct work *w);
void work_free(struct work *w); /* after pool_close */

/* Handles a message that is about work (JobInfo, JobEnd, ChunkData, ChunkMissing, Lease, Revoke,
 * ResultAck); takes `body` (may be NULL). An error ends the connection. */
TL_NODISCARD enum err work_message(struct work *w, const struct message *m, unsigned char *body,
                                   size_t body_bytes);

/* Whether the body of a ChunkData is wanted (conn_handlers.body_wanted). */
TL_NODISCARD enum err work_body_wanted(const struct work *w, const struct message *m,
                                       uint32_t body_bytes);

/* Registered with a master. `same_farm`: the one of before; offers it the results it may not have.
 * Another farm: everything held is dropped. */
void work_connected(struct work *w, bool same_farm);

/* Nothing more is begun; once draining, what has not begun is dropped. */
void work_disconnected(struct work *w);

/* For the Hello: what is held, results first, then what is begun, then the rest; gives how many.
 * What finds no room and has not begun is dropped. */
uint32_t work_held(struct work *w, tilery_Held held[LIMIT_HELD_TOLD]);

/* From now on leases are ignored; those that wait for a scene, or for a connection, are dropped. */
void work_drain(struct work *w);

/* Sends results that found no room before. */
void work_flush(struct work *w);

/* No lease held, no result unacknowledged. */
bool work_idle(const struct work *w);

/* Results without acknowledgement. */
uint32_t work_result_count(const struct work *w);

#endif
