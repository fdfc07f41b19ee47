#include "master/store.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <pthread.h>
#include <stdatomic.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "common/log.h"
#include "common/mem.h"
#include "master/durable.h"

enum { KEY_BYTES_MAX = 256 };

/* For the log. */
static const char *const op_names[] = {
    "job",   "result",         "reset", "check",      "event",    "value",
    "blame", "forgiven blame", "past",  "checkpoint", "deletion",
};

enum op_kind {
    OP_JOB,
    OP_RESULT,
    OP_RESET,
    OP_CHECK,
    OP_EVENT,
    OP_VALUE,
    OP_BLAME,
    OP_FORGET_BLAME,
    OP_PAST,
    OP_CHECKPOINT, /* from here on: an operation that is a batch of its own */
    OP_DELETE_JOB,
};

struct op {
    struct op *next;
    enum op_kind kind;
    enum err result;
    store_done *done; /* may be NULL */
    void *ctx;
    struct job_record job;        /* JOB; its spec_json is owned */
    struct journal_result unit;   /* RESULT; RESET, CHECK: job, sequence, unit */
    bool open;                    /* CHECK */
    struct sched_blame blame;     /* BLAME */
    struct worker_past past;      /* PAST */
    struct segment_place place;   /* RESULT, filled in by the thread */
    struct checkpoint checkpoint; /* CHECKPOINT */
    const struct film *film;      /* CHECKPOINT, borrowed */
    uint64_t job_id;              /* EVENT, BLAME, FORGET_BLAME, DELETE_JOB */
    int64_t at_us;                /* EVENT */
    bool has_key;                 /* JOB: it comes with an idempotency key */
    digest body_digest;           /* JOB: of the submission that brought the key */
    unsigned char *bytes;         /* RESULT body, EVENT text, VALUE: owned */
    size_t byte_count;            /* VALUE, RESULT */
    char key[KEY_BYTES_MAX];      /* VALUE, JOB */
};

struct op_list {
    struct op *first, **end;
};

struct store {
    char *dir; /* owned */
    int lock_fd;
    struct store_db *db;      /* loop thread until started, store thread after */
    struct segments segments; /* likewise */
    pthread_t thread;
    bool started;
    void (*notify)(void *ctx);
    void *notify_ctx;

    pthread_mutex_t mutex; /* guards the rest */
    pthread_cond_t wake;
    struct op_list todo, finished;
    bool stopping;
    atomic_uint_fast64_t waiting_bytes;
};

static void list_clear(struct op_list *l)
{
    l->first = NULL;
    l->end = &l->first;
}

static void list_append(struct op_list *l, struct op *op)
{
    op->next = NULL;
    *l->end = op;
    l->end = &op->next;
}

static void op_free(struct op *op)
{
    mem_free(op->job.spec_json);
    provenance_release(&op->checkpoint.provenance);
    mem_free(op->bytes);
    mem_free(op);
}

/* --- Opening ------------------------------------------------------------ */

/* The master's own folder: what is above it need not be readable. */
static enum err make_folder(const char *dir)
{
    return mkdir(dir, 0700) == 0 || errno == EEXIST ? ERR_OK : err_from_errno(errno);
}

static enum err make_jobs_folder(const char *dir)
{
    char *path = mem_sprintf("%s/jobs", dir);
    enum err e = path ? durable_make_folder(path) : ERR_NOMEM;
    mem_free(path);
    return e;
}

static enum err lock_folder(struct store *s)
{
    char *path = mem_sprintf("%s/lock", s->dir);
    if (!path)
        return ERR_NOMEM;
    s->lock_fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    mem_free(path);
    if (s->lock_fd < 0)
        return err_from_errno(errno);
    if (flock(s->lock_fd, LOCK_EX | LOCK_NB) != 0)
        return errno == EWOULDBLOCK ? ERR_STATE : err_from_errno(errno);
    return ERR_OK;
}

