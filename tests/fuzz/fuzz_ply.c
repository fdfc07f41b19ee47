/* Fuzzes the PLY reader. */
#include <stdint.h>

#include "common/model_file.h"
#include "common/ply_file.h"
#include "tests/fuzz/mesh_judge.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    struct diag_list problems;
    struct scene_mesh mesh;
    diag_init(&problems);
    if (ply_read_mesh((const char *)data, bytes, "f.ply", &mesh, &problems) == ERR_OK) {
        (void)model_fix_winding(&mesh);
        mesh_judge(&mesh);
        scene_mesh_release(&mesh);
    }
    diag_release(&problems);
    return 0;
}
