/* Fuzzes the OBJ reader and the making of its mesh. */
#include <stdint.h>

#include "common/model_file.h"
#include "common/obj_mesh.h"
#include "tests/fuzz/mesh_judge.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    struct diag_list problems;
    struct obj_model model;
    struct scene_mesh mesh;
    diag_init(&problems);
    if (obj_read((const char *)data, bytes, "f.obj", &model, &problems) == ERR_OK) {
        if (model.triangle_count && obj_mesh(&model, OBJ_MATERIAL_ALL, &mesh) == ERR_OK) {
            (void)model_fix_winding(&mesh);
            mesh_judge(&mesh);
            scene_mesh_release(&mesh);
        }
        obj_release(&model);
    }
    diag_release(&problems);
    return 0;
}