enum err store_open(const char *dir, struct store **out)
{
    struct store *s = mem_calloc(1, sizeof *s);
    if (!s)
        return ERR_NOMEM;
    s->lock_fd = -1;
    list_clear(&s->todo);
    list_clear(&s->finished);
    (void)pthread_mutex_init(&s->mutex, NULL);
    (void)pthread_cond_init(&s->wake, NULL);
    s->dir = mem_strdup(dir);
    char *path = mem_sprintf("%s/store.db", dir);
    enum err e = s->dir && path ? make_folder(dir) : ERR_NOMEM;
    if (e == ERR_OK)
        e = lock_folder(s);
    if (e == ERR_OK)
        e = make_jobs_folder(dir);
    if (e == ERR_OK)
        e = segments_init(&s->segments, dir);
    if (e == ERR_OK)
        e = store_db_open(path, &s->db);
    mem_free(path);
    if (e != ERR_OK) {
        store_close(s);
        return e;
    }
    *out = s;
    return ERR_OK;
}

/* --- Loading ------------------------------------------------------------ */

enum err store_load(struct store *s, const struct store_visitor *v)
{
    TL_ASSERT(!s->started);
    TL_TRY(store_db_each_job(s->db, v));
    TL_TRY(store_db_each_blame(s->db, v));
    TL_TRY(store_db_each_past(s->db, v));
    return store_db_each_key(s->db, v);
}

enum err store_load_events(struct store *s, uint64_t job, uint32_t count,
                           const struct store_visitor *v)
{
    TL_ASSERT(!s->started);
    return store_db_each_event(s->db, job, count, v);
}

enum err store_load_value(struct store *s, const char *key, void *value, size_t bytes)
{
    TL_ASSERT(!s->started);
    return store_db_get_value(s->db, key, value, bytes);
}

enum err store_set_value(struct store *s, const char *key, const void *value, size_t bytes)
{
    TL_ASSERT(!s->started);
    TL_TRY(store_db_begin(s->db));
    enum err e = store_db_put_value(s->db, key, value, bytes);
    if (e == ERR_OK)
        e = store_db_commit(s->db);
    if (e != ERR_OK)
        store_db_rollback(s->db);
    return e;
}

struct replaying {
    struct store *store;
    uint64_t job;
    struct film *film;
    store_replay *replay;
    store_note *note;
    void *ctx;
    uint64_t sequence;
    uint64_t segment, segment_bytes; /* the file being read, and how far the index knows it */
    uint64_t damaged[64];            /* sequences to be forgotten */
    uint32_t damaged_count;
};

static void end_segment(struct replaying *r)
{
    if (r->segment)
        segments_truncate(r->store->dir, r->job, r->segment, r->segment_bytes);
    r->segment = 0;
}

static enum err replay_step(void *ctx, const struct store_step *step)
{
    struct replaying *r = ctx;
    r->sequence = step->sequence;
    if (step->kind == STORE_STEP_RESET)
        TL_TRY(film_reset(r->film, step->unit.cell_begin, step->unit.cell_count));
    if (step->kind != STORE_STEP_RESULT)
        return r->note ? r->note(r->ctx, step->kind, step->unit) : ERR_OK;
    if (r->segment != step->place->segment)
        end_segment(r);
    r->segment = step->place->segment;
    r->segment_bytes = step->place->offset + step->place->bytes;
    unsigned char *data = NULL;
    const unsigned char *body;
    struct journal_result result;
    enum err e = segment_read(r->store->dir, r->job, step->place, &data, &result, &body);
    if (e == ERR_OK && memcmp(&result.unit, &step->unit, sizeof step->unit) != 0)
        e = ERR_CORRUPT;
    if (e == ERR_OK)
        e = r->replay(r->ctx, r->film, &result, body);
    mem_free(data);
    if (e == ERR_OK || e == ERR_NOMEM)
        return e;
    log_warn("store",
             "result unreadable, will be rendered again job=j%" PRIu64 " sequence=%" PRIu64
             " error=\"%s\"",
             r->job, step->sequence, err_text(e));
    if (r->damaged_count < sizeof r->damaged / sizeof *r->damaged)
        r->damaged[r->damaged_count++] = step->sequence;
    return ERR_OK;
}

