#include "master/allocate.h"

#include <math.h>

#include "common/dmath.h"

/* Of the mean share: less would trust a pilot that may have missed spikes. */
static const double SHARE_MIN = 1.0 / 16;
/* 1 / (1 + p) is best where variance falls as 1 / samples^p; p is 1 to 1.9, and a power below one
 * half trusts a pilot of few samples less besides. */
static const double SHARE_POWER = 0.4;

/* What the neighbours say of a cell is worth so many of its pixels. */
static const double NEAR_WORTH = 2;

static double cell_pixels(const struct grid *grid, uint32_t cell)
{
    struct grid_rect r = grid_cell(grid, cell);
    return (double)r.width * r.height;
}

/* Makes the pixels' mean share 1. */
static void normalise(const struct grid *grid, float *shares)
{
    double sum = 0, pixels = 0;
    for (uint32_t cell = 0; cell < grid->cell_count; cell++) {
        sum += (double)shares[cell] * cell_pixels(grid, cell);
        pixels += cell_pixels(grid, cell);
    }
    for (uint32_t cell = 0; cell < grid->cell_count; cell++)
        shares[cell] = sum > 0 ? (float)((double)shares[cell] * pixels / sum) : 1;
}

/* Mean of the cells around one, itself left out; `by_place` is row by row. */
static double around(const struct grid *grid, const float *by_place, uint32_t place)
{
    uint32_t column = place % grid->columns, row = place / grid->columns, count = 0;
    double sum = 0;
    for (uint32_t y = row > 0 ? row - 1 : 0; y <= row + 1 && y < grid->rows; y++) {
        for (uint32_t x = column > 0 ? column - 1 : 0; x <= column + 1 && x < grid->columns; x++) {
            if (x == column && y == row)
                continue;
            sum += (double)by_place[y * grid->columns + x];
            count++;
        }
    }
    return count > 0 ? sum / count : (double)by_place[place];
}

/* Belief in a cell's own measure: e pixels, all alike, would carry its error as surely. A cell
 * without any error, as of background, is worth a pixel. */
static double own_belief(double term, double square)
{
    double e = square > 0 ? term * term / square : 1;
    return e / (e + NEAR_WORTH);
}

void allocate_shares(const struct grid *grid, const double *terms, const double *squares,
                     float *shares, float *scratch)
{
    for (uint32_t cell = 0; cell < grid->cell_count; cell++)
        scratch[grid->order[cell]] =
            (float)dmath_pow(terms[cell] / cell_pixels(grid, cell), SHARE_POWER);
    for (uint32_t cell = 0; cell < grid->cell_count; cell++) {
        uint32_t place = grid->order[cell];
        double own = own_belief(terms[cell], squares[cell]);
        shares[cell] =
            (float)(own * (double)scratch[place] + (1 - own) * around(grid, scratch, place));
    }
    normalise(grid, shares);
    for (uint32_t cell = 0; cell < grid->cell_count; cell++)
        if ((double)shares[cell] < SHARE_MIN)
            shares[cell] = (float)SHARE_MIN;
    normalise(grid, shares);
}

/* The steps of the ladder that plans take: whole sets of well spread samples, which are of powers
 * of two, and halfway. Between the powers errors are up to 1.13 times what their law says
 * (docs/ERROR.md), halfway no less than at the quarters, and finer steps would follow the shares no
 * better than that costs. */
struct plan_steps {
    uint32_t count;
    uint16_t limit[JOB_BLOCKS_MAX]; /* blocks of a cell, rising; the last is the job's end */
    double spp[JOB_BLOCKS_MAX];
};

static bool whole_or_half(uint64_t samples)
{
    uint64_t rest = samples & (samples - 1); /* without the lowest bit */
    return rest == 0 || (2 * samples == 3 * rest && (rest & (rest - 1)) == 0);
}

static void plan_steps_init(struct plan_steps *s, const struct job_blocks *blocks)
{
    s->count = 0;
    for (uint32_t limit = blocks->pilot + 2; limit <= blocks->count; limit += 2) {
        uint64_t spp = job_blocks_samples(blocks, limit);
        if (!whole_or_half(spp) && limit != blocks->count)
            continue;
        s->limit[s->count] = (uint16_t)limit;
        s->spp[s->count++] = (double)spp;
    }
}

/* The limit nearest to so many samples, by ratio. */
static uint16_t nearest_limit(const struct plan_steps *s, double spp)
{
    uint32_t low = 0, high = s->count - 1;
    while (low < high) {
        uint32_t middle = (low + high) / 2;
        if (s->spp[middle] * s->spp[middle + 1] < spp * spp)
            low = middle + 1;
        else
            high = middle;
    }
    return s->limit[low];
}

bool allocate_limits(const struct grid *grid, const struct job_blocks *blocks, const float *shares,
                     double mean_spp, double spp_min, uint16_t *limits)
{
    struct plan_steps steps;
    plan_steps_init(&steps, blocks);
    bool any = false;
    for (uint32_t cell = 0; cell < grid->cell_count; cell++) {
        double spp = mean_spp * (double)shares[cell];
        limits[cell] = nearest_limit(&steps, spp > spp_min ? spp : spp_min);
        any |= limits[cell] < blocks->count;
    }
    return any;
}

double allocate_predict(const struct grid *grid, const struct job_blocks *blocks,
                        const double *terms, double power, const uint16_t *limits)
{
    double sum = 0, pixels = 0, pilot = (double)job_pilot_samples(blocks);
    double left[JOB_BLOCKS_MAX + 1]; /* of the pilot's error, by limit */
    for (uint32_t limit = blocks->pilot + 1; limit <= blocks->count; limit++)
        left[limit] = dmath_pow(pilot / (double)job_blocks_samples(blocks, limit), power);
    for (uint32_t cell = 0; cell < grid->cell_count; cell++) {
        sum += terms[cell] * left[limits[cell]];
        pixels += cell_pixels(grid, cell);
    }
    return sum / pixels;
}

double allocate_mean_for(const struct grid *grid, const struct job_blocks *blocks,
                         const double *terms, const float *shares, double power, double target,
                         uint16_t *limits)
{
    enum { HALVINGS = 40 };
    double low = 1, high = 2 * (double)blocks->spp / SHARE_MIN;
    for (int i = 0; i < HALVINGS; i++) {
        double middle = sqrt(low * high);
        (void)allocate_limits(grid, blocks, shares, middle, 0, limits);
        if (allocate_predict(grid, blocks, terms, power, limits) > target)
            low = middle;
        else
            high = middle;
    }
    return high;
}

double allocate_gain(const struct grid *grid, const double *terms, const float *shares)
{
    double even = 0, shared = 0;
    for (uint32_t cell = 0; cell < grid->cell_count; cell++) {
        even += terms[cell];
        shared += terms[cell] / (double)shares[cell];
    }
    return even > 0 ? shared / even : 1;
}
