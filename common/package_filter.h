/* common/package_filter.h: arrays turned so that a compressor finds what repeats, and back.
 *
 * Internal to package_chunks.c. Lossless and of the same size: a number is told by its
 * difference to the one before it, low bytes apart from high ones; a vertex index by its
 * distance from the highest so far; a picture's byte by what its neighbours left and above
 * foretell (the median edge detector of LOCO-I, Weinberger et al. 2000). Any bytes decode
 * to something; whether it makes sense is judged behind. Pure; any thread.
 */
#ifndef COMMON_PACKAGE_FILTER_H
#define COMMON_PACKAGE_FILTER_H

#include "common/err.h"

/* `count` rows of `columns` words of 4 or 8 bytes to the same number of bytes: column by column,
 * each as planes of bytes, the lowest first. */
void filter_words_put(const void *rows, size_t count, size_t columns, size_t word_bytes,
                      unsigned char *out);
void filter_words_get(const unsigned char *in, size_t count, size_t columns, size_t word_bytes,
                      void *rows);

/* Words of 4 bytes: rows of doubles that are all floats to float rows, and back. */
void filter_floats_put(const double *rows, size_t count, size_t columns, unsigned char *out);
void filter_floats_get(const unsigned char *in, size_t count, size_t columns, double *rows);

void filter_indices_put(const uint32_t *indices, size_t count, unsigned char *out);
void filter_indices_get(const unsigned char *in, size_t count, uint32_t *indices);

/* One channel of an interleaved picture of bytes; `stride` is its channel count. */
void filter_plane_put(const unsigned char *samples, uint32_t width, uint32_t height, size_t stride,
                      unsigned char *out);
void filter_plane_get(const unsigned char *in, uint32_t width, uint32_t height, size_t stride,
                      unsigned char *samples);

#endif
