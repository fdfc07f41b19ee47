#include "worker/render/microfacet.h"

#include "common/dmath.h"
#include "worker/render/microfacet_parts.h"
#include "worker/render/warp.h"

double microfacet_d(const struct microfacet *mf, vec3 m)
{
    return mf->distribution == SCENE_GGX ? microfacet_part_d(SCENE_GGX, mf->ax, mf->ay, m)
                                         : microfacet_part_d(SCENE_BECKMANN, mf->ax, mf->ay, m);
}

double microfacet_lambda(const struct microfacet *mf, vec3 w)
{
    return mf->distribution == SCENE_GGX
               ? microfacet_part_lambda(SCENE_GGX, mf->ax, mf->ay, w)
               : microfacet_part_lambda(SCENE_BECKMANN, mf->ax, mf->ay, w);
}

/* Dupuy and Benyoub 2023, "Sampling Visible GGX Normals with Spherical Caps", in the space where
 * the roughness is 1. */
static vec3 sample_ggx(vec3 wo, double u, double v)
{
    double z = (1 - v) * (1 + wo.z) - wo.z;
    double r2 = 1 - z * z;
    double r = sqrt(r2 > 0 ? r2 : 0);
    double s, c;
    warp_sincos_turn(u, &s, &c);
    return v3_add(v3(r * c, r * s, z), wo);
}

/* Inverse of erf on (-1, 1) to seven digits: Giles's single-precision polynomials (2010). */
static double erf_inverse_rough(double x)
{
    double limit = 1 - 1e-14;
    x = x < -limit ? -limit : x > limit ? limit : x;
    double w = -dmath_log((1 - x) * (1 + x)), p;
    if (w < 5) {
        w -= 2.5;
        p = 2.81022636e-08;
        p = 3.43273939e-07 + p * w;
        p = -3.5233877e-06 + p * w;
        p = -4.39150654e-06 + p * w;
        p = 0.00021858087 + p * w;
        p = -0.00125372503 + p * w;
        p = -0.00417768164 + p * w;
        p = 0.246640727 + p * w;
        p = 1.50140941 + p * w;
    } else {
        w = sqrt(w) - 3;
        p = -0.000200214257;
        p = 0.000100950558 + p * w;
        p = 0.00134934322 + p * w;
        p = -0.00367342844 + p * w;
        p = 0.00573950773 + p * w;
        p = -0.0076224613 + p * w;
        p = 0.00943887047 + p * w;
        p = 1.00167406 + p * w;
        p = 2.83297682 + p * w;
    }
    return p * x;
}

/* And to fourteen, by a Newton step. */
static double erf_inverse(double x)
{
    double y = erf_inverse_rough(x), bell;
    double error = gauss_below(y, &bell) - 1 - x;
    return y - error * (0.5 * SQRT_PI) / bell;
}

/* Newton doubles the digits: behind a step of this size there is nothing left to do. */
static const double SLOPE_STEP_MIN = 1e-6;

/* The slope along the view, for roughness 1 and a view at tangent 1 / cot, that a share u of the
 * visible ones lies below. Their distribution function is, up to a factor, that integral of
 * (cot - x) exp(-x^2), cot (1 + erf x) + exp(-x^2) / sqrt(pi): inverted by Newton's method kept
 * within a shrinking bracket. */
static double sample_slope(double cot, double u)
{
    double low = -6.5, high = cot < 6.5 ? cot : 6.5, bell;
    /* Beyond 6.5 nothing changes any more. */
    double below = gauss_below(high, &bell);
    double target = u * (cot * below + bell * INV_SQRT_PI);
    double x = erf_inverse_rough(u * below - 1);
    for (int i = 0; i < 24; i++) {
        if (!(x > low && x < high))
            x = 0.5 * (low + high);
        double error = cot * gauss_below(x, &bell) + bell * INV_SQRT_PI - target;
        if (error > 0)
            high = x;
        else
            low = x;
        double step = error / (2 * INV_SQRT_PI * (cot - x) * bell);
        x -= step;
        if (fabs(step) < SLOPE_STEP_MIN)
            return x;
    }
    return 0.5 * (low + high);
}

/* Heitz and d'Eon 2014: slopes visible from wo, in the space where the roughness is 1. */
static vec3 sample_beckmann(vec3 wo, double u, double v)
{
    double sine = sqrt(wo.x * wo.x + wo.y * wo.y);
    if (sine < 1e-9 * wo.z) {
        double r = sqrt(-dmath_log(1 - u)), s, c;
        warp_sincos_turn(v, &s, &c);
        return v3(-r * c, -r * s, 1);
    }
    double across = erf_inverse(2 * v - 1);
    double along = sample_slope(wo.z / sine, u);
    double c = wo.x / sine, s = wo.y / sine;
    return v3(-(along * c - across * s), -(along * s + across * c), 1);
}

vec3 microfacet_sample(const struct microfacet *mf, vec3 wo, double u, double v)
{
    vec3 stretched = v3_unit(v3(wo.x * mf->ax, wo.y * mf->ay, wo.z));
    vec3 m = mf->distribution == SCENE_GGX ? sample_ggx(stretched, u, v)
                                           : sample_beckmann(stretched, u, v);
    return v3_unit(v3(m.x * mf->ax, m.y * mf->ay, m.z > 0 ? m.z : 0));
}
