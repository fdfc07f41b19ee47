/* Blobs: bytes that several connections send at once, freed with the last reference. Counts are
 * atomic: any thread may take or drop one. See transport.h. */
#include <stdatomic.h>

#include "common/mem.h"
#include "proto/transport.h"

struct blob {
    atomic_uint references;
    unsigned char *data;
    size_t bytes;
};

struct blob *blob_new(unsigned char *data, size_t bytes)
{
    struct blob *b = mem_alloc(sizeof *b);
    if (!b)
        return NULL;
    atomic_init(&b->references, 1);
    b->data = data;
    b->bytes = bytes;
    return b;
}

struct blob *blob_ref(struct blob *b)
{
    atomic_fetch_add_explicit(&b->references, 1, memory_order_relaxed);
    return b;
}

void blob_unref(struct blob *b)
{
    if (!b || atomic_fetch_sub_explicit(&b->references, 1, memory_order_acq_rel) != 1)
        return;
    mem_free(b->data);
    mem_free(b);
}

const unsigned char *blob_data(const struct blob *b)
{
    return b->data;
}

size_t blob_bytes(const struct blob *b)
{
    return b->bytes;
}
