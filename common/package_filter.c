#include "common/package_filter.h"

#include <string.h>

/* --- Numbers ------------------------------------------------------------- */

/* Small differences of either sign to small numbers, and back. */
static uint64_t fold(uint64_t d)
{
    return (d << 1) ^ (0 - (d >> 63));
}

static uint64_t unfold(uint64_t z)
{
    return (z >> 1) ^ (0 - (z & 1));
}

/* Words go between rows and planes by way of a block of them, so that what is done to all alike is
 * a loop over neighbours. */
enum { BLOCK = 256 };

/* Words `first`, ... of `some` to their planes of `count` bytes each. */
static void split_u32(const uint32_t *words, size_t first, size_t some, size_t count,
                      unsigned char *planes)
{
    for (size_t k = 0; k < sizeof *words; k++) {
        unsigned char *to = planes + k * count + first;
        for (size_t i = 0; i < some; i++)
            to[i] = (unsigned char)(words[i] >> 8 * k);
    }
}

static void join_u32(const unsigned char *planes, size_t first, size_t some, size_t count,
                     uint32_t *words)
{
    const unsigned char *a = planes + first, *b = a + count, *c = b + count, *d = c + count;
    for (size_t i = 0; i < some; i++)
        words[i] = a[i] | (uint32_t)b[i] << 8 | (uint32_t)c[i] << 16 | (uint32_t)d[i] << 24;
}

static size_t block_from(size_t first, size_t count)
{
    return count - first < BLOCK ? count - first : BLOCK;
}

static uint32_t fold32(uint32_t d)
{
    return (d << 1) ^ (0 - (d >> 31));
}

static uint32_t unfold32(uint32_t z)
{
    return (z >> 1) ^ (0 - (z & 1));
}

static void put_column_u32(const unsigned char *at, size_t count, size_t row_bytes,
                           unsigned char *out)
{
    uint32_t block[BLOCK], before = 0;
    for (size_t first = 0; first < count; first += BLOCK) {
        size_t some = block_from(first, count);
        for (size_t i = 0; i < some; i++, at += row_bytes) {
            uint32_t word;
            memcpy(&word, at, sizeof word);
            block[i] = fold32(word - before);
            before = word;
        }
        split_u32(block, first, some, count, out);
    }
}

static void put_column_u64(const unsigned char *at, size_t count, size_t row_bytes,
                           unsigned char *out)
{
    uint32_t low[BLOCK], high[BLOCK];
    uint64_t before = 0;
    for (size_t first = 0; first < count; first += BLOCK) {
        size_t some = block_from(first, count);
        for (size_t i = 0; i < some; i++, at += row_bytes) {
            uint64_t word;
            memcpy(&word, at, sizeof word);
            uint64_t folded = fold(word - before);
            before = word;
            low[i] = (uint32_t)folded;
            high[i] = (uint32_t)(folded >> 32);
        }
        split_u32(low, first, some, count, out);
        split_u32(high, first, some, count, out + 4 * count);
    }
}

void filter_words_put(const void *rows, size_t count, size_t columns, size_t word_bytes,
                      unsigned char *out)
{
    TL_ASSERT(word_bytes == 4 || word_bytes == 8);
    for (size_t c = 0; c < columns; c++, out += count * word_bytes) {
        const unsigned char *at = (const unsigned char *)rows + c * word_bytes;
        if (word_bytes == 4)
            put_column_u32(at, count, columns * word_bytes, out);
        else
            put_column_u64(at, count, columns * word_bytes, out);
    }
}

static void get_column_u32(const unsigned char *in, size_t count, size_t row_bytes,
                           unsigned char *at)
{
    uint32_t block[BLOCK], word = 0;
    for (size_t first = 0; first < count; first += BLOCK) {
        size_t some = block_from(first, count);
        join_u32(in, first, some, count, block);
        for (size_t i = 0; i < some; i++, at += row_bytes) {
            word += unfold32(block[i]);
            memcpy(at, &word, sizeof word);
        }
    }
}

static void get_column_u64(const unsigned char *in, size_t count, size_t row_bytes,
                           unsigned char *at)
{
    uint32_t low[BLOCK], high[BLOCK];
    uint64_t word = 0;
    for (size_t first = 0; first < count; first += BLOCK) {
        size_t some = block_from(first, count);
        join_u32(in, first, some, count, low);
        join_u32(in + 4 * count, first, some, count, high);
        for (size_t i = 0; i < some; i++, at += row_bytes) {
            word += unfold(low[i] | (uint64_t)high[i] << 32);
            memcpy(at, &word, sizeof word);
        }
    }
}

