/* tests/e2e/wire_fixture.c: a real package on disk for the tests that play the master.
 *
 *   wire_fixture DIR SIDE SPP CELLS_PER_UNIT
 *
 * writes DIR/HEX.zst for each chunk of the Cornell box, DIR/index (a line "HEX RAW_BYTES" each,
 * the root first), DIR/spec.json, and for each unit DIR/unit_BEGIN_COUNT_BLOCK, the body that a
 * worker must send for it, rendered here.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/buf.h"
#include "common/file_io.h"
#include "common/mem.h"
#include "common/package.h"
#include "proto/tile_codec.h"
#include "tests/render/render_kit.h"
#include "worker/scene/scene_build.h"

static void must(bool ok, const char *what)
{
    if (!ok) {
        (void)fprintf(stderr, "wire_fixture: %s\n", what);
        exit(1);
    }
}

static void save(const char *folder, const char *name, const void *data, size_t bytes)
{
    char *path = file_join(folder, name);
    must(path && file_write(path, data, bytes) == ERR_OK, name);
    mem_free(path);
}

static void save_package(const char *folder, const struct scene *scene)
{
    struct package package;
    struct buf index;
    buf_init(&index);
    must(package_write(scene, 0, &package) == ERR_OK, "package_write");
    for (size_t i = 0; i < package.count; i++) {
        const struct package_chunk *c = &package.chunks[i];
        char hex[DIGEST_HEX_BYTES], file[DIGEST_HEX_BYTES + 4];
        struct buf frame;
        buf_init(&frame);
        digest_to_hex(&c->name, hex);
        (void)snprintf(file, sizeof file, "%s.zst", hex);
        must(chunk_compress(c->data, c->bytes, &frame) == ERR_OK, "chunk_compress");
        save(folder, file, frame.data, frame.bytes);
        buf_printf(&index, "%s %zu\n", hex, c->bytes);
        buf_release(&frame);
    }
    must(buf_status(&index) == ERR_OK, "index");
    save(folder, "index", index.data, index.bytes);
    buf_release(&index);
    package_release(&package);
}

static void save_units(const char *folder, const struct scene *scene, const struct job_spec *spec,
                       uint32_t cells_per_unit)
{
    struct render_scene *built;
    struct render_scratch *scratch;
    struct grid grid;
    must(scene_build(scene, spec, NULL, &built) == ERR_OK, "scene_build");
    must(render_scratch_new(&scratch) == ERR_OK, "render_scratch_new");
    must(grid_init(&grid, spec) == ERR_OK, "grid_init");
    struct job_blocks blocks = job_blocks_of(spec->spp);
    for (uint32_t block = 0; block < blocks.count; block++) {
        for (uint32_t begin = 0; begin < grid.cell_count; begin += cells_per_unit) {
            struct unit unit = {.cell_begin = begin, .cell_count = cells_per_unit, .block = block};
            if (unit.cell_count > grid.cell_count - begin)
                unit.cell_count = grid.cell_count - begin;
            size_t values = grid.plane_count * (size_t)grid_pixels(&grid, begin, unit.cell_count);
            float *rgb = mem_alloc_array(values, sizeof *rgb);
            struct render_counters counters;
            must(rgb && render_unit(built, &grid, unit, scratch, NULL, rgb, &counters) == ERR_OK,
                 "render_unit");
            unsigned char *body;
            size_t body_bytes;
            must(tile_codec_encode(rgb, values, &body, &body_bytes) == ERR_OK, "encode");
            char file[64];
            (void)snprintf(file, sizeof file, "unit_%u_%u_%u", begin, unit.cell_count, block);
            save(folder, file, body, body_bytes);
            mem_free(body);
            mem_free(rgb);
        }
    }
    grid_release(&grid);
    render_scratch_free(scratch);
    render_scene_free(built);
}

int main(int argc, char **argv)
{
    must(argc == 5, "usage: wire_fixture DIR SIDE SPP CELLS_PER_UNIT");
    struct scene scene;
    scene_init(&scene);
    kit_cornell(&scene, KIT_BOXES | KIT_AREA_LIGHT | KIT_GLASS_SPHERE);
    struct job_spec spec =
        kit_spec((uint32_t)strtoul(argv[2], NULL, 10), strtoull(argv[3], NULL, 10));
    char *json = job_spec_to_json(&spec);
    must(json != NULL, "job_spec_to_json");
    save(argv[1], "spec.json", json, strlen(json));
    save_package(argv[1], &scene);
    save_units(argv[1], &scene, &spec, (uint32_t)strtoul(argv[4], NULL, 10));
    mem_free(json);
    scene_release(&scene);
    return 0;
}
