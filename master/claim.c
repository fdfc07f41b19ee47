#include "master/claim.h"

#include <math.h>

#include "common/dmath.h"
#include "master/allocate.h"

/* Of the estimate's deviation, at every look. 1.9 of the 1.2 by which stated over true scatters:
 * one-sided 97 %, since most jobs look four or five times. */
static const double QUANTILE = 2.3;
/* By how much stated errors of large pictures are off in some scenes, however many pixels they
 * have: of the logarithm. */
static const double DOUBT = 0.1;
/* Below this effective size the deviation is no measure of the doubt, and no claim is made. */
static const double CLAIM_EFFECTIVE_MIN = 8;
/* From the pilot's few samples on, error falls as samples to about this power or less
 * (docs/ERROR.md: 1 to 1.9). The first look comes where the target would be reached then: a look
 * too many costs little, samples too many are not got back. */
static const double FIRST_POWER = 1.5;
/* It comes no later than after so many samples on average: what two samples state of a picture of
 * few levels may be twenty times its error. */
static const double FIRST_SPP_MAX = 16;
/* By which power the next look is set. */
static const double NEXT_POWER = 1.7;
/* Between two looks samples grow by at least and at most so much. */
static const double GROWTH_MIN = 1.03, GROWTH_MAX = 4;
/* What the next look should find, of what is needed. */
static const double GROWTH_MARGIN = 1.02;
/* Too small an effective size, and no other reason: how it goes on. */
static const double HEAVY_GROWTH = 1.25;

double claim_upper(const struct film_error *e)
{
    if (!e->known)
        return (double)INFINITY;
    if (!(e->relmse > 0))
        return 0;
    double scatter = QUANTILE * e->relmse_deviation / e->relmse;
    return e->relmse * dmath_exp(sqrt(scatter * scatter + DOUBT * DOUBT));
}

/* Not carried by a handful of spikes. */
static bool trusted(const struct film_error *e)
{
    return !(e->relmse > 0) || e->effective >= CLAIM_EFFECTIVE_MIN;
}

bool claim_stands(const struct film_error *e, double target)
{
    return trusted(e) && claim_upper(e) <= target;
}

double claim_first(const struct grid *grid, const struct job_blocks *blocks, const double *terms,
                   const float *shares, double target, uint16_t *limits)
{
    double mean = allocate_mean_for(grid, blocks, terms, shares, FIRST_POWER, target, limits);
    mean = mean < FIRST_SPP_MAX ? mean : FIRST_SPP_MAX;
    (void)allocate_limits(grid, blocks, shares, mean, 0, limits);
    return mean;
}

double claim_growth(const struct film_error *e, double target)
{
    double growth = dmath_pow(GROWTH_MARGIN * claim_upper(e) / target, 1 / NEXT_POWER);
    if (!trusted(e) && growth < HEAVY_GROWTH)
        return HEAVY_GROWTH;
    return growth < GROWTH_MIN ? GROWTH_MIN : growth < GROWTH_MAX ? growth : GROWTH_MAX;
}

static uint64_t total_of(const struct grid *grid, const uint16_t *limits)
{
    uint64_t total = 0;
    for (uint32_t cell = 0; cell < grid->cell_count; cell++)
        total += limits[cell];
    return total;
}

bool claim_more(const struct grid *grid, const struct job_blocks *blocks, const float *shares,
                const struct film_error *e, double target, double *mean_spp, uint16_t *limits)
{
    uint64_t before = total_of(grid, limits);
    if (before == (uint64_t)grid->cell_count * blocks->count)
        return false;
    /* A small step may leave every cell on its step of the ladder: the same picture again. */
    while (total_of(grid, limits) == before) {
        *mean_spp *= claim_growth(e, target);
        (void)allocate_limits(grid, blocks, shares, *mean_spp, 0, limits);
    }
    return true;
}
