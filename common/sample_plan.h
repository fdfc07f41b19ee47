/* common/sample_plan.h: how many samples each 16 x 16 square of a picture gets, as people see it.
 *
 * A job that was given an error or a time writes the plan it followed into its report; --plan FILE
 * gives it to another job, which then has the same bits. The squares are those of the full
 * picture, so that a plan also fits a crop of it. Numbers of samples are those of the ladder
 * (job_spec.h).
 *
 *   {"square": 16, "column": 0, "row": 0, "columns": 7, "rows": 7, "max_spp": 65536,
 *    "pilot": "dropped", "spp": [24, 24, 32, ...]}
 *
 * `spp` goes row by row; `column` and `row` are the first square's. Pure; any thread. Reads foreign
 * text: fuzz_sample_plan. Tests: tests/unit/test_sample_plan.c.
 */
#ifndef COMMON_SAMPLE_PLAN_H
#define COMMON_SAMPLE_PLAN_H

#include "common/buf.h"
#include "common/grid.h"
#include "common/json_get.h"

struct sample_plan {
    uint32_t column, row, columns, rows; /* squares of the full picture */
    bool pilot_kept;                     /* the pilot's samples are part of the picture */
    uint64_t max_spp;                    /* job_spec.spp of the job: its blocks follow from it */
    uint64_t *spp;                       /* columns * rows; owned */
};

void sample_plan_release(struct sample_plan *p);

/* Reads the plan's object, or a report with a member "plan". Problems name what is wrong.
 * ERR_INPUT, ERR_NOMEM. */
TL_NODISCARD enum err sample_plan_read(struct json_get *g, const struct json *object,
                                       struct sample_plan *out);

/* Blocks of each cell of a job's grid; `limits` has cell_count places. False: the plan does not
 * cover the grid, or has a number of samples that no number of blocks gives; *x and *y say at
 * which pixel. */
TL_NODISCARD bool sample_plan_limits(const struct sample_plan *p, const struct grid *grid,
                                     const struct job_blocks *blocks, uint16_t *limits, uint32_t *x,
                                     uint32_t *y);

/* Writes the object for a job's grid and limits. */
void sample_plan_put(struct buf *b, const struct grid *grid, const struct job_blocks *blocks,
                     const uint16_t *limits, bool pilot_kept);

/* Samples of a pixel after so many blocks. */
uint64_t sample_plan_spp(const struct job_blocks *blocks, uint32_t limit, bool pilot_kept);

#endif
