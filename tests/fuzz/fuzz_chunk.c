/* Fuzzes chunks as they arrive: zstd frames of any size and claim, and what they unpack to as a
 * package root, a mesh or an image. First byte: 0 a frame, else plain bytes of a chunk. */
#include <stdint.h>

#include "common/mem.h"
#include "common/model_file.h"
#include "common/package_codec.h"

enum { RAW_BYTES_MAX = 1 << 20 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

static void fuzz_frame(const uint8_t *data, size_t bytes)
{
    struct buf out;
    /* Any name: what unpacks but hashes otherwise is ERR_CORRUPT; the true name comes second. */
    digest name = digest_of(data, bytes);
    buf_init(&out);
    enum err e = chunk_decompress_any(data, bytes, &name, RAW_BYTES_MAX, &out);
    TL_ASSERT(e != ERR_OK && out.bytes == 0);
    buf_release(&out);
}

static void fuzz_plain(const uint8_t *data, size_t bytes)
{
    struct package_index index;
    struct scene_mesh mesh = {0};
    struct scene_image image = {0};
    if (package_root_read(data, bytes, &index) == ERR_OK)
        package_index_release(&index);
    if (package_mesh_get(data, bytes, &mesh) == ERR_OK) {
        struct buf again;
        buf_init(&again);
        enum { FLAGS_AT = 16, POSITIONS_F32 = 4 };
        bool f32 = data[FLAGS_AT] & POSITIONS_F32;
        TL_ASSERT(package_mesh_put(&mesh, f32, &again) != ERR_OK || again.bytes == bytes);
        buf_release(&again);
        scene_mesh_release(&mesh);
    }
    if (package_image_get(data, bytes, &image) == ERR_OK)
        mem_free(image.pixels);
    struct package_base base;
    if (package_base_get(data, bytes, &base) == ERR_OK) {
        const struct scene_image *last = &base.levels[base.level_count - 1];
        TL_ASSERT(last->width == 1 && last->height == 1);
        package_base_release(&base);
    }
    /* A chunk that we pack comes back as it was. */
    struct buf frame, out;
    buf_init(&frame);
    buf_init(&out);
    digest name = digest_of(data, bytes);
    if (chunk_compress(data, bytes, &frame) == ERR_OK && bytes <= RAW_BYTES_MAX)
        TL_ASSERT(chunk_decompress(frame.data, frame.bytes, &name, bytes, &out) == ERR_OK);
    buf_release(&frame);
    buf_release(&out);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    if (bytes < 1)
        return 0;
    if (data[0] == 0)
        fuzz_frame(data + 1, bytes - 1);
    else
        fuzz_plain(data + 1, bytes - 1);
    return 0;
}
