#include "client/picture.h"

#include <string.h>

#include "common/dmath.h"
#include "common/exr_file.h"
#include "common/file_io.h"
#include "common/image_file.h"
#include "common/mem.h"

enum err picture_from_exr(const char *path, const void *data, size_t bytes, struct picture *out,
                          struct diag_list *problems)
{
    static const char *const names[] = {"R", "G", "B"};
    struct exr_image image;
    TL_TRY(exr_read(data, bytes, path, names, 3, &image, problems));
    out->width = image.data_width;
    out->height = image.data_height;
    size_t pixels = (size_t)out->width * out->height;
    out->rgb = mem_alloc_array(pixels, 3 * sizeof *out->rgb);
    for (size_t c = 0; out->rgb && c < 3; c++) {
        const float *plane = exr_image_plane(&image, names[c]);
        for (size_t i = 0; i < pixels; i++)
            out->rgb[3 * i + c] = plane[i];
    }
    exr_image_release(&image);
    return out->rgb ? ERR_OK : ERR_NOMEM;
}

static float linear_of(const struct scene_image *image, size_t i)
{
    if (image->format == SCENE_IMAGE_F32)
        return ((const float *)image->pixels)[i];
    double v = ((const unsigned char *)image->pixels)[i] / 255.0;
    return (float)(image->format == SCENE_IMAGE_U8_SRGB ? dmath_srgb_decode(v) : v);
}

static enum err from_image(const char *path, const void *data, size_t bytes, struct picture *out,
                           struct diag_list *problems)
{
    struct scene_image image;
    TL_TRY(image_read(data, bytes, path, IMAGE_COLOR, &image, problems));
    out->width = image.width;
    out->height = image.height;
    size_t pixels = (size_t)out->width * out->height;
    out->rgb = mem_alloc_array(pixels, 3 * sizeof *out->rgb);
    for (size_t i = 0; out->rgb && i < 3 * pixels; i++)
        out->rgb[i] =
            linear_of(&image, i / 3 * image.channel_count + (image.channel_count >= 3 ? i % 3 : 0));
    mem_free(image.pixels);
    return out->rgb ? ERR_OK : ERR_NOMEM;
}

enum err picture_read(const char *path, struct picture *out, struct diag_list *problems)
{
    static const unsigned char exr_magic[4] = {0x76, 0x2f, 0x31, 0x01};
    char *data;
    size_t bytes;
    *out = (struct picture){0};
    enum err e = file_read(path, UINT64_C(1) << 34, &data, &bytes);
    if (e != ERR_OK) {
        char *hint = e == ERR_NOT_FOUND ? file_missing_hint(path) : NULL;
        diag_add(problems, DIAG_ERROR, (struct diag_place){.file = path},
                 e == ERR_NOT_FOUND ? "missing-file" : "unreadable-file", hint,
                 "cannot be read: %s", file_read_why(path, e));
        mem_free(hint);
        return ERR_INPUT;
    }
    bool exr = bytes >= 4 && memcmp(data, exr_magic, 4) == 0;
    e = exr ? picture_from_exr(path, data, bytes, out, problems)
            : from_image(path, data, bytes, out, problems);
    mem_free(data);
    return e;
}
