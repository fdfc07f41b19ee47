#include "common/digest.h"

#include <gnutls/crypto.h>
#include <gnutls/gnutls.h>
#include <string.h>

digest digest_of(const void *data, size_t bytes)
{
    digest d;
    int status = gnutls_hash_fast(GNUTLS_DIG_SHA256, data, bytes, d.bytes);
    TL_ASSERT(status == 0);
    return d;
}

enum err digest_begin(struct digest_ctx *c)
{
    gnutls_hash_hd_t hash;
    if (gnutls_hash_init(&hash, GNUTLS_DIG_SHA256) != 0)
        return ERR_NOMEM;
    c->impl = hash;
    return ERR_OK;
}

void digest_add(struct digest_ctx *c, const void *data, size_t bytes)
{
    int status = gnutls_hash(c->impl, data, bytes);
    TL_ASSERT(status == 0);
}

digest digest_end(struct digest_ctx *c)
{
    digest d;
    gnutls_hash_deinit(c->impl, d.bytes);
    c->impl = NULL;
    return d;
}

bool digest_equal(const digest *a, const digest *b)
{
    return memcmp(a->bytes, b->bytes, DIGEST_BYTES) == 0;
}

void digest_to_hex(const digest *d, char out[DIGEST_HEX_BYTES])
{
    static const char digits[] = "0123456789abcdef";
    for (size_t i = 0; i < DIGEST_BYTES; i++) {
        out[2 * i] = digits[d->bytes[i] >> 4];
        out[2 * i + 1] = digits[d->bytes[i] & 15];
    }
    out[2 * DIGEST_BYTES] = '\0';
}

static int hex_value(char c)
{
    if (c >= '0' && c <= '9')
        return c - '0';
    if (c >= 'a' && c <= 'f')
        return c - 'a' + 10;
    if (c >= 'A' && c <= 'F')
        return c - 'A' + 10;
    return -1;
}

bool digest_from_hex(const char *hex, digest *out)
{
    digest d;
    if (strlen(hex) != 2 * DIGEST_BYTES)
        return false;
    for (size_t i = 0; i < DIGEST_BYTES; i++) {
        int high = hex_value(hex[2 * i]), low = hex_value(hex[2 * i + 1]);
        if (high < 0 || low < 0)
            return false;
        d.bytes[i] = (unsigned char)(high << 4 | low);
    }
    *out = d;
    return true;
}
