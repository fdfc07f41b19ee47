/* master/sched/sched.h: who renders what, and when to stop waiting for them.
 *
 * Pure state machine. Never reads a clock, does I/O, logs, or allocates after
 * sched_new(): a job's tables live in memory that the caller hands in with it.
 * Feed an event with the current time, then drain the actions. The same events
 * give the same actions, so tests/sim runs 10,000 workers from one seed. One
 * thread at a time (the master's loop).
 *
 * A (cell, block) pair of a job is a *spot*. Each spot is in one state:
 *
 *                frontier moves       carved into a unit            first valid result
 *      SHUT ----------------> WAITING -----------------> LEASED ----------------------> DONE
 *   (beyond the                ^    |                      |                              |
 *    cell's window)            |    +----------------------+-- result of any epoch -------+
 *                              +---------------------------+   deadline, worker lost,     |
 *                              |                               unit failed, drained       |
 *                              +-- cells reset (a liar touched them, or storing failed) --+
 *
 * A cell has the blocks below its *limit*: the job's block_count, or less where a plan says so.
 * A cell's *frontier* is its first block that is not done. Blocks [frontier, frontier +
 * SCHED_WINDOW) of a cell are open, those above are shut: so at most SCHED_WINDOW - 1 results
 * a cell ever wait to be added to the film.
 *
 * A worker:
 *
 *      joined --> IDLE <--> LOADING --> BUSY --> (IDLE)      left or lost from anywhere --> LOST
 *                  any --> DRAINING --> drained              rejoins from LOST
 *                  any --> away for limits.away_ms --> LOST  rejoins from there with its leases
 *                  any --> SET_ASIDE -- pause over --> IDLE  fails, times out, is lost often
 *                  any --> QUARANTINED                       lied; for good
 *
 * Invariants (sched_check):
 *   1. Every spot of a job is in exactly one state, and shut + waiting + leased + done == the sum
 *      of the cells' limits; the counters of the job agree with the tables. Beyond its limit a
 *      cell has no spots.
 *   2. A leased spot is owned by exactly one lease (or one held-back suspect unit) that covers it,
 *      and that lease's count of open cells is the number of spots it owns.
 *   3. No lease reaches beyond a cell's window: block < frontier + SCHED_WINDOW.
 *   4. DONE is final unless the caller resets the cell.
 *   5. A lease names a live worker. An epoch names one lease for ever; one that is adopted keeps
 *      it.
 *   6. A worker is given no lease beyond its allowance (it may bring more along), and none while
 *      it is away; `begun` are at most its threads, and a lease has a deadline exactly while it is
 *      begun (its worker has reported the job ready). The deadline goes on while the worker is
 *      away and after it is back: coming back again and again gains nothing. While its worker asks
 *      for chunks a lease has as long, from when it was begun, as a scene has to load.
 *   7. No lease is held by a worker that is lost, set aside or quarantined.
 *   8. A worker that renders a suspect alone holds that one lease only.
 *   9. Copies of a unit are on different workers; a check never asks a worker that has voted.
 *  10. A job that is done, failed or cancelled has no lease. It is done exactly when every spot is
 *      done, no check is open and no liar's cells wait to be reset.
 *  11. Progress never goes back.
 *  12. A lease's worker has all tags that its job asks for.
 *
 * A worker whose connection breaks is away first: within limits.away_ms the same process can be
 * back. Then what it still holds goes on as if nothing had happened, and nothing is counted against
 * anybody; what it does not tell of was lost on the way and goes to others, without blame. Idle
 * workers may copy its leases meanwhile.
 *
 * Over a restart of the master the caller keeps what matters: done spots, blame (SCHED_UNIT_LOST),
 * open checks (SCHED_CHECK_OPENED, _CLOSED) and who lied or was set aside; see sched_job_add and
 * SCHED_WORKER_PAST. Leases are kept by the workers themselves: each says when it joins what it
 * still holds (struct sched_held), and that becomes leases again, with the old epochs, unless
 * another worker has done it or begun it. A job that goes on is quiet for a while
 * (sched_job_add.quiet_ms), so that they can come back before anything is leased anew. Speeds and
 * costs are measured again.
 *
 * Method: guided self-scheduling bounds the unit size (Polychronopoulos and Kuck 1987); late copies
 * of the slowest leases follow MapReduce and LATE (Zaharia et al., OSDI 2008).
 * Tests: tests/unit/test_sched*.c, tests/sim.
 */
