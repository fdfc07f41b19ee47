/* common/dmath.h: transcendental functions with the same bits on every x86-64 CPU.
 *
 * glibc picks other code when the CPU has FMA, so its results differ between machines
 * of one farm. These are SLEEF's pure C scalar functions without FMA (`cinz_*_purec`,
 * at most 1.0 ulp, or 0.5 where named so). Everything that decides bits uses them; a
 * lint test refuses libm's in worker/render. sqrt is correctly rounded everywhere and
 * comes from the compiler. Pure; any thread. The one door to SLEEF.
 *
 * Domains are libm's: NaN outside. Tests: test_dmath (accuracy against libm in long
 * double, a digest of bits).
 */
#ifndef COMMON_DMATH_H
#define COMMON_DMATH_H

double dmath_sin(double radians);
double dmath_cos(double radians);
double dmath_tan(double radians);
void dmath_sincos(double radians, double *sine, double *cosine);

/* sin and cos of pi * x, exact at multiples of 1/2. */
double dmath_sinpi(double x);
double dmath_cospi(double x);

double dmath_asin(double x);
double dmath_acos(double x);
double dmath_atan(double x);
double dmath_atan2(double y, double x);

double dmath_exp(double x);
double dmath_exp2(double x);
double dmath_expm1(double x);
double dmath_log(double x);
double dmath_log2(double x);
double dmath_log1p(double x);
double dmath_pow(double x, double y);
double dmath_cbrt(double x);

double dmath_sinh(double x);
double dmath_cosh(double x);
double dmath_tanh(double x);
double dmath_erf(double x);

/* The sRGB transfer curve (IEC 61966-2-1), both ways, extended by odd symmetry. */
double dmath_srgb_encode(double linear);
double dmath_srgb_decode(double encoded);

#define DMATH_PI 3.14159265358979323846

#endif
