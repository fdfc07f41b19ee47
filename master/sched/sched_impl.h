/* master/sched/sched_impl.h: the scheduler's tables, shared by its files only.
 *
 * sched.c            start, events in, actions out
 * sched_cells.c      spots of one job: window, owners, progress
 * sched_jobs.c       life of a job
 * sched_workers.c    life and health of a worker
 * sched_leases.c     life of a lease: begun, ended, blamed
 * sched_adopt.c      leases that a worker brings along when it joins
 * sched_assign.c     who gets what next
 * sched_results.c    results and checks
 * sched_restore.c    what an earlier life of the master knew
 * sched_report.c     what people see
 * sched_check.c      the invariants
 *
 * Records refer to each other by slot. Nothing here allocates after sched_new().
 */
#ifndef MASTER_SCHED_SCHED_IMPL_H
#define MASTER_SCHED_SCHED_IMPL_H

#include "master/sched/cellset.h"
#include "master/sched/chain.h"
#include "master/sched/eta.h"
#include "master/sched/sched.h"
#include "master/sched/slotmap.h"
#include "master/sched/timers.h"

/* Who owns an open spot: a lease slot, a suspect slot with OWNER_SUSPECT set, or: */
#define OWNER_NONE    UINT32_MAX       /* waiting */
#define OWNER_DONE    (UINT32_MAX - 1) /* accepted, a lower block of the cell is not */
#define OWNER_SUSPECT (UINT32_C(1) << 31)

enum {
    WORKER_JOBS = 4,         /* jobs of which a worker may hold the scene at once */
    COPIES_MAX = 2,          /* end-game copies of one unit beside the first lease */
    FAULT_POINTS = 4,        /* a fault weighs as much as so many good results... */
    FAULT_POINTS_ASIDE = 16, /* ...and so many points set a worker aside */
    UNFIT_POINTS = 2,        /* a worker says that it cannot render the job */
    UNFIT_POINTS_LOST = 1,   /* a worker is lost while it gets ready */
    UNFIT_POINTS_FAIL = 6,   /* without anyone ready in between: the job fails */
    SUSPECT_LOSERS = 4,
    SUSPECT_REPEATS = 3,        /* losses of the same worker that count as one of another */
    PAUSES_MAX = 16,            /* doublings of a pause that are counted */
    SUSPECT_PATIENCE_MS = 5000, /* before a worker gets a unit again with which it was lost */
    TICK_MS = 100,              /* while workers are idle and leases are out */
};

struct spot_counts {
    uint64_t done, waiting, leased; /* the rest is shut */
};

struct job {
    uint64_t id;
    enum sched_job_state state;
    bool removed; /* slot is freed once every worker was told */
    bool closing; /* workers must be told: sched_next walks them from close_slot on */
    uint32_t close_slot;
    int32_t priority;
    uint32_t unit_cells_max;
    uint64_t tags;     /* that its workers have */
    uint32_t threads;  /* of workers that may take work and have them */
    uint32_t reserved; /* workers that are being emptied for a suspect of this job */

    /* The spots; tables in the caller's memory. */
    uint32_t cell_count, block_count;
    uint32_t unit_ms;        /* cap of a unit's aimed duration */
    uint64_t quiet_until_ms; /* nothing new is leased before */
    uint64_t leased_ms;      /* thread-time of its leases, as expected: equals get as much */
    bool contends;           /* it had work when jobs were last looked at */
    bool held;               /* nothing new is leased until the caller lets it go */
    bool open;               /* limits may change yet */
    double cell_cost, verify_share;
    struct cellset_shape shape;
    uint32_t *owner;         /* [cell][block % SCHED_WINDOW], for open blocks */
    uint16_t *frontier;      /* [cell] */
    uint16_t *limit;         /* [cell]: blocks that it gets */
    float *cost_s;           /* [cell]: thread-seconds per weight; 0: not measured */
    uint64_t *measured;      /* [cell]: weight of its measured spots */
    double *spent_s;         /* [cell]: thread-seconds that those took */
    uint64_t *waiting;       /* [block]: the set of its waiting cells */
    uint32_t *waiting_count; /* [block] */
    uint64_t waiting_blocks[JOB_BLOCKS_MAX / 64]; /* blocks with waiting cells */
    struct spot_counts spots;
    uint64_t spot_count;                       /* sum of the limits */
    uint64_t weight_below[JOB_BLOCKS_MAX + 1]; /* [block]: of all blocks below it */
    uint64_t weight_count, weight_done;        /* of the spots, and of those done */

    /* Leases and units held back. */
    struct chain solo;           /* leases that own spots and have no copy, oldest first */
    struct chain others;         /* copies, copied ones, checks */
    uint32_t begun;              /* leases begun */
    struct chain suspects;       /* pending, to be leased again whole */
    struct chain suspects_alone; /* pending, to be leased alone */
    struct chain checks;         /* pending, in need of another worker */
    struct chain checks_out;     /* leased */
    uint32_t unfit_points;

