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
 * A load survives the loss of the connection and goes on with the next one.
 * Thread: the loop's; its tasks run on the pool's service thread.
 * Tests: the fake-master test (tests/e2e/test_worker_wire.py).
 */
#ifndef WORKER_SCENE_FETCHER_H
#define WORKER_SCENE_FETCHER_H

#include "common/digest.h"
#include "worker/chunk_cache.h"
#include "worker/pool.h"
#include "worker/scene/scene_build.h"

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
};

/* Borrows pool and cache; lazy_triangles_min as in scene_build.h. ERR_NOMEM. */
TL_NODISCARD enum err scene_fetcher_new(struct pool *pool, struct chunk_cache *cache,
                                        uint32_t lazy_triangles_min,
                                        const struct scene_fetcher_handlers *handlers, void *ctx,
                                        struct scene_fetcher **out);

/* After pool_close: none of its tasks is left. */
void scene_fetcher_free(struct scene_fetcher *l);

/* Queues a load; copies package and spec. A job is loaded at most once at a time (asserted). */
TL_NODISCARD enum err scene_fetcher_start(struct scene_fetcher *l, uint64_t job,
                                          const digest *package, const struct job_spec *spec);
void scene_fetcher_cancel(struct scene_fetcher *l, uint64_t job);

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
