/* common/determinism.h: the number raised by hand when a picture's bits change on purpose.
 *
 * The determinism id of a worker is the SHA-256 of this number (u32, little-endian) and
 * the 32 bytes of render_self_test(): what the self-test does not reach is covered by
 * raising the number in the commit that changes samplers, estimators, filters, the
 * scene build or the film.
 */
#ifndef COMMON_DETERMINISM_H
#define COMMON_DETERMINISM_H

#include "common/digest.h"

enum { DETERMINISM_NUMBER = 30 };

/* The id of a renderer whose self-test gave these bytes. */
digest determinism_id(const unsigned char self_test[32]);

#endif
