/* Fuzzes the Radiance HDR reader: run lengths, exponents and header lines of any kind. */
#include <math.h>
#include <stdint.h>

#include "common/image_parts.h"
#include "common/mem.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    struct diag_list problems;
    struct scene_image image;
    diag_init(&problems);
    enum err e = hdr_read(data, bytes, "f", &image, &problems);
    if (e == ERR_OK) {
        TL_ASSERT(image.format == SCENE_IMAGE_F32 && image.channel_count == 3);
        size_t samples = (size_t)image.width * image.height * image.channel_count;
        for (size_t i = 0; i < samples; i++)
            TL_ASSERT(isfinite(((const float *)image.pixels)[i]));
        mem_free(image.pixels);
    } else {
        TL_ASSERT(e != ERR_INPUT || problems.error_count > 0);
    }
    diag_release(&problems);
    return 0;
}
