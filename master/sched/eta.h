/* master/sched/eta.h: how long a render still takes, as an 80 % interval.
 *
 * What is left of a job has two parts. *Known*: cells that were measured in an
 * earlier block; their cost repeats almost exactly. *Unknown*: cells that were
 * never rendered; they cost the mean of those that were, give or take the spread
 * between units. Both are divided by the threads at work; the longest open unit says how far apart
 * the threads may end.
 *
 * Pure arithmetic. tests/unit/test_sched_eta.c holds it to its word: on renders with
 * drawn costs the truth lies inside in 80 % of checks at 25, 50 and 75 %.
 */
#ifndef MASTER_SCHED_ETA_H
#define MASTER_SCHED_ETA_H

#include "common/err.h"

enum {
    ETA_UNITS_MIN = 20,  /* no interval before so many results... */
    ETA_SECONDS_MIN = 2, /* ...and so many seconds of rendering */
};

/* Spread of unit costs: count, mean and sum of squared deviations (Welford 1962). */
struct eta_spread {
    uint64_t count;
    double mean, m2;
};

void eta_spread_add(struct eta_spread *s, double x);

/* Standard deviation over mean; 0 before two values. */
double eta_spread_cv(const struct eta_spread *s);

struct eta {
    double known_s;           /* thread-seconds left in measured cells */
    double unknown_s;         /* and in the others, at the mean cost */
    uint64_t unknown_units;   /* about how many units the others make */
    struct eta_spread spread; /* of seconds per spot, over units */
    double threads;           /* at work on it now */
    double longest_open_s;    /* expected rest of the longest unit that is out */
    double elapsed_s;         /* since the first lease */
};

/* False when it is too early to tell, or when no thread is at work. */
bool eta_left(const struct eta *e, double *low_s, double *high_s);

#endif
