#include "common/half.h"

#include <math.h>

/* Steps of a half: 2^-24 below 2^-14, else 2^-10 of the power of two. */
#define EXPONENT_LOW  (-13) /* of frexp: the values of [2^-14, 2^-13) */
#define SIGNIFICANT   11
#define TINY_EXPONENT (EXPONENT_LOW - SIGNIFICANT)

float half_round(float v)
{
    int exponent;
    if (isnan(v) || v == 0)
        return v;
    if (fabsf(v) > HALF_MAX)
        return copysignf(HALF_MAX, v);
    (void)frexpf(v, &exponent);
    int step = exponent - SIGNIFICANT;
    if (step < TINY_EXPONENT)
        step = TINY_EXPONENT;
    /* Scaling by powers of two is exact, and nearbyint rounds ties to even. */
    return (float)ldexp(nearbyint(ldexp((double)v, -step)), step);
}

uint64_t half_clamp(float *values, size_t count)
{
    uint64_t clamped = 0;
    for (size_t i = 0; i < count; i++) {
        if (!(fabsf(values[i]) > HALF_MAX))
            continue;
        values[i] = copysignf(HALF_MAX, values[i]);
        clamped++;
    }
    return clamped;
}
