/* common/buf.h: bytes that grow, and a reader that cannot run past the end.
 *
 * All numbers are little-endian. A writer remembers its first failure (out of
 * memory) and ignores what follows, so that callers check once at the end; a
 * reader does the same with running short and then gives zeros. One thread.
 */
#ifndef COMMON_BUF_H
#define COMMON_BUF_H

#include "common/err.h"

struct buf {
    unsigned char *data;
    size_t bytes, capacity;
    bool failed;
};

void buf_init(struct buf *b);
void buf_release(struct buf *b);
void buf_clear(struct buf *b);

/* Room for `bytes` more at the end, now part of the contents; NULL on failure. */
unsigned char *buf_extend(struct buf *b, size_t bytes);

/* Memory for `bytes` more, so that adding them copies nothing; the contents stay. */
void buf_reserve(struct buf *b, size_t bytes);

void buf_put(struct buf *b, const void *data, size_t bytes);
void buf_put_u8(struct buf *b, uint8_t v);
void buf_put_u32(struct buf *b, uint32_t v);
void buf_put_u64(struct buf *b, uint64_t v);
void buf_put_f32(struct buf *b, float v);
void buf_put_f64(struct buf *b, double v);
void buf_put_text(struct buf *b, const char *text); /* u32 length, bytes, no NUL */
void buf_printf(struct buf *b, const char *format, ...) TL_PRINTF(2, 3);

/* ERR_NOMEM if anything failed since buf_init. */
TL_NODISCARD enum err buf_status(const struct buf *b);

struct buf_reader {
    const unsigned char *at, *end;
    bool failed;
    bool no_memory; /* that was why, not the bytes */
};

struct buf_reader buf_reader_of(const void *data, size_t bytes);
size_t buf_left(const struct buf_reader *r);

/* The next `bytes` in place, or NULL (and failed). */
const unsigned char *buf_get(struct buf_reader *r, size_t bytes);
uint8_t buf_get_u8(struct buf_reader *r);
uint32_t buf_get_u32(struct buf_reader *r);
uint64_t buf_get_u64(struct buf_reader *r);
float buf_get_f32(struct buf_reader *r);
double buf_get_f64(struct buf_reader *r);

/* A text written by buf_put_text, at most `bytes_max` long, without NUL bytes;
 * you own it. NULL: failed (short, too long, NUL inside, out of memory). */
TL_NODISCARD char *buf_get_text(struct buf_reader *r, size_t bytes_max);

/* What is wrong: ERR_NOMEM, or ERR_CORRUPT; ERR_OK. */
TL_NODISCARD enum err buf_reader_status(const struct buf_reader *r);

#endif