    /* Measures. */
    uint64_t started_ms;       /* first lease; UINT64_MAX: none yet */
    double samples, samples_s; /* accepted, and the thread-seconds they took */
    double committed_s;        /* sum of the cells' spent_s */
    uint64_t measured_weight;  /* sum of the cells' measured */
    double known_s;            /* cost of the spots of measured cells that are not done */
    uint64_t known_weight;
    struct eta_spread spread;
    double done_shown; /* highest share that was ever shown */
    uint64_t units, retried, speculated, rejected, compared, verified, mismatched, cells_reset;
};

struct worker_job {
    uint64_t job; /* id; 0: free entry */
    bool open, ready;
    uint32_t unfit;           /* how often it could not render it */
    uint64_t barred_until_ms; /* 0: not barred */
    uint64_t opened_ms;
    uint32_t leases;
    uint32_t late;      /* leases in a row that were not answered in time */
    double speed;       /* pixel-samples per second and thread; 0: unknown */
    uint32_t target_ms; /* duration of the next unit */
    uint64_t used_ms;
};

enum worker_list { LIST_NONE, LIST_STARVING, LIST_PREFETCH, LIST_GONE };

struct worker {
    uint64_t handle;
    bool connected, draining, drained_told, quarantined, set_aside;
    bool away; /* `connected`, and holds its leases, but has no connection until it joins again */
    uint64_t away_until_ms;
    bool counted;          /* its threads are part of sched.threads */
    bool alone;            /* renders a suspect alone */
    uint64_t reserved_job; /* gets nothing until it is empty, then a suspect of this job; 0: no */
    uint32_t threads;
    uint64_t tags, rtt_us;
    struct chain begun, queued; /* its leases, oldest first */
    uint32_t held;
    enum worker_list list;
    struct worker_job jobs[WORKER_JOBS];
    uint32_t fault_points, pauses;
    uint32_t good_results; /* since the last pause */
    uint64_t until_ms;     /* of the pause */
    uint64_t units, lost, failed, timeouts, differed;
    double speed_shown;
};

struct lease {
    uint64_t epoch;
    uint32_t worker, job;
    struct unit unit;
    enum sched_lease_kind kind;
    bool owner; /* owns spots; else a copy or a check */
    bool begun;
    bool alone;
    bool solo;     /* in the job's solo chain */
    bool revoked;  /* ended; waits for its REVOKE to be taken */
    bool told;     /* its worker, which is joining again, still has it */
    uint32_t open; /* spots it owns */
    uint32_t twin; /* ring of the leases of one unit */
    uint32_t suspect, check;
    uint64_t leased_ms, begun_ms;
    uint32_t expected_ms;
};

/* A unit whose begun lease lost a worker. */
struct suspect {
    uint32_t job;
    struct unit unit;
    uint32_t losses, losses_alone;
    uint32_t repeats;                /* losses of a worker that it had lost before */
    uint64_t losers[SUSPECT_LOSERS]; /* handles of the workers that were lost, a ring */
    uint64_t lost_ms;                /* when the last one was */
    uint32_t lease;                  /* SLOT_NONE: pending */
    uint32_t open;                   /* spots it holds while pending */
};

struct vote {
    uint64_t worker, digest;
};

/* A unit that is rendered by several workers; vote 0 is the accepted version. */
struct check {
    uint32_t job;
    struct unit unit;
    struct vote votes[SCHED_VOTES_MAX];
    uint32_t vote_count;
    uint32_t lease; /* SLOT_NONE: pending */
};

/* A table of records with free slots kept in a chain. */
struct pool {
    struct link *links;
    struct chain free;
};

/* The result that is being answered. */
struct scan {
    bool active;
    uint32_t job; /* slot; SLOT_NONE: all of it is ignored */
    uint64_t job_id, worker;
    struct sched_result result;
    uint32_t at; /* cells answered */
    uint32_t accepted;
    bool checked;       /* its check was announced; it is opened with the last answer */
    bool unchecked;     /* it should be, but only part of it is new: that part is not accepted */
    double cell_s;      /* thread-seconds of one cell */
    enum sched_why why; /* with job SLOT_NONE */
    bool vote;
};

struct sched {
    struct sched_limits limits;
    uint64_t now_ms;
    uint64_t epoch_next;
    uint32_t liars_unsettled;

