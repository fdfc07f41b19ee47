/* master/allocate.h: where samples go: from the pilot's error to blocks per cell.
 *
 * With variance v / samples^p of a pixel, weighed as relMSE weighs it, the samples that reach an
 * error with the least work are in proportion to v^(1 / (1 + p)): sqrt(v) for independent samples
 * (Neyman 1934), v^0.4 for well spread ones, and that is taken; by squares of 16 x 16 pixels. The
 * pilot alone decides the proportions, and its samples are then dropped: samples that decide how
 * many follow them must not be part of the mean, or dark pixels whose spikes were not seen yet
 * would stay dark. The same plan on every machine (dmath.h). Pure; no allocation.
 *
 * Tests: tests/unit/test_sample_plan.c.
 */
#ifndef MASTER_ALLOCATE_H
#define MASTER_ALLOCATE_H

#include "common/grid.h"

/* `terms` is each cell's sum of the pixels' terms of relMSE over the pilot, `squares` that of their
 * squares. Fills `shares`: samples of the cell's pixels over the picture's mean. A cell whose error
 * few pixels carry is measured badly, and may have spikes that the pilot missed: the more so, the
 * more of its share is its neighbours' mean; and none gets less than a sixteenth of the picture's.
 * `scratch` has cell_count places. */
void allocate_shares(const struct grid *grid, const double *terms, const double *squares,
                     float *shares, float *scratch);

/* Blocks of each cell for `mean_spp` samples a pixel on average, the pilot's not counted, and at
 * least `spp_min`: whole sets of samples, which are of powers of two, and halfway. False: all cells
 * are at the job's end already. */
bool allocate_limits(const struct grid *grid, const struct job_blocks *blocks, const float *shares,
                     double mean_spp, double spp_min, uint16_t *limits);

/* relMSE at those limits, none of them within the pilot, were variance to fall as 1 /
 * samples^power. */
double allocate_predict(const struct grid *grid, const struct job_blocks *blocks,
                        const double *terms, double power, const uint16_t *limits);

/* The mean samples that `target` takes by allocate_predict. `limits` is scratch. */
double allocate_mean_for(const struct grid *grid, const struct job_blocks *blocks,
                         const double *terms, const float *shares, double power, double target,
                         uint16_t *limits);

/* Work of the allocation over that of equal samples for the same error, <= 1 for exact shares. */
double allocate_gain(const struct grid *grid, const double *terms, const float *shares);

#endif
