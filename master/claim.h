/* master/claim.h: when a job with --target-error may say that its error is reached, and how far it
 * goes on until then. The rule alone: job_plan.c feeds it finished pictures, and
 * tests/campaign/claim_replay.c feeds it stored samples of many seeds, by which it was tuned.
 *
 *   upper = relMSE exp(sqrt((QUANTILE s)^2 + DOUBT^2))     s: the estimate's relative deviation
 *   claim: upper <= target, and an effective size of at least CLAIM_EFFECTIVE_MIN
 *   next look: samples times (1.02 upper / target)^(1 / NEXT_POWER), within bounds
 *
 * The estimate scatters by s, and so does the true error of this very picture; both are sums of few
 * squares, hence skewed, and their logarithms nearly normal. Were they independent the ratio would
 * scatter by sqrt(2) s; rare hits raise both, so that it is 1.2 s on average (docs/ERROR.md, where
 * QUANTILE's choice is, too). In large pictures s is small, and what is left is by how much the
 * estimate is off in a scene, whatever the seed: DOUBT. Two-phase with fresh samples after Stein
 * (1945); looks at geometric steps. Pure: the same answers on every machine (dmath.h); no
 * allocation.
 *
 * Tests: tests/unit/test_claim.c, tests/e2e/test_e2e_adaptive.py, tests/campaign/claims.py.
 */
#ifndef MASTER_CLAIM_H
#define MASTER_CLAIM_H

#include "master/film.h"

/* The relMSE that the true one is below in 19 of 20 claims; infinite when the error is not known.
 */
double claim_upper(const struct film_error *e);

/* True if a picture of this error may claim a relMSE of at most `target`, > 0. */
bool claim_stands(const struct film_error *e, double target);

/* The mean samples a pixel at the first look, from the pilot's terms (allocate.h); `limits` gets
 * the blocks of each cell. */
double claim_first(const struct grid *grid, const struct job_blocks *blocks, const double *terms,
                   const float *shares, double target, uint16_t *limits);

/* By how much the samples grow, > 1, after a look at which no claim stood. */
double claim_growth(const struct film_error *e, double target);

/* Grows `mean_spp` and by it `limits` after such a look, until a cell has more. False: all cells
 * are at the job's end, and nothing changed. */
bool claim_more(const struct grid *grid, const struct job_blocks *blocks, const float *shares,
                const struct film_error *e, double target, double *mean_spp, uint16_t *limits);

#endif