    struct slotmap job_map, worker_map, lease_map;
    struct job *jobs;
    struct worker *workers;
    struct lease *leases;
    struct link *lease_worker_links; /* begun and queued; revoked */
    struct link *lease_job_links;    /* solo and others */
    struct link *worker_links;       /* starving, prefetch, gone */
    struct chain starving, prefetch, gone, revoked;
    struct suspect *suspects;
    struct pool suspect_pool;
    struct check *checks;
    struct pool check_pool;
    uint32_t *job_rank; /* slots by falling priority, then arrival */
    uint32_t job_rank_count;
    uint32_t threads;     /* of workers that may take work */
    struct timers timers; /* lease slots, then worker slots */

    struct scan scan;
    struct sched_action *news; /* ring */
    uint32_t news_begin, news_count, news_capacity;
    struct sched_action stash; /* a LEASE behind its OPEN_JOB */
    bool stashed;
    uint32_t went_without[2]; /* tries in a row that gave nothing: of starving, of prefetching */
};

/* --- sched.c --- */
void sched_news_push(struct sched *s, const struct sched_action *a);

/* --- sched_cells.c --- */
enum spot_state { SPOT_SHUT, SPOT_WAITING, SPOT_LEASED, SPOT_DONE };
void job_cells_init(struct job *j, const struct sched_job_add *add);
void job_cells_restore(struct sched *s, struct job *j, const struct sched_done *done, size_t count);
enum spot_state job_spot_state(const struct job *j, uint32_t cell, uint32_t block);
uint32_t *job_spot_owner(const struct job *j, uint32_t cell, uint32_t block);
/* A run of waiting cells of the lowest block: how many, at most `cells_max`; 0: none. */
uint32_t job_waiting_run(const struct job *j, uint32_t cells_max, struct unit *out);
void job_spot_take(struct job *j, uint32_t cell, uint32_t block, uint32_t owner);
void job_spot_give_back(struct job *j, uint32_t cell, uint32_t block);
/* Counts a spot as done, whoever owned it; `cost_s` as measured, 0: not. */
void job_spot_finish(struct sched *s, struct job *j, uint32_t cell, uint32_t block, double cost_s);
void job_cells_reset(struct sched *s, struct job *j, struct unit unit);
/* Other limits; what is leased or done keeps its place. */
void job_cells_limit(struct job *j, const uint16_t *limits);
uint64_t job_weight(const struct job *j, uint32_t block);
/* Expected thread-seconds of one cell of the job in that block; 0: nothing is known yet. */
double job_cell_seconds(const struct job *j, uint32_t cell, uint32_t block);
double job_left_seconds(const struct job *j, double *unknown_s);
double job_done_share(const struct job *j);
void job_progress_update(struct job *j);
void job_known_update(struct job *j, uint32_t cell, int sign);
uint64_t job_spot_count(const struct job *j);

/* --- sched_jobs.c --- */
bool jobs_feed(struct sched *s, const struct sched_event *e);
void job_fail(struct sched *s, uint32_t job, enum sched_why why, struct unit unit);
/* Declares the job done if it is. */
void job_settle(struct sched *s, uint32_t job);
void job_reopen(struct sched *s, uint32_t job);
/* One step of telling workers that a job is over; false when there is nothing to tell. */
bool jobs_close_next(struct sched *s, struct sched_action *out);

/* --- sched_workers.c --- */
bool workers_feed(struct sched *s, const struct sched_event *e);
/* A slot for a new worker: a free one, or that of the worker gone for longest; SLOT_NONE. */
uint32_t worker_add(struct sched *s, uint64_t handle);
bool worker_usable(const struct worker *w);
/* Of workers that may take work and have all of the tags. */
uint32_t threads_with(const struct sched *s, uint64_t tags);
uint32_t worker_allowance(const struct sched *s, const struct worker *w);
/* Puts the worker into the list where it belongs, at its end. */
void worker_place(struct sched *s, uint32_t worker);
void worker_unreserve(struct sched *s, uint32_t worker);
void worker_unlist(struct sched *s, uint32_t worker);
struct worker_job *worker_job_find(struct worker *w, uint64_t job);
/* The worker's entry of a job, made if needed; NULL when all entries hold leases. */
struct worker_job *worker_job_get(struct sched *s, struct worker *w, uint64_t job);
void worker_job_open(struct sched *s, uint32_t worker, struct worker_job *wj);
/* The worker may not render the job: it lacks a tag, or could not render it just now. */
bool worker_barred(const struct sched *s, struct worker *w, const struct job *j);
void worker_begin_leases(struct sched *s, uint32_t worker);
void worker_fault(struct sched *s, uint32_t worker);
void worker_good(struct sched *s, uint32_t worker);
void worker_quarantine(struct sched *s, uint32_t worker);
void worker_timer_fired(struct sched *s, uint32_t worker);
void worker_timer_set(struct sched *s, uint32_t worker);
void worker_job_unfit(struct sched *s, uint32_t worker, struct worker_job *wj, uint32_t points);
enum sched_worker_state worker_state(const struct worker *w);

