#include "master/store_db.h"

#include <sqlite3.h>
#include <stdio.h>
#include <string.h>

#include "common/log.h"
#include "common/mem.h"
#include "master/durable.h"

enum { SCHEMA_VERSION = 1 };

static const char schema[] =
    "CREATE TABLE IF NOT EXISTS job(id INTEGER PRIMARY KEY, state INTEGER NOT NULL,"
    " priority INTEGER NOT NULL, name TEXT NOT NULL, note TEXT NOT NULL, package BLOB NOT NULL,"
    " spec TEXT NOT NULL, created_us INTEGER NOT NULL, started_us INTEGER NOT NULL,"
    " finished_us INTEGER NOT NULL, image BLOB, numbers BLOB NOT NULL) STRICT;"
    "CREATE TABLE IF NOT EXISTS unit(job INTEGER NOT NULL, sequence INTEGER NOT NULL,"
    " cell_begin INTEGER NOT NULL, cell_count INTEGER NOT NULL, block INTEGER NOT NULL,"
    " worker INTEGER NOT NULL, segment INTEGER NOT NULL, at INTEGER NOT NULL,"
    " bytes INTEGER NOT NULL, record BLOB, PRIMARY KEY(job, sequence)) STRICT, WITHOUT ROWID;"
    "CREATE TABLE IF NOT EXISTS event(id INTEGER PRIMARY KEY, job INTEGER NOT NULL,"
    " at_us INTEGER NOT NULL, text TEXT NOT NULL) STRICT;"
    "CREATE INDEX IF NOT EXISTS event_job ON event(job, id);"
    "CREATE TABLE IF NOT EXISTS frame(job INTEGER PRIMARY KEY, shot INTEGER NOT NULL,"
    " number INTEGER NOT NULL) STRICT;"
    "CREATE TABLE IF NOT EXISTS value(key TEXT PRIMARY KEY, value BLOB NOT NULL) STRICT;"
    "CREATE TABLE IF NOT EXISTS idempotency(key TEXT PRIMARY KEY, body BLOB NOT NULL,"
    " job INTEGER NOT NULL, at_us INTEGER NOT NULL) STRICT;"
    "CREATE TABLE IF NOT EXISTS blame(id INTEGER PRIMARY KEY, job INTEGER NOT NULL,"
    " cell_begin INTEGER NOT NULL, cell_count INTEGER NOT NULL, block INTEGER NOT NULL,"
    " worker INTEGER NOT NULL, alone INTEGER NOT NULL) STRICT;"
    "CREATE INDEX IF NOT EXISTS blame_job ON blame(job, id);"
    "CREATE TABLE IF NOT EXISTS past(worker INTEGER PRIMARY KEY, lied INTEGER NOT NULL,"
    " pauses INTEGER NOT NULL, until_us INTEGER NOT NULL) STRICT;";

