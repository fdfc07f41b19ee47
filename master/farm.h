/* master/farm.h: the master's state: jobs, workers, and what ties them to scheduler and store.
 *
 * One loop thread owns everything here. The parts, each in its own file:
 *
 *   farm.c       scheduler glue: feeds events, carries out actions, keeps its timer
 *   jobs.c       the table of jobs: submit, pause, cancel, fail, load, retention
 *   job_admit.c  which of them are with the scheduler
 *   job_keys.c   idempotency keys of submissions
 *   job_film.c   a job's film: load, checkpoint, finish
 *   job_picture.c  its picture as a file, for people
 *   job_plan.c   samples by error or time: pilot, plan, stages (job_plan.h)
 *   results.c    a result's way: decode, check, schedule, store, film, acknowledge
 *   verify.c     results that are compared; liars; what is remembered of losses and pauses
 *   workers.c    connections: hello, leases out, heartbeats, loss
 *   chunks.c     scene chunks by SHA-256
 *   sweep.c      which of them nobody needs any more
 *   events.c     news for people: event stream and logs
 *
 * A unit's way: Result arrives -> decoded and checked (pool when large) -> scheduler says which
 * cells are new -> store appends, syncs, commits (its thread) -> film adds, worker is
 * acknowledged. A job is done when the scheduler has every spot and the film every sum; then
 * the picture is made and hashed (pool), the job's row committed, the film checkpointed.
 */
#ifndef MASTER_FARM_H
#define MASTER_FARM_H

#include <uv.h>

#include "master/chunks.h"
#include "master/events.h"
#include "master/film.h"
#include "master/job_plan.h"
#include "master/rate.h"
#include "master/sched/sched.h"
#include "master/store.h"
#include "master/tag_table.h"
#include "proto/transport.h"

enum {
    FARM_JOBS_MAX = 100000,       /* kept at once, finished ones included */
    FARM_WORKERS_MAX = 10000,     /* known at once, lost ones included */
    FARM_CONNECTIONS_MAX = 12000, /* at once, those before their hello included */
    /* Descriptors that connections must leave to the store, the chunks and the loop. */
    FARM_DESCRIPTORS_OWN = 23,
    FARM_PEOPLE_MIN = 4,
    FARM_PEOPLE_MAX = 1000, /* HTTP connections at once */
    FARM_HEARTBEAT_MS = 1000,
    /* Of journal since the last checkpoint of a job. A segment lives for up to two of these, since
     * what is under way at a checkpoint ends up behind it: 48 of the 64 MiB promised. */
    FARM_CHECKPOINT_BYTES = 24 << 20,
    /* Of journal, and of results on their way there, at which nothing more of the job is leased
     * until a checkpoint has covered it: a disk that is slow, or waits for its turn on a busy
     * machine, makes neither the journal nor the queue before it longer. What is leased then comes
     * on top. */
    FARM_HOLD_BYTES = 30 << 20,
    FARM_EVENTS_SHOWN = 20,             /* last lines of a job's log in its report */
    FARM_INLINE_BYTES = 32 << 10,       /* results up to this size are decoded on the loop */
    FARM_PICTURE_BYTES_MAX = INT32_MAX, /* of a film's sums, in KiB: 2 TiB */
};

struct farm;

/* --- Jobs ----------------------------------------------------------------- */

struct job_event {
    int64_t at_us;
    char text[200];
};

struct job {
    struct job_record rec; /* rec.spec_json is owned */
    struct job_spec spec;
    struct job_blocks blocks;
    struct grid grid; /* valid while grid_ready */
    bool grid_ready;
    uint64_t rev;          /* rises with every visible change */
    struct job_plan *plan; /* NULL: every pixel gets spec.spp samples */

    /* While the scheduler knows it. */
    bool in_sched, sched_done;
    uint64_t tag_bits; /* of the farm's tag_table */
    void *sched_memory;
    struct sched_blame *blame; /* units that lost workers, for a scheduler that starts anew */
    size_t blame_count, blame_capacity;
    double done_share; /* last known, for when the scheduler has forgotten it */