/* A result that cannot be read now must not come back when its unit was rendered anew. */
static enum err forget_damaged(struct replaying *r)
{
    if (r->damaged_count == 0)
        return ERR_OK;
    TL_TRY(store_db_begin(r->store->db));
    for (uint32_t i = 0; i < r->damaged_count; i++) {
        enum err e = store_db_delete_unit(r->store->db, r->job, r->damaged[i]);
        if (e != ERR_OK) {
            store_db_rollback(r->store->db);
            return e;
        }
    }
    return store_db_commit(r->store->db);
}

enum err store_load_film(struct store *s, uint64_t job, const struct grid *grid,
                         const struct job_blocks *blocks, store_replay *replay, store_note *note,
                         void *ctx, struct film **film, struct checkpoint *at, uint64_t *sequence)
{
    TL_ASSERT(!s->started);
    char *path = store_film_path(s, job);
    if (!path)
        return ERR_NOMEM;
    struct checkpoint from = {0};
    struct replaying r = {.store = s, .job = job, .replay = replay, .note = note, .ctx = ctx};
    enum err e = checkpoint_read(path, job, grid, blocks, &from, &r.film);
    mem_free(path);
    if (e == ERR_NOMEM)
        return e;
    if (e != ERR_OK) {
        if (e != ERR_NOT_FOUND)
            log_error("store",
                      "checkpoint unreadable, job starts again job=j%" PRIu64 " error=\"%s\"", job,
                      err_text(e));
        from = (struct checkpoint){.job = job, .totals.nonfinite_pixel = UINT64_MAX};
        TL_TRY(film_new(grid, blocks, &r.film));
    }
    r.sequence = from.covered_sequence;
    *at = from;
    e = store_db_each_step(s->db, job, from.covered_sequence, replay_step, &r);
    end_segment(&r);
    if (e == ERR_OK)
        e = forget_damaged(&r);
    if (e != ERR_OK) {
        provenance_release(&at->provenance);
        film_free(r.film);
        return e;
    }
    *film = r.film;
    *sequence = r.sequence;
    return ERR_OK;
}

static enum err found_step(void *ctx, const struct store_step *step)
{
    (void)step;
    *(bool *)ctx = true;
    return ERR_CANCELLED; /* one is enough */
}

bool store_has_checkpoint(struct store *s, uint64_t job)
{
    TL_ASSERT(!s->started);
    char *path = store_film_path(s, job);
    bool found = path && access(path, F_OK) == 0;
    mem_free(path);
    return found;
}

bool store_has_journal(struct store *s, uint64_t job)
{
    TL_ASSERT(!s->started);
    bool found = false;
    (void)!store_db_each_step(s->db, job, 0, found_step, &found);
    return found;
}

char *store_film_path(const struct store *s, uint64_t job)
{
    return segments_film_path(s->dir, job);
}

/* --- The thread --------------------------------------------------------- */

/* A job's row, and the key that it was submitted with. */
static enum err put_job(struct store *s, const struct op *op)
{
    TL_TRY(store_db_put_job(s->db, &op->job));
    if (!op->has_key)
        return ERR_OK;
    TL_TRY(store_db_delete_keys(s->db, op->job.created_us - STORE_KEY_LIFE_US));
    return store_db_put_key(s->db, op->key, &op->body_digest, op->job.id, op->job.created_us);
}

