#include "worker/scene_fetcher_impl.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "common/log.h"
#include "common/mem.h"
#include "common/package_late.h"
#include "common/scene_lazy.h"

enum {
    PATIENCE_MS = 500, /* for the tree that another worker builds, and more for many triangles */
    PATIENCE_TRIANGLES_A_MS = 250,
    PATIENCE_MS_MAX = 600000,
};

static double now_seconds(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + (double)now.tv_nsec * 1e-9;
}

static void begin_next(struct scene_fetcher *l);

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

/* What the root says, but for the root itself. */
static void free_index(struct load *load)
{
    free_parts(load);
    mem_free(load->late);
    mem_free(load->chunks);
    load->late = NULL;
    load->chunks = NULL;
    package_index_release(&load->index);
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
    free_index(load);
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

/* Which pictures come later, and where each is to be had then. */
static enum err choose_late(struct load *load, const struct scene *tables)
{
    load->late = mem_calloc(load->index.count, sizeof *load->late);
    load->chunks = mem_calloc(tables->image_count, sizeof *load->chunks);
    if (!load->late || !load->chunks)
        return ERR_NOMEM;
    size_t count = 0;
    if (!load->eager)
        count = package_late_choose(tables, &load->index, load->late);
    if (count > 0)
        log_info("job", "pictures come when they are met job=%" PRIu64 " late=%zu of=%zu",
                 load->job, count, tables->image_count);
    for (size_t i = 0; i < tables->image_count; i++) {
        const struct package_index_entry *e = &load->index.entries[tables->mesh_count + i];
        load->chunks[i] = (struct late_chunk){.late = load->late[tables->mesh_count + i],
                                              .name = e->name,
                                              .bytes = e->bytes,
                                              .pieces = load->index.pieces[i],
                                              .entries = load->index.entries};
    }
    return ERR_OK;
}

/* Of the chunks of the index, those that the cache lacks are wanted, unless they come later. */
static enum err list_wants(struct load *load)
{
    struct want *wants = mem_alloc_array(load->index.count, sizeof *wants);
    load->parts = mem_calloc(load->index.count, sizeof *load->parts);
    if (!wants || !load->parts) {
        mem_free(wants);
        return ERR_NOMEM;
    }
    mem_free(load->wants);
    load->wants = wants;
    load->want_count = load->index.count;
    load->held_count = 0;
    for (size_t i = 0; i < load->index.count; i++) {
        const struct package_index_entry *e = &load->index.entries[i];
        bool held = load->late[i] || chunk_cache_has(load->loader->cache, &e->name);
        wants[i] = (struct want){
            .name = e->name, .raw_bytes_max = e->bytes, .state = held ? WANT_HELD : WANT_NEEDED};
        load->held_count += held;
    }
    return ERR_OK;
}

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
    free_index(load);
    load->index = (struct package_index){0};
    struct scene tables;
    load->error = package_tables_read(load->root.data, load->root.bytes, &tables, &load->index);
    if (load->error != ERR_OK)
        return;
    load->error = choose_late(load, &tables);
    scene_release(&tables);
    if (load->error == ERR_OK)
        load->error = list_wants(load);
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
    load->error = package_read_parts(load->root.data, load->root.bytes, load->parts, load->late,
                                     fetch_chunk, load, &scene);
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
        struct scene_building how = {
            .runner = &runner, .trees = kept ? &trees : NULL, .late = load->chunks};
        if (!load->loader->eager)
            how.lazy_triangles_min = SCENE_LAZY_TRIANGLES_MIN;
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
    fetcher_ask(l);
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

struct asked *fetcher_slot(struct scene_fetcher *l, uint64_t raw_bytes_max)
{
    if (l->asked_bytes > 0 && l->asked_bytes + raw_bytes_max > ASKED_BYTES_MAX)
        return NULL;
    for (size_t i = 0; i < ASKED_MAX; i++)
        if (!l->asked[i].used)
            return &l->asked[i];
    return NULL;
}

struct asked *fetcher_find_asked(const struct scene_fetcher *l, const digest *name)
{
    for (size_t i = 0; i < ASKED_MAX; i++)
        if (l->asked[i].used && digest_equal(&l->asked[i].name, name))
            return (struct asked *)&l->asked[i];
    return NULL;
}

void fetcher_asked(struct scene_fetcher *l, struct asked *slot, const struct asked *request)
{
    TL_ASSERT(!slot->used);
    *slot = *request;
    slot->used = true;
    l->asked_bytes += slot->raw_bytes_max;
}

/* The next chunks of the load at work; once all are held, goes on to the next phase. */
static void ask_load(struct scene_fetcher *l)
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
        if (w->state != WANT_NEEDED) {
            load->want_next++;
            continue;
        }
        struct asked *slot = fetcher_slot(l, w->raw_bytes_max);
        if (!slot || !l->handlers.request(l->ctx, &w->name))
            return;
        fetcher_asked(l, slot,
                      &(struct asked){.name = w->name,
                                      .raw_bytes_max = w->raw_bytes_max,
                                      .load = load,
                                      .want = load->want_next});
        w->state = WANT_ASKED;
        load->want_next++;
    }
}

