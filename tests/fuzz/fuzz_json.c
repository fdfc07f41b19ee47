/* Fuzzes the JSON parser and the scene reader: whatever loads is a valid scene that survives
 * packing. Files are looked for in an empty folder, so that nothing of this machine is read. */
#include <stdint.h>

#include "common/json_get.h"
#include "common/mem.h"
#include "common/package.h"
#include "common/scene_json.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    struct diag_list problems;
    struct scene scene;
    struct job_spec spec;
    struct package package;
    diag_init(&problems);
    enum err e = scene_json_read((const char *)data, bytes, "f.json", "/nonexistent", &scene, &spec,
                                 &problems);
    TL_ASSERT((e == ERR_OK) == (problems.error_count == 0));
    if (e == ERR_OK) {
        TL_ASSERT(scene_valid(&scene) && job_spec_valid(&spec, NULL));
        TL_ASSERT(package_write(&scene, 0, &package) == ERR_OK);
        package_release(&package);
        scene_release(&scene);
    }
    diag_release(&problems);
    return 0;
}
