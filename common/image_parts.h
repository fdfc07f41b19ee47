/* common/image_parts.h: what the image readers share. Internal to them. */
#ifndef COMMON_IMAGE_PARTS_H
#define COMMON_IMAGE_PARTS_H

#include "common/image_file.h"

/* One problem; returns ERR_INPUT. */
enum err image_problem(struct diag_list *problems, const char *file, const char *id,
                       const char *format, ...) TL_PRINTF(4, 5);

/* Checks the size and takes zeroed memory for it (untouched pages cost nothing). A size over the
 * limits is a problem. ERR_INPUT, ERR_NOMEM. */
TL_NODISCARD enum err image_alloc(uint64_t width, uint64_t height, uint32_t channel_count,
                                  enum scene_image_format format, const char *file,
                                  struct scene_image *out, struct diag_list *problems);

/* jpeg_file.c and hdr_file.c: as png_read. */
TL_NODISCARD enum err jpeg_read(const void *data, size_t bytes, const char *file,
                                enum image_use use, struct scene_image *out,
                                struct diag_list *problems);
TL_NODISCARD enum err hdr_read(const void *data, size_t bytes, const char *file,
                               struct scene_image *out, struct diag_list *problems);

#endif
