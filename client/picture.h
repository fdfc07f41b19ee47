/* client/picture.h: a picture of any format we read, as linear RGB.
 *
 * One thread per call.
 */
#ifndef CLIENT_PICTURE_H
#define CLIENT_PICTURE_H

#include "common/diag.h"
#include "common/err.h"

struct picture {
    uint32_t width, height;
    float *rgb; /* owned (mem_free); width * height * 3, interleaved */
};

/* Channels R, G and B of an EXR in memory. ERR_INPUT with a problem, ERR_NOMEM. */
TL_NODISCARD enum err picture_from_exr(const char *name, const void *data, size_t bytes,
                                       struct picture *out, struct diag_list *problems);

/* A file: EXR, PNG, JPEG, HDR; display values are decoded. ERR_INPUT with a problem, ERR_NOMEM. */
TL_NODISCARD enum err picture_read(const char *path, struct picture *out,
                                   struct diag_list *problems);

#endif
