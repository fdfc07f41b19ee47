/* Fuzzes the picture readers: OpenEXR, PNG, JPEG, Radiance HDR, told apart by their first bytes. */
#include <math.h>
#include <stdint.h>

#include "common/image_file.h"
#include "common/mem.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    struct diag_list problems;
    struct scene_image image;
    diag_init(&problems);
    if (image_read(data, bytes, "f", bytes & 1 ? IMAGE_COLOR : IMAGE_DATA, &image, &problems) ==
        ERR_OK) {
        size_t samples = (size_t)image.width * image.height * image.channel_count;
        TL_ASSERT(samples >= 1);
        for (size_t i = 0; image.format == SCENE_IMAGE_F32 && i < samples; i++)
            TL_ASSERT(isfinite(((float *)image.pixels)[i]));
        mem_free(image.pixels);
    }
    diag_release(&problems);
    return 0;
}
