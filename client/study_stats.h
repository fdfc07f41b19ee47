/* client/study_stats.h: intervals, efficiencies and fronts, of which a study's conclusions are
 * made.
 *
 * Pure; any thread. Test: test_study (quantiles against tables, coverage against seeded draws).
 */
#ifndef CLIENT_STUDY_STATS_H
#define CLIENT_STUDY_STATS_H

#include "common/err.h"

/* A value with its 95 % interval; low and high are NaN when it cannot be told. */
struct stats_interval {
    double value, low, high;
};

/* Two-sided 95 % quantile of Student's t for `count` values (count - 1 degrees of freedom, count >=
 * 2); to 0.1 %. */
double stats_t95(uint32_t count);

/* Mean of values that measure something positive. The interval is taken on the logarithm (the
 * delta method), so that it stays positive; one value, or a mean that is not positive, has none. */
struct stats_interval stats_mean(const double *v, uint32_t count);

/* The median, with the mean's relative interval around it: what time costs on a busy machine. */
struct stats_interval stats_cost(const double *v, uint32_t count);

double stats_median(const double *v, uint32_t count); /* count 1..STATS_MEDIAN_MAX */
enum { STATS_MEDIAN_MAX = 64 };

/* How many times less work `ours` needs than `base` for one error: the ratio of cost * error,
 * repeat by repeat (the same seed, minutes of the same machine), as a geometric mean with the
 * interval of its logarithm. NaN when a product is not positive. */
struct stats_work {
    const double *cost, *error;
};
struct stats_interval stats_gain(struct stats_work base, struct stats_work ours, uint32_t count);

/* front[i]: no other point has both less cost and less error. Points that are not positive numbers
 * are never on it. */
void stats_front(const double *cost, const double *error, size_t count, bool *front);

/* error = a * n^-p through points in logarithms, by least squares; p held within 0.5..2. One point:
 * p is 1. False: no usable point. */
struct stats_law {
    double a, p;
};
bool stats_law_fit(const double *n, const double *error, size_t count, struct stats_law *out);
double stats_law_at(const struct stats_law *law, double n);
/* The n that the law needs for an error. */
double stats_law_solve(const struct stats_law *law, double error);

#endif
