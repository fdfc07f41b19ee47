/* Late pictures on their way into scenes. Owns each from the first unit that asks for it until it
 * is in the scene; see scene_fetcher.h. Thread: the loop's, but for run_bring on the pool's. */
#include "worker/scene_fetcher_impl.h"

#include <stdio.h>

#include "common/mem.h"

/* Frames that have come and are not made into pictures yet: no more are asked for meanwhile. */
enum { MAKING_MAX = ASKED_MAX };

static void free_bring(struct bring *b)
{
    TAILQ_REMOVE(&b->loader->brings, b, in_brings);
    picture_free(b->picture);
    mem_free(b->frame);
    mem_free(b);
}

/* The picture is in its scene, or will never be. */
static void end(struct bring *b, enum err error, const char *what, uint64_t received_bytes)
{
    struct scene_fetcher *l = b->loader;
    void *job = b->job;
    char hex[DIGEST_HEX_BYTES], text[TEXT_BYTES];
    digest_to_hex(&b->need.name, hex);
    (void)snprintf(text, sizeof text, "chunk %.16s: %s", hex, what);
    free_bring(b);
    if (job)
        l->handlers.brought(l->ctx, job, error, text, received_bytes);
    fetcher_ask(l);
}

/* --- On a thread of the pool -------------------------------------------------------- */

/* The plain chunk from the frame that came, or from the cache. */
static enum err get_chunk(struct bring *b, struct buf *plain)
{
    struct chunk_cache *cache = b->loader->cache;
    enum err e;
    if (b->frame) {
        e = chunk_cache_put(cache, &b->need.name, b->frame, b->frame_bytes, b->need.bytes, plain);
        b->frame = NULL;
        b->lost = e != ERR_OK && e != ERR_NOMEM;
        b->what = e == ERR_NOMEM ? "no memory for it" : "came damaged each time";
    } else {
        e = chunk_cache_get(cache, &b->need.name, b->need.bytes, plain);
        b->lost = e == ERR_NOT_FOUND;
        b->what = "the chunk cache loses what it is given";
    }
    return e;
}

/* What the chunk holds, judged as package_read judges it. */
static enum err make_picture(struct bring *b, const struct buf *plain)
{
    enum err e = picture_read(&b->need, plain->data, plain->bytes, &b->picture);
    b->what = e == ERR_NOMEM ? "no memory for the picture" : "it is no picture, or another one";
    return e;
}

static void run_bring(struct pool_task *task, uint32_t thread)
{
    (void)thread;
    struct bring *b = (struct bring *)task;
    struct buf plain;
    buf_init(&plain);
    b->error = get_chunk(b, &plain);
    if (b->error == ERR_OK)
        b->error = make_picture(b, &plain);
    buf_release(&plain);
}

/* --- On the loop -------------------------------------------------------------------- */

static void done_bring(struct pool_task *task)
{
    struct bring *b = (struct bring *)task;
    uint64_t received_bytes = b->frame_bytes;
    b->frame_bytes = 0;
    if (b->error != ERR_OK && b->lost && b->job && ++b->tries < TRIES_MAX) {
        b->state = BRING_NEEDED;
        fetcher_ask(b->loader);
        return;
    }
    if (b->error == ERR_OK && b->job) {
        render_scene_put(b->scene, b->need.number, b->picture);
        b->picture = NULL;
    }
    end(b, b->error, b->what, received_bytes);
}

/* A render thread that has nothing to do, if there is one; else the service thread. */
static enum pool_kind maker_of(const struct scene_fetcher *l)
{
    uint32_t threads = pool_thread_count(l->pool), busy = pool_busy(l->pool), given = 0;
    const struct bring *b;
    TAILQ_FOREACH(b, &l->brings, in_brings)
    given += b->state == BRING_MAKING && b->task.kind == POOL_RENDER;
    return busy < threads && given < threads ? POOL_RENDER : POOL_SERVICE;
}

