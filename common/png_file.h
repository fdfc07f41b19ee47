/* common/png_file.h: PNG pictures, written and read. The one door to libpng.
 *
 * Written: 8-bit sRGB from linear floats, the same bytes on every machine. Read: every
 * colour type, depth, interlacing and transparency of the standard. One thread per call.
 */
#ifndef COMMON_PNG_FILE_H
#define COMMON_PNG_FILE_H

#include "common/buf.h"
#include "common/image_file.h"

/* `rgb` is width * height * 3 linear floats, interleaved, row 0 on top. Values are scaled by
 * `exposure`, clamped to [0, 1], sRGB-encoded and rounded to nearest; NaN is black. Appends the
 * file to `out`. ERR_NOMEM, ERR_IO. */
TL_NODISCARD enum err png_write_rgb(const float *rgb, uint32_t width, uint32_t height,
                                    double exposure, struct buf *out);

/* 8-bit samples as they are, 1 (grey) or 3 channels. */
TL_NODISCARD enum err png_write_bytes(const unsigned char *samples, uint32_t width, uint32_t height,
                                      uint32_t channel_count, struct buf *out);

TL_NODISCARD enum err png_read(const void *data, size_t bytes, const char *file, enum image_use use,
                               struct scene_image *out, struct diag_list *problems);

#endif
