#include "worker/scene_fetcher.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "common/log.h"
#include "common/mem.h"
#include "common/package.h"

enum {
    ASKED_MAX = 8, /* requests in flight: the next chunk is on its way while one is stored */
    TRIES_MAX = 3, /* of one chunk that comes damaged, and of a scene whose chunks get lost */
    TEXT_BYTES = 200,
    PATIENCE_MS = 500, /* for the tree that another worker builds, and more for many triangles */
    PATIENCE_TRIANGLES_A_MS = 250,
    PATIENCE_MS_MAX = 600000,
};

/* Plain bytes in flight at most (or one chunk): what storing them takes in memory. */
static const uint64_t asked_bytes_max = UINT64_C(64) << 20;

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

/* A request that the master has not answered yet; `load` NULL: of a load that is no more. */
struct asked {
    bool used;
    digest name;
    uint64_t raw_bytes_max;
    struct load *load;
    size_t want;
};

struct scene_fetcher {
    struct pool *pool;
    struct chunk_cache *cache;
    uint32_t lazy_triangles_min;
    struct scene_fetcher_handlers handlers;
    void *ctx;
    TAILQ_HEAD(, load) loads; /* the first is the one at work */
    struct asked asked[ASKED_MAX];
    uint64_t asked_bytes;
    TAILQ_HEAD(, store) stores;
    TAILQ_HEAD(, tree_write) trees;
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

static double now_seconds(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + (double)now.tv_nsec * 1e-9;
}

static void begin_next(struct scene_fetcher *l);
static void ask(struct scene_fetcher *l);

/* --- The end of a load ------------------------------------------------------------ */

static void free_tree(struct tree_write *w)
{
    if (!w)
        return;
    (void)render_scene_free(w->scene);
    tree_cache_release(w->claim);
    mem_free(w);
}

static void free_parts(struct load *load)
{
    for (size_t i = 0; load->parts && i < load->index.count; i++)
        package_part_release(&load->parts[i]);
    mem_free(load->parts);
    load->parts = NULL;
}

static void free_store(struct store *s)
{
    package_part_release(&s->part);
    mem_free(s->frame);
    mem_free(s);
}

static void free_load(struct load *load)
{
    free_tree(load->new_tree);
    tree_cache_release(load->claim);
    buf_release(&load->root);
    buf_release(&load->chunk);
    free_parts(load);
    package_index_release(&load->index);
    render_scene_free(load->scene);
    mem_free(load->wants);
    mem_free(load);
}

/* Takes the load out of everything that refers to it. */
static void detach(struct scene_fetcher *l, struct load *load)
{
    for (size_t i = 0; i < ASKED_MAX; i++)
        if (l->asked[i].load == load)
            l->asked[i].load = NULL;
    struct store *s;
    TAILQ_FOREACH(s, &l->stores, in_stores)
    if (s->load == load)
        s->load = NULL;
    TAILQ_REMOVE(&l->loads, load, in_loads);
}

static void end(struct load *load, enum err error, const char *text)
{
    struct scene_fetcher *l = load->loader;
    struct loaded_scene scene = {.scene = load->scene,
                                 .load_seconds = load->load_seconds,
                                 .build_seconds = load->build_seconds,
                                 .received_bytes = load->received_bytes};
    load->scene = NULL;
    if (scene.scene)
        scene.scene_bytes = render_scene_bytes(scene.scene);
    uint64_t job = load->job;
    bool cancelled = load->cancelled;
    detach(l, load);
    free_load(load);
    if (cancelled)
        render_scene_free(scene.scene);
    else
        l->handlers.finished(l->ctx, job, error, text, &scene);
    begin_next(l);
}

static void end_with_chunk(struct load *load, const struct want *w, enum err error,
                           const char *what)
{
    char hex[DIGEST_HEX_BYTES], text[TEXT_BYTES];
    digest_to_hex(&w->name, hex);
    (void)snprintf(text, sizeof text, "chunk %.16s: %s", hex, what);
    end(load, error, text);
}

/* --- On the service thread --------------------------------------------------------- */

static void run_open(struct pool_task *task, uint32_t thread)
{
    (void)thread;
    struct load *load = (struct load *)task;
    struct chunk_cache *cache = load->loader->cache;
    load->step = "cannot read the scene's root chunk";
    load->root_missing = !chunk_cache_has(cache, &load->package);
    if (load->root_missing)
        return;
    buf_clear(&load->root);
    load->error = chunk_cache_get(cache, &load->package, PACKAGE_ROOT_BYTES_MAX, &load->root);
    if (load->error == ERR_NOT_FOUND) {
        load->error = ERR_OK;
        load->root_missing = true;
        return;
    }
    if (load->error != ERR_OK)
        return;
    free_parts(load);
    package_index_release(&load->index);
    load->index = (struct package_index){0};
    load->error = package_root_read(load->root.data, load->root.bytes, &load->index);
    if (load->error != ERR_OK)
        return;

    load->error = ERR_NOMEM;
    struct want *wants = mem_alloc_array(load->index.count, sizeof *wants);
    load->parts = mem_calloc(load->index.count, sizeof *load->parts);
    if (!wants || !load->parts) {
        mem_free(wants);
        return;
    }
    mem_free(load->wants);
    load->wants = wants;
    load->want_count = load->index.count;
    load->held_count = 0;
    for (size_t i = 0; i < load->index.count; i++) {
        const struct package_index_entry *e = &load->index.entries[i];
        bool held = chunk_cache_has(cache, &e->name);
        wants[i] = (struct want){
            .name = e->name, .raw_bytes_max = e->bytes, .state = held ? WANT_HELD : WANT_NEEDED};
        load->held_count += held;
    }
    load->error = ERR_OK;
}

static enum err fetch_chunk(void *ctx, size_t i, const struct package_index_entry *entry,
                            const unsigned char **data, size_t *bytes)
{
    (void)i;
    struct load *load = ctx;
    buf_clear(&load->chunk);
    enum err e = chunk_cache_get(load->loader->cache, &entry->name, entry->bytes, &load->chunk);
    if (e == ERR_NOT_FOUND)
        load->chunk_lost = true;
    if (e != ERR_OK)
        return e;
    if (load->chunk.bytes != entry->bytes)
        return ERR_CORRUPT;
    *data = load->chunk.data;
    *bytes = load->chunk.bytes;
    return ERR_OK;
}

static struct accel_runner runner_of(const struct load *load)
{
    struct pool *pool = load->loader->pool;
    return (struct accel_runner){
        .run = pool_run, .ctx = pool, .thread_count = pool_spread_count(pool)};
}

/* How long another worker is waited for: what building takes on one slow or busy core. One that is
 * stopped is not waited for without end. */
static uint32_t patience_ms(uint64_t triangles)
{
    uint64_t ms = PATIENCE_MS + triangles / PATIENCE_TRIANGLES_A_MS;
    return ms < PATIENCE_MS_MAX ? (uint32_t)ms : PATIENCE_MS_MAX;
}

static bool find_tree(void *ctx, const digest *key, uint64_t triangles, void **data, size_t *bytes)
{
    struct load *load = ctx;
    struct tree_cache *trees = chunk_cache_trees(load->loader->cache);
    struct accel_runner runner = runner_of(load);
    if (tree_cache_get(trees, key, &runner, data, bytes) == ERR_OK)
        return true;
    return tree_cache_claim(trees, key, patience_ms(triangles), &load->claim) &&
           tree_cache_get(trees, key, &runner, data, bytes) == ERR_OK;
}

static void drop_tree(void *ctx, const digest *key)
{
    struct load *load = ctx;
    log_warn("cache", "tree dropped: it is not what was built job=%" PRIu64, load->job);
    tree_cache_drop(chunk_cache_trees(load->loader->cache), key);
}

/* Written behind the build, by write_tree. No memory: not kept. */
static void keep_tree(void *ctx, const digest *key, const struct accel *accel)
{
    (void)accel;
    struct load *load = ctx;
    load->new_tree = mem_calloc(1, sizeof *load->new_tree);
    if (load->new_tree)
        *load->new_tree = (struct tree_write){.loader = load->loader, .key = *key};
}

static void give_tree(void *ctx, size_t from, size_t bytes, unsigned char *out)
{
    accel_trees_copy(ctx, from, bytes, out);
}

static void run_tree_write(struct pool_task *task, uint32_t thread)
{
    (void)thread;
    struct tree_write *w = (struct tree_write *)task;
    struct accel *accel = render_scene_accel(w->scene);
    enum err e = tree_cache_put(chunk_cache_trees(w->loader->cache), &w->key,
                                accel_trees_bytes(accel), give_tree, accel);
    if (e != ERR_OK)
        log_warn("cache", "tree not kept: the folder cannot take it error=\"%s\"", err_text(e));
}

static void run_build(struct pool_task *task, uint32_t thread)
{
    (void)thread;
    struct load *load = (struct load *)task;
    struct scene scene;
    scene_init(&scene);
    load->step = "cannot read the scene";
    load->error = package_read_parts(load->root.data, load->root.bytes, load->parts, fetch_chunk,
                                     load, &scene);
    buf_release(&load->chunk);
    buf_init(&load->chunk);
    double read = now_seconds();
    load->load_seconds = read - load->begun;
    if (load->error == ERR_OK) {
        load->step = "cannot build the scene";
        struct accel_runner runner = runner_of(load);
        struct scene_trees trees = {
            .find = find_tree, .drop = drop_tree, .keep = keep_tree, .ctx = load};
        bool kept = chunk_cache_trees(load->loader->cache) != NULL;
        struct scene_building how = {.runner = &runner,
                                     .trees = kept ? &trees : NULL,
                                     .lazy_triangles_min = load->loader->lazy_triangles_min};
        load->error = scene_build_as(&scene, &load->spec, &how, &load->scene);
        load->build_seconds = now_seconds() - read;
    }
    scene_release(&scene);
}

static void run_store(struct pool_task *task, uint32_t thread)
{
    (void)thread;
    struct store *s = (struct store *)task;
    struct buf plain;
    buf_init(&plain);
    s->error = chunk_cache_put(s->loader->cache, &s->name, s->frame, s->frame_bytes,
                               s->raw_bytes_max, &plain);
    s->frame = NULL;
    /* Decoded while others are on their way. What cannot be is told when the scene is read. */
    if (s->error == ERR_OK && !s->is_root && plain.bytes == s->raw_bytes_max) {
        enum err ignored = package_part_get(s->kind, plain.data, plain.bytes, &s->part);
        (void)ignored;
    }
    buf_release(&plain);
}

/* --- Phases, on the loop ------------------------------------------------------------ */

static void submit(struct load *load, enum phase phase, void (*run)(struct pool_task *, uint32_t),
                   void (*done)(struct pool_task *))
{
    load->phase = phase;
    load->error = ERR_OK;
    load->root_missing = load->chunk_lost = false;
    load->task.kind = POOL_SERVICE;
    load->task.run = run;
    load->task.done = done;
    pool_submit(load->loader->pool, &load->task);
}

static void done_open(struct pool_task *task);
static void done_build(struct pool_task *task);

static void open_again(struct load *load)
{
    if (++load->rounds > TRIES_MAX)
        end(load, ERR_IO, "the chunk cache loses what it is given");
    else
        submit(load, PHASE_OPENING, run_open, done_open);
}

static void want_root(struct load *load)
{
    struct want *wants = mem_alloc_array(1, sizeof *wants);
    if (!wants) {
        end(load, ERR_NOMEM, "no memory for the scene's root chunk");
        return;
    }
    *wants = (struct want){.name = load->package, .raw_bytes_max = PACKAGE_ROOT_BYTES_MAX};
    mem_free(load->wants);
    load->wants = wants;
    load->want_count = 1;
    load->held_count = 0;
}

static void done_open(struct pool_task *task)
{
    struct load *load = (struct load *)task;
    struct scene_fetcher *l = load->loader;
    if (load->cancelled || load->error != ERR_OK) {
        end(load, load->error, load->step);
        return;
    }
    load->want_next = 0;
    load->phase = PHASE_FETCHING;
    if (load->root_missing)
        want_root(load);
    ask(l);
}

static void done_tree_write(struct pool_task *task)
{
    struct tree_write *w = (struct tree_write *)task;
    TAILQ_REMOVE(&w->loader->trees, w, in_trees);
    free_tree(w);
}

/* From the scene itself, which lives until a slow disk has the tree. */
static void write_tree(struct load *load)
{
    struct tree_write *w = load->new_tree;
    if (!w || !load->scene || render_scene_share(load->scene, &load->spec, &w->scene) != ERR_OK)
        return;
    load->new_tree = NULL;
    w->claim = load->claim;
    load->claim = NULL;
    w->task =
        (struct pool_task){.run = run_tree_write, .done = done_tree_write, .kind = POOL_SERVICE};
    TAILQ_INSERT_TAIL(&w->loader->trees, w, in_trees);
    pool_submit(w->loader->pool, &w->task);
}

static void done_build(struct pool_task *task)
{
    struct load *load = (struct load *)task;
    write_tree(load);
    if (!load->cancelled && load->chunk_lost) {
        open_again(load);
        return;
    }
    end(load, load->error, load->error == ERR_OK ? "" : load->step);
}

static void begin_next(struct scene_fetcher *l)
{
    struct load *load = TAILQ_FIRST(&l->loads);
    if (!load || load->phase != PHASE_QUEUED)
        return;
    load->begun = now_seconds();
    chunk_cache_begin(l->cache);
    submit(load, PHASE_OPENING, run_open, done_open);
}

/* --- Asking and receiving ----------------------------------------------------------- */

static struct asked *free_slot(struct scene_fetcher *l)
{
    for (size_t i = 0; i < ASKED_MAX; i++)
        if (!l->asked[i].used)
            return &l->asked[i];
    return NULL;
}

static struct asked *find_asked(const struct scene_fetcher *l, const digest *name)
{
    for (size_t i = 0; i < ASKED_MAX; i++)
        if (l->asked[i].used && digest_equal(&l->asked[i].name, name))
            return (struct asked *)&l->asked[i];
    return NULL;
}

/* Asks for the next chunks of the load at work, as far as the window allows; once all are held,
 * goes on to the next phase. */
static void ask(struct scene_fetcher *l)
{
    struct load *load = TAILQ_FIRST(&l->loads);
    if (!load || load->phase != PHASE_FETCHING)
        return;
    if (load->held_count == load->want_count) {
        if (load->root_missing)
            open_again(load);
        else
            submit(load, PHASE_BUILDING, run_build, done_build);
        return;
    }
    while (load->want_next < load->want_count) {
        struct want *w = &load->wants[load->want_next];
        struct asked *slot = free_slot(l);
        if (w->state != WANT_NEEDED) {
            load->want_next++;
            continue;
        }
        bool over = l->asked_bytes > 0 && l->asked_bytes + w->raw_bytes_max > asked_bytes_max;
        if (!slot || over || !l->handlers.request(l->ctx, &w->name))
            return;
        *slot = (struct asked){.used = true,
                               .name = w->name,
                               .raw_bytes_max = w->raw_bytes_max,
                               .load = load,
                               .want = load->want_next};
        l->asked_bytes += w->raw_bytes_max;
        w->state = WANT_ASKED;
        load->want_next++;
    }
}

static void answered(struct scene_fetcher *l, struct asked *a)
{
    TL_ASSERT(a->used && l->asked_bytes >= a->raw_bytes_max);
    l->asked_bytes -= a->raw_bytes_max;
    *a = (struct asked){0};
}

/* The chunk did not come, or not whole: once more, unless that has been tried enough. */
static void want_again(struct load *load, size_t i, enum err error)
{
    struct want *w = &load->wants[i];
    w->state = WANT_NEEDED;
    if (load->want_next > i)
        load->want_next = i;
    if (++w->tries >= TRIES_MAX)
        end_with_chunk(load, w, error, "came damaged each time");
    else
        ask(load->loader);
}

static void done_store(struct pool_task *task)
{
    struct store *s = (struct store *)task;
    struct scene_fetcher *l = s->loader;
    struct load *load = s->load;
    size_t i = s->want;
    enum err error = s->error;
    TAILQ_REMOVE(&l->stores, s, in_stores);
    if (load && !s->is_root && error == ERR_OK) {
        load->parts[i] = s->part;
        s->part = (struct package_part){0};
    }
    free_store(s);
    if (!load)
        return;
    if (error == ERR_OK) {
        load->wants[i].state = WANT_HELD;
        load->held_count++;
        ask(l);
    } else if (error == ERR_NOMEM) {
        end_with_chunk(load, &load->wants[i], error, "no memory for it");
    } else {
        want_again(load, i, error);
    }
}

enum err scene_fetcher_wants(const struct scene_fetcher *l, const digest *chunk, uint64_t raw_bytes,
                             uint64_t body_bytes)
{
    const struct asked *a = find_asked(l, chunk);
    if (!a)
        return ERR_CORRUPT;
    /* zstd adds at most 1/256 and a little to what it cannot compress. */
    if (raw_bytes > a->raw_bytes_max || body_bytes > raw_bytes + raw_bytes / 128 + 1024)
        return ERR_LIMIT;
    return ERR_OK;
}

void scene_fetcher_chunk(struct scene_fetcher *l, const digest *chunk, unsigned char *body,
                         size_t body_bytes)
{
    struct asked *a = find_asked(l, chunk);
    struct store *s = a ? mem_calloc(1, sizeof *s) : NULL;
    struct load *load = a ? a->load : NULL;
    if (!s) {
        mem_free(body);
        if (a)
            answered(l, a);
        if (load)
            end(load, ERR_NOMEM, "no memory to store a chunk");
        return;
    }
    *s = (struct store){.task = {.run = run_store, .done = done_store, .kind = POOL_SERVICE},
                        .loader = l,
                        .load = load,
                        .want = a->want,
                        .name = *chunk,
                        .raw_bytes_max = a->raw_bytes_max,
                        .frame = body,
                        .frame_bytes = body_bytes};
    answered(l, a);
    if (load) {
        load->wants[s->want].state = WANT_STORING;
        s->is_root = load->root_missing;
        s->kind = s->is_root ? PACKAGE_ROOT : load->index.entries[s->want].kind;
        load->received_bytes += body_bytes;
    }
    TAILQ_INSERT_TAIL(&l->stores, s, in_stores);
    pool_submit(l->pool, &s->task);
    ask(l);
}

enum err scene_fetcher_missing(struct scene_fetcher *l, const digest *chunk)
{
    struct asked *a = find_asked(l, chunk);
    if (!a)
        return ERR_CORRUPT;
    struct load *load = a->load;
    size_t i = a->want;
    answered(l, a);
    if (load)
        end_with_chunk(load, &load->wants[i], ERR_NOT_FOUND, "the master does not have it");
    return ERR_OK;
}

/* --- Requests ----------------------------------------------------------------------- */

void scene_fetcher_connected(struct scene_fetcher *l)
{
    ask(l);
}

void scene_fetcher_disconnected(struct scene_fetcher *l)
{
    for (size_t i = 0; i < ASKED_MAX; i++) {
        struct asked *a = &l->asked[i];
        if (!a->used)
            continue;
        if (a->load) {
            a->load->wants[a->want].state = WANT_NEEDED;
            if (a->load->want_next > a->want)
                a->load->want_next = a->want;
        }
        answered(l, a);
    }
}

enum err scene_fetcher_start(struct scene_fetcher *l, uint64_t job, const digest *package,
                             const struct job_spec *spec)
{
    struct load *load;
    TAILQ_FOREACH(load, &l->loads, in_loads)
    TL_ASSERT(load->job != job || load->cancelled);
    load = mem_calloc(1, sizeof *load);
    if (!load)
        return ERR_NOMEM;
    load->loader = l;
    load->job = job;
    load->package = *package;
    load->spec = *spec;
    buf_init(&load->root);
    buf_init(&load->chunk);
    TAILQ_INSERT_TAIL(&l->loads, load, in_loads);
    begin_next(l);
    return ERR_OK;
}

void scene_fetcher_cancel(struct scene_fetcher *l, uint64_t job)
{
    struct load *load;
    TAILQ_FOREACH(load, &l->loads, in_loads)
    if (load->job == job && !load->cancelled)
        break;
    if (!load)
        return;
    load->cancelled = true;
    bool at_work = load->phase == PHASE_OPENING || load->phase == PHASE_BUILDING;
    if (!at_work || pool_cancel(l->pool, &load->task))
        end(load, ERR_CANCELLED, "");
}

enum err scene_fetcher_new(struct pool *pool, struct chunk_cache *cache,
                           uint32_t lazy_triangles_min,
                           const struct scene_fetcher_handlers *handlers, void *ctx,
                           struct scene_fetcher **out)
{
    struct scene_fetcher *l = mem_calloc(1, sizeof *l);
    if (!l)
        return ERR_NOMEM;
    *l = (struct scene_fetcher){.pool = pool,
                                .cache = cache,
                                .lazy_triangles_min = lazy_triangles_min,
                                .handlers = *handlers,
                                .ctx = ctx};
    TAILQ_INIT(&l->loads);
    TAILQ_INIT(&l->stores);
    TAILQ_INIT(&l->trees);
    *out = l;
    return ERR_OK;
}

void scene_fetcher_free(struct scene_fetcher *l)
{
    if (!l)
        return;
    while (!TAILQ_EMPTY(&l->loads)) {
        struct load *load = TAILQ_FIRST(&l->loads);
        TAILQ_REMOVE(&l->loads, load, in_loads);
        free_load(load);
    }
    while (!TAILQ_EMPTY(&l->stores)) {
        struct store *s = TAILQ_FIRST(&l->stores);
        TAILQ_REMOVE(&l->stores, s, in_stores);
        free_store(s);
    }
    while (!TAILQ_EMPTY(&l->trees)) {
        struct tree_write *w = TAILQ_FIRST(&l->trees);
        TAILQ_REMOVE(&l->trees, w, in_trees);
        free_tree(w);
    }
    mem_free(l);
}
