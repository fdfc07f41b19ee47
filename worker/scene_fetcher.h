/* worker/scene_fetcher.h: from a package's name to a scene that can be traced.
 *
 * One load at a time, in order of request. For each: read the root chunk from the
 * cache, ask the master for what is missing (a few requests in flight), check and
 * store what comes, then decode and build on the service thread, spread over the
 * pool. A chunk that the disk has lost or changed meanwhile is asked for again.
 *
 *   OPENING --> FETCHING --> BUILDING --> finished
 *      ^           |             |
 *      +-----------+-------------+   root came, or a chunk was lost
 *
 * Late pictures (package_late.h) are left out of a load. scene_fetcher_bring gets those, and of
 * pictures in pieces those pieces, that units have met: each is asked for once, however many units
 * wait for it, before what a load asks for; read from the cache if it is there, made ready on
 * threads that are free, and put into the scene.
 *
 * A load survives the loss of the connection and goes on with the next one.
 * Thread: the loop's; its tasks run on the pool's service thread.
 * Tests: the fake-master test (tests/e2e/test_worker_wire.py), tests/e2e/test_e2e_late.py.
 */
#ifndef WORKER_SCENE_FETCHER_H
#define WORKER_SCENE_FETCHER_H

#include "common/digest.h"
#include "worker/chunk_cache.h"
#include "worker/pool.h"
#include "worker/scene/scene_late.h"

struct scene_fetcher; /* opaque */

struct loaded_scene {
    struct render_scene *scene; /* yours: render_scene_free */
    double load_seconds, build_seconds;
    uint64_t scene_bytes, received_bytes;
};

struct scene_fetcher_handlers {
    /* Asks the master for a chunk; false: not connected now (scene_fetcher_connected follows). */
    bool (*request)(void *ctx, const digest *chunk);

    /* The load of `job` is over, and `scene` (NULL after an error) is yours. `text` says what went
     * wrong, for people. Not called for a cancelled load. */
    void (*finished)(void *ctx, uint64_t job, enum err error, const char *text,
                     const struct loaded_scene *scene);

    /* A picture that `job` (of scene_fetcher_bring) asked for is in its scene, or cannot be had:
     * then `text` says why, for people. `received_bytes` came over the wire for it. */
    void (*brought)(void *ctx, void *job, enum err error, const char *text,
                    uint64_t received_bytes);
};

/* Borrows pool and cache. `eager`: scenes are fetched and built whole. ERR_NOMEM. */
TL_NODISCARD enum err scene_fetcher_new(struct pool *pool, struct chunk_cache *cache, bool eager,
                                        const struct scene_fetcher_handlers *handlers, void *ctx,
                                        struct scene_fetcher **out);

/* After pool_close: none of its tasks is left. */
void scene_fetcher_free(struct scene_fetcher *l);

/* Queues a load; copies package and spec. A job is loaded at most once at a time (asserted).
 * `eager`: none of its pictures is late. */
TL_NODISCARD enum err scene_fetcher_start(struct scene_fetcher *l, uint64_t job,
                                          const digest *package, const struct job_spec *spec,
                                          bool eager);
void scene_fetcher_cancel(struct scene_fetcher *l, uint64_t job);

/* Brings a picture, or part of one, into a scene, unless it is there or on its way; its number as
 * in scene_late.h. `job` is whose `scene` it is: both are borrowed until `brought` or
 * scene_fetcher_forget. ERR_NOMEM. */
TL_NODISCARD enum err scene_fetcher_bring(struct scene_fetcher *l, void *job,
                                          struct render_scene *scene, uint32_t number);

/* Pictures and parts of such on their way for this job. */
size_t scene_fetcher_bringing(const struct scene_fetcher *l, const void *job);

/* The job wants none of its pictures any more. Other jobs on its scene ask again for theirs. */
void scene_fetcher_forget(struct scene_fetcher *l, const void *job);

/* The connection is up: asks (again) for what is missing. Down: forgets what was asked. */
void scene_fetcher_connected(struct scene_fetcher *l);
void scene_fetcher_disconnected(struct scene_fetcher *l);

/* For the body of a ChunkData: ERR_OK if it was asked for and the sizes can be true. */
TL_NODISCARD enum err scene_fetcher_wants(const struct scene_fetcher *l, const digest *chunk,
                                          uint64_t raw_bytes, uint64_t body_bytes);

/* Takes `body` (mem_free). */
void scene_fetcher_chunk(struct scene_fetcher *l, const digest *chunk, unsigned char *body,
                         size_t body_bytes);
/* The master has no such chunk: the load fails. ERR_CORRUPT if it was not asked for: then the
 * answer that is waited for will not come. */
TL_NODISCARD enum err scene_fetcher_missing(struct scene_fetcher *l, const digest *chunk);

#endif
