/* Fuzzes what is read of glTF before assimp: container, JSON, checks, hierarchy, materials, and the
 * document rewritten with floats, which must pass the same checks. */
#include <stdint.h>

#include "client/import_gltf.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

static void read_parts(struct gltf *t)
{
    uint64_t total = 0;
    if (gltf_check(t, &total) != ERR_OK || gltf_order(t) != ERR_OK || gltf_materials(t) != ERR_OK)
        return;
    if (gltf_nodes(t) != ERR_OK)
        return;
    TL_ASSERT(t->order_count <= t->tables[GLTF_MATERIALS].count);
    TL_ASSERT(t->im->problems->error_count > 0 || scene_valid(&t->im->scene));
}

static void read_again(struct import *im, const struct buf *doc)
{
    struct gltf t;
    if (doc->bytes == 0)
        return;
    TL_ASSERT(gltf_open(&t, im, (const char *)doc->data, doc->bytes) == ERR_OK);
    gltf_close(&t);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    struct diag_list problems;
    struct import im;
    struct gltf t;
    struct buf doc, floats;
    diag_init(&problems);
    buf_init(&doc);
    buf_init(&floats);
    if (import_init(&im, "f.gltf", &problems) == ERR_OK) {
        if (gltf_open(&t, &im, (const char *)data, bytes) == ERR_OK) {
            read_parts(&t);
            gltf_close(&t);
        }
        if (gltf_floats(&im, (const char *)data, bytes, &doc, &floats) == ERR_OK)
            read_again(&im, &doc);
        import_release(&im);
    }
    buf_release(&doc);
    buf_release(&floats);
    diag_release(&problems);
    return 0;
}