#ifndef MASTER_SCHED_SCHED_H
#define MASTER_SCHED_SCHED_H

#include "common/grid.h"
#include "common/mem.h"

enum {
    SCHED_WINDOW = 4,         /* blocks of a cell that may be open at once */
    SCHED_VOTES_MAX = 5,      /* results of one unit that are compared before giving up */
    SCHED_LOSSES_COMPANY = 2, /* workers that a begun unit may lose before it is leased alone */
    SCHED_LOSSES_ALONE = 3,   /* losses alone that fail the job */
    SCHED_THREADS_MAX = 1024, /* of one worker; more are not used */
};

struct sched; /* opaque; lives in the arena given to sched_new() */

/* Every table is sized from these at sched_new. sched_limits_init gives the defaults in brackets.
 */
struct sched_limits {
    uint32_t worker_count_max;      /* known at once, lost ones included [16,384] */
    uint32_t job_count_max;         /* known at once, finished and not removed included [1,024] */
    uint32_t lease_count_max;       /* of the whole farm [65,536] */
    uint32_t leases_per_worker_max; /* hard cap on what one worker holds [256] */
    uint32_t suspect_count_max;     /* units remembered because they lost a worker [4,096] */
    uint32_t unit_ms;               /* aimed duration of a unit [1,000] */
    uint32_t unit_first_ms;         /* of the first one of a worker in a job [100] */
    uint32_t lease_factor;          /* a begun lease may take expected x this... [8] */
    uint32_t lease_ms_min;          /* ...but never less than this [20,000] */
    uint32_t load_ms;      /* a worker that was not ready for a job after this fails it [600,000] */
    uint32_t pause_ms_min; /* first pause of a worker that is set aside; doubles [2,000] */
    uint32_t pause_ms_max; /* [120,000] */
    uint32_t away_ms;      /* a worker without a connection keeps its leases for so long [600] */
    uint64_t seed;         /* decides which units are verified; secret from workers [1] */
};

void sched_limits_init(struct sched_limits *limits);

/* Takes all its memory from `arena`, which must outlive the scheduler. `epoch_first` is the
 * number of the first lease: larger than every one this farm ever gave (the caller keeps an upper
 * bound on disk and moves it on before sched_epoch_next() reaches it).
 * ERR_LIMIT if a field is out of range, ERR_NOMEM. */
TL_NODISCARD enum err sched_new(struct arena *arena, const struct sched_limits *limits,
                                uint64_t epoch_first, struct sched **out);

/* The epoch that the next lease will get. */
uint64_t sched_epoch_next(const struct sched *s);

/* Bytes of the memory block that comes with a job; 0 when cells or blocks are out of range
 * (1..GRID_CELLS_MAX, 1..JOB_BLOCKS_MAX). About 28 bytes a cell plus one bit per spot. */
size_t sched_job_bytes(uint32_t cell_count, uint32_t block_count);

/* --- Events: what the caller tells --------------------------------------- */

/* Why an event may be refused: see sched_feed. Handles (worker, job) are the caller's own numbers,
 * never 0. A worker process that reconnects keeps its handle, so that speed and faults are kept. */
enum sched_event_type {
    /* The clock has moved on: feed at sched_deadline_ms() at the latest. */
    SCHED_TICK,

