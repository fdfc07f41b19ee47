/* tests/campaign/claim_samples.c: the sample blocks of many seeds of a scene, for claims.py.
 *
 * usage: claim_samples SCENE OUT WIDTH HEIGHT SPP FIRST_SEED SEEDS [direct|ao]
 *
 * A sample is a function of pixel, seed, half and number, so that what a job with --target-error
 * would have done can be worked out from its blocks. Renders the pilot and the estimate's blocks
 * up to SPP samples of each seed, and writes five 32-bit numbers (width, height, seeds, blocks,
 * of which pilot) and then floats [seed][block][channel][row][column]: sums over the block.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/grid.h"
#include "common/mem.h"
#include "common/scene_json.h"
#include "worker/render/render.h"
#include "worker/scene/scene_build.h"

static _Noreturn void fail(const char *what)
{
    fprintf(stderr, "claim_samples: %s\n", what);
    exit(5);
}

static void put(const void *data, size_t bytes, FILE *out)
{
    if (fwrite(data, 1, bytes, out) != bytes)
        fail("the file cannot be written");
}

/* One seed: all blocks, each as a picture. */
static void render_seed(const struct scene *scene, const struct job_spec *spec, FILE *out)
{
    struct render_scene *built;
    struct render_scratch *scratch;
    struct grid grid;
    struct job_blocks blocks = job_spec_blocks(spec);
    if (scene_build(scene, spec, NULL, &built) != ERR_OK || grid_init(&grid, spec) != ERR_OK ||
        render_scratch_new(&scratch) != ERR_OK)
        fail("no memory");
    size_t pixels = (size_t)spec->width * spec->height;
    float *unit = mem_alloc_array(pixels, 3 * sizeof *unit);
    float *picture = mem_alloc_array(pixels, 3 * sizeof *picture);
    if (!unit || !picture)
        fail("no memory");
    for (uint32_t block = 0; block < blocks.count; block++) {
        struct render_counters counters;
        if (render_unit(built, &grid, (struct unit){0, grid.cell_count, block}, scratch, NULL, unit,
                        &counters) != ERR_OK)
            fail("no memory");
        size_t at = 0;
        for (uint32_t cell = 0; cell < grid.cell_count; cell++) {
            struct grid_rect r = grid_cell(&grid, cell);
            for (uint32_t y = r.y; y < r.y + r.height; y++)
                for (uint32_t x = r.x; x < r.x + r.width; x++, at++)
                    for (size_t c = 0; c < 3; c++)
                        picture[c * pixels + y * spec->width + x] = unit[c * pixels + at];
        }
        put(picture, 3 * pixels * sizeof *picture, out);
    }
    mem_free(unit);
    mem_free(picture);
    render_scratch_free(scratch);
    grid_release(&grid);
    render_scene_free(built);
}

int main(int argc, char **argv)
{
    if (argc < 8 || argc > 9) {
        fprintf(stderr,
                "usage: claim_samples SCENE OUT WIDTH HEIGHT SPP FIRST_SEED SEEDS [direct|ao]\n");
        return 2;
    }
    struct scene scene;
    struct job_spec spec;
    struct diag_list problems;
    diag_init(&problems);
    enum err e = scene_json_read_file(argv[1], &scene, &spec, &problems);
    if (e != ERR_OK)
        diag_print(&problems, stderr);
    diag_release(&problems);
    if (e != ERR_OK)
        return 3;
    spec.width = (uint32_t)strtoul(argv[3], NULL, 10);
    spec.height = (uint32_t)strtoul(argv[4], NULL, 10);
    spec.crop = (struct job_crop){.width = spec.width, .height = spec.height};
    spec.spp = strtoull(argv[5], NULL, 10);
    spec.stop = JOB_STOP_ERROR;
    spec.target_error = 1;
    spec.tile = GRID_SQUARE;
    if (argc == 9)
        spec.integrator = strcmp(argv[8], "ao") == 0 ? JOB_INTEGRATOR_AO : JOB_INTEGRATOR_DIRECT;
    if (!job_spec_valid(&spec, NULL))
        fail("bad size or number of samples");
    unsigned long long first = strtoull(argv[6], NULL, 10), seeds = strtoull(argv[7], NULL, 10);
    struct job_blocks blocks = job_spec_blocks(&spec);
    uint32_t head[5] = {spec.width, spec.height, (uint32_t)seeds, blocks.count, blocks.pilot};
    FILE *out = fopen(argv[2], "wb");
    if (!out)
        fail("the file cannot be made");
    put(head, sizeof head, out);
    for (spec.seed = first; spec.seed < first + seeds; spec.seed++)
        render_seed(&scene, &spec, out);
    scene_release(&scene);
    if (fclose(out) != 0)
        fail("the file cannot be written");
    return 0;
}