void filter_words_get(const unsigned char *in, size_t count, size_t columns, size_t word_bytes,
                      void *rows)
{
    TL_ASSERT(word_bytes == 4 || word_bytes == 8);
    for (size_t c = 0; c < columns; c++, in += count * word_bytes) {
        unsigned char *at = (unsigned char *)rows + c * word_bytes;
        if (word_bytes == 4)
            get_column_u32(in, count, columns * word_bytes, at);
        else
            get_column_u64(in, count, columns * word_bytes, at);
    }
}

void filter_floats_put(const double *rows, size_t count, size_t columns, unsigned char *out)
{
    for (size_t c = 0; c < columns; c++, out += count * sizeof(float)) {
        uint32_t block[BLOCK], before = 0;
        const double *at = rows + c;
        for (size_t first = 0; first < count; first += BLOCK) {
            size_t some = block_from(first, count);
            for (size_t i = 0; i < some; i++, at += columns) {
                float f = (float)*at;
                uint32_t word;
                memcpy(&word, &f, sizeof word);
                block[i] = fold32(word - before);
                before = word;
            }
            split_u32(block, first, some, count, out);
        }
    }
}

void filter_floats_get(const unsigned char *in, size_t count, size_t columns, double *rows)
{
    for (size_t c = 0; c < columns; c++, in += count * sizeof(float)) {
        uint32_t block[BLOCK], word = 0;
        double *at = rows + c;
        for (size_t first = 0; first < count; first += BLOCK) {
            size_t some = block_from(first, count);
            join_u32(in, first, some, count, block);
            for (size_t i = 0; i < some; i++, at += columns) {
                float f;
                word += unfold32(block[i]);
                memcpy(&f, &word, sizeof f);
                *at = (double)f;
            }
        }
    }
}

/* --- Indices ------------------------------------------------------------- */

/* Vertices are numbered in the order of their first use: then a new one is always 0, and one of the
 * triangles just before is small. */
void filter_indices_put(const uint32_t *indices, size_t count, unsigned char *out)
{
    uint32_t block[BLOCK], next = 0;
    for (size_t first = 0; first < count; first += BLOCK) {
        size_t some = block_from(first, count);
        for (size_t i = 0; i < some; i++) {
            uint32_t index = indices[first + i];
            block[i] = next - index;
            next = index >= next ? index + 1 : next;
        }
        split_u32(block, first, some, count, out);
    }
}

void filter_indices_get(const unsigned char *in, size_t count, uint32_t *indices)
{
    uint32_t next = 0;
    for (size_t first = 0; first < count; first += BLOCK) {
        size_t some = block_from(first, count);
        join_u32(in, first, some, count, indices + first);
        for (size_t i = 0; i < some; i++) {
            uint32_t index = next - indices[first + i];
            indices[first + i] = index;
            next = index >= next ? index + 1 : next;
        }
    }
}

/* --- Pictures ------------------------------------------------------------ */

/* Left a, above b, above left c: at an edge the one beside it, else the plane through them. */
static int foretell(int a, int b, int c)
{
    int low = a < b ? a : b, high = a < b ? b : a;
    return c >= high ? low : c <= low ? high : a + b - c;
}

void filter_plane_put(const unsigned char *samples, uint32_t width, uint32_t height, size_t stride,
                      unsigned char *out)
{
    for (uint32_t y = 0; y < height; y++) {
        const unsigned char *row = samples + (size_t)y * width * stride;
        const unsigned char *above = row - (y ? (size_t)width * stride : 0);
        for (uint32_t x = 0; x < width; x++) {
            int a = x ? row[(x - 1) * stride] : 0, b = y ? above[x * stride] : 0;
            int c = x && y ? above[(x - 1) * stride] : 0;
            *out++ = (unsigned char)(row[x * stride] - foretell(a, b, c));
        }
    }
}

void filter_plane_get(const unsigned char *in, uint32_t width, uint32_t height, size_t stride,
                      unsigned char *samples)
{
    for (uint32_t y = 0; y < height; y++) {
        unsigned char *row = samples + (size_t)y * width * stride;
        const unsigned char *above = row - (y ? (size_t)width * stride : 0);
        int a = 0, c = 0;
        for (uint32_t x = 0; x < width; x++) {
            int b = y ? above[x * stride] : 0;
            a = (unsigned char)(*in++ + foretell(a, b, c));
            row[x * stride] = (unsigned char)a;
            c = b;
        }
    }
}