    SCHED_JOB_ADD,   /* .add; ACTIVE, or PAUSED if add.paused */
    SCHED_JOB_PAUSE, /* leases out stay; their results are accepted */
    SCHED_JOB_RESUME,
    SCHED_JOB_CANCEL,   /* leases are revoked */
    SCHED_JOB_RETRY,    /* a failed or cancelled job goes on where it was; blame is forgotten */
    SCHED_JOB_PRIORITY, /* .priority */
    SCHED_JOB_HOLD,     /* .hold: nothing of it is leased anew until it is let go; results are
                           taken, and leases that are late are copied */
    SCHED_JOB_LIMITS,   /* .limits: other numbers of blocks for the cells of an open job */
    SCHED_JOB_REMOVE,   /* forget the job; its memory is the caller's again once sched_next was
                           drained */
    /* .unit: these cells start again from .unit.block on: a liar touched them (block 0), or what
     * was accepted could not be stored. Results accepted for them are forgotten, and checks that
     * touch them end: give whole units of open checks, or their other cells go unchecked. */
    SCHED_CELLS_RESET,

    SCHED_WORKER_PAST,  /* .past: what is known of an unknown worker; before its JOIN */
    SCHED_WORKER_JOIN,  /* .join; also a return */
    SCHED_WORKER_AWAY,  /* connection gone or silent: lost, unless it joins again soon */
    SCHED_WORKER_LOST,  /* gone for good: its leases go to others at once */
    SCHED_WORKER_DRAIN, /* takes no more work */
    SCHED_WORKER_LEFT,  /* said goodbye: leases returned, no blame */
    SCHED_WORKER_RTT,   /* .rtt_us, measured */
    SCHED_WORKER_TAGS,  /* .tags: other bits; it keeps those that jobs known here ask for */

    SCHED_JOB_READY,   /* worker has built the scene of .job, or got what it asked for meanwhile */
    SCHED_WORKER_ASKS, /* worker has asked for a chunk: perhaps what begun units lack */
    SCHED_JOB_UNFIT,   /* worker cannot render .job here (JobFailed) */
    SCHED_RESULT,      /* .result; checked by the caller: body decoded, right size, finite */
    SCHED_UNIT_FAILED, /* .epoch: worker could not render that unit */
    /* .mismatch: bits of a COMPARE differ from those accepted. */
    SCHED_MISMATCH,
    /* Every SCHED_CELLS_RESET that follows from one SCHED_LIAR was fed. Before, nothing is leased
     * and no job becomes done. */
    SCHED_LIAR_SETTLED,
};

/* Blocks [block_begin, block_end) of a run of cells, done in an earlier life. */
struct sched_done {
    uint32_t cell_begin, cell_count;
    uint32_t block_begin, block_end;
};

/* A begun unit lost a worker: as SCHED_UNIT_LOST said. */
struct sched_blame {
    struct unit unit;
    uint64_t worker;
    bool alone;
};

/* A check that SCHED_CHECK_OPENED told of and no SCHED_CHECK_CLOSED or reset since. */
struct sched_open_check {
    struct unit unit;
    uint64_t worker; /* who gave the accepted bits */
    uint64_t digest; /* of them: as in sched_result */
};

/* How many blocks each cell gets. A cell keeps what is done or leased: for it the limit is no lower
 * than that. */
struct sched_job_limits {
    const uint16_t *limits; /* cell_count of 1..block_count; lent for the call; NULL: as they are */
    bool cut;               /* leases that are not begun are taken back before */
    bool final;             /* these are the last limits: the job is done when they are reached */
};

struct sched_job_add {
    uint32_t cell_count, block_count;
    /* Where cells get different numbers of blocks: how many. NULL: all. Lent for the call. */
    const uint16_t *limits;
    bool open; /* limits may change yet: the job is not done before a LIMITS says `final` */
    /* Cost of each block beside the others, >= 1. NULL: all the same. Lent for the call. */
    const uint64_t *block_weights;
    uint32_t unit_ms;        /* longest aimed duration of its units; 0: as limits.unit_ms says */
    double cell_cost;        /* pixels x samples of an average spot for each of its weight, > 0 */
    uint32_t unit_cells_max; /* what one result frame can carry; 0: no cap */
    double verify_share;     /* of units rendered twice by different workers, 0..1 */
    int32_t priority;        /* higher first */
    uint64_t tags; /* bits, as the caller numbers words: only workers that have all of them */
    bool paused;
    uint32_t quiet_ms; /* leases nothing for so long, but takes up what workers bring along */
    void *memory;      /* sched_job_bytes(), aligned to 64; lent until SCHED_JOB_REMOVE */
    /* What is done already, in the order in which it was accepted or by rising block (a spot
     * beyond its cell's window cannot be held and is rendered again). Lent for the call. */
    const struct sched_done *done;
    size_t done_count;
    /* From an earlier life, in the order of the news; what does not fit `done` any more is
     * ignored. Lent for the call. */
    const struct sched_blame *blame;
    size_t blame_count;
    const struct sched_open_check *checks;
    size_t check_count;
};

