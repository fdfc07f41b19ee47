/* Fuzzes plans: what is accepted has the squares that it says, and fits its own grid or is refused.
 */
#include <stdint.h>
#include <string.h>

#include "common/mem.h"
#include "common/sample_plan.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

/* Applies the plan to the picture that its squares make. */
static void apply(const struct sample_plan *plan)
{
    struct job_spec spec;
    struct grid grid;
    uint32_t x, y;
    job_spec_init(&spec);
    spec.stop = JOB_STOP_PLAN;
    spec.spp = plan->max_spp;
    uint64_t width = (uint64_t)(plan->column + plan->columns) * GRID_SQUARE;
    uint64_t height = (uint64_t)(plan->row + plan->rows) * GRID_SQUARE;
    if (width > 4096 || height > 4096)
        return;
    spec.width = (uint32_t)width;
    spec.height = (uint32_t)height;
    spec.crop = (struct job_crop){plan->column * GRID_SQUARE, plan->row * GRID_SQUARE,
                                  plan->columns * GRID_SQUARE, plan->rows * GRID_SQUARE};
    if (!job_spec_valid(&spec, NULL) || grid_init(&grid, &spec) != ERR_OK)
        return;
    struct job_blocks blocks = job_spec_blocks(&spec);
    uint16_t *limits = mem_alloc_array(grid.cell_count, sizeof *limits);
    if (limits && sample_plan_limits(plan, &grid, &blocks, limits, &x, &y))
        for (uint32_t i = 0; i < grid.cell_count; i++)
            TL_ASSERT(limits[i] >= 1 && limits[i] <= blocks.count);
    mem_free(limits);
    grid_release(&grid);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    struct diag_list problems;
    struct json_get g;
    struct sample_plan plan;
    diag_init(&problems);
    if (json_get_open(&g, (const char *)data, bytes, NULL, &problems) == ERR_OK) {
        if (sample_plan_read(&g, g.root, &plan) == ERR_OK) {
            apply(&plan);
            sample_plan_release(&plan);
        } else {
            TL_ASSERT(problems.count > 0);
        }
        json_get_close(&g);
    }
    diag_release(&problems);
    return 0;
}
