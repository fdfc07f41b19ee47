#include "common/dmath.h"

#include <sleef.h>

double dmath_sin(double radians)
{
    return Sleef_cinz_sind1_u10purec(radians);
}

double dmath_cos(double radians)
{
    return Sleef_cinz_cosd1_u10purec(radians);
}

double dmath_tan(double radians)
{
    return Sleef_cinz_tand1_u10purec(radians);
}

void dmath_sincos(double radians, double *sine, double *cosine)
{
    Sleef_double_2 both = Sleef_cinz_sincosd1_u10purec(radians);
    *sine = both.x;
    *cosine = both.y;
}

double dmath_sinpi(double x)
{
    return Sleef_cinz_sinpid1_u05purec(x);
}

double dmath_cospi(double x)
{
    return Sleef_cinz_cospid1_u05purec(x);
}

double dmath_asin(double x)
{
    return Sleef_cinz_asind1_u10purec(x);
}

double dmath_acos(double x)
{
    return Sleef_cinz_acosd1_u10purec(x);
}

double dmath_atan(double x)
{
    return Sleef_cinz_atand1_u10purec(x);
}

double dmath_atan2(double y, double x)
{
    return Sleef_cinz_atan2d1_u10purec(y, x);
}

double dmath_exp(double x)
{
    return Sleef_cinz_expd1_u10purec(x);
}

double dmath_exp2(double x)
{
    return Sleef_cinz_exp2d1_u10purec(x);
}

double dmath_expm1(double x)
{
    return Sleef_cinz_expm1d1_u10purec(x);
}

double dmath_log(double x)
{
    return Sleef_cinz_logd1_u10purec(x);
}

double dmath_log2(double x)
{
    return Sleef_cinz_log2d1_u10purec(x);
}

double dmath_log1p(double x)
{
    return Sleef_cinz_log1pd1_u10purec(x);
}

double dmath_pow(double x, double y)
{
    return Sleef_cinz_powd1_u10purec(x, y);
}

double dmath_cbrt(double x)
{
    return Sleef_cinz_cbrtd1_u10purec(x);
}

double dmath_sinh(double x)
{
    return Sleef_cinz_sinhd1_u10purec(x);
}

double dmath_cosh(double x)
{
    return Sleef_cinz_coshd1_u10purec(x);
}

double dmath_tanh(double x)
{
    return Sleef_cinz_tanhd1_u10purec(x);
}

double dmath_erf(double x)
{
    return Sleef_cinz_erfd1_u10purec(x);
}

double dmath_srgb_encode(double linear)
{
    double x = linear < 0 ? -linear : linear;
    double y = x <= 0.0031308 ? 12.92 * x : 1.055 * dmath_pow(x, 1 / 2.4) - 0.055;
    return linear < 0 ? -y : y;
}

double dmath_srgb_decode(double encoded)
{
    double x = encoded < 0 ? -encoded : encoded;
    double y = x <= 0.04045 ? x / 12.92 : dmath_pow((x + 0.055) / 1.055, 2.4);
    return encoded < 0 ? -y : y;
}