/* A lease of an earlier connection, as its worker tells. Nothing of it is believed: a unit that is
 * none, a job or an epoch that never was are refused. */
enum sched_held_state {
    SCHED_HELD_WAITING, /* not begun */
    SCHED_HELD_BEGUN,
    SCHED_HELD_RESULT, /* rendered; the result comes next */
};
struct sched_held {
    uint64_t job, epoch;
    struct unit unit;
    enum sched_held_state state;
};

/* Of what it holds, the leases that it still has and what nobody else has begun stay with the
 * worker; SCHED_REVOKE follows for the rest. At most leases_per_worker_max of it are looked at. */
struct sched_join {
    uint32_t threads;              /* 1.. */
    uint64_t tags;                 /* bits that it has */
    const struct sched_held *held; /* results first, then what is begun; lent for the call */
    size_t held_count;
};

struct sched_past {
    bool lied;         /* quarantined */
    uint32_t pauses;   /* how often it was set aside: the next pause is so much longer */
    uint64_t until_ms; /* end of a pause that still goes on; 0: none */
};

struct sched_result {
    struct unit unit;
    uint64_t epoch;
    uint64_t samples;   /* pixel-samples in it; decides the worker's speed */
    uint64_t render_us; /* on one thread */
    uint64_t digest;    /* of the unit's decoded pixels: the same for the same unit and bits.
                           Should fold per-cell hashes in cell order, for SCHED_MISMATCH. */
};

struct sched_mismatch {
    struct unit unit;         /* the run that differs */
    uint64_t worker_accepted; /* who gave the accepted bits; 0: not known any more */
    uint64_t digest_accepted; /* over `unit` */
    uint64_t digest;          /* over `unit`, of event.worker's bits */
};

struct sched_event {
    enum sched_event_type type;
    uint64_t worker; /* 0 where none is concerned */
    uint64_t job;    /* 0 where none is concerned */
    union {
        struct sched_job_add add;
        struct unit unit;
        struct sched_job_limits limits;
        struct sched_result result;
        struct sched_mismatch mismatch;
        struct sched_past past;
        struct sched_join join;
        uint64_t rtt_us;
        uint64_t tags;
        uint64_t epoch;
        int32_t priority;
        bool hold;
    };
};

/* `now_ms` is monotonic; going backwards, or feeding before sched_next() was drained, is a bug and
 * aborts. False: the event changed nothing, because it was not possible:
 * a full table (JOB_ADD, WORKER_JOIN), a handle that exists (JOB_ADD) or does not, a state in
 * which it has no meaning (RESUME of a finished job). An event from an unknown worker or epoch is
 * legal (networks do that). A RESULT is always answered by actions and returns true. */
bool sched_feed(struct sched *s, uint64_t now_ms, const struct sched_event *event);

/* --- Actions: what the caller must do ------------------------------------ */

enum sched_action_type {
    /* To a worker; never to one that is away. */
    SCHED_OPEN_JOB,  /* send JobInfo of .job; always before the first lease of it */
    SCHED_CLOSE_JOB, /* send JobEnd: no more units of .job */
    SCHED_LEASE,     /* send Lease .job .unit .epoch */
    SCHED_REVOKE,    /* send Revoke .job .epoch: not wanted any more */

    /* Answers to SCHED_RESULT: one or more runs that cover its cells, in order. */
    SCHED_ACCEPT,  /* .unit is new: journal in the order of these actions, then acknowledge */
    SCHED_COMPARE, /* .unit was accepted before: compare bits, feed SCHED_MISMATCH if they differ */
    SCHED_VOTE,    /* result of a check, in time or late: nothing to store, acknowledge */
    SCHED_IGNORE,  /* .why: drop .unit, acknowledge */