/* X(name, text): the statements, prepared once. */
#define STATEMENTS(X)                                                                              \
    X(BEGIN, "BEGIN IMMEDIATE")                                                                    \
    X(COMMIT, "COMMIT")                                                                            \
    X(ROLLBACK, "ROLLBACK")                                                                        \
    X(PUT_JOB, "INSERT OR REPLACE INTO job VALUES(?1,?2,?3,?4,?5,?6,?7,?8,?9,?10,?11,?12)")        \
    X(PUT_UNIT, "INSERT INTO unit VALUES(?1,?2,?3,?4,?5,?6,?7,?8,?9,?10)")                         \
    X(COVER, "DELETE FROM unit WHERE job=?1 AND sequence<=?2")                                     \
    X(LOWEST, "SELECT min(segment) FROM unit WHERE job=?1 AND record IS NOT NULL")                 \
    X(DELETE_UNIT, "DELETE FROM unit WHERE job=?1 AND sequence=?2")                                \
    X(DELETE_JOB, "DELETE FROM job WHERE id=?1")                                                   \
    X(PUT_NUMBERS, "UPDATE job SET numbers=?2 WHERE id=?1")                                        \
    X(PUT_FRAME, "INSERT OR REPLACE INTO frame VALUES(?1,?2,?3)")                                  \
    X(DELETE_FRAME, "DELETE FROM frame WHERE job=?1")                                              \
    X(DELETE_PLAN, "DELETE FROM value WHERE key='plan.'||?1")                                      \
    X(DELETE_EVENTS, "DELETE FROM event WHERE job=?1")                                             \
    X(PUT_EVENT, "INSERT INTO event(job,at_us,text) VALUES(?1,?2,?3)")                             \
    X(TRIM_EVENTS, "DELETE FROM event WHERE job=?1 AND id<=(SELECT id FROM event WHERE job=?1 "    \
                   "ORDER BY id DESC LIMIT 1 OFFSET ?2)")                                          \
    X(PUT_VALUE, "INSERT OR REPLACE INTO value VALUES(?1,?2)")                                     \
    X(GET_VALUE, "SELECT value FROM value WHERE key=?1")                                           \
    X(PUT_KEY, "INSERT OR REPLACE INTO idempotency VALUES(?1,?2,?3,?4)")                           \
    X(DELETE_KEYS, "DELETE FROM idempotency WHERE at_us<?1")                                       \
    X(PUT_BLAME, "INSERT INTO blame(job,cell_begin,cell_count,block,worker,alone) "                \
                 "VALUES(?1,?2,?3,?4,?5,?6)")                                                      \
    X(TRIM_BLAME, "DELETE FROM blame WHERE job=?1 AND id<=(SELECT id FROM blame WHERE job=?1 "     \
                  "ORDER BY id DESC LIMIT 1 OFFSET ?2)")                                           \
    X(FORGET_BLAME, "DELETE FROM blame WHERE job=?1")                                              \
    X(EACH_BLAME, "SELECT job,cell_begin,cell_count,block,worker,alone FROM blame ORDER BY id")    \
    X(PUT_PAST, "INSERT OR REPLACE INTO past VALUES(?1,?2,?3,?4)")                                 \
    X(EACH_PAST, "SELECT worker,lied,pauses,until_us FROM past ORDER BY worker")                   \
    X(EACH_KEY, "SELECT key,body,job,at_us FROM idempotency ORDER BY at_us")                       \
    X(EACH_JOB, "SELECT id,state,priority,name,note,package,spec,created_us,started_us,"           \
                "finished_us,image,numbers,coalesce(shot,0),coalesce(number,0) "                   \
                "FROM job LEFT JOIN frame ON frame.job=job.id ORDER BY id")                        \
    X(EACH_EVENT, "SELECT at_us,text FROM (SELECT id,at_us,text FROM event WHERE job=?1 "          \
                  "ORDER BY id DESC LIMIT ?2) ORDER BY id")                                        \
    X(EACH_STEP, "SELECT sequence,cell_begin,cell_count,block,segment,at,bytes,record FROM unit "  \
                 "WHERE job=?1 AND sequence>?2 ORDER BY sequence")

enum statement {
#define STATEMENT_ENUM(name, text) STATEMENT_##name,
    STATEMENTS(STATEMENT_ENUM)
#undef STATEMENT_ENUM
        STATEMENT_COUNT
};

static const char *const texts[STATEMENT_COUNT] = {
#define STATEMENT_TEXT(name, text) [STATEMENT_##name] = text,
    STATEMENTS(STATEMENT_TEXT)
#undef STATEMENT_TEXT
};

struct store_db {
    sqlite3 *db;
    sqlite3_stmt *statement[STATEMENT_COUNT];
};

