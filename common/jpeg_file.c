/* JPEG pictures through libjpeg-turbo: baseline and progressive, grey and YCbCr or RGB. */
#include <turbojpeg.h>

#include "common/image_parts.h"
#include "common/mem.h"

static enum err read_header(tjhandle tj, const void *data, size_t bytes, const char *file,
                            enum image_use use, struct scene_image *out, struct diag_list *problems)
{
    int width, height, sampling, space;
    if (tjDecompressHeader3(tj, data, bytes, &width, &height, &sampling, &space) != 0)
        return image_problem(problems, file, "image-damaged", "JPEG: %s", tjGetErrorStr2(tj));
    if (space == TJCS_CMYK || space == TJCS_YCCK)
        return image_problem(problems, file, "unsupported",
                             "CMYK JPEG is not supported; "
                             "convert it to RGB");
    if (width < 1 || height < 1)
        return image_problem(problems, file, "image-size", "JPEG without a size");
    return image_alloc((uint64_t)width, (uint64_t)height, space == TJCS_GRAY ? 1 : 3,
                       use == IMAGE_COLOR ? SCENE_IMAGE_U8_SRGB : SCENE_IMAGE_U8_LINEAR, file, out,
                       problems);
}

enum err jpeg_read(const void *data, size_t bytes, const char *file, enum image_use use,
                   struct scene_image *out, struct diag_list *problems)
{
    struct scene_image image;
    tjhandle tj = tjInitDecompress();
    if (!tj)
        return ERR_NOMEM;
    enum err e = read_header(tj, data, bytes, file, use, &image, problems);
    if (e != ERR_OK) {
        (void)tjDestroy(tj);
        return e;
    }
    int status = tjDecompress2(tj, data, bytes, image.pixels, (int)image.width, 0,
                               (int)image.height, image.channel_count == 1 ? TJPF_GRAY : TJPF_RGB,
                               TJFLAG_ACCURATEDCT | TJFLAG_LIMITSCANS);
    bool fatal = status != 0 && tjGetErrorCode(tj) == TJERR_FATAL;
    if (fatal)
        e = image_problem(problems, file, "image-damaged", "JPEG: %s", tjGetErrorStr2(tj));
    else if (status != 0)
        diag_add(problems, DIAG_WARNING, (struct diag_place){.file = file}, "image-damaged", NULL,
                 "JPEG: %s; the rest of it is shown as it came out", tjGetErrorStr2(tj));
    (void)tjDestroy(tj);
    if (e == ERR_OK)
        *out = image;
    else
        mem_free(image.pixels);
    return e;
}
