/* common/digest.h: SHA-256, by which chunks, pictures and builds are named.
 *
 * Any thread; a context belongs to one thread. The one door to GnuTLS's hashes.
 */
#ifndef COMMON_DIGEST_H
#define COMMON_DIGEST_H

#include "common/err.h"

enum { DIGEST_BYTES = 32, DIGEST_HEX_BYTES = 65 };

typedef struct digest {
    unsigned char bytes[DIGEST_BYTES];
} digest;

/* Aborts only if the library cannot hash at all. */
digest digest_of(const void *data, size_t bytes);

struct digest_ctx {
    void *impl; /* owned */
};

/* ERR_NOMEM: nothing to release. */
TL_NODISCARD enum err digest_begin(struct digest_ctx *c);
void digest_add(struct digest_ctx *c, const void *data, size_t bytes);

/* Ends and releases the context. */
digest digest_end(struct digest_ctx *c);

bool digest_equal(const digest *a, const digest *b);

/* 64 lower-case hexadecimal digits and a NUL. */
void digest_to_hex(const digest *d, char out[DIGEST_HEX_BYTES]);

/* Exactly 64 hexadecimal digits, either case, then NUL; else false. */
TL_NODISCARD bool digest_from_hex(const char *hex, digest *out);

#endif