static enum err err_of(struct store_db *db, int code)
{
    switch (code & 0xff) {
    case SQLITE_OK:
    case SQLITE_ROW:
    case SQLITE_DONE:
        return ERR_OK;
    case SQLITE_FULL:
        return ERR_NOSPACE;
    case SQLITE_NOMEM:
        return ERR_NOMEM;
    case SQLITE_CORRUPT:
    case SQLITE_NOTADB:
        log_error("store", "database damaged error=\"%s\"", sqlite3_errmsg(db->db));
        return ERR_CORRUPT;
    default:
        log_error("store", "database error=\"%s\" code=%d", sqlite3_errmsg(db->db), code);
        return ERR_IO;
    }
}

static enum err run(struct store_db *db, const char *text)
{
    return err_of(db, sqlite3_exec(db->db, text, NULL, NULL, NULL));
}

static enum err check_version(struct store_db *db)
{
    sqlite3_stmt *s = NULL;
    TL_TRY(err_of(db, sqlite3_prepare_v2(db->db, "PRAGMA user_version", -1, &s, NULL)));
    int version = sqlite3_step(s) == SQLITE_ROW ? sqlite3_column_int(s, 0) : 0;
    (void)sqlite3_finalize(s);
    if (version > SCHEMA_VERSION) {
        log_error("store", "database of a later version found=%d known=%d", version,
                  SCHEMA_VERSION);
        return ERR_VERSION;
    }
    return ERR_OK;
}

static enum err prepare(struct store_db *db)
{
    TL_TRY(check_version(db));
    TL_TRY(run(db, durable_wanted() ? "PRAGMA synchronous=FULL;" : "PRAGMA synchronous=OFF;"));
    TL_TRY(run(db, "PRAGMA journal_mode=WAL; PRAGMA locking_mode=EXCLUSIVE;"
                   "PRAGMA user_version=1;"));
    TL_TRY(run(db, schema));
    for (int i = 0; i < STATEMENT_COUNT; i++)
        TL_TRY(err_of(db, sqlite3_prepare_v3(db->db, texts[i], -1, SQLITE_PREPARE_PERSISTENT,
                                             &db->statement[i], NULL)));
    return ERR_OK;
}

enum err store_db_open(const char *path, struct store_db **out)
{
    struct store_db *db = mem_calloc(1, sizeof *db);
    if (!db)
        return ERR_NOMEM;
    enum err e = err_of(db, sqlite3_open(path, &db->db));
    if (e == ERR_OK)
        e = prepare(db);
    if (e != ERR_OK) {
        store_db_close(db);
        return e;
    }
    *out = db;
    return ERR_OK;
}

void store_db_close(struct store_db *db)
{
    if (!db)
        return;
    for (int i = 0; i < STATEMENT_COUNT; i++)
        (void)sqlite3_finalize(db->statement[i]);
    (void)sqlite3_close(db->db);
    mem_free(db);
}

/* Runs a bound statement that gives no rows, and makes it ready for the next time. */
static enum err step(struct store_db *db, enum statement which)
{
    sqlite3_stmt *s = db->statement[which];
    int code = sqlite3_step(s);
    enum err e = err_of(db, code);
    (void)sqlite3_reset(s);
    (void)sqlite3_clear_bindings(s);
    return e;
}

static sqlite3_stmt *bind_u64(struct store_db *db, enum statement which, int at, uint64_t v)
{
    (void)sqlite3_bind_int64(db->statement[which], at, (int64_t)v);
    return db->statement[which];
}

enum err store_db_begin(struct store_db *db)
{
    return step(db, STATEMENT_BEGIN);
}

enum err store_db_commit(struct store_db *db)
{
    return step(db, STATEMENT_COMMIT);
}

void store_db_rollback(struct store_db *db)
{
    if (!sqlite3_get_autocommit(db->db))
        (void)step(db, STATEMENT_ROLLBACK);
}