void fetcher_ask(struct scene_fetcher *l)
{
    if (bring_ask(l))
        ask_load(l);
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
        fetcher_ask(load->loader);
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
        fetcher_ask(l);
    } else if (error == ERR_NOMEM) {
        end_with_chunk(load, &load->wants[i], error, "no memory for it");
    } else {
        want_again(load, i, error);
    }
}

enum err scene_fetcher_wants(const struct scene_fetcher *l, const digest *chunk, uint64_t raw_bytes,
                             uint64_t body_bytes)
{
    const struct asked *a = fetcher_find_asked(l, chunk);
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
    struct asked *a = fetcher_find_asked(l, chunk);
    if (a && a->bring) {
        struct bring *b = a->bring;
        answered(l, a);
        bring_chunk(b, body, body_bytes);
        fetcher_ask(l);
        return;
    }
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
    fetcher_ask(l);
}

enum err scene_fetcher_missing(struct scene_fetcher *l, const digest *chunk)
{
    struct asked *a = fetcher_find_asked(l, chunk);
    if (!a)
        return ERR_CORRUPT;
    struct load *load = a->load;
    struct bring *b = a->bring;
    size_t i = a->want;
    answered(l, a);
    if (b)
        bring_missing(b);
    if (load)
        end_with_chunk(load, &load->wants[i], ERR_NOT_FOUND, "the master does not have it");
    return ERR_OK;
}

/* --- Requests ----------------------------------------------------------------------- */

void scene_fetcher_connected(struct scene_fetcher *l)
{
    fetcher_ask(l);
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
        if (a->bring)
            bring_unasked(a->bring);
        answered(l, a);
    }
}

enum err scene_fetcher_start(struct scene_fetcher *l, uint64_t job, const digest *package,
                             const struct job_spec *spec, bool eager)
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
    load->eager = eager || l->eager;
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

enum err scene_fetcher_new(struct pool *pool, struct chunk_cache *cache, bool eager,
                           const struct scene_fetcher_handlers *handlers, void *ctx,
                           struct scene_fetcher **out)
{
    struct scene_fetcher *l = mem_calloc(1, sizeof *l);
    if (!l)
        return ERR_NOMEM;
    *l = (struct scene_fetcher){
        .pool = pool, .cache = cache, .eager = eager, .handlers = *handlers, .ctx = ctx};
    TAILQ_INIT(&l->loads);
    TAILQ_INIT(&l->stores);
    TAILQ_INIT(&l->trees);
    TAILQ_INIT(&l->brings);
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
    bring_free_all(l);
    mem_free(l);
}
