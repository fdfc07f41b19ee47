/* master/job_plan.h: how a job that was given an error, a time or a plan goes on.
 *
 *   PILOT (a few samples for every cell) --> PLANNED (limits per cell, raised in stages) --> SEALED
 *
 * --target-error: the pilot's error by square sets the proportions; the estimate begins with
 * fresh samples and is looked at each time all cells have reached their limits: it is done when
 * the upper bound of its error is below the target, else the limits rise (claim.h). Everything
 * depends on finished cells alone, so that the picture's bits depend on the scene and the settings
 * only.
 * --time-limit: where the pilot takes no more than a small share of the time it sets the
 * proportions, else it is kept as the first passes and all cells get the same. Then limits rise
 * while there is time; shortly before the end what is not begun is taken back, and what came in
 * is the plan. --plan: sealed from the start.
 *
 * The plan is handed to the store before any lease that follows from it, and the store works in
 * order: a result never lies on disk without the plan it belongs to. One thread: the loop's.
 * Tests: tests/e2e/test_e2e_adaptive.py.
 */
#ifndef MASTER_JOB_PLAN_H
#define MASTER_JOB_PLAN_H

#include "common/sample_plan.h"
#include "master/film.h"

struct farm;
struct job;

/* What ended a job. Stored by number: append only. */
enum job_end {
    JOB_END_NONE,
    JOB_END_SPP,
    JOB_END_ERROR,
    JOB_END_MAX_SPP,
    JOB_END_TIME,
    JOB_END_PLAN,
    JOB_END_PILOT,
    JOB_END_COUNT
};
extern const char *const job_end_names[JOB_END_COUNT];

struct job_plan {
    bool begun;  /* the pilot is over and the limits are the plan's */
    bool sealed; /* they are final */
    enum film_pilot pilot;
    enum job_end end;
    uint32_t looks;   /* at the error so far */
    double mean_spp;  /* that the limits were made for */
    double gain;      /* work over that of equal samples, as the pilot saw it; 0: not known */
    uint16_t *limits; /* per cell */
    float *shares;    /* per cell */

    /* Not stored. */
    bool judging; /* the pool works on the error */
    bool due;     /* limits are decided and wait for the film's readers to go */
    double shown; /* highest share done that was shown */
};

/* Makes job->plan for a job that wants one; `given` is the plan that came with it, or NULL.
 * ERR_INPUT: it does not fit; ERR_NOMEM. */
TL_NODISCARD enum err job_plan_new(struct job *job, const struct sample_plan *given);
void job_plan_free(struct job_plan *p);

/* The plan of an earlier life, before its film is read. */
TL_NODISCARD enum err job_plan_load(struct farm *f, struct job *job);
TL_NODISCARD enum err job_plan_store(struct farm *f, struct job *job);

/* Tells a film that was just made or read. */
void job_plan_apply(const struct job *job, struct film *film);

/* All that was asked for is in the film, or readers have left: goes on. */
void job_plan_step(struct farm *f, struct job *job);

/* A result came: a job with a time limit gets more to do before it runs out. */
void job_plan_more(struct farm *f, struct job *job);

/* Cuts jobs whose time is up; arms the timer for the next. */
void job_plans_tick(struct farm *f);

/* Share done, and seconds left; false: the scheduler knows better. */
double job_plan_share(const struct job *job);
bool job_plan_left(const struct job *job, double *seconds);

#endif