enum err store_db_put_job(struct store_db *db, const struct job_record *job)
{
    struct buf numbers;
    buf_init(&numbers);
    job_numbers_put(&numbers, &job->totals, &job->stats);
    if (buf_status(&numbers) != ERR_OK) {
        buf_release(&numbers);
        return ERR_NOMEM;
    }
    sqlite3_stmt *s = bind_u64(db, STATEMENT_PUT_JOB, 1, job->id);
    (void)sqlite3_bind_int(s, 2, (int)job->state);
    (void)sqlite3_bind_int(s, 3, job->priority);
    (void)sqlite3_bind_text(s, 4, job->name, -1, SQLITE_STATIC);
    (void)sqlite3_bind_text(s, 5, job->note, -1, SQLITE_STATIC);
    (void)sqlite3_bind_blob(s, 6, job->package.bytes, DIGEST_BYTES, SQLITE_STATIC);
    (void)sqlite3_bind_text(s, 7, job->spec_json, -1, SQLITE_STATIC);
    (void)sqlite3_bind_int64(s, 8, job->created_us);
    (void)sqlite3_bind_int64(s, 9, job->started_us);
    (void)sqlite3_bind_int64(s, 10, job->finished_us);
    if (job->has_image)
        (void)sqlite3_bind_blob(s, 11, job->image.bytes, DIGEST_BYTES, SQLITE_STATIC);
    (void)sqlite3_bind_blob(s, 12, numbers.data, (int)numbers.bytes, SQLITE_STATIC);
    enum err e = step(db, STATEMENT_PUT_JOB);
    buf_release(&numbers);
    if (e != ERR_OK || job->shot == 0)
        return e;
    bind_u64(db, STATEMENT_PUT_FRAME, 1, job->id);
    bind_u64(db, STATEMENT_PUT_FRAME, 2, job->shot);
    bind_u64(db, STATEMENT_PUT_FRAME, 3, job->frame);
    return step(db, STATEMENT_PUT_FRAME);
}

enum err store_db_put_numbers(struct store_db *db, uint64_t job, const struct job_totals *totals,
                              const struct job_stats *stats)
{
    struct buf numbers;
    buf_init(&numbers);
    job_numbers_put(&numbers, totals, stats);
    enum err e = buf_status(&numbers);
    if (e == ERR_OK) {
        sqlite3_stmt *s = bind_u64(db, STATEMENT_PUT_NUMBERS, 1, job);
        (void)sqlite3_bind_blob(s, 2, numbers.data, (int)numbers.bytes, SQLITE_STATIC);
        e = step(db, STATEMENT_PUT_NUMBERS);
    }
    buf_release(&numbers);
    return e;
}

enum err store_db_put_unit(struct store_db *db, const struct journal_result *r,
                           const struct segment_place *place)
{
    sqlite3_stmt *s = bind_u64(db, STATEMENT_PUT_UNIT, 1, r->job);
    bind_u64(db, STATEMENT_PUT_UNIT, 2, r->sequence);
    bind_u64(db, STATEMENT_PUT_UNIT, 3, r->unit.cell_begin);
    bind_u64(db, STATEMENT_PUT_UNIT, 4, r->unit.cell_count);
    bind_u64(db, STATEMENT_PUT_UNIT, 5, r->unit.block);
    bind_u64(db, STATEMENT_PUT_UNIT, 6, r->worker);
    bind_u64(db, STATEMENT_PUT_UNIT, 7, place->segment);
    bind_u64(db, STATEMENT_PUT_UNIT, 8, place->offset);
    bind_u64(db, STATEMENT_PUT_UNIT, 9, place->bytes);
    (void)sqlite3_bind_blob(s, 10, place->record.bytes, DIGEST_BYTES, SQLITE_STATIC);
    return step(db, STATEMENT_PUT_UNIT);
}