    /* News, for the log, the API and the store. */
    SCHED_JOB_DONE,    /* every spot is accepted and every check settled */
    SCHED_JOB_FAILED,  /* .why, .unit names the culprit where there is one */
    SCHED_WORKER_NEWS, /* .state changed to SET_ASIDE (until .until_ms), IDLE (back), LOST */
    SCHED_UNIT_LOST,   /* a begun unit lost .worker: .losses so far, .alone */
    SCHED_DRAINED,     /* a draining worker holds nothing any more */
    /* .unit is to be rendered by another worker and compared; told before it is accepted, or when
     * a result differs. CLOSED: two agree. A reset of its cells ends a check in silence. */
    SCHED_CHECK_OPENED,
    SCHED_CHECK_CLOSED,
    /* .worker (0: unknown) gave bits that two others contradict, seen in .unit of .job. It is
     * quarantined. Caller: feed SCHED_CELLS_RESET (block 0) for every run of cells of every
     * unfinished job to which it gave an accepted result, .unit included if .accepted. */
    SCHED_LIAR,
};

enum sched_why {
    SCHED_WHY_NONE,
    SCHED_WHY_NO_JOB,       /* job unknown, cancelled, failed or done */
    SCHED_WHY_NO_UNIT,      /* not a unit of the job, or not the one of that lease */
    SCHED_WHY_SHUT,         /* beyond the window (after a reset or a restart) */
    SCHED_WHY_UNCHECKED,    /* to be verified, and not all of the result is new */
    SCHED_WHY_QUARANTINED,  /* from a liar */
    SCHED_WHY_UNIT_KILLS,   /* SCHED_LOSSES_ALONE workers were lost by one unit */
    SCHED_WHY_JOB_UNFIT,    /* no worker could get ready for it */
    SCHED_WHY_NO_AGREEMENT, /* SCHED_VOTES_MAX workers gave different bits */
    SCHED_WHY_COUNT
};

enum sched_worker_state {
    SCHED_WORKER_IDLE,
    SCHED_WORKER_LOADING, /* has leases, none of a job it is ready for */
    SCHED_WORKER_BUSY,
    SCHED_WORKER_DRAINING,
    SCHED_WORKER_SET_ASIDE,
    SCHED_WORKER_QUARANTINED, /* shown as set aside */
    SCHED_WORKER_GONE,        /* lost or left */
};

enum sched_lease_kind {
    SCHED_KIND_FIRST, /* of waiting cells */
    SCHED_KIND_RETRY, /* of a unit that lost a worker */
    SCHED_KIND_COPY,  /* end-game: the slowest lease once more */
    SCHED_KIND_CHECK, /* verification */
};

struct sched_action {
    enum sched_action_type type;
    uint64_t worker, job;
    struct unit unit;
    uint64_t epoch;
    enum sched_lease_kind kind; /* LEASE */
    enum sched_why why;
    enum sched_worker_state state; /* WORKER_NEWS */
    uint64_t until_ms;             /* WORKER_NEWS: end of the pause, in the caller's clock */
    uint32_t losses;               /* UNIT_LOST; WORKER_NEWS LOST, SET_ASIDE: leases returned */
    bool alone;                    /* UNIT_LOST: it was leased alone */
    bool accepted;                 /* LIAR: the lie was the accepted version */
};

/* Pops one action; false when there is nothing to do before the next event or
 * sched_deadline_ms(). Call until false after every feed. */
bool sched_next(struct sched *s, struct sched_action *out);

/* When to feed SCHED_TICK at the latest; UINT64_MAX: no need. */
uint64_t sched_deadline_ms(const struct sched *s);

/* --- What people see ------------------------------------------------------ */

enum sched_job_state {
    SCHED_ACTIVE,
    SCHED_PAUSED,
    SCHED_CANCELLED,
    SCHED_FAILED,
    SCHED_DONE,
};