/* --- sched_leases.c --- */
enum lease_end {
    END_RESULT,  /* its result arrived and is about to be answered */
    END_FAILED,  /* the worker gave it back */
    END_TAKEN,   /* from a worker that is late or not to be trusted; it must be told */
    END_REVOKED, /* not wanted any more; likewise */
    END_DROPPED, /* worker is gone */
};
/* SLOT_NONE when the table is full. Takes no spots. */
uint32_t lease_new(struct sched *s, uint32_t worker, uint32_t job, struct unit unit,
                   enum sched_lease_kind kind);
/* As lease_new, with an epoch of before. */
uint32_t lease_make(struct sched *s, uint32_t worker, uint32_t job, struct unit unit,
                    enum sched_lease_kind kind, uint64_t epoch);
void lease_own(struct sched *s, uint32_t lease);
void lease_own_suspect(struct sched *s, uint32_t lease, uint32_t suspect);
void lease_own_check(struct sched *s, uint32_t lease, uint32_t check);
void lease_join(struct sched *s, uint32_t lease, uint32_t twin);
void lease_end(struct sched *s, uint32_t lease, enum lease_end how, bool blame);
void lease_release_unit(struct sched *s, uint32_t lease);
void lease_begin(struct sched *s, uint32_t lease);
void lease_timer_fired(struct sched *s, uint32_t lease);
void worker_leases_wait(struct sched *s, uint32_t worker);
void worker_leases_go_on(struct sched *s, uint32_t worker, uint64_t job);
void lease_spot_lost(struct sched *s, uint32_t owner);
void suspect_free(struct sched *s, uint32_t suspect);
/* Where a pending suspect stands. */
struct chain *suspect_chain(struct job *j, const struct suspect *p);
/* The spots of a pending suspect wait again, one by one; its losses are forgotten. */
void suspect_dissolve(struct sched *s, uint32_t suspect);
void job_leases_revoke(struct sched *s, uint32_t job);
void worker_leases_end(struct sched *s, uint32_t worker, uint64_t job, enum lease_end how,
                       bool blame);

/* --- sched_adopt.c --- */
/* Marks the leases of a worker that it tells of as it joins again. */
void worker_told(struct sched *s, uint32_t worker, const struct sched_held *held, size_t count);
/* What a worker that joins holds becomes leases again, or is revoked. */
void worker_adopt(struct sched *s, uint32_t worker, const struct sched_held *held, size_t count);

/* --- sched_assign.c --- */
/* After every event: workers may be tried again. */
void assign_rearm(struct sched *s);
bool assign_next(struct sched *s, struct sched_action *out);
double worker_speed_ratio(const struct sched *s, struct worker *w, const struct job *j);
uint32_t unit_expected_ms(const struct sched *s, struct worker *w, const struct job *j,
                          struct unit unit);

/* --- sched_results.c --- */
void result_feed(struct sched *s, const struct sched_event *e);
bool scan_next(struct sched *s, struct sched_action *out);
bool mismatch_feed(struct sched *s, const struct sched_event *e);
void check_free(struct sched *s, uint32_t check);
bool check_voted(const struct check *c, uint64_t worker);
/* A pending check whose first vote is the accepted version; SLOT_NONE when the table is full. */
uint32_t check_new(struct sched *s, uint32_t job, struct unit unit, struct vote accepted);
void job_checks_drop(struct sched *s, uint32_t job, uint32_t cell_begin, uint32_t cell_count);

/* --- sched_restore.c --- */
void job_blame_restore(struct sched *s, uint32_t job, const struct sched_blame *blame,
                       size_t count);
void job_checks_restore(struct sched *s, uint32_t job, const struct sched_open_check *checks,
                        size_t count);
bool worker_past(struct sched *s, uint64_t handle, const struct sched_past *past);

static inline bool unit_equal(struct unit a, struct unit b)
{
    return a.cell_begin == b.cell_begin && a.cell_count == b.cell_count && a.block == b.block;
}

static inline bool unit_within(const struct job *j, struct unit u)
{
    return u.cell_count > 0 && u.cell_begin < j->cell_count &&
           u.cell_count <= j->cell_count - u.cell_begin && u.block < j->block_count;
}

static inline uint32_t job_slot(const struct sched *s, const struct job *j)
{
    return (uint32_t)(j - s->jobs);
}

static inline uint32_t worker_slot(const struct sched *s, const struct worker *w)
{
    return (uint32_t)(w - s->workers);
}

static inline bool worker_has_tags(const struct worker *w, const struct job *j)
{
    return (j->tags & ~w->tags) == 0;
}

static inline bool job_is_live(const struct job *j)
{
    return j->state == SCHED_ACTIVE || j->state == SCHED_PAUSED;
}

#endif