enum err store_db_put_reset(struct store_db *db, uint64_t job, uint64_t sequence,
                            uint32_t cell_begin, uint32_t cell_count)
{
    bind_u64(db, STATEMENT_PUT_UNIT, 1, job);
    bind_u64(db, STATEMENT_PUT_UNIT, 2, sequence);
    bind_u64(db, STATEMENT_PUT_UNIT, 3, cell_begin);
    bind_u64(db, STATEMENT_PUT_UNIT, 4, cell_count);
    for (int at = 5; at <= 9; at++)
        bind_u64(db, STATEMENT_PUT_UNIT, at, 0);
    return step(db, STATEMENT_PUT_UNIT); /* no record: a reset */
}

/* Without a record; what kind of step it is stands in the segment's place. */
enum err store_db_put_check(struct store_db *db, uint64_t job, uint64_t sequence, struct unit unit,
                            bool open)
{
    bind_u64(db, STATEMENT_PUT_UNIT, 1, job);
    bind_u64(db, STATEMENT_PUT_UNIT, 2, sequence);
    bind_u64(db, STATEMENT_PUT_UNIT, 3, unit.cell_begin);
    bind_u64(db, STATEMENT_PUT_UNIT, 4, unit.cell_count);
    bind_u64(db, STATEMENT_PUT_UNIT, 5, unit.block);
    bind_u64(db, STATEMENT_PUT_UNIT, 6, 0);
    bind_u64(db, STATEMENT_PUT_UNIT, 7, open ? STORE_STEP_CHECK_OPENED : STORE_STEP_CHECK_CLOSED);
    bind_u64(db, STATEMENT_PUT_UNIT, 8, 0);
    bind_u64(db, STATEMENT_PUT_UNIT, 9, 0);
    return step(db, STATEMENT_PUT_UNIT);
}

enum err store_db_put_blame(struct store_db *db, uint64_t job, const struct sched_blame *blame)
{
    bind_u64(db, STATEMENT_PUT_BLAME, 1, job);
    bind_u64(db, STATEMENT_PUT_BLAME, 2, blame->unit.cell_begin);
    bind_u64(db, STATEMENT_PUT_BLAME, 3, blame->unit.cell_count);
    bind_u64(db, STATEMENT_PUT_BLAME, 4, blame->unit.block);
    bind_u64(db, STATEMENT_PUT_BLAME, 5, blame->worker);
    bind_u64(db, STATEMENT_PUT_BLAME, 6, blame->alone);
    TL_TRY(step(db, STATEMENT_PUT_BLAME));
    bind_u64(db, STATEMENT_TRIM_BLAME, 1, job);
    bind_u64(db, STATEMENT_TRIM_BLAME, 2, STORE_BLAME_KEPT);
    return step(db, STATEMENT_TRIM_BLAME);
}

enum err store_db_forget_blame(struct store_db *db, uint64_t job)
{
    bind_u64(db, STATEMENT_FORGET_BLAME, 1, job);
    return step(db, STATEMENT_FORGET_BLAME);
}

enum err store_db_put_past(struct store_db *db, const struct worker_past *past)
{
    bind_u64(db, STATEMENT_PUT_PAST, 1, past->id);
    bind_u64(db, STATEMENT_PUT_PAST, 2, past->lied);
    bind_u64(db, STATEMENT_PUT_PAST, 3, past->pauses);
    (void)sqlite3_bind_int64(db->statement[STATEMENT_PUT_PAST], 4, past->until_us);
    return step(db, STATEMENT_PUT_PAST);
}

enum err store_db_cover(struct store_db *db, uint64_t job, uint64_t sequence,
                        uint64_t *segment_lowest)
{
    bind_u64(db, STATEMENT_COVER, 1, job);
    bind_u64(db, STATEMENT_COVER, 2, sequence);
    TL_TRY(step(db, STATEMENT_COVER));
    sqlite3_stmt *s = bind_u64(db, STATEMENT_LOWEST, 1, job);
    int code = sqlite3_step(s);
    *segment_lowest = UINT64_MAX;
    if (code == SQLITE_ROW && sqlite3_column_type(s, 0) != SQLITE_NULL)
        *segment_lowest = (uint64_t)sqlite3_column_int64(s, 0);
    enum err e = err_of(db, code);
    (void)sqlite3_reset(s);
    return e;
}

