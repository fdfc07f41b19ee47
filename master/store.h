/* master/store.h: what outlives the master: jobs, results, checkpoints, events.
 *
 * A thread of its own takes operations from a queue, in order, all that have come at a time: it
 * appends the results to segment files, syncs those, commits rows and index in one
 * transaction, and only then reports them done. So a slow disk makes batches larger, never the
 * loop slower, and what is reported done survives a loss of power.
 *
 *   DIR/lock         held while a master uses the folder
 *   DIR/store.db     SQLite (store_db.h)
 *   DIR/jobs/ID/     film checkpoint and segments (store_files.h)
 *
 * Errors of the disk are reported to the operation's callback; then nothing of its batch counts,
 * files are cut back, and the store goes on. ERR_NOSPACE: disk full.
 *
 * Threads: all functions belong to the loop thread. `notify` is called on the store
 * thread when something is done; call store_poll on the loop thread then.
 * Tests: tests/unit/test_store.c (kill at random points, damaged files, a full disk).
 */
#ifndef MASTER_STORE_H
#define MASTER_STORE_H

#include "master/checkpoint.h"
#include "master/store_db.h"

struct store; /* opaque */

/* Called by store_poll on the loop thread, in the order of the operations. */
typedef void store_done(void *ctx, enum err e);

/* Opens or makes the folder and locks it. ERR_STATE: another master uses it. Until store_start only
 * the loading functions below may be called. */
TL_NODISCARD enum err store_open(const char *dir, struct store **out);

/* Loading: see store_db.h. */
TL_NODISCARD enum err store_load(struct store *s, const struct store_visitor *v);
TL_NODISCARD enum err store_load_events(struct store *s, uint64_t job, uint32_t count,
                                        const struct store_visitor *v);
TL_NODISCARD enum err store_load_value(struct store *s, const char *key, void *value, size_t bytes);
/* Puts a value and waits until it is on disk. */
TL_NODISCARD enum err store_set_value(struct store *s, const char *key, const void *value,
                                      size_t bytes);

/* What store_load_film calls for every result behind the checkpoint; anything but ERR_OK counts as
 * a damaged result, which is dropped (and rendered again) and logged. */
typedef enum err store_replay(void *ctx, struct film *film, const struct journal_result *r,
                              const unsigned char *body);
/* And for every other step, a reset after the film has forgotten; may be NULL. */
typedef enum err store_note(void *ctx, enum store_step_kind kind, struct unit unit);

/* A job's film from checkpoint and journal, with the totals up to the checkpoint in *at (all zero
 * when there is none) and the highest sequence in *sequence. A damaged checkpoint is logged and
 * counts as none. *at is set before the first callback, which may add to its provenance. You own
 * *film and the provenance. */
TL_NODISCARD enum err store_load_film(struct store *s, uint64_t job, const struct grid *grid,
                                      const struct job_blocks *blocks, store_replay *replay,
                                      store_note *note, void *ctx, struct film **film,
                                      struct checkpoint *at, uint64_t *sequence);

/* True if the job has a checkpoint; if it has results behind that. */
TL_NODISCARD bool store_has_checkpoint(struct store *s, uint64_t job);
TL_NODISCARD bool store_has_journal(struct store *s, uint64_t job);

/* Starts the thread. */
TL_NODISCARD enum err store_start(struct store *s, void (*notify)(void *ctx), void *ctx);

/* An idempotency key is forgotten so long after its submission. */
#define STORE_KEY_LIFE_US (INT64_C(24) * 3600 * 1000000)

/* Operations. `done` may be NULL. They fail at once (ERR_NOMEM) or report through `done`. */
TL_NODISCARD enum err store_put_job(struct store *s, const struct job_record *job, store_done *done,
                                    void *ctx);
/* A new job's row and its idempotency key (NULL: none; ERR_LIMIT: too long): both or neither. */
TL_NODISCARD enum err store_put_new_job(struct store *s, const struct job_record *job,
                                        const char *key, const digest *body, store_done *done,
                                        void *ctx);
/* Takes `body` (mem_alloc'ed, r->body_bytes) in any case. */
TL_NODISCARD enum err store_put_result(struct store *s, const struct journal_result *r,
                                       unsigned char *body, store_done *done, void *ctx);
TL_NODISCARD enum err store_put_reset(struct store *s, uint64_t job, uint64_t sequence,
                                      uint32_t cell_begin, uint32_t cell_count, store_done *done,
                                      void *ctx);
/* A check of a unit's bits was opened or closed (provenance.h). */
TL_NODISCARD enum err store_put_check(struct store *s, uint64_t job, uint64_t sequence,
                                      struct unit unit, bool open, store_done *done, void *ctx);
/* A begun unit lost a worker; all blame of a job is forgotten. */
TL_NODISCARD enum err store_put_blame(struct store *s, uint64_t job,
                                      const struct sched_blame *blame);
TL_NODISCARD enum err store_forget_blame(struct store *s, uint64_t job);
TL_NODISCARD enum err store_put_past(struct store *s, const struct worker_past *past);
/* The film must be between film_read_begin and film_read_end until `done`. Takes the provenance in
 * *c on success. */
TL_NODISCARD enum err store_put_checkpoint(struct store *s, const struct checkpoint *c,
                                           const struct film *film, store_done *done, void *ctx);
TL_NODISCARD enum err store_delete_job(struct store *s, uint64_t job);
TL_NODISCARD enum err store_put_event(struct store *s, uint64_t job, int64_t at_us,
                                      const char *text);
TL_NODISCARD enum err store_put_value(struct store *s, const char *key, const void *value,
                                      size_t bytes);

/* Runs the callbacks of what is done. */
void store_poll(struct store *s);

/* Bytes of results that wait for the disk. */
uint64_t store_waiting_bytes(const struct store *s);

/* Path of a job's checkpoint; you own it. */
char *store_film_path(const struct store *s, uint64_t job);

/* Finishes what is queued, runs all callbacks, ends the thread, unlocks. */
void store_close(struct store *s);

#endif