/* The rows of one operation, inside the batch's transaction. */
static enum err op_apply(struct store *s, struct op *op)
{
    switch (op->kind) {
    case OP_JOB:
        return put_job(s, op);
    case OP_RESULT:
        return store_db_put_unit(s->db, &op->unit, &op->place);
    case OP_RESET:
        return store_db_put_reset(s->db, op->unit.job, op->unit.sequence, op->unit.unit.cell_begin,
                                  op->unit.unit.cell_count);
    case OP_CHECK:
        return store_db_put_check(s->db, op->unit.job, op->unit.sequence, op->unit.unit, op->open);
    case OP_BLAME:
        return store_db_put_blame(s->db, op->job_id, &op->blame);
    case OP_FORGET_BLAME:
        return store_db_forget_blame(s->db, op->job_id);
    case OP_PAST:
        return store_db_put_past(s->db, &op->past);
    case OP_EVENT:
        return store_db_put_event(s->db, op->job_id, op->at_us, (const char *)op->bytes);
    case OP_VALUE:
        return store_db_put_value(s->db, op->key, op->bytes, op->byte_count);
    case OP_DELETE_JOB:
        return store_db_delete_job(s->db, op->job_id);
    case OP_CHECKPOINT:
        break; /* runs alone: run_checkpoint */
    }
    TL_ASSERT(op->kind < OP_CHECKPOINT);
    return ERR_STATE;
}

/* Append, sync, commit; or nothing of the batch counts. */
static enum err batch_store(struct store *s, struct op *first)
{
    for (struct op *op = first; op; op = op->next)
        if (op->kind == OP_RESULT)
            TL_TRY(segments_append(&s->segments, &op->unit, op->bytes, &op->place));
    TL_TRY(segments_sync(&s->segments));
    TL_TRY(store_db_begin(s->db));
    for (struct op *op = first; op; op = op->next)
        TL_TRY(op_apply(s, op));
    return store_db_commit(s->db);
}

static void run_batch(struct store *s, struct op *first)
{
    enum err e = batch_store(s, first);
    if (e == ERR_OK) {
        segments_commit(&s->segments);
    } else {
        store_db_rollback(s->db);
        segments_rollback(&s->segments);
    }
    for (struct op *op = first; op; op = op->next)
        op->result = e;
}

/* The film aside, synced and renamed; then the index forgets what it covers, and the job's row gets
 * the numbers of the file, which nobody opens to tell of an ended job; then the files. */
static enum err run_checkpoint(struct store *s, struct op *op)
{
    TL_TRY(segments_make_folder(&s->segments, op->checkpoint.job));
    char *path = store_film_path(s, op->checkpoint.job);
    if (!path)
        return ERR_NOMEM;
    enum err e = checkpoint_write(path, &op->checkpoint, op->film);
    mem_free(path);
    TL_TRY(e);
    uint64_t lowest = 0;
    e = store_db_begin(s->db);
    if (e == ERR_OK)
        e = store_db_cover(s->db, op->checkpoint.job, op->checkpoint.covered_sequence, &lowest);
    if (e == ERR_OK)
        e = store_db_put_numbers(s->db, op->checkpoint.job, &op->checkpoint.totals,
                                 &op->checkpoint.stats);
    if (e == ERR_OK)
        e = store_db_commit(s->db);
    if (e != ERR_OK) {
        store_db_rollback(s->db);
        return e;
    }
    segments_roll(&s->segments, op->checkpoint.job, lowest);
    return ERR_OK;
}

static void run_alone(struct store *s, struct op *op)
{
    if (op->kind == OP_CHECKPOINT) {
        op->result = run_checkpoint(s, op);
        return;
    }
    run_batch(s, op);
    if (op->result == ERR_OK)
        segments_delete_job(&s->segments, op->job_id);
}

/* Hands operations back to the loop thread. */
static void finish(struct store *s, struct op *first)
{
    (void)pthread_mutex_lock(&s->mutex);
    *s->finished.end = first;
    while (*s->finished.end)
        s->finished.end = &(*s->finished.end)->next;
    (void)pthread_mutex_unlock(&s->mutex);
    s->notify(s->notify_ctx);
}

/* Runs all that was taken: runs of plain operations as one batch each. */
static void run_all(struct store *s, struct op *op)
{
    while (op) {
        struct op *first = op, *last = op;
        if (op->kind < OP_CHECKPOINT)
            while (last->next && last->next->kind < OP_CHECKPOINT)
                last = last->next;
        op = last->next;
        last->next = NULL;
        if (first->kind < OP_CHECKPOINT)
            run_batch(s, first);
        else
            run_alone(s, first);
        finish(s, first);
    }
}