    /* Film and journal. */
    struct film *film;            /* NULL: not loaded, or nothing rendered yet */
    struct provenance provenance; /* of what is in it; empty: not known, or done */
    bool has_stored;              /* the store holds a checkpoint or results */
    uint32_t film_users;          /* readers and operations that need it to stay */
    uint64_t film_used_at;        /* for eviction */
    uint64_t sequence;            /* of the last result handed to the store */
    uint64_t settled;             /* up to here the store has answered */
    uint32_t in_store;            /* results handed over and not yet answered */
    uint64_t in_store_bytes;      /* of them in the journal */
    uint64_t journal_bytes;       /* since the last checkpoint */
    bool held;                    /* see FARM_HOLD_BYTES */
    bool checkpointing, finishing, loading, estimating, record_dirty;
    struct finish *finish; /* its picture is made, and its end on its way to the disk; else NULL */
    int64_t estimated_ms, estimate_took_ms; /* of the error so far: when last, and how long */
    uint64_t estimated_count;               /* cell-blocks that were in it */
    bool final_stored;                      /* ended and its film is checkpointed */
    bool unstored;                          /* submitted, and its first row is not on disk yet */
    int64_t checkpoint_failed_ms;           /* when the last one did; 0: it did not */
    uint64_t counts_stored;                 /* sum of what is counted in units, as the row has it */

    /* For the report. */
    int64_t ready_us, last_result_us; /* the first of this master */
    struct rate rate;                 /* of rays */
    uint64_t contributors; /* workers that gave results: bits of worker ids are in `seen` */
    uint32_t *seen;        /* ids of contributors, sorted by arrival */
    size_t seen_capacity;
    struct job_event events[FARM_EVENTS_SHOWN];
    uint32_t event_count; /* ever; the last FARM_EVENTS_SHOWN are kept */
    int64_t news_at_ms;   /* when a job event was last sent */
    bool news_due;
};

/* --- Workers -------------------------------------------------------------- */

struct worker {
    struct farm *farm;
    uint64_t id;       /* "w3" is 3 */
    uint64_t instance; /* random per process */
    struct conn *conn; /* NULL: lost */
    uint32_t conns;    /* that it has had, this one included */
    char name[65], host[65], cpu[33], build[65];
    struct tags tags;
    uint64_t tag_bits; /* of the farm's tag_table, as the scheduler knows them */
    uint32_t threads;
    int64_t seen_ms; /* loop time of its last message */
    int64_t joined_us;
    bool draining, said_goodbye;
    uint64_t bytes_in, bytes_out, frames_in, frames_out; /* of connections that are gone */
    uint64_t rtt_us;
    double speed_rays_s; /* smoothed, one thread times threads */
    uint64_t rays;
    char note[129];
    enum sched_worker_state told;   /* last state sent as an event */
    struct chunk_wait *chunk_waits; /* requests not answered yet */
};

/* --- Farm ----------------------------------------------------------------- */

struct farm_counters {
    uint64_t results, result_bytes, results_refused, scene_bytes, connections, handshakes_refused;
    uint64_t samples, rays;
};

struct farm {
    uv_loop_t *loop; /* borrowed */
    struct store *store;
    struct sched *sched;
    struct arena arena; /* the scheduler's */
    struct chunk_store *chunks;
    struct events *events;
    struct transport *transport;
    struct listener *listener;

    struct job **jobs; /* by rising id */
    size_t job_count, job_capacity;
    uint64_t job_next;       /* id of the next one */
    struct worker **workers; /* by rising id */
    size_t worker_count, worker_capacity;
    uint64_t worker_next;
    struct job_keys {
        struct job_key *items; /* by age */
        size_t count, capacity;
    } keys;
    struct worker_past *pasts; /* of workers that lied or were set aside, ever */
    size_t past_count, past_capacity;

    uint64_t started_ms;  /* of the loop's clock */
    uint64_t id;          /* random per data directory */
    uint64_t epoch_limit; /* on disk: no epoch reaches it */
    bool determinism_known;
    digest determinism;          /* what a worker must have */
    const char *token;           /* borrowed; NULL: none asked */
    const struct tls_party *tls; /* borrowed; NULL: workers come in clear */
    uint32_t retention_s;        /* finished jobs are kept so long; 0: for ever */
    uint32_t keep_lost_s;        /* workers that are gone are listed so long */

