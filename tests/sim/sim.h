/* tests/sim/sim.h: a whole farm in one thread over virtual time, from one seed.
 *
 * The production objects under test are the scheduler (master/sched), the frames,
 * messages and tile codec of the wire (proto) and the records of the journal
 * (master/journal.h). Around them, simulated: a network of connections that keep their
 * order but break, stall one way and delay; a disk that keeps what was synced and tears
 * the rest; a master and workers that are killed, stopped, slow, hung, or lie.
 *
 *   sim_run: config from the seed -> fault phase -> healed -> every job must end in bounded time
 *
 * Checked all along (sim_book.c): a spot is accepted once; what was acknowledged is on disk after
 * every crash and is never leased again; epochs never repeat, over all lives of the master; leases
 * stay in the window and go to connected workers only; the picture at the end is the honest one.
 * sched_check() runs at random moments.
 *
 * The same seed gives the same run, event by event. A failure prints the seed and exits; an
 * assertion of the production code prints it on the way out.
 */
#ifndef TESTS_SIM_SIM_H
#define TESTS_SIM_SIM_H

#include "common/buf.h"
#include "common/digest.h"
#include "common/mem.h"
#include "master/journal.h"
#include "master/sched/sched.h"
#include "proto/frame.h"
#include "proto/limits.h"
#include "proto/message.h"
#include "proto/tile_codec.h"

#include <inttypes.h>
#include <stdio.h>

enum {
    SIM_JOBS_MAX = 4,
    SIM_THREADS_MAX = 16,
    SIM_SILENCE_US = 3000000, /* three heartbeats */
    SIM_EPOCHS_RESERVED = 100000,
    SIM_CELL_FLOATS = 3,
};

/* What a seed decides. Times in microseconds. */
struct sim_config {
    uint64_t seed;
    uint32_t workers, liars, zombies;
    uint32_t jobs, cells[SIM_JOBS_MAX], blocks[SIM_JOBS_MAX];
    double verify;
    bool tags; /* every second worker has a tag, and every second job asks for it */
    double cost_us, cost_spread; /* of a spot, and how much cells differ */
    double cell_cost;            /* what the job says: pixel-samples of a spot */
    uint32_t latency_us;
    uint64_t fault_us;       /* length of the fault phase; 0: none */
    uint64_t fault_every_us; /* mean time between faults */
    bool master_crashes;
    bool codec;                    /* bodies through the tile codec; else plain floats */
    bool handles_kept;             /* a restarted worker keeps its handle */
    int32_t poison_cell;           /* of job 0: kills whoever renders it; -1: none */
    double hang_share, fail_share; /* of units in the fault phase */
    uint32_t late;                 /* pictures of a job that units ask for when they meet them */
    uint32_t check_every;          /* events between sched_check() */
    bool trace;                    /* print every action */
};

struct sim_stats {
    uint64_t events, messages, results, leases, copies, checks, crashes, master_crashes,
        liars_found, asks;
    uint64_t virtual_us, ideal_us, spots, wasted_us, rendered_us;
};

enum sim_event_type {
    EV_PACKET,    /* conn a, side b, data */
    EV_CLOSED,    /* conn a, side b learns that the peer closed */
    EV_SILENT,    /* conn a, side b: has it been silent since c? */
    EV_UNSTALL,   /* conn a, side b, stalled since c */
    EV_CONNECT,   /* worker a, life b */
    EV_WORKER_UP, /* worker a */
    EV_LOADED,    /* worker a, life b, job c */
    EV_RENDERED,  /* worker a, life b, epoch c */
    EV_BROUGHT,   /* worker a, life b, job c: a picture that units wait for is there */
    EV_ASK,       /* worker a, life b, epoch c: its unit hangs and asks for chunks all the time */
    EV_CONTINUE,  /* worker a: SIGCONT */
    EV_LEFT,      /* worker a, life b: has drained, goes */
    EV_MASTER_UP,
    EV_TICK,      /* master life b, ticket c */
    EV_COMMITTED, /* master life b, disk up to c */
    EV_FAULT,
    EV_HEAL,
    EV_OPERATOR,
};

struct sim_event {
    uint64_t at_us, order;
    enum sim_event_type type;
    uint32_t a, b;
    uint64_t c;
    struct packet *data; /* owned */
};

struct packet {
    struct packet *next;
    size_t bytes;
    unsigned char data[];
};

enum sim_side { SIDE_MASTER, SIDE_WORKER };