/* What an active job waits for, when it has no lease out. */
enum sched_wait {
    SCHED_WAIT_NOTHING,
    SCHED_WAIT_WORKER,        /* there is none (or all are set aside, unfit or lack a tag) */
    SCHED_WAIT_BEHIND,        /* jobs of higher priority take all workers */
    SCHED_WAIT_SECOND_WORKER, /* a check needs a worker that did not render the unit */
    SCHED_WAIT_THIRD_WORKER,  /* two workers differ; a third must decide */
};

struct sched_job_info {
    enum sched_job_state state;
    enum sched_wait wait;
    int32_t priority;
    uint64_t spots, spots_done, spots_leased; /* cells x blocks, as the limits are now */
    uint32_t leases;                          /* out now */
    uint32_t workers;                         /* that hold one */
    uint64_t units;                           /* results accepted, wholly or in part */
    /* Leases that ended without their result, so that their cells were leased again: the worker
     * was lost, late, set aside or a liar, left, or failed the unit. Not what the master took back
     * because it was not wanted any more, and no copies. */
    uint64_t retried;
    uint64_t speculated; /* end-game copies leased */
    uint64_t rejected;   /* results ignored, or found to be lies */
    uint64_t compared;   /* results, or parts, that came twice */
    uint64_t verified;   /* checks settled */
    uint64_t mismatched; /* checks in which someone lied */
    uint64_t checks_open;
    uint64_t cells_reset;
    double thread_seconds; /* render time of the accepted results */
    double done;           /* share of the expected cost, 0..1, never going back */
    /* 80 % interval of the seconds left at the present pace; false before 2 s and 20 units,
     * and while no thread works on it. */
    bool left_known;
    double left_low_s, left_high_s;
};

struct sched_worker_info {
    enum sched_worker_state state;
    uint64_t job; /* of its oldest lease; 0: none */
    uint32_t threads, leases;
    uint64_t units;  /* results accepted */
    uint64_t lost;   /* leases taken back from it */
    uint64_t failed; /* units it reported failed */
    uint64_t timeouts;
    uint64_t differed; /* checks that it lost */
    uint64_t until_ms; /* SET_ASIDE: end of the pause */
    uint32_t pauses;   /* that count for the length of the next */
    double speed;      /* pixel-samples per second and thread, of its latest job; 0: unknown */
};

struct sched_farm_info {
    uint32_t workers, threads;     /* connected, set-aside ones included */
    uint32_t jobs[SCHED_DONE + 1]; /* by state */
    uint32_t leases;
    uint64_t epoch_next;
};

/* False when there is no such job or worker. */
bool sched_job_info(const struct sched *s, uint64_t job, struct sched_job_info *out);
bool sched_worker_info(const struct sched *s, uint64_t worker, struct sched_worker_info *out);
void sched_farm_info(const struct sched *s, struct sched_farm_info *out);

/* The leases that are out, for the page: calls `visit` for each lease of `job` (0: of all). */
void sched_each_lease(const struct sched *s, uint64_t job,
                      void (*visit)(void *context, uint64_t worker, uint64_t job, struct unit unit,
                                    enum sched_lease_kind kind),
                      void *context);

/* Is this spot accepted? False for an unknown job. */
bool sched_spot_done(const struct sched *s, uint64_t job, uint32_t cell, uint32_t block);

/* The first block of a cell that is not accepted. 0 for an unknown job. */
uint32_t sched_frontier(const struct sched *s, uint64_t job, uint32_t cell);

/* Spots that could be leased now; 0 for an unknown job. Cheap. */
uint64_t sched_waiting(const struct sched *s, uint64_t job);

/* The limits of a job's cells as they are; false for an unknown job. */
bool sched_limits_get(const struct sched *s, uint64_t job, uint16_t *limits);

/* Thread-seconds of what is not done, as far as known; a cell's mean ones for each of the weight.
 */
double sched_left_seconds(const struct sched *s, uint64_t job);

const char *sched_why_text(enum sched_why why); /* for people */
const char *
sched_worker_state_name(enum sched_worker_state st); /* "idle", ..., "set-aside", "lost" */
const char *sched_job_state_name(enum sched_job_state st);

/* Asserts every invariant; O(everything): for tests. */
void sched_check(const struct sched *s);

#endif