    uv_timer_t sched_timer, tick_timer, cut_timer;
    uv_prepare_t settle; /* before the loop sleeps: admits jobs */
    uv_async_t store_wake;
    int handles_open;
    void (*stopped)(void *ctx);
    void *stopped_ctx;

    /* Scheduler glue. */
    bool draining_actions;
    struct sched_event *later; /* events fed while actions were carried out */
    size_t later_count, later_capacity;
    struct result *answering; /* the result that ACCEPT and COMPARE speak of */
    bool admit_due;           /* a job may be let into the scheduler */
    bool sweeping;            /* chunks.c looks for what no job needs */
    int64_t swept_ms;
    uint32_t sched_jobs; /* known to the scheduler */
    struct tag_table tag_table;

    bool running; /* everything was loaded, and the store takes operations */
    bool stopping;
    struct picture_queue { /* job_picture.c */
        struct picture *first;
        uint32_t running;
    } pictures;
    struct farm_counters counters;
};

struct farm_options {
    const char *listen, *data_dir, *token;
    int listen_socket; /* a bound socket instead of listen, which says where it is; -1: none */
    const struct tls_party *tls; /* for workers; NULL: in clear; outlives the farm */
    bool determinism_pinned;
    digest determinism;
    uint32_t retention_s, keep_lost_s;
};

/* Opens the store, takes up unfinished jobs, listens. On failure what went wrong was written to the
 * log as an error. ERR_STATE: the data folder is in use; ERR_ADDRESS; ... */
TL_NODISCARD enum err farm_start(struct farm *f, uv_loop_t *loop, const struct farm_options *o);

/* Tells workers, stores what is in memory, closes; calls `done` when all is closed. farm_release
 * then frees the rest, once the loop has ended. */
void farm_stop(struct farm *f, void (*done)(void *ctx), void *ctx);
void farm_release(struct farm *f);

/* Feeds the scheduler and carries out what it answers; later, when called while it does. */
void farm_feed(struct farm *f, const struct sched_event *event);

/* How many connections of people and workers the limit of open files has room for: a quarter is for
 * people, at most `people_max`. Strangers must never keep a result from the disk. */
void farm_connection_limits(uint32_t people_max, uint32_t *people, uint32_t *workers);

/* Milliseconds of the loop's monotonic clock. */
int64_t farm_now_ms(const struct farm *f);
/* Microseconds since 1970: the time of day at the first call, and what has passed since. A clock
 * that is set meanwhile changes no job's seconds. */
int64_t farm_wall_us(void);

/* --- jobs.c --------------------------------------------------------------- */

struct job *farm_job(const struct farm *f, uint64_t id); /* NULL: unknown */
struct worker *farm_worker(const struct farm *f, uint64_t id);

/* What a submission asks for; texts are copied. */
struct job_request {
    const char *name;
    const struct job_spec *spec;
    digest package;
    int32_t priority;
    bool is_frame;
    uint64_t shot, frame;           /* of a frame; shot 0: the first one */
    const struct sample_plan *plan; /* for JOB_STOP_PLAN, else NULL */
    const char *key;                /* Idempotency-Key, or NULL */
    digest body;                    /* of the request's body, for the key */
};

/* Makes a job, and calls `done` when it is on disk: before that nobody renders it. If it cannot be
 * stored there is no such job any more when `done` is called. ERR_LIMIT: too many jobs or too
 * large; ERR_INPUT: the plan does not fit. */
TL_NODISCARD enum err jobs_submit(struct farm *f, const struct job_request *r, store_done *done,
                                  void *ctx, struct job **out);

/* ERR_STATE: not possible in its state. Stored by the time `done` is called. */
TL_NODISCARD enum err jobs_set_state(struct farm *f, struct job *job, enum job_state to,
                                     store_done *done, void *ctx);
/* Calls `done` when the job is on disk as it is now. ERR_NOMEM. */
TL_NODISCARD enum err jobs_when_stored(struct farm *f, struct job *job, store_done *done,
                                       void *ctx);
TL_NODISCARD enum err jobs_set_priority(struct farm *f, struct job *job, int32_t priority,
                                        store_done *done, void *ctx);

/* Loads rows, journals and keys of an earlier life. */
TL_NODISCARD enum err jobs_load(struct farm *f);
void jobs_release(struct farm *f);