struct conn {
    uint32_t worker, worker_life, master_life;
    uint64_t handle; /* once the Hello arrived */
    bool open[2];    /* as that side knows */
    bool reset[2];   /* packets to that side are lost */
    bool stalled[2]; /* packets to that side are held */
    uint64_t stalled_us[2];
    uint64_t last_us[2]; /* arrival of the latest packet to that side */
    struct packet *held[2], *held_tail[2];
    struct frame_decoder decoder[2];
};

struct sim_lease {
    uint64_t job, epoch;
    struct unit unit;
};

struct sim_result {
    struct sim_lease lease;
    uint64_t render_us;
    uint32_t raw_bytes;
    unsigned char *body; /* owned */
    size_t body_bytes;
};

struct sim_running {
    struct sim_lease lease;
    uint64_t cost_us;
    bool hung;
    bool waits; /* for a picture */
};

enum sim_load { LOAD_NONE, LOAD_LOADING, LOAD_READY };

struct sim_worker {
    uint64_t handle;
    uint32_t life; /* counts its processes */
    bool alive, stopped, draining;
    uint64_t stop_end_us;
    uint32_t conn; /* UINT32_MAX: none */
    bool welcomed;
    uint32_t threads;
    double slow; /* times the cost */
    bool liar, zombie;
    enum sim_load load[SIM_JOBS_MAX];
    uint32_t late_left[SIM_JOBS_MAX]; /* pictures that it does not have yet */
    bool asked[SIM_JOBS_MAX];         /* for one of them */
    struct sim_lease *queue;
    size_t queue_count, queue_capacity;
    struct sim_running running[SIM_THREADS_MAX];
    uint32_t running_count;
    tilery_Held told[LIMIT_HELD_TOLD]; /* in the last Hello */
    uint32_t told_count;
    struct sim_result *unacked;
    size_t unacked_count, unacked_capacity;
};

/* Flags of a spot in the book. */
enum { SPOT_ACCEPTED = 1, SPOT_DURABLE = 2, SPOT_ACKED = 4 };

struct sim_job {
    uint64_t id;
    uint32_t cells, blocks;
    uint8_t *flags;   /* [block][cell] */
    uint32_t *hash;   /* of the accepted version */
    uint32_t *worker; /* handle that gave it */
    void *memory;     /* lent to the scheduler */
    uint64_t accepted, durable;
    struct unit *checks; /* open ones */
    size_t check_count, check_capacity;
    struct sched_blame *blame;
    size_t blame_count, blame_capacity;
    bool done;    /* told by the scheduler, in this life */
    double shown; /* progress, in this life */
};

/* A record that is written and not yet durable. */
struct sim_pending {
    size_t end;                  /* offset on disk behind it */
    uint64_t handle, job, epoch; /* handle 0: a reset */
    struct unit unit;
    int note;   /* enum sim_note, with epoch 0 */
    bool stale; /* its cells were reset since */
};

/* Records of the simulated journal that are no result, in its field `samples`. */
enum sim_note {
    NOTE_RESET,
    NOTE_CHECK_OPENED,
    NOTE_CHECK_CLOSED,
    NOTE_BLAME, /* of worker, `rays`: alone */
    NOTE_FORGIVEN,
    NOTE_LIAR, /* worker */
};

struct sim_disk {
    struct buf bytes;
    size_t durable;
    uint64_t epoch_limit;
    struct sim_pending *pending;
    size_t pending_count, pending_capacity;
    bool committing;
};

struct sim_master {
    bool alive;
    uint32_t life;
    struct arena arena;
    struct sched *s;
    uint64_t clock_base_ms; /* its monotonic clock starts anywhere */
    uint64_t tick_ticket;
    struct sched_event *later; /* events that actions gave rise to */
    size_t later_count, later_capacity;
    const struct sim_result *answering; /* result that the actions are about */
    uint64_t answering_handle;
    const uint32_t *answering_hash;
};

struct sim {
    struct sim_config c;
    struct sim_stats stats;
    uint64_t rng;
    uint64_t now_us, order;
    struct sim_event *heap;
    size_t heap_count, heap_capacity;
    struct conn *conns;
    size_t conn_count, conn_capacity;
    struct sim_worker *workers;
    uint64_t handle_next;
    uint32_t *handle_conn;   /* master's side: conn of a handle */
    uint32_t *handle_worker; /* whose it is, over all lives of the master */
    size_t handle_capacity;
    struct sim_job jobs[SIM_JOBS_MAX];
    uint32_t *liars; /* handles of those that were found */
    size_t liar_count, liar_capacity;
    struct sim_disk disk;
    struct sim_master m;
    uint64_t epoch_highest;
    bool healed;
    uint64_t healed_us, deadline_us;
    uint32_t failed_told; /* jobs that the scheduler failed, by bit */
    bool poison_named;
};

