/* common/half.h: 16-bit floats, for pictures of half the bytes.
 *
 * A half has 11 significant bits: a step is 2^-10 of the value's power of two, 2^-24 below
 * 2^-14, and the largest is 65504. Pure; any thread. Test: test_half (every half, and the values
 * between two of them).
 */
#ifndef COMMON_HALF_H
#define COMMON_HALF_H

#include "common/err.h"

#define HALF_MAX 65504.0f

/* The value that a half keeps of v: rounded to nearest, ties to even; what is over HALF_MAX (or
 * infinite) becomes HALF_MAX of its sign; NaN stays. */
float half_round(float v);

/* Brings values over HALF_MAX in size back to it, in place; NaN stays. How many there were. */
uint64_t half_clamp(float *values, size_t count);

#endif
