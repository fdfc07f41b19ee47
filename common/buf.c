#include "common/buf.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "common/mem.h"

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "numbers are copied as they lie");

void buf_init(struct buf *b)
{
    *b = (struct buf){0};
}

void buf_release(struct buf *b)
{
    mem_free(b->data);
    buf_init(b);
}

void buf_clear(struct buf *b)
{
    b->bytes = 0;
    b->failed = false;
}

static void set_capacity(struct buf *b, size_t capacity)
{
    unsigned char *data = mem_realloc_array(b->data, capacity, 1);
    b->failed |= data == NULL;
    if (!data)
        return;
    b->data = data;
    b->capacity = capacity;
}

void buf_reserve(struct buf *b, size_t bytes)
{
    if (b->failed || bytes <= b->capacity - b->bytes)
        return;
    if (bytes > SIZE_MAX - b->bytes)
        b->failed = true;
    else
        set_capacity(b, b->bytes + bytes);
}

unsigned char *buf_extend(struct buf *b, size_t bytes)
{
    if (b->failed)
        return NULL;
    if (bytes > b->capacity - b->bytes) {
        size_t capacity = b->capacity ? b->capacity : 256;
        while (capacity - b->bytes < bytes) {
            if (capacity > SIZE_MAX / 2) {
                b->failed = true;
                return NULL;
            }
            capacity *= 2;
        }
        set_capacity(b, capacity);
    }
    if (b->failed || !b->data)
        return NULL; /* nothing was asked of an empty one */
    unsigned char *at = b->data + b->bytes;
    b->bytes += bytes;
    return at;
}

void buf_put(struct buf *b, const void *data, size_t bytes)
{
    unsigned char *at = buf_extend(b, bytes);
    if (at && bytes)
        memcpy(at, data, bytes);
}

void buf_put_u8(struct buf *b, uint8_t v)
{
    buf_put(b, &v, sizeof v);
}

void buf_put_u32(struct buf *b, uint32_t v)
{
    buf_put(b, &v, sizeof v);
}

void buf_put_u64(struct buf *b, uint64_t v)
{
    buf_put(b, &v, sizeof v);
}

void buf_put_f32(struct buf *b, float v)
{
    buf_put(b, &v, sizeof v);
}

void buf_put_f64(struct buf *b, double v)
{
    buf_put(b, &v, sizeof v);
}

void buf_put_text(struct buf *b, const char *text)
{
    size_t bytes = strlen(text);
    TL_ASSERT(bytes <= UINT32_MAX);
    buf_put_u32(b, (uint32_t)bytes);
    buf_put(b, text, bytes);
}

void buf_printf(struct buf *b, const char *format, ...)
{
    va_list args;
    va_start(args, format);
    int bytes = vsnprintf(NULL, 0, format, args);
    va_end(args);
    unsigned char *at = bytes < 0 ? NULL : buf_extend(b, (size_t)bytes + 1);
    if (!at) {
        b->failed = true;
        return;
    }
    va_start(args, format);
    (void)vsnprintf((char *)at, (size_t)bytes + 1, format, args);
    va_end(args);
    b->bytes--; /* the NUL is not part of the contents */
}

enum err buf_status(const struct buf *b)
{
    return b->failed ? ERR_NOMEM : ERR_OK;
}

struct buf_reader buf_reader_of(const void *data, size_t bytes)
{
    return (struct buf_reader){.at = data, .end = (const unsigned char *)data + bytes};
}

size_t buf_left(const struct buf_reader *r)
{
    return (size_t)(r->end - r->at);
}

const unsigned char *buf_get(struct buf_reader *r, size_t bytes)
{
    if (r->failed || buf_left(r) < bytes) {
        r->failed = true;
        return NULL;
    }
    const unsigned char *at = r->at;
    r->at += bytes;
    return at;
}

static void get(struct buf_reader *r, void *out, size_t bytes)
{
    const unsigned char *at = buf_get(r, bytes);
    if (at)
        memcpy(out, at, bytes);
    else
        memset(out, 0, bytes);
}

uint8_t buf_get_u8(struct buf_reader *r)
{
    uint8_t v;
    get(r, &v, sizeof v);
    return v;
}

uint32_t buf_get_u32(struct buf_reader *r)
{
    uint32_t v;
    get(r, &v, sizeof v);
    return v;
}

uint64_t buf_get_u64(struct buf_reader *r)
{
    uint64_t v;
    get(r, &v, sizeof v);
    return v;
}

float buf_get_f32(struct buf_reader *r)
{
    float v;
    get(r, &v, sizeof v);
    return v;
}

double buf_get_f64(struct buf_reader *r)
{
    double v;
    get(r, &v, sizeof v);
    return v;
}

char *buf_get_text(struct buf_reader *r, size_t bytes_max)
{
    uint32_t bytes = buf_get_u32(r);
    const unsigned char *at = bytes <= bytes_max ? buf_get(r, bytes) : NULL;
    bool good = at && !memchr(at, 0, bytes);
    char *text = good ? mem_strndup((const char *)at, bytes) : NULL;
    r->no_memory |= good && !text;
    r->failed |= !text;
    return text;
}

enum err buf_reader_status(const struct buf_reader *r)
{
    if (r->no_memory)
        return ERR_NOMEM;
    return r->failed ? ERR_CORRUPT : ERR_OK;
}