static void *thread_main(void *ctx)
{
    struct store *s = ctx;
    for (;;) {
        (void)pthread_mutex_lock(&s->mutex);
        while (!s->todo.first && !s->stopping)
            (void)pthread_cond_wait(&s->wake, &s->mutex);
        struct op *first = s->todo.first;
        list_clear(&s->todo);
        (void)pthread_mutex_unlock(&s->mutex);
        if (!first)
            return NULL;
        run_all(s, first);
    }
}

enum err store_start(struct store *s, void (*notify)(void *ctx), void *ctx)
{
    s->notify = notify;
    s->notify_ctx = ctx;
    if (pthread_create(&s->thread, NULL, thread_main, s) != 0)
        return ERR_NOMEM;
    s->started = true;
    return ERR_OK;
}

/* --- Operations --------------------------------------------------------- */

static struct op *op_new(enum op_kind kind, store_done *done, void *ctx)
{
    struct op *op = mem_calloc(1, sizeof *op);
    if (op) {
        op->kind = kind;
        op->done = done;
        op->ctx = ctx;
    }
    return op;
}

static void submit(struct store *s, struct op *op)
{
    TL_ASSERT(s->started);
    if (op->kind == OP_RESULT)
        atomic_fetch_add(&s->waiting_bytes, op->byte_count);
    (void)pthread_mutex_lock(&s->mutex);
    list_append(&s->todo, op);
    (void)pthread_cond_signal(&s->wake);
    (void)pthread_mutex_unlock(&s->mutex);
}

/* True if the key was copied whole. */
static bool copy_key(struct op *op, const char *key)
{
    size_t bytes = strlen(key);
    if (bytes >= sizeof op->key)
        return false;
    memcpy(op->key, key, bytes + 1);
    return true;
}

enum err store_put_job(struct store *s, const struct job_record *job, store_done *done, void *ctx)
{
    return store_put_new_job(s, job, NULL, NULL, done, ctx);
}

enum err store_put_new_job(struct store *s, const struct job_record *job, const char *key,
                           const digest *body, store_done *done, void *ctx)
{
    struct op *op = op_new(OP_JOB, done, ctx);
    if (!op)
        return ERR_NOMEM;
    enum err e = !key || copy_key(op, key) ? ERR_OK : ERR_LIMIT;
    op->job = *job;
    op->job.spec_json = mem_strdup(job->spec_json);
    if (e == ERR_OK && !op->job.spec_json)
        e = ERR_NOMEM;
    if (e != ERR_OK) {
        op_free(op);
        return e;
    }
    op->has_key = key != NULL;
    if (key)
        op->body_digest = *body;
    submit(s, op);
    return ERR_OK;
}

enum err store_put_result(struct store *s, const struct journal_result *r, unsigned char *body,
                          store_done *done, void *ctx)
{
    struct op *op = op_new(OP_RESULT, done, ctx);
    if (!op) {
        mem_free(body);
        return ERR_NOMEM;
    }
    op->unit = *r;
    op->bytes = body;
    op->byte_count = r->body_bytes;
    submit(s, op);
    return ERR_OK;
}

enum err store_put_reset(struct store *s, uint64_t job, uint64_t sequence, uint32_t cell_begin,
                         uint32_t cell_count, store_done *done, void *ctx)
{
    struct op *op = op_new(OP_RESET, done, ctx);
    if (!op)
        return ERR_NOMEM;
    op->unit = (struct journal_result){
        .job = job, .sequence = sequence, .unit = {cell_begin, cell_count, 0}};
    submit(s, op);
    return ERR_OK;
}

enum err store_put_check(struct store *s, uint64_t job, uint64_t sequence, struct unit unit,
                         bool open, store_done *done, void *ctx)
{
    struct op *op = op_new(OP_CHECK, done, ctx);
    if (!op)
        return ERR_NOMEM;
    op->unit = (struct journal_result){.job = job, .sequence = sequence, .unit = unit};
    op->open = open;
    submit(s, op);
    return ERR_OK;
}

