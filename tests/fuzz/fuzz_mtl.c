/* Fuzzes the reader of OBJ material libraries. */
#include <stdint.h>

#include "common/mtl_file.h"
#include "common/scene.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    struct diag_list problems;
    struct mtl_library library;
    diag_init(&problems);
    if (mtl_read((const char *)data, bytes, "f.mtl", &library, &problems) == ERR_OK) {
        TL_ASSERT(problems.error_count == 0);
        for (size_t i = 0; i < library.count; i++) {
            const struct mtl_material *m = &library.materials[i];
            TL_ASSERT(m->name && m->opacity >= 0 && m->opacity <= 1 && m->ns >= 0);
            for (int c = 0; c < 3; c++)
                TL_ASSERT(m->kd[c] >= 0 && m->ke[c] >= 0 && m->ke[c] <= SCENE_NUMBER_MAX);
        }
        mtl_release(&library);
    }
    diag_release(&problems);
    return 0;
}
