/* worker/scene_fetcher_impl.h: what the two halves of the fetcher share: scene_fetcher.c loads
 * scenes, scene_fetcher_bring.c brings late pictures into scenes that are loaded. Both ask the
 * master through one window of requests, pictures first: units wait for them. Thread: the loop's.
 */
#ifndef WORKER_SCENE_FETCHER_IMPL_H
#define WORKER_SCENE_FETCHER_IMPL_H

#include <sys/queue.h>

#include "common/package.h"
#include "worker/scene_fetcher.h"

enum {
    ASKED_MAX = 8, /* requests in flight: the next chunk is on its way while one is stored */
    TRIES_MAX = 3, /* of one chunk that comes damaged, and of a scene whose chunks get lost */
    TEXT_BYTES = 200,
};

/* Plain bytes in flight at most (or one chunk): what storing them takes in memory. */
#define ASKED_BYTES_MAX (UINT64_C(64) << 20)

enum want_state { WANT_NEEDED, WANT_ASKED, WANT_STORING, WANT_HELD };

struct want {
    digest name;
    uint64_t raw_bytes_max;
    enum want_state state;
    uint32_t tries;
};

enum phase { PHASE_QUEUED, PHASE_OPENING, PHASE_FETCHING, PHASE_BUILDING };

struct load {
    struct pool_task task;
    struct scene_fetcher *loader;
    uint64_t job;
    digest package;
    struct job_spec spec;
    enum phase phase;
    bool cancelled;
    double begun, load_seconds, build_seconds;
    uint64_t received_bytes;
    uint32_t rounds;
    bool eager; /* nothing of it comes later */

    /* The root alone while it is missing, else every chunk of the index. */
    struct want *wants;
    size_t want_count, want_next, held_count;

    /* Written by the service thread, read by the loop in `done`. */
    enum err error;
    bool root_missing, chunk_lost;
    const char *step; /* what failed */
    struct buf root, chunk;
    struct package_index index;
    struct package_part *parts; /* of the index: chunks decoded as they came */
    bool *late;                 /* of the index: pictures that come later */
    struct late_chunk *chunks;  /* of the images */
    struct render_scene *scene;
    struct tree_write *new_tree; /* to be written behind the build; or NULL */
    struct tree_claim *claim;    /* others wait for the tree that is built here; or NULL */
    TAILQ_ENTRY(load) in_loads;
};

/* A tree on its way to the cache: nobody here waits for it. */
struct tree_write {
    struct pool_task task;
    struct scene_fetcher *loader;
    digest key;
    struct render_scene *scene; /* shared until the tree is written; the loop's */
    struct tree_claim *claim;
    TAILQ_ENTRY(tree_write) in_trees;
};

/* A late picture on its way into a scene. */
enum bring_state { BRING_NEEDED, BRING_ASKED, BRING_MAKING };

struct bring {
    struct pool_task task;
    struct scene_fetcher *loader;
    void *job;                  /* who asked for it first; NULL: nobody wants it any more */
    struct render_scene *scene; /* the job's */
    struct picture_need need;
    enum bring_state state;
    uint32_t tries;
    unsigned char *frame; /* as it came; NULL: it is in the cache */
    size_t frame_bytes;

    /* Written by a thread of the pool, read by the loop in `done`. */
    enum err error;
    bool lost;        /* the cache does not have it after all, or it came damaged */
    const char *what; /* went wrong */
    struct picture *picture;
    TAILQ_ENTRY(bring) in_brings;
};

/* A request that the master has not answered yet; both NULL: of a load that is no more. */
struct asked {
    bool used;
    digest name;
    uint64_t raw_bytes_max;
    struct load *load;
    size_t want;
    struct bring *bring;
};

struct scene_fetcher {
    struct pool *pool;
    struct chunk_cache *cache;
    bool eager;
    struct scene_fetcher_handlers handlers;
    void *ctx;
    TAILQ_HEAD(, load) loads; /* the first is the one at work */
    struct asked asked[ASKED_MAX];
    uint64_t asked_bytes;
    TAILQ_HEAD(, store) stores;
    TAILQ_HEAD(, tree_write) trees;
    TAILQ_HEAD(, bring) brings;
};

/* A chunk on its way to the cache. */
struct store {
    struct pool_task task;
    struct scene_fetcher *loader;
    struct load *load; /* NULL: of a load that is no more */
    size_t want;
    digest name;
    uint64_t raw_bytes_max;
    unsigned char *frame;
    size_t frame_bytes;
    bool is_root;
    enum package_kind kind;
    struct package_part part; /* decoded, if it can be */
    enum err error;
    TAILQ_ENTRY(store) in_stores;
};

/* The window: a slot for one more request of so many plain bytes; NULL: it is full. */
struct asked *fetcher_slot(struct scene_fetcher *l, uint64_t raw_bytes_max);

/* Fills a slot from fetcher_slot. */
void fetcher_asked(struct scene_fetcher *l, struct asked *slot, const struct asked *request);

/* The request that asks for a chunk; NULL: none. */
struct asked *fetcher_find_asked(const struct scene_fetcher *l, const digest *name);

/* Asks for what the window has room for. */
void fetcher_ask(struct scene_fetcher *l);

/* The pictures' part of it: false when the window is full or there is no connection. */
bool bring_ask(struct scene_fetcher *l);

/* The answers to requests for pictures. */
void bring_chunk(struct bring *b, unsigned char *body, size_t body_bytes);
void bring_missing(struct bring *b);
void bring_unasked(struct bring *b); /* no answer will come: the connection is lost */

/* After pool_close. */
void bring_free_all(struct scene_fetcher *l);

#endif
