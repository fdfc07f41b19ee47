#include "common/package_filter.h"

#include <string.h>

/* --- Numbers ------------------------------------------------------------- */

/* Small differences of either sign to small numbers, and back. */
static uint64_t fold(uint64_t d, unsigned bits)
{
    uint64_t sign = d >> (bits - 1) & 1;
    return (d << 1) ^ (0 - sign);
}

static uint64_t unfold(uint64_t z)
{
    return (z >> 1) ^ (0 - (z & 1));
}

void filter_words_put(const void *rows, size_t count, size_t columns, size_t word_bytes,
                      unsigned char *out)
{
    for (size_t c = 0; c < columns; c++) {
        const unsigned char *at = (const unsigned char *)rows + c * word_bytes;
        uint64_t before = 0;
        for (size_t i = 0; i < count; i++, at += columns * word_bytes) {
            uint64_t word = 0;
            memcpy(&word, at, word_bytes);
            uint64_t folded = fold(word - before, (unsigned)word_bytes * 8);
            before = word;
            for (size_t k = 0; k < word_bytes; k++)
                out[k * count + i] = (unsigned char)(folded >> 8 * k);
        }
        out += count * word_bytes;
    }
}

/* The word at place i of planes of `count` bytes. */
static uint32_t planes_u32(const unsigned char *planes, size_t count, size_t i)
{
    return planes[i] | (uint32_t)planes[count + i] << 8 | (uint32_t)planes[2 * count + i] << 16 |
           (uint32_t)planes[3 * count + i] << 24;
}

static uint64_t planes_u64(const unsigned char *planes, size_t count, size_t i)
{
    return planes_u32(planes, count, i) | (uint64_t)planes_u32(planes + 4 * count, count, i) << 32;
}

void filter_words_get(const unsigned char *in, size_t count, size_t columns, size_t word_bytes,
                      void *rows)
{
    for (size_t c = 0; c < columns; c++) {
        unsigned char *at = (unsigned char *)rows + c * word_bytes;
        uint64_t word = 0;
        for (size_t i = 0; i < count; i++, at += columns * word_bytes) {
            word += word_bytes == 4 ? unfold(planes_u32(in, count, i))
                                    : unfold(planes_u64(in, count, i));
            memcpy(at, &word, word_bytes);
        }
        in += count * word_bytes;
    }
}

void filter_floats_get(const unsigned char *in, size_t count, size_t columns, double *rows)
{
    for (size_t c = 0; c < columns; c++) {
        uint32_t word = 0;
        for (size_t i = 0; i < count; i++) {
            float f;
            word += (uint32_t)unfold(planes_u32(in, count, i));
            memcpy(&f, &word, sizeof f);
            rows[i * columns + c] = (double)f;
        }
        in += count * sizeof(float);
    }
}

/* --- Indices ------------------------------------------------------------- */

/* Vertices are numbered in the order of their first use: then a new one is always 0, and one of the
 * triangles just before is small. */
void filter_indices_put(const uint32_t *indices, size_t count, unsigned char *out)
{
    uint32_t next = 0;
    for (size_t i = 0; i < count; i++) {
        uint32_t code = next - indices[i];
        if (indices[i] >= next)
            next = indices[i] + 1;
        for (size_t k = 0; k < 4; k++)
            out[k * count + i] = (unsigned char)(code >> 8 * k);
    }
}

void filter_indices_get(const unsigned char *in, size_t count, uint32_t *indices)
{
    uint32_t next = 0;
    for (size_t i = 0; i < count; i++) {
        indices[i] = next - planes_u32(in, count, i);
        if (indices[i] >= next)
            next = indices[i] + 1;
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
