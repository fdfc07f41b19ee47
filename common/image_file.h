/* common/image_file.h: pictures of any kind we read, into a scene_image.
 *
 * The kind is told by the first bytes, not by the name: OpenEXR (exr_file.h), PNG
 * (png_file.h), JPEG (jpeg_file.h), Radiance HDR (hdr_file.h). Sizes are checked against
 * SCENE_IMAGE_SIDE_MAX and IMAGE_PIXELS_MAX before anything is allocated. One thread per
 * call. Problems go to a diag_list with the file's name.
 */
#ifndef COMMON_IMAGE_FILE_H
#define COMMON_IMAGE_FILE_H

#include "common/diag.h"
#include "common/scene.h"

#define IMAGE_PIXELS_MAX (UINT64_C(1) << 28) /* 16,384 x 16,384 */

/* What the numbers mean: colours are sRGB-encoded in 8- and 16-bit files, data (normals,
 * roughness) is taken as it is. Float files are linear in any case. */
enum image_use { IMAGE_COLOR, IMAGE_DATA };

/* You own out->pixels (mem_free). ERR_INPUT with a problem, ERR_NOMEM. */
TL_NODISCARD enum err image_read(const void *data, size_t bytes, const char *file,
                                 enum image_use use, struct scene_image *out,
                                 struct diag_list *problems);
TL_NODISCARD enum err image_read_file(const char *path, enum image_use use, struct scene_image *out,
                                      struct diag_list *problems);

#endif