static void make(struct bring *b)
{
    enum pool_kind kind = maker_of(b->loader);
    b->state = BRING_MAKING;
    b->error = ERR_OK;
    b->lost = false;
    b->task = (struct pool_task){.run = run_bring, .done = done_bring, .kind = kind};
    pool_submit(b->loader->pool, &b->task);
}

bool bring_ask(struct scene_fetcher *l)
{
    struct bring *b;
    size_t making = 0;
    TAILQ_FOREACH(b, &l->brings, in_brings)
    making += b->state == BRING_MAKING;
    TAILQ_FOREACH(b, &l->brings, in_brings)
    {
        if (b->state != BRING_NEEDED)
            continue;
        if (making >= MAKING_MAX)
            return true; /* what was asked for goes on; so may a load */
        if (b->tries == 0 && chunk_cache_has(l->cache, &b->need.name)) {
            make(b);
            making++;
            continue;
        }
        struct asked *slot = fetcher_slot(l, b->need.bytes);
        if (!slot || !l->handlers.request(l->ctx, &b->need.name))
            return false;
        fetcher_asked(
            l, slot,
            &(struct asked){.name = b->need.name, .raw_bytes_max = b->need.bytes, .bring = b});
        b->state = BRING_ASKED;
    }
    return true;
}

void bring_chunk(struct bring *b, unsigned char *body, size_t body_bytes)
{
    TL_ASSERT(b->state == BRING_ASKED);
    b->frame = body;
    b->frame_bytes = body_bytes;
    make(b);
}

void bring_missing(struct bring *b)
{
    end(b, ERR_NOT_FOUND, "the master does not have it", 0);
}

void bring_unasked(struct bring *b)
{
    b->state = BRING_NEEDED;
    if (!b->job)
        free_bring(b);
}

/* --- Requests ----------------------------------------------------------------------- */

enum err scene_fetcher_bring(struct scene_fetcher *l, void *job, struct render_scene *scene,
                             uint32_t number)
{
    struct picture_need need;
    if (!render_scene_need(scene, number, &need))
        return ERR_OK;
    struct bring *b;
    TAILQ_FOREACH(b, &l->brings, in_brings)
    {
        if (b->job && b->need.number == number && render_scene_is_one(b->scene, scene))
            return ERR_OK;
    }
    /* Asked for by a job that is gone: the answer is as good for this one. */
    TAILQ_FOREACH(b, &l->brings, in_brings)
    {
        if (b->job || b->state != BRING_ASKED || !digest_equal(&b->need.name, &need.name) ||
            b->need.bytes != need.bytes)
            continue;
        b->need = need;
        b->job = job;
        b->scene = scene;
        return ERR_OK;
    }
    b = mem_calloc(1, sizeof *b);
    if (!b)
        return ERR_NOMEM;
    *b = (struct bring){.loader = l, .job = job, .scene = scene, .need = need};
    TAILQ_INSERT_TAIL(&l->brings, b, in_brings);
    fetcher_ask(l);
    return ERR_OK;
}

size_t scene_fetcher_bringing(const struct scene_fetcher *l, const void *job)
{
    size_t count = 0;
    const struct bring *b;
    TAILQ_FOREACH(b, &l->brings, in_brings)
    count += b->job == job;
    return count;
}

void scene_fetcher_forget(struct scene_fetcher *l, const void *job)
{
    struct bring *b, *next;
    for (b = TAILQ_FIRST(&l->brings); b; b = next) {
        next = TAILQ_NEXT(b, in_brings);
        if (b->job != job)
            continue;
        b->job = NULL;
        b->scene = NULL;
        /* What is on its way comes, and what is being made ends; nobody hears of it. The pool is
         * not asked: it may be closed. */
        if (b->state == BRING_NEEDED)
            free_bring(b);
    }
}

void bring_free_all(struct scene_fetcher *l)
{
    while (!TAILQ_EMPTY(&l->brings))
        free_bring(TAILQ_FIRST(&l->brings));
}
