/* master/store_db.h: the database of jobs and the index of the journal.
 *
 * SQLite, write-ahead log, synchronous FULL: what was committed survives a loss of power. Every
 * write happens between store_db_begin and store_db_commit. One thread at a time: the loop thread
 * until the store thread starts, then that one. ERR_NOSPACE, ERR_IO, ERR_NOMEM, ERR_CORRUPT.
 */
#ifndef MASTER_STORE_DB_H
#define MASTER_STORE_DB_H

#include "master/job_record.h"
#include "master/sched/sched.h"
#include "master/store_files.h"

struct store_db; /* opaque */

/* What is kept of a worker after it lied or was set aside. */
struct worker_past {
    uint64_t id;
    bool lied;
    uint32_t pauses;
    int64_t until_us; /* end of the last pause, since 1970 */
};

TL_NODISCARD enum err store_db_open(const char *path, struct store_db **out);
void store_db_close(struct store_db *db);

TL_NODISCARD enum err store_db_begin(struct store_db *db);
TL_NODISCARD enum err store_db_commit(struct store_db *db);
void store_db_rollback(struct store_db *db);

TL_NODISCARD enum err store_db_put_job(struct store_db *db, const struct job_record *job);
TL_NODISCARD enum err store_db_put_unit(struct store_db *db, const struct journal_result *r,
                                        const struct segment_place *place);
/* Only the numbers of a job that is there. */
TL_NODISCARD enum err store_db_put_numbers(struct store_db *db, uint64_t job,
                                           const struct job_totals *totals,
                                           const struct job_stats *stats);
/* A run of cells starts again from nothing. */
TL_NODISCARD enum err store_db_put_reset(struct store_db *db, uint64_t job, uint64_t sequence,
                                         uint32_t cell_begin, uint32_t cell_count);
/* Forgets units and resets up to a sequence that a checkpoint covers; gives the lowest segment
 * that is still referred to (UINT64_MAX: none). */
TL_NODISCARD enum err store_db_cover(struct store_db *db, uint64_t job, uint64_t sequence,
                                     uint64_t *segment_lowest);
TL_NODISCARD enum err store_db_delete_unit(struct store_db *db, uint64_t job, uint64_t sequence);
TL_NODISCARD enum err store_db_delete_job(struct store_db *db, uint64_t job);
/* A line of a job's log (job 0: the farm's); the last STORE_EVENTS_KEPT of each are kept. */
enum { STORE_EVENTS_KEPT = 1000 };
TL_NODISCARD enum err store_db_put_event(struct store_db *db, uint64_t job, int64_t at_us,
                                         const char *text);
TL_NODISCARD enum err store_db_put_value(struct store_db *db, const char *key, const void *value,
                                         size_t bytes);
TL_NODISCARD enum err store_db_put_key(struct store_db *db, const char *key, const digest *body,
                                       uint64_t job, int64_t at_us);
/* Forgets idempotency keys older than `before_us`. */
TL_NODISCARD enum err store_db_delete_keys(struct store_db *db, int64_t before_us);

/* Checks: a step of the journal like a reset. */
TL_NODISCARD enum err store_db_put_check(struct store_db *db, uint64_t job, uint64_t sequence,
                                         struct unit unit, bool open);
/* Blame of units, the last STORE_BLAME_KEPT of a job. */
enum { STORE_BLAME_KEPT = 4096 };
TL_NODISCARD enum err store_db_put_blame(struct store_db *db, uint64_t job,
                                         const struct sched_blame *blame);
TL_NODISCARD enum err store_db_forget_blame(struct store_db *db, uint64_t job);
TL_NODISCARD enum err store_db_put_past(struct store_db *db, const struct worker_past *past);

/* Reading; each stops at the first error of its callback. */
struct store_visitor {
    void *ctx;
    /* Takes record->spec_json. */
    enum err (*job)(void *ctx, struct job_record *record);
    enum err (*event)(void *ctx, uint64_t job, int64_t at_us, const char *text);
    enum err (*key)(void *ctx, const char *key, const digest *body, uint64_t job, int64_t at_us);
    enum err (*blame)(void *ctx, uint64_t job, const struct sched_blame *blame);
    enum err (*past)(void *ctx, const struct worker_past *past);
};
TL_NODISCARD enum err store_db_each_job(struct store_db *db, const struct store_visitor *v);
/* The last `count` events of a job, oldest first. */
TL_NODISCARD enum err store_db_each_event(struct store_db *db, uint64_t job, uint32_t count,
                                          const struct store_visitor *v);
TL_NODISCARD enum err store_db_each_key(struct store_db *db, const struct store_visitor *v);
/* Nothing when their callback is NULL. */
TL_NODISCARD enum err store_db_each_blame(struct store_db *db, const struct store_visitor *v);
TL_NODISCARD enum err store_db_each_past(struct store_db *db, const struct store_visitor *v);

/* One step of a job's journal; a result is at `place`. Stored by number: append only. */
enum store_step_kind {
    STORE_STEP_RESET,
    STORE_STEP_CHECK_OPENED,
    STORE_STEP_CHECK_CLOSED,
    STORE_STEP_RESULT,
};
struct store_step {
    enum store_step_kind kind;
    uint64_t sequence;
    struct unit unit;
    const struct segment_place *place;
};
/* All steps with a sequence above `after`, in order. */
TL_NODISCARD enum err store_db_each_step(struct store_db *db, uint64_t job, uint64_t after,
                                         enum err (*visit)(void *ctx, const struct store_step *),
                                         void *ctx);

/* ERR_NOT_FOUND; a value of another size than `bytes` is ERR_CORRUPT. */
TL_NODISCARD enum err store_db_get_value(struct store_db *db, const char *key, void *value,
                                         size_t bytes);

#endif