enum err store_db_delete_unit(struct store_db *db, uint64_t job, uint64_t sequence)
{
    bind_u64(db, STATEMENT_DELETE_UNIT, 1, job);
    bind_u64(db, STATEMENT_DELETE_UNIT, 2, sequence);
    return step(db, STATEMENT_DELETE_UNIT);
}

enum err store_db_delete_job(struct store_db *db, uint64_t job)
{
    bind_u64(db, STATEMENT_COVER, 1, job);
    bind_u64(db, STATEMENT_COVER, 2, INT64_MAX);
    TL_TRY(step(db, STATEMENT_COVER));
    bind_u64(db, STATEMENT_DELETE_EVENTS, 1, job);
    TL_TRY(step(db, STATEMENT_DELETE_EVENTS));
    bind_u64(db, STATEMENT_DELETE_FRAME, 1, job);
    TL_TRY(step(db, STATEMENT_DELETE_FRAME));
    TL_TRY(store_db_forget_blame(db, job));
    bind_u64(db, STATEMENT_DELETE_PLAN, 1, job);
    TL_TRY(step(db, STATEMENT_DELETE_PLAN));
    bind_u64(db, STATEMENT_DELETE_JOB, 1, job);
    return step(db, STATEMENT_DELETE_JOB);
}

enum err store_db_put_event(struct store_db *db, uint64_t job, int64_t at_us, const char *text)
{
    sqlite3_stmt *s = bind_u64(db, STATEMENT_PUT_EVENT, 1, job);
    (void)sqlite3_bind_int64(s, 2, at_us);
    (void)sqlite3_bind_text(s, 3, text, -1, SQLITE_STATIC);
    TL_TRY(step(db, STATEMENT_PUT_EVENT));
    bind_u64(db, STATEMENT_TRIM_EVENTS, 1, job);
    bind_u64(db, STATEMENT_TRIM_EVENTS, 2, STORE_EVENTS_KEPT);
    return step(db, STATEMENT_TRIM_EVENTS);
}

enum err store_db_put_value(struct store_db *db, const char *key, const void *value, size_t bytes)
{
    sqlite3_stmt *s = db->statement[STATEMENT_PUT_VALUE];
    (void)sqlite3_bind_text(s, 1, key, -1, SQLITE_STATIC);
    (void)sqlite3_bind_blob(s, 2, value, (int)bytes, SQLITE_STATIC);
    return step(db, STATEMENT_PUT_VALUE);
}

enum err store_db_put_key(struct store_db *db, const char *key, const digest *body, uint64_t job,
                          int64_t at_us)
{
    sqlite3_stmt *s = db->statement[STATEMENT_PUT_KEY];
    (void)sqlite3_bind_text(s, 1, key, -1, SQLITE_STATIC);
    (void)sqlite3_bind_blob(s, 2, body->bytes, DIGEST_BYTES, SQLITE_STATIC);
    bind_u64(db, STATEMENT_PUT_KEY, 3, job);
    (void)sqlite3_bind_int64(s, 4, at_us);
    return step(db, STATEMENT_PUT_KEY);
}

enum err store_db_delete_keys(struct store_db *db, int64_t before_us)
{
    (void)sqlite3_bind_int64(db->statement[STATEMENT_DELETE_KEYS], 1, before_us);
    return step(db, STATEMENT_DELETE_KEYS);
}

/* --- Reading ------------------------------------------------------------ */

static bool column_digest(sqlite3_stmt *s, int at, digest *out)
{
    if (sqlite3_column_bytes(s, at) != DIGEST_BYTES)
        return false;
    memcpy(out->bytes, sqlite3_column_blob(s, at), DIGEST_BYTES);
    return true;
}

