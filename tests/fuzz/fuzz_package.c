/* Fuzzes package roots, chunks and zstd frames.
 *
 * Input: u32 length of the root, the root, then the bytes that every chunk consists of, each
 * chunk taking what its entry says (or all that is left). */
#include <stdint.h>
#include <string.h>

#include "common/package.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

struct supply {
    const uint8_t *at;
    size_t left;
};

static enum err fetch(void *ctx, size_t i, const struct package_index_entry *entry,
                      const unsigned char **data, size_t *bytes)
{
    struct supply *s = ctx;
    (void)i;
    *data = s->at;
    *bytes = entry->bytes < s->left ? (size_t)entry->bytes : s->left;
    s->at += *bytes;
    s->left -= *bytes;
    return ERR_OK;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    uint32_t root_bytes;
    struct scene scene;
    struct package package;
    struct buf out;
    if (bytes < sizeof root_bytes)
        return 0;
    memcpy(&root_bytes, data, sizeof root_bytes);
    data += sizeof root_bytes;
    bytes -= sizeof root_bytes;
    size_t root = root_bytes < bytes ? root_bytes : bytes;
    struct supply supply = {.at = data + root, .left = bytes - root};
    if (package_read(data, root, fetch, &supply, &scene) == ERR_OK) {
        TL_ASSERT(scene_valid(&scene));
        TL_ASSERT(package_write(&scene, 0, &package) == ERR_OK);
        package_release(&package);
        TL_ASSERT(package_write_pieces(&scene, 0, 1, &package) == ERR_OK);
        package_release(&package);
        scene_release(&scene);
    }
    digest name = digest_of(data, root);
    buf_init(&out);
    if (chunk_decompress_any(data, bytes, &name, 1 << 20, &out) == ERR_OK)
        TL_ASSERT(out.bytes <= 1 << 20);
    buf_release(&out);
    return 0;
}
