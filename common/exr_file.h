/* common/exr_file.h: OpenEXR pictures, written and read. The one door to OpenEXRCore.
 *
 * Written: one part, float or half channels, scanlines, ZIP, into memory; the caller
 * writes the bytes aside, syncs and renames (file_io.h). The library deletes a file with
 * missing rows and reports success, so rows are counted here and the bytes checked.
 *
 * Read: single or multi part (the first flat part counts), scanline or tiled (level 0),
 * half, float, uint; NONE, RLE, ZIPS, ZIP, PIZ, PXR24. Refused by name: deep data,
 * B44, B44A, DWAA, DWAB, which the library version does not decode rightly.
 * One thread per call; exr_write deflates on more of its own (parallel.h).
 */
#ifndef COMMON_EXR_FILE_H
#define COMMON_EXR_FILE_H

#include "common/buf.h"
#include "common/diag.h"

enum { EXR_CHANNELS_MAX = 256, EXR_NAME_BYTES_MAX = 255 };

/* One channel of a picture to write: `pixels[(y * width + x) * stride]` over the data window. */
struct exr_channel {
    const char *name; /* "R", "N.X", "depth.Z" ... */
    const float *pixels;
    size_t stride; /* in floats: 1 planar, 3 interleaved RGB */
};

enum exr_attribute_type { EXR_TEXT, EXR_FLOAT, EXR_INT };

struct exr_attribute {
    const char *name;
    enum exr_attribute_type type;
    const char *text;
    double number; /* EXR_FLOAT as float, EXR_INT as int32 */
};

struct exr_picture {
    uint32_t width, height;                 /* display window, from (0, 0) */
    uint32_t x, y, data_width, data_height; /* data window: the crop, within the display window */
    const struct exr_channel *channels;     /* any order; names distinct */
    size_t channel_count;
    size_t half_count; /* so many first ones are stored in 16 bits; clamped before (half.h) */
    const struct exr_attribute *attributes; /* names distinct, none a standard one */
    size_t attribute_count;
};

/* Appends the file's bytes to `out`. ERR_NOMEM, ERR_IO (the library failed; logged). */
TL_NODISCARD enum err exr_write(const struct exr_picture *picture, struct buf *out);

/* A picture read back: `planes[c]` has data_width * data_height floats. */
struct exr_image {
    uint32_t width, height; /* display window */
    int32_t x, y;           /* data window's corner, relative to the display window */
    uint32_t data_width, data_height;
    size_t channel_count;
    char (*names)[EXR_NAME_BYTES_MAX + 1];
    float **planes;
};

/* All channels, or only those named in `wanted` (missing ones are a problem) when wanted_count is
 * not 0. ERR_INPUT with a problem naming what is wrong, ERR_NOMEM. */
TL_NODISCARD enum err exr_read(const void *data, size_t bytes, const char *file,
                               const char *const *wanted, size_t wanted_count,
                               struct exr_image *out, struct diag_list *problems);
TL_NODISCARD enum err exr_read_file(const char *path, const char *const *wanted,
                                    size_t wanted_count, struct exr_image *out,
                                    struct diag_list *problems);
void exr_image_release(struct exr_image *image);

/* The plane of a channel, or NULL. */
const float *exr_image_plane(const struct exr_image *image, const char *name);

#endif