/* Every second: retention, rows that could not be stored, films that nobody needs. */
void jobs_tick(struct farm *f);

/* The scheduler's news. */
void jobs_started(struct farm *f, struct job *job);
void jobs_sched_done(struct farm *f, struct job *job);
void jobs_sched_failed(struct farm *f, struct job *job, const char *why);

/* The disk would not take a result: pauses the job and says why. */
void jobs_disk_trouble(struct farm *f, struct job *job, enum err e);
void jobs_fail(struct farm *f, struct job *job, const char *why);

/* A line in the job's log, its report and the event stream. */
void jobs_log(struct farm *f, struct job *job, const char *format, ...) TL_PRINTF(3, 4);

/* Something visible changed: a `job` event is due (at once when `urgent`, else at most 2 a second).
 */
void jobs_changed(struct farm *f, struct job *job, bool urgent);

/* Sends what was not urgent, in its time. */
void job_news_tick(struct farm *f, struct job *job);

/* Stores the job's row now; retried every second until it works. */
void jobs_store_record(struct farm *f, struct job *job);

double jobs_done_share(const struct farm *f, const struct job *job);

/* Rays a second over the last seconds; 0: nobody works at it, or no result has come yet. */
double jobs_rays_s(const struct farm *f, const struct job *job);
/* Fills info's seconds left where the job knows them better than the scheduler. */
void jobs_left(const struct job *job, struct sched_job_info *info);
/* Why it is not moving, or "". */
const char *jobs_note(const struct farm *f, const struct job *job);

/* Stores the rows of jobs of which something was leased again, verified or the like since: a
 * restart must not forget it. */
void jobs_keep_counts(struct farm *f);

/* --- job_admit.c ------------------------------------------------------------ */

/* Lets waiting jobs into the scheduler as far as there is room. */
void jobs_admit(struct farm *f);

/* Takes the job out of the scheduler; it may be admitted again from its film. */
void jobs_leave_sched(struct farm *f, struct job *job);
/* The scheduler has forgotten it: frees what it had lent. */
void jobs_left_sched(struct job *job);

/* Adds the scheduler's counts of the job, which it begins anew whenever the job enters. */
void jobs_add_counts(const struct farm *f, const struct job *job, struct job_stats *to);

/* --- job_keys.c ------------------------------------------------------------ */

/* The job made under an Idempotency-Key within STORE_KEY_LIFE_US; *conflict when its body differed.
 * NULL: none, or it is gone. */
struct job *jobs_by_key(const struct farm *f, const char *key, const digest *body, bool *conflict);
/* Remembers a key, in place of an older use of it; the oldest goes when there are too many. */
TL_NODISCARD enum err job_keys_note(struct farm *f, const char *key, const digest *body,
                                    uint64_t job, int64_t at_us);
void job_keys_release(struct farm *f);

/* --- sweep.c ---------------------------------------------------------------- */

/* Called every second; now and then chunks that no kept job needs go, but not what somebody is
 * about to submit. */
void sweep_chunks(struct farm *f);

/* --- job_film.c ----------------------------------------------------------- */

TL_NODISCARD enum err job_need_grid(struct job *job);
TL_NODISCARD enum err job_need_film(struct job *job);       /* an empty one if there is none */
TL_NODISCARD enum err job_need_provenance(struct job *job); /* likewise; the grid is there */

/* Reads the film of an ended job back on the pool, so that it can go on; job->loading meanwhile.
 * A checkpoint that cannot be read fails the job. */
TL_NODISCARD enum err job_fetch_film(struct farm *f, struct job *job);

/* Works out the error so far on the pool, now and then: never more than a share of the time. */
void job_estimate(struct farm *f, struct job *job);

/* A film that is being read must stay, and stay as it is. */
void job_film_hold(struct job *job);
void job_film_let_go(struct farm *f, struct job *job);

void job_error_put(struct job_stats *s, const struct film_error *e);

/* Replays checkpoint and journal; before the store's thread starts. */
TL_NODISCARD enum err job_load_film(struct farm *f, struct job *job);

/* Makes the job's row that of a finished one if its end is on its way to the disk. */
void job_finish_put(const struct job *job, struct job_record *row);

