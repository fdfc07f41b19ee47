/* master/film.h: where the block sums of a job's units become a picture.
 *
 * Per pixel and plane (R, G, B, then the AOVs') two double sums, one for each half (even
 * and odd sample blocks). Blocks are added per pixel strictly in block order within each half,
 * whatever order they arrive in, so that the picture's bits depend on nothing but the
 * job. A block that comes before its predecessor waits in memory; the scheduler's
 * window bounds how much can wait.
 *
 * Sums lie in grid order (grid.h), as payloads do, so that adding a unit is three
 * straight loops. The film borrows the grid, which must outlive it.
 *
 * Threads: all functions belong to the loop thread, but between film_read_begin and
 * film_read_end those marked "reader" may run on another thread meanwhile: units that
 * arrive are then held aside and added when the last reader has gone.
 *
 * Invariants (film_check):
 *   1. A (cell, block) is present at most once: added, waiting or held.
 *   2. next[half][cell] blocks of a half are added, and none behind them.
 *   3. A waiting unit has at least one cell whose turn has not come.
 *
 * Files: film.c adds, film_error.c measures, film_file.c saves and loads.
 * Tests: tests/unit/test_film.c.
 */
#ifndef MASTER_FILM_H
#define MASTER_FILM_H

#include "common/digest.h"
#include "common/grid.h"

enum { FILM_CHANNELS = JOB_COLOR_PLANES, FILM_HALVES = 2 };

struct film; /* opaque */

/* Memory that a film of this job takes when nothing waits, in bytes. */
uint64_t film_bytes_of(const struct job_spec *spec);

/* Empty. Borrows `grid`. ERR_NOMEM. */
TL_NODISCARD enum err film_new(const struct grid *grid, const struct job_blocks *blocks,
                               struct film **out);
void film_free(struct film *f);

/* Takes `values` (mem_alloc'ed: the grid's plane_count planes of grid_pixels(unit) floats) on
 * success. ERR_STATE: a cell of the unit already has this block. ERR_NOMEM. The unit must be one of
 * the grid's (grid_has_unit). */
TL_NODISCARD enum err film_add(struct film *f, struct unit unit, float *values);

/* These cells start again from nothing: what they had, waiting payloads included, is dropped.
 * ERR_NOMEM (only while somebody reads): nothing changed. */
TL_NODISCARD enum err film_reset(struct film *f, uint32_t cell_begin, uint32_t cell_count);

/* True if any cell of the unit already has this block. */
bool film_has_any(const struct film *f, struct unit unit);

/* True when every block of every cell is in the sums. */
bool film_complete(const struct film *f);

/* Cell-blocks present and in all, and the bytes of payloads that wait. */
uint64_t film_present_count(const struct film *f);
uint64_t film_total_count(const struct film *f);
uint64_t film_waiting_bytes(const struct film *f);

/* Calls `visit` for maximal runs of cells whose block is present, block by block. */
void film_each_present(const struct film *f, void (*visit)(void *ctx, struct unit run), void *ctx);

/* True while units wait for a reader to end: film_save would not give them. */
bool film_holds(const struct film *f);

void film_read_begin(struct film *f);
void film_read_end(struct film *f);

/* Reader. Linear RGB, row by row of the crop, FILM_CHANNELS floats a pixel: (A + B) over the
 * samples that are in. Pixels without samples are 0. */
void film_picture(const struct film *f, float *rgb);

/* Reader. A float a pixel, row by row of the crop, of what aov.h describes: the sum or the mean of
 * a plane, the samples that are in, or the standard error of the mean over R, G and B. Beyond
 * 2^24 samples a count is rounded. */
enum film_aov { FILM_AOV_SUM, FILM_AOV_MEAN, FILM_AOV_SAMPLES, FILM_AOV_ERROR };
void film_aov(const struct film *f, enum film_aov kind, uint32_t plane, float *out);

/* --- Cells with different numbers of blocks (job_blocks.pilot > 0) ---------
 *
 * Such a film begins with the pilot's blocks for every cell. film_plan then says how many blocks,
 * the pilot's included, each cell gets, and what becomes of the pilot's samples. */
enum film_pilot {
    FILM_PILOT_DROPPED, /* it set the plan: its samples are no part of the estimate */
    FILM_PILOT_KEPT,    /* the plan does not depend on what it saw */
    FILM_PILOT_SKIPPED, /* dropped, and where nothing is rendered yet, never rendered */
};

/* `limits` is copied; none below what a cell has. The pilot's fate is decided by the first call.
 * False while somebody reads: try again. */
TL_NODISCARD bool film_plan(struct film *f, const uint16_t *limits, enum film_pilot pilot);
bool film_planned(const struct film *f);

/* Blocks that each cell gets, as things are; NULL: all of them. */
const uint16_t *film_limits(const struct film *f);

/* What the halves say about the picture's error (docs/ERROR.md has the formulas and what was
 * measured of them); all 0 and false when a pixel has no sample in one of the halves. relMSE as
 * in ARCHITECTURE.md, with (x - r)^2 replaced by its unbiased estimate from the halves. Pixels of
 * a 4 x 4 group of the full picture may share paths, and the intervals allow for it; they do
 * not depend on --tile. */
struct film_error {
    bool known;
    double relmse, relmse_low, relmse_high; /* 95 % */
    double relmse_deviation;                /* standard deviation of relmse, as estimated */
    double mean, mean_low, mean_high;       /* of all pixels and channels, 95 % */
    double effective;          /* size: of so many independent terms, all alike, the sum would have
                                * this deviation: (relmse / relmse_deviation)^2, >= 1 */
    uint32_t worst_x, worst_y; /* corner of the square with the largest mean error */
    double worst_relmse;       /* of that square */
};

/* Below this effective size a few pixels carry the error, and others like them may not have been
 * seen: a heavy tail. */
enum { FILM_EFFECTIVE_MIN = 32 };

/* Reader. Unknown when memory cannot be had. */
void film_error_estimate(const struct film *f, struct film_error *out);

/* Reader. The same estimate per pixel, one float for each, row by row of the crop: their mean is
 * relmse. False: not known. */
TL_NODISCARD bool film_error_pixels(const struct film *f, float *out);

/* Fewest, mean and most samples of a pixel. Reader. */
void film_samples(const struct film *f, uint64_t *spp_min, double *spp_mean, uint64_t *spp_max);

/* Reader. Gives everything but held units to `write`, in pieces; stops at its first error. */
TL_NODISCARD enum err film_save(const struct film *f,
                                enum err (*write)(void *ctx, const void *data, size_t bytes),
                                void *ctx);

/* A film as film_save wrote it for the same grid and blocks. `read` fills all of `bytes` or
 * fails. ERR_CORRUPT: not such a film. */
TL_NODISCARD enum err film_load(const struct grid *grid, const struct job_blocks *blocks,
                                enum err (*read)(void *ctx, void *data, size_t bytes), void *ctx,
                                struct film **out);

/* Asserts the invariants; for tests. */
void film_check(const struct film *f);

#endif
