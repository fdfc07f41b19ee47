#include "common/image_file.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "common/exr_file.h"
#include "common/file_io.h"
#include "common/image_parts.h"
#include "common/mem.h"
#include "common/png_file.h"

#define FILE_BYTES_MAX (UINT64_C(2) << 30)

/* --- What the readers share ---------------------------------------------- */

enum err image_problem(struct diag_list *problems, const char *file, const char *id,
                       const char *format, ...)
{
    char text[300];
    va_list args;
    va_start(args, format);
    (void)vsnprintf(text, sizeof text, format, args);
    va_end(args);
    diag_add(problems, DIAG_ERROR, (struct diag_place){.file = file}, id, NULL, "%s", text);
    return ERR_INPUT;
}

enum err image_alloc(uint64_t width, uint64_t height, uint32_t channel_count,
                     enum scene_image_format format, const char *file, struct scene_image *out,
                     struct diag_list *problems)
{
    if (width < 1 || width > SCENE_IMAGE_SIDE_MAX || height < 1 || height > SCENE_IMAGE_SIDE_MAX ||
        width * height > IMAGE_PIXELS_MAX)
        return image_problem(problems, file, "image-size",
                             "%llu x %llu pixels, expected 1 to %d a side and at most %llu in all",
                             (unsigned long long)width, (unsigned long long)height,
                             (int)SCENE_IMAGE_SIDE_MAX, (unsigned long long)IMAGE_PIXELS_MAX);
    size_t sample = format == SCENE_IMAGE_F32 ? sizeof(float) : 1;
    void *pixels = mem_calloc((size_t)(width * height), channel_count * sample);
    if (!pixels)
        return ERR_NOMEM;
    *out = (struct scene_image){.width = (uint32_t)width,
                                .height = (uint32_t)height,
                                .channel_count = channel_count,
                                .format = format,
                                .pixels = pixels};
    return ERR_OK;
}

/* --- OpenEXR into an image ----------------------------------------------- */

/* Grey from Y (or a lone channel), RGB, or RGBA. */
static enum err pick_planes(const struct exr_image *exr, const char *file, const float *planes[4],
                            uint32_t *count, struct diag_list *problems)
{
    static const char *const names[4] = {"R", "G", "B", "A"};
    for (int i = 0; i < 4; i++)
        planes[i] = exr_image_plane(exr, names[i]);
    *count = planes[3] ? 4 : 3;
    if (planes[0] && planes[1] && planes[2])
        return ERR_OK;
    const float *grey = exr_image_plane(exr, "Y");
    planes[0] = grey ? grey : exr->channel_count == 1 ? exr->planes[0] : NULL;
    *count = 1;
    return planes[0] ? ERR_OK
                     : image_problem(problems, file, "exr-channels",
                                     "no channels R, G, B or Y in it, for a texture");
}

static enum err read_exr(const void *data, size_t bytes, const char *file, struct scene_image *out,
                         struct diag_list *problems)
{
    struct exr_image exr;
    const float *planes[4];
    uint32_t count;
    TL_TRY(exr_read(data, bytes, file, NULL, 0, &exr, problems));
    enum err e = pick_planes(&exr, file, planes, &count, problems);
    if (e == ERR_OK)
        e = image_alloc(exr.data_width, exr.data_height, count, SCENE_IMAGE_F32, file, out,
                        problems);
    size_t pixel_count = (size_t)exr.data_width * exr.data_height;
    for (uint32_t c = 0; e == ERR_OK && c < count; c++)
        for (size_t i = 0; i < pixel_count; i++)
            ((float *)out->pixels)[i * count + c] = planes[c][i];
    exr_image_release(&exr);
    return e;
}

/* Infinite, NaN and (as colour) negative samples would poison every mean. */
static void clean_floats(struct scene_image *image, const char *file, enum image_use use,
                         struct diag_list *problems)
{
    size_t count = (size_t)image->width * image->height * image->channel_count, cleaned = 0;
    float *v = image->pixels;
    for (size_t i = 0; i < count; i++) {
        if (isfinite(v[i]) && (v[i] >= 0 || use == IMAGE_DATA))
            continue;
        v[i] = 0;
        cleaned++;
    }
    if (cleaned)
        diag_add(problems, DIAG_WARNING, (struct diag_place){.file = file}, "not-finite", NULL,
                 "%zu samples are infinite, NaN or negative and are taken as 0", cleaned);
}

/* --- Any file ------------------------------------------------------------ */

static bool starts_with(const void *data, size_t bytes, const char *magic, size_t magic_bytes)
{
    return bytes >= magic_bytes && memcmp(data, magic, magic_bytes) == 0;
}

enum err image_read(const void *data, size_t bytes, const char *file, enum image_use use,
                    struct scene_image *out, struct diag_list *problems)
{
    struct scene_image image;
    enum err e;
    if (starts_with(data, bytes, "\x76\x2f\x31\x01", 4))
        e = read_exr(data, bytes, file, &image, problems);
    else if (starts_with(data, bytes, "\x89PNG\r\n\x1a\n", 8))
        e = png_read(data, bytes, file, use, &image, problems);
    else if (starts_with(data, bytes, "\xff\xd8\xff", 3))
        e = jpeg_read(data, bytes, file, use, &image, problems);
    else if (starts_with(data, bytes, "#?", 2))
        e = hdr_read(data, bytes, file, &image, problems);
    else
        e = image_problem(problems, file, "unknown-format",
                          "not a picture, expected OpenEXR, PNG, JPEG or Radiance HDR");
    if (e != ERR_OK)
        return e;
    if (image.format == SCENE_IMAGE_F32)
        clean_floats(&image, file, use, problems);
    *out = image;
    return ERR_OK;
}

enum err image_read_file(const char *path, enum image_use use, struct scene_image *out,
                         struct diag_list *problems)
{
    char *data;
    size_t bytes;
    enum err e = file_read(path, FILE_BYTES_MAX, &data, &bytes);
    if (e == ERR_NOMEM)
        return e;
    if (e == ERR_NOT_FOUND)
        return image_problem(problems, path, "missing-file", "no such file");
    if (e == ERR_LIMIT)
        return image_problem(problems, path, "file-too-large", "over 2 GiB");
    if (e != ERR_OK)
        return image_problem(problems, path, "unreadable-file", "cannot be read: %s",
                             file_read_why(path, e));
    e = image_read(data, bytes, path, use, out, problems);
    mem_free(data);
    return e;
}
