/* tests/golden/test_golden.c: one digest a scene, on every build, compiler and CPU.
 *
 * Renders small versions of scenes/ through render_unit() with each builder and compares the
 * SHA-256 of all block sums with tests/golden/digests.txt ("SCENE HEX" a line).
 *
 * usage: test_golden [--update]   run in the top folder; --update writes the file anew. A change of
 *        a digest is a change of every user's pictures: raise DETERMINISM_NUMBER with it.
 */
#include <stdio.h>
#include <string.h>

#include "common/digest.h"
#include "common/grid.h"
#include "common/mem.h"
#include "common/scene_json.h"
#include "worker/render/render.h"
#include "worker/scene/scene_build.h"

static const struct golden {
    const char *name, *scene;
    enum job_precision precision;
} scenes[] = {
    {"cbox_no_light", "cbox_no_light", JOB_PRECISION_EXACT},
    {"cbox_no_light_refract", "cbox_no_light_refract", JOB_PRECISION_EXACT},
    {"cbox", "cbox", JOB_PRECISION_EXACT},
    {"glass_cbox", "glass_cbox", JOB_PRECISION_EXACT},
    {"veach", "veach", JOB_PRECISION_EXACT},
    {"two_spheres", "two_spheres", JOB_PRECISION_EXACT},
    {"sphere", "sphere", JOB_PRECISION_EXACT},
    {"cbox-fast", "cbox", JOB_PRECISION_FAST},
};
enum { SCENE_COUNT = sizeof scenes / sizeof *scenes, SIDE = 40, SPP = 8, FAILED = -1 };
static const char digests_file[] = "tests/golden/digests.txt";

/* The digest of every unit of one cell, in order. */
static int digest_of_render(const struct render_scene *built, const struct job_spec *spec,
                            digest *out)
{
    struct grid grid;
    struct render_scratch *scratch;
    struct digest_ctx hash;
    if (grid_init(&grid, spec) != ERR_OK || render_scratch_new(&scratch) != ERR_OK ||
        digest_begin(&hash) != ERR_OK)
        return FAILED;
    struct job_blocks blocks = job_blocks_of(spec->spp);
    int status = 0;
    for (uint32_t block = 0; block < blocks.count; block++) {
        for (uint32_t cell = 0; cell < grid.cell_count; cell++) {
            struct unit unit = {.cell_begin = cell, .cell_count = 1, .block = block};
            struct render_counters counters;
            float rgb[JOB_COLOR_PLANES * 16 * 16];
            if (render_unit(built, &grid, unit, scratch, NULL, rgb, &counters) != ERR_OK)
                status = FAILED;
            digest_add(&hash, rgb, grid_pixels(&grid, cell, 1) * JOB_COLOR_PLANES * sizeof *rgb);
        }
    }
    *out = digest_end(&hash);
    render_scratch_free(scratch);
    grid_release(&grid);
    return status;
}

static int render_scene_file(const struct golden *golden, enum job_builder builder, digest *out)
{
    char path[200];
    struct scene scene;
    struct job_spec spec;
    struct diag_list problems;
    struct render_scene *built;
    (void)snprintf(path, sizeof path, "scenes/%s.json", golden->scene);
    diag_init(&problems);
    if (scene_json_read_file(path, &scene, &spec, &problems) != ERR_OK) {
        diag_print(&problems, stdout);
        diag_release(&problems);
        return FAILED;
    }
    diag_release(&problems);
    spec.width = spec.height = SIDE;
    spec.crop = (struct job_crop){.width = SIDE, .height = SIDE};
    spec.spp = SPP;
    spec.tile = 16;
    spec.builder = builder;
    spec.precision = golden->precision;
    if (scene_build(&scene, &spec, NULL, &built) != ERR_OK)
        return FAILED;
    int status = digest_of_render(built, &spec, out);
    render_scene_free(built);
    scene_release(&scene);
    return status;
}

/* The digest on record for a scene; false when there is none. */
static bool recorded(const char *name, char hex[DIGEST_HEX_BYTES])
{
    char line_name[64], line_hex[DIGEST_HEX_BYTES];
    bool found = false;
    FILE *file = fopen(digests_file, "r");
    while (file && fscanf(file, "%63s %64s", line_name, line_hex) == 2) {
        if (strcmp(line_name, name) == 0) {
            memcpy(hex, line_hex, DIGEST_HEX_BYTES);
            found = true;
        }
    }
    if (file)
        (void)fclose(file);
    return found;
}

/* Renders with each builder; counts what differs from the record or between builders. */
static int check(const struct golden *golden, char hex[DIGEST_HEX_BYTES])
{
    const char *name = golden->name;
    char expected[DIGEST_HEX_BYTES] = "nothing";
    bool known = recorded(name, expected);
    int failures = 0;
    for (int builder = 0; builder < JOB_BUILDER_COUNT; builder++) {
        digest d;
        if (builder == JOB_BUILDER_NONE && golden->precision == JOB_PRECISION_FAST)
            continue; /* always in double */
        if (render_scene_file(golden, (enum job_builder)builder, &d) != 0) {
            printf("%s, builder %s: did not render\n", name, job_builder_names[builder]);
            return 1;
        }
        digest_to_hex(&d, hex);
        bool same = known && strcmp(hex, expected) == 0;
        failures += !same;
        printf("%s, builder %s: %s%s%s\n", name, job_builder_names[builder], hex,
               same ? "" : ", expected ", same ? "" : expected);
    }
    return failures;
}

int main(int argc, char **argv)
{
    bool update = argc == 2 && strcmp(argv[1], "--update") == 0;
    char hex[SCENE_COUNT][DIGEST_HEX_BYTES];
    int failures = 0;
    for (int i = 0; i < SCENE_COUNT; i++)
        failures += check(&scenes[i], hex[i]);
    if (!update) {
        printf("golden: %d scenes, %d differences\n", SCENE_COUNT, failures);
        return failures != 0;
    }
    FILE *file = fopen(digests_file, "w");
    for (int i = 0; file && i < SCENE_COUNT; i++)
        (void)fprintf(file, "%s %s\n", scenes[i].name, hex[i]);
    return !file || fclose(file) != 0;
}
