/* worker/render/gauss.h: exp(x) for x <= 0 and the error function, for Beckmann's facets.
 *
 * Inline, without branches and by + - * / alone, so that a loop over many of them becomes vectors
 * and the bits are the same everywhere; several times cheaper than the general functions of
 * dmath.h, to a few units in the last place. Any thread. Tests: test_bsdf (gauss_is_exact).
 */
#ifndef WORKER_RENDER_GAUSS_H
#define WORKER_RENDER_GAUSS_H

#include <math.h>
#include <stdint.h>
#include <string.h>

/* e^x for x <= 0; 0 below -708, where doubles end. */
static inline double gauss_exp(double x)
{
    static const double LOG2_E = 1.4426950408889634, SHIFT = 0x1.8p52;
    /* ln 2 in two parts; the first has so few bits that its multiples are exact. */
    static const double LN2_HIGH = 0x1.62e42fee00000p-1, LN2_LOW = 0x1.a39ef35793c76p-33;
    double bounded = x > -708 ? x : -708;
    /* The nearest whole number of powers of two stands in the last bits of the sum. */
    double shifted = bounded * LOG2_E + SHIFT, whole = shifted - SHIFT;
    double r = (bounded - whole * LN2_HIGH) - whole * LN2_LOW, r2 = r * r;
    double even = 1.0 / 479001600.0, odd = 1.0 / 6227020800.0;
    even = even * r2 + 1.0 / 3628800.0;
    odd = odd * r2 + 1.0 / 39916800.0;
    even = even * r2 + 1.0 / 40320.0;
    odd = odd * r2 + 1.0 / 362880.0;
    even = even * r2 + 1.0 / 720.0;
    odd = odd * r2 + 1.0 / 5040.0;
    even = even * r2 + 1.0 / 24.0;
    odd = odd * r2 + 1.0 / 120.0;
    even = even * r2 + 0.5;
    odd = odd * r2 + 1.0 / 6.0;
    odd = odd * r2 + 1.0;
    double value = 1.0 + (r * odd + r2 * even);
    uint64_t bits;
    memcpy(&bits, &shifted, sizeof bits);
    bits = (bits + 1023) << 52;
    double power;
    memcpy(&power, &bits, sizeof power);
    return x > -708 ? value * power : 0;
}

/* e^(x^2) (1 - erf x) for x in [0, 6.6]: the rational function of degrees 7 and 8 of least relative
 * error there, 2e-15 (fitted in 40 digits). */
static inline double gauss_erfcx(double x)
{
    double p = 0.00057451380026717270, q = 0.0010182992890229729;
    p = p * x + 0.0087133540530811556;
    q = q * x + 0.015444013005927255;
    p = p * x + 0.062699236427110843;
    q = q * x + 0.11164077878395529;
    p = p * x + 0.27448733890007801;
    q = q * x + 0.49423612094576560;
    p = p * x + 0.78720194719111594;
    q = q * x + 1.4503588518747625;
    p = p * x + 1.4850656856733943;
    q = q * x + 2.8675475056504460;
    p = p * x + 1.7290211663960048;
    q = q * x + 3.7092966940534992;
    p = p * x + 0.99999999999999820;
    q = q * x + 2.8574003334910831;
    q = q * x + 1.0;
    return p / q;
}

/* 1 + erf x for |x| <= 6.6; *bell: e^(-x^2). */
static inline double gauss_below(double x, double *bell)
{
    *bell = gauss_exp(-x * x);
    double tail = *bell * gauss_erfcx(fabs(x));
    return x < 0 ? tail : 2 - tail;
}

#endif