/* --- sim.c: the run ------------------------------------------------------------------ */
struct sim_config sim_config_of(uint64_t seed);
struct sim_stats sim_run(const struct sim_config *c);
void sim_fail(const struct sim *sim, const char *format, ...) TL_PRINTF(2, 3) TL_NORETURN;
#define SIM_CHECK(sim, cond, ...)                                                                  \
    do {                                                                                           \
        if (!(cond))                                                                               \
            sim_fail(sim, __VA_ARGS__);                                                            \
    } while (0)
uint64_t sim_rand(struct sim *sim);
uint64_t sim_below(struct sim *sim, uint64_t n);
bool sim_chance(struct sim *sim, double p);
uint64_t sim_spread(struct sim *sim, uint64_t mean); /* exponential */
void sim_push(struct sim *sim, uint64_t at_us, struct sim_event e);
uint64_t sim_hash(uint64_t a, uint64_t b);
void *sim_grow(void *array, size_t count, size_t *capacity, size_t bytes);

/* --- sim_net.c ------------------------------------------------------------------------ */
uint32_t net_connect(struct sim *sim, uint32_t worker);
void net_send(struct sim *sim, uint32_t conn, enum sim_side to, const struct message *m,
              const void *body, size_t body_bytes);
void net_close(struct sim *sim, uint32_t conn, enum sim_side by, bool silently);
void net_stall(struct sim *sim, uint32_t conn, enum sim_side to, uint64_t us);
void net_event(struct sim *sim, struct sim_event *e);
void net_free(struct sim *sim);

/* --- sim_worker.c ----------------------------------------------------------------------- */
void worker_init(struct sim *sim, uint32_t worker);
void worker_kill(struct sim *sim, uint32_t worker, bool silently, uint64_t back_us);
void worker_stop(struct sim *sim, uint32_t worker, uint64_t us);
void worker_event(struct sim *sim, const struct sim_event *e);
void worker_message(struct sim *sim, uint32_t worker, const struct message *m);
void worker_conn_lost(struct sim *sim, uint32_t worker, uint32_t conn);
void worker_resend_some(struct sim *sim, uint32_t worker);
void worker_leave(struct sim *sim, uint32_t worker);
void worker_heal(struct sim *sim, uint32_t worker);
void worker_free(struct sim_worker *w);
uint64_t spot_cost_us(const struct sim *sim, uint32_t job, uint32_t cell, uint32_t block);
/* The honest pixels of a cell, and the hash of any. */
void spot_pixels(uint64_t job, uint32_t cell, uint32_t block, float out[SIM_CELL_FLOATS]);
uint32_t pixels_hash(const float pixels[SIM_CELL_FLOATS]);

/* --- sim_master.c ----------------------------------------------------------------------- */
void master_up(struct sim *sim);
void master_kill(struct sim *sim);
void master_event(struct sim *sim, const struct sim_event *e);
void master_message(struct sim *sim, uint32_t conn, const struct message *m,
                    const unsigned char *body, size_t body_bytes);
void master_conn_lost(struct sim *sim, uint32_t conn);
void master_feed(struct sim *sim, const struct sched_event *e);
void master_retry(struct sim *sim, uint64_t job);
void master_free(struct sim *sim);

/* --- sim_book.c: the disk, and what must hold ------------------------------------------------ */
void book_init(struct sim *sim);
void book_free(struct sim *sim);
void book_lease(struct sim *sim, const struct sched_action *a);
void book_accept(struct sim *sim, const struct sched_action *a);
void book_reset(struct sim *sim, uint32_t job, uint32_t cell_begin, uint32_t cell_count);
/* Writes what is no result down, and takes it into the book. */
void book_note(struct sim *sim, const struct sched_action *a, enum sim_note note);
bool book_lied(const struct sim *sim, uint64_t handle);
/* As provenance_widen. */
void book_widen(const struct sim_job *j, uint32_t *cell_begin, uint32_t *cell_count);
bool book_touched(const struct sim_job *j, uint32_t cell, uint64_t handle);
void book_committed(struct sim *sim, size_t end);
void book_crash(struct sim *sim);   /* tears what is not durable */
void book_recover(struct sim *sim); /* reads the disk again */
void book_final(struct sim *sim);
struct sim_job *book_job(struct sim *sim, uint64_t id);
uint64_t spot_index(const struct sim_job *j, uint32_t cell, uint32_t block);
/* The hashes of a result's cells; false: not a body of that many cells. */
bool body_hashes(const struct sim *sim, const void *body, size_t bytes, uint32_t cells,
                 uint32_t *out);

#endif