static void column_text(sqlite3_stmt *s, int at, char *out, size_t bytes)
{
    const char *text = (const char *)sqlite3_column_text(s, at);
    (void)snprintf(out, bytes, "%s", text ? text : "");
}

static enum err read_job(sqlite3_stmt *s, struct job_record *r)
{
    *r = (struct job_record){.id = (uint64_t)sqlite3_column_int64(s, 0),
                             .priority = sqlite3_column_int(s, 2),
                             .created_us = sqlite3_column_int64(s, 7),
                             .started_us = sqlite3_column_int64(s, 8),
                             .finished_us = sqlite3_column_int64(s, 9),
                             .shot = (uint64_t)sqlite3_column_int64(s, 12),
                             .frame = (uint64_t)sqlite3_column_int64(s, 13)};
    int state = sqlite3_column_int(s, 1);
    if (state < 0 || state >= JOB_STATE_COUNT || !column_digest(s, 5, &r->package))
        return ERR_CORRUPT;
    r->state = (enum job_state)state;
    column_text(s, 3, r->name, sizeof r->name);
    column_text(s, 4, r->note, sizeof r->note);
    r->has_image = column_digest(s, 10, &r->image);
    TL_TRY(job_numbers_get(sqlite3_column_blob(s, 11), (size_t)sqlite3_column_bytes(s, 11),
                           &r->totals, &r->stats));
    const char *spec = (const char *)sqlite3_column_text(s, 6);
    r->spec_json = mem_strdup(spec ? spec : "");
    return r->spec_json ? ERR_OK : ERR_NOMEM;
}

enum err store_db_each_job(struct store_db *db, const struct store_visitor *v)
{
    sqlite3_stmt *s = db->statement[STATEMENT_EACH_JOB];
    enum err e = ERR_OK;
    int code = SQLITE_DONE;
    while (e == ERR_OK && (code = sqlite3_step(s)) == SQLITE_ROW) {
        struct job_record record;
        e = read_job(s, &record);
        if (e == ERR_OK)
            e = v->job(v->ctx, &record);
    }
    (void)sqlite3_reset(s);
    return e != ERR_OK ? e : err_of(db, code);
}

enum err store_db_each_event(struct store_db *db, uint64_t job, uint32_t count,
                             const struct store_visitor *v)
{
    sqlite3_stmt *s = bind_u64(db, STATEMENT_EACH_EVENT, 1, job);
    bind_u64(db, STATEMENT_EACH_EVENT, 2, count);
    enum err e = ERR_OK;
    int code = SQLITE_DONE;
    while (e == ERR_OK && (code = sqlite3_step(s)) == SQLITE_ROW)
        e = v->event(v->ctx, job, sqlite3_column_int64(s, 0),
                     (const char *)sqlite3_column_text(s, 1));
    (void)sqlite3_reset(s);
    return e != ERR_OK ? e : err_of(db, code);
}

enum err store_db_each_key(struct store_db *db, const struct store_visitor *v)
{
    sqlite3_stmt *s = db->statement[STATEMENT_EACH_KEY];
    enum err e = ERR_OK;
    int code = SQLITE_DONE;
    while (e == ERR_OK && (code = sqlite3_step(s)) == SQLITE_ROW) {
        digest body;
        if (column_digest(s, 1, &body))
            e = v->key(v->ctx, (const char *)sqlite3_column_text(s, 0), &body,
                       (uint64_t)sqlite3_column_int64(s, 2), sqlite3_column_int64(s, 3));
    }
    (void)sqlite3_reset(s);
    return e != ERR_OK ? e : err_of(db, code);
}

