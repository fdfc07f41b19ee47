/* tests/unit/sched_rig.h: a scheduler under test, with its clock and its books.
 *
 * Every event is fed, every action taken and written down, and sched_check() run.
 * The rig holds the leases that are out, and asserts of each new one what must
 * always hold: within the window, a fresh epoch, a worker that was told of the job.
 */
#ifndef TESTS_UNIT_SCHED_RIG_H
#define TESTS_UNIT_SCHED_RIG_H

#include "master/sched/sched.h"

enum { RIG_LEASES = 4096, RIG_ACTIONS = 8192, RIG_JOBS = 16 };

struct rig_lease {
    uint64_t worker, job, epoch;
    struct unit unit;
    enum sched_lease_kind kind;
};

struct rig {
    struct arena arena;
    struct sched *s;
    uint64_t now_ms;
    bool auto_ready; /* workers are ready for a job as soon as they hear of it */
    struct rig_lease leases[RIG_LEASES];
    uint32_t lease_count;
    struct sched_action actions[RIG_ACTIONS]; /* since the last feed by the test */
    uint32_t action_count;
    void *job_memory[RIG_JOBS];
    uint64_t epoch_last;
    uint64_t open[256]; /* (worker << 32 | job) pairs that were told */
    uint32_t open_count;
};

/* One for a program whose tests each begin with a new scheduler: RIG_TEST(name) in its list. */
extern struct rig rig;
int rig_setup(void **state);
int rig_teardown(void **state);
#define RIG_TEST(name) cmocka_unit_test_setup_teardown(name, rig_setup, rig_teardown)

void rig_start(struct rig *r, const struct sched_limits *limits); /* NULL: defaults, small tables */
void rig_stop(struct rig *r);

/* Feeds, drains, checks; forgets the actions of the feed before. */
bool rig_feed(struct rig *r, const struct sched_event *e);
bool rig_worker(struct rig *r, enum sched_event_type type, uint64_t worker);
bool rig_job(struct rig *r, enum sched_event_type type, uint64_t job);
bool rig_join(struct rig *r, uint64_t worker, uint32_t threads);
bool rig_ready(struct rig *r, uint64_t worker, uint64_t job);

/* Moves the clock, ticking at each deadline on the way. */
void rig_wait(struct rig *r, uint64_t ms);

/* A job of 1,000 pixel-samples a spot. */
bool rig_add(struct rig *r, uint64_t job, uint32_t cells, uint32_t blocks);
bool rig_add_with(struct rig *r, uint64_t job, struct sched_job_add add);

/* The result of a lease that is or was out; `us` on one thread, honest digest plus `lie`. */
bool rig_result(struct rig *r, const struct rig_lease *l, uint64_t us, uint64_t lie);
uint64_t rig_digest(uint64_t job, struct unit unit);

/* The i-th lease that a worker holds (0: oldest), by value; aborts the test if it has none. */
struct rig_lease rig_lease_of(const struct rig *r, uint64_t worker, uint32_t i);
uint32_t rig_held(const struct rig *r, uint64_t worker);

/* Actions of a type since the last feed; the first one. */
uint32_t rig_count(const struct rig *r, enum sched_action_type type);
const struct sched_action *rig_find(const struct rig *r, enum sched_action_type type);

/* Answers leases, the oldest first, until none is out; `us_per_cell` each. Gives how many. */
uint32_t rig_finish(struct rig *r, uint64_t us_per_cell);

struct sched_job_info rig_info(const struct rig *r, uint64_t job);
struct sched_worker_info rig_winfo(const struct rig *r, uint64_t worker);

#endif