/* After a unit was added, or the scheduler was done: checkpoint or finish when due. */
void job_film_changed(struct farm *f, struct job *job);
void job_checkpoint(struct farm *f, struct job *job);

/* Holds the job back while its journal is too long, and lets it go again. */
void job_journal_limit(struct farm *f, struct job *job);

/* Frees films of finished jobs when there are too many. */
void job_films_evict(struct farm *f);

/* --- job_picture.c ---------------------------------------------------------- */

/* The picture as a file, made on the pool when its turn comes. `done` gets the bytes (takes them)
 * or an error, and how many values were too large for a half. */
enum picture_format { PICTURE_EXR, PICTURE_EXR_HALF, PICTURE_PNG };
/* Those whose turn has come: when a reader of a film has ended. */
void job_pictures_start(struct farm *f);
typedef void picture_done(void *ctx, enum err e, struct buf *file, uint64_t clamped);
TL_NODISCARD enum err job_picture(struct farm *f, struct job *job, enum picture_format format,
                                  picture_done *done, void *ctx);

/* --- results.c ------------------------------------------------------------ */

/* Takes `body`. */
void results_take(struct farm *f, struct worker *w, const tilery_Result *m, unsigned char *body,
                  size_t body_bytes);
/* The scheduler's answer about farm.answering. */
void results_accept(struct farm *f, const struct sched_action *a);
/* Of that result: the hashes of a run of its cells, and who gave it. */
const uint64_t *results_answering(const struct farm *f, struct unit run, uint64_t *worker);

/* Adds one step of the journal to film, totals and provenance at restart; ctx of both. */
struct job_loading {
    struct job *job;
    struct checkpoint at;
};
enum err results_replay(void *loading, struct film *film, const struct journal_result *r,
                        const unsigned char *body);
enum err results_replay_note(void *loading, enum store_step_kind kind, struct unit unit);

/* --- verify.c ------------------------------------------------------------- */

/* The scheduler's answers: a run of farm.answering came before; a check opened or closed; a worker
 * lied: its name is kept, and what it touched in unfinished jobs starts again. */
void verify_compare(struct farm *f, const struct sched_action *a);
void verify_check(struct farm *f, const struct sched_action *a);
void verify_liar(struct farm *f, const struct sched_action *a);
/* Before a job is admitted: what known liars touched starts again. True: something does, and the
 * job must wait until that is stored. */
bool verify_reset_liars(struct farm *f, struct job *job);
/* For its admission; you own the array; NULL: out of memory. */
struct sched_open_check *verify_open_checks(const struct job *job, size_t *count);

/* What is remembered of a worker, told to the scheduler before it joins. */
void verify_keep_past(struct farm *f, const struct worker_past *past);
void verify_tell_past(struct farm *f, uint64_t worker);
enum err verify_load_past(void *farm, const struct worker_past *past);
/* And of units that lost workers (SCHED_UNIT_LOST), until somebody asks for a retry. */
void verify_keep_blame(struct farm *f, struct job *job, const struct sched_action *a);
void verify_forget_blame(struct farm *f, struct job *job);
enum err verify_load_blame(void *farm, uint64_t job, const struct sched_blame *blame);

/* --- workers.c ------------------------------------------------------------ */

TL_NODISCARD enum err workers_listen(struct farm *f, const char *address, int fd);
void workers_stop(struct farm *f);
void workers_release(struct farm *f);
/* Sends to a worker by id; nothing when it is gone. */
void workers_send(struct farm *f, uint64_t worker, const struct message *m);
void workers_open_job(struct farm *f, uint64_t worker, uint64_t job);
void workers_news(struct farm *f, const struct sched_action *a);
void workers_tick(struct farm *f);

/* After a bit of the tag table went to another word: the scheduler hears who has it. */
void workers_retag(struct farm *f);
enum sched_worker_state workers_state(const struct farm *f, const struct worker *w,
                                      struct sched_worker_info *info);
TL_NODISCARD enum err workers_drain(struct farm *f, struct worker *w);
/* A `workers` event about this one, for those who follow the farm (once it is in quarantine, for
 * those who follow a job too). */
void workers_changed(struct farm *f, struct worker *w);

#endif