enum err store_db_each_blame(struct store_db *db, const struct store_visitor *v)
{
    sqlite3_stmt *s = db->statement[STATEMENT_EACH_BLAME];
    enum err e = ERR_OK;
    int code = SQLITE_DONE;
    while (v->blame && e == ERR_OK && (code = sqlite3_step(s)) == SQLITE_ROW) {
        struct sched_blame blame = {.unit = {(uint32_t)sqlite3_column_int64(s, 1),
                                             (uint32_t)sqlite3_column_int64(s, 2),
                                             (uint32_t)sqlite3_column_int64(s, 3)},
                                    .worker = (uint64_t)sqlite3_column_int64(s, 4),
                                    .alone = sqlite3_column_int(s, 5) != 0};
        e = v->blame(v->ctx, (uint64_t)sqlite3_column_int64(s, 0), &blame);
    }
    (void)sqlite3_reset(s);
    return e != ERR_OK ? e : err_of(db, code);
}

enum err store_db_each_past(struct store_db *db, const struct store_visitor *v)
{
    sqlite3_stmt *s = db->statement[STATEMENT_EACH_PAST];
    enum err e = ERR_OK;
    int code = SQLITE_DONE;
    while (v->past && e == ERR_OK && (code = sqlite3_step(s)) == SQLITE_ROW) {
        struct worker_past past = {.id = (uint64_t)sqlite3_column_int64(s, 0),
                                   .lied = sqlite3_column_int(s, 1) != 0,
                                   .pauses = (uint32_t)sqlite3_column_int64(s, 2),
                                   .until_us = sqlite3_column_int64(s, 3)};
        e = v->past(v->ctx, &past);
    }
    (void)sqlite3_reset(s);
    return e != ERR_OK ? e : err_of(db, code);
}

enum err store_db_each_step(struct store_db *db, uint64_t job, uint64_t after,
                            enum err (*visit)(void *ctx, const struct store_step *), void *ctx)
{
    sqlite3_stmt *s = bind_u64(db, STATEMENT_EACH_STEP, 1, job);
    bind_u64(db, STATEMENT_EACH_STEP, 2, after);
    enum err e = ERR_OK;
    int code = SQLITE_DONE;
    while (e == ERR_OK && (code = sqlite3_step(s)) == SQLITE_ROW) {
        struct segment_place place = {.segment = (uint64_t)sqlite3_column_int64(s, 4),
                                      .offset = (uint64_t)sqlite3_column_int64(s, 5),
                                      .bytes = (uint64_t)sqlite3_column_int64(s, 6)};
        struct store_step found = {.sequence = (uint64_t)sqlite3_column_int64(s, 0),
                                   .unit = {(uint32_t)sqlite3_column_int64(s, 1),
                                            (uint32_t)sqlite3_column_int64(s, 2),
                                            (uint32_t)sqlite3_column_int64(s, 3)},
                                   .place = column_digest(s, 7, &place.record) ? &place : NULL};
        found.kind = found.place ? STORE_STEP_RESULT : (enum store_step_kind)place.segment;
        if (!found.place && place.segment >= STORE_STEP_RESULT) {
            e = ERR_CORRUPT;
            break;
        }
        e = visit(ctx, &found);
    }
    (void)sqlite3_reset(s);
    return e != ERR_OK ? e : err_of(db, code);
}

enum err store_db_get_value(struct store_db *db, const char *key, void *value, size_t bytes)
{
    sqlite3_stmt *s = db->statement[STATEMENT_GET_VALUE];
    (void)sqlite3_bind_text(s, 1, key, -1, SQLITE_STATIC);
    int code = sqlite3_step(s);
    enum err e = err_of(db, code);
    if (code == SQLITE_DONE)
        e = ERR_NOT_FOUND;
    else if (code == SQLITE_ROW && sqlite3_column_bytes(s, 0) != (int)bytes)
        e = ERR_CORRUPT;
    else if (code == SQLITE_ROW)
        memcpy(value, sqlite3_column_blob(s, 0), bytes);
    (void)sqlite3_reset(s);
    (void)sqlite3_clear_bindings(s);
    return e;
}