enum err store_put_blame(struct store *s, uint64_t job, const struct sched_blame *blame)
{
    struct op *op = op_new(OP_BLAME, NULL, NULL);
    if (!op)
        return ERR_NOMEM;
    op->job_id = job;
    op->blame = *blame;
    submit(s, op);
    return ERR_OK;
}

enum err store_forget_blame(struct store *s, uint64_t job)
{
    struct op *op = op_new(OP_FORGET_BLAME, NULL, NULL);
    if (!op)
        return ERR_NOMEM;
    op->job_id = job;
    submit(s, op);
    return ERR_OK;
}

enum err store_put_past(struct store *s, const struct worker_past *past)
{
    struct op *op = op_new(OP_PAST, NULL, NULL);
    if (!op)
        return ERR_NOMEM;
    op->past = *past;
    submit(s, op);
    return ERR_OK;
}

enum err store_put_checkpoint(struct store *s, const struct checkpoint *c, const struct film *film,
                              store_done *done, void *ctx)
{
    struct op *op = op_new(OP_CHECKPOINT, done, ctx);
    if (!op)
        return ERR_NOMEM;
    op->checkpoint = *c;
    op->film = film;
    submit(s, op);
    return ERR_OK;
}

enum err store_delete_job(struct store *s, uint64_t job)
{
    struct op *op = op_new(OP_DELETE_JOB, NULL, NULL);
    if (!op)
        return ERR_NOMEM;
    op->job_id = job;
    submit(s, op);
    return ERR_OK;
}

enum err store_put_event(struct store *s, uint64_t job, int64_t at_us, const char *text)
{
    struct op *op = op_new(OP_EVENT, NULL, NULL);
    if (!op)
        return ERR_NOMEM;
    op->job_id = job;
    op->at_us = at_us;
    op->bytes = (unsigned char *)mem_strdup(text);
    if (!op->bytes) {
        op_free(op);
        return ERR_NOMEM;
    }
    submit(s, op);
    return ERR_OK;
}

enum err store_put_value(struct store *s, const char *key, const void *value, size_t bytes)
{
    struct op *op = op_new(OP_VALUE, NULL, NULL);
    if (!op)
        return ERR_NOMEM;
    op->bytes = mem_alloc(bytes);
    if (!op->bytes || !copy_key(op, key)) {
        op_free(op);
        return ERR_NOMEM;
    }
    memcpy(op->bytes, value, bytes);
    op->byte_count = bytes;
    submit(s, op);
    return ERR_OK;
}

void store_poll(struct store *s)
{
    (void)pthread_mutex_lock(&s->mutex);
    struct op *op = s->finished.first;
    list_clear(&s->finished);
    (void)pthread_mutex_unlock(&s->mutex);
    while (op) {
        struct op *next = op->next;
        if (op->kind == OP_RESULT)
            atomic_fetch_sub(&s->waiting_bytes, op->byte_count);
        if (op->result != ERR_OK)
            log_error("store", "not stored what=%s error=\"%s\"", op_names[op->kind],
                      err_text(op->result));
        if (op->done)
            op->done(op->ctx, op->result);
        op_free(op);
        op = next;
    }
}

uint64_t store_waiting_bytes(const struct store *s)
{
    return atomic_load(&s->waiting_bytes);
}

void store_close(struct store *s)
{
    if (!s)
        return;
    if (s->started) {
        (void)pthread_mutex_lock(&s->mutex);
        s->stopping = true;
        (void)pthread_cond_signal(&s->wake);
        (void)pthread_mutex_unlock(&s->mutex);
        (void)pthread_join(s->thread, NULL);
        store_poll(s);
    }
    store_db_close(s->db);
    segments_release(&s->segments);
    if (s->lock_fd >= 0)
        (void)close(s->lock_fd);
    (void)pthread_cond_destroy(&s->wake);
    (void)pthread_mutex_destroy(&s->mutex);
    mem_free(s->dir);
    mem_free(s);
}
