/* worker/render/warp.h: from the unit square to disks, spheres and triangles.
 *
 * Area-preserving maps of u in [0,1)^2 with bounded distortion, so that the strata
 * of a low-discrepancy set survive. Trigonometry is by our own polynomials on an
 * eighth of the circle: the same bits everywhere, and several times cheaper than a
 * general sine. Any thread. Tests: test_surface, test_light.
 */
#ifndef WORKER_RENDER_WARP_H
#define WORKER_RENDER_WARP_H

#include "worker/render/vec.h"

/* sin and cos of x * pi / 4 for |x| <= 1, to about 1 ulp (Taylor series in Horner form). */
static inline void warp_sincos_eighth(double x, double *sine, double *cosine)
{
    double a = x * (VEC_PI / 4);
    double z = a * a;
    double s = 2.8114572543455206e-15;
    s = s * z - 7.6471637318198164e-13;
    s = s * z + 1.6059043836821613e-10;
    s = s * z - 2.5052108385441720e-08;
    s = s * z + 2.7557319223985893e-06;
    s = s * z - 1.9841269841269841e-04;
    s = s * z + 8.3333333333333332e-03;
    s = s * z - 1.6666666666666666e-01;
    double c = 4.7794773323873853e-14;
    c = c * z - 1.1470745597729725e-11;
    c = c * z + 2.0876756987868099e-09;
    c = c * z - 2.7557319223985888e-07;
    c = c * z + 2.4801587301587302e-05;
    c = c * z - 1.3888888888888889e-03;
    c = c * z + 4.1666666666666664e-02;
    c = c * z - 0.5;
    *sine = a + a * z * s;
    *cosine = 1.0 + z * c;
}

/* a if `first`, else b, by the bits: which of them it is cannot be predicted, and a wrong guess
 * costs more than the rest of a map. */
static inline double warp_pick(bool first, double a, double b)
{
    uint64_t bits_a, bits_b;
    memcpy(&bits_a, &a, sizeof a);
    memcpy(&bits_b, &b, sizeof b);
    bits_b ^= (bits_a ^ bits_b) & (0 - (uint64_t)first);
    memcpy(&b, &bits_b, sizeof b);
    return b;
}

/* sin and cos of 2 * pi * u for u in [0,1). */
static inline void warp_sincos_turn(double u, double *sine, double *cosine)
{
    /* The nearest quarter turn, then at most an eighth of a turn either way. */
    double quarters = u * 4;
    int quarter = (int)(quarters + 0.5);
    double s, c;
    warp_sincos_eighth((quarters - quarter) * 2, &s, &c);
    double even_s = warp_pick(quarter & 1, c, s);
    double even_c = warp_pick(quarter & 1, -s, c);
    *sine = warp_pick(quarter & 2, -even_s, even_s);
    *cosine = warp_pick(quarter & 2, -even_c, even_c);
}

/* The u in [0,1] for which sine and cosine of 2 pi u are in the proportion of y and x, to about
 * 2e-16: 0 for two zeros. By the arcus tangent between 0 and an eighth of a turn, a polynomial of
 * the least largest relative error over tan(0) to tan(pi / 8). */
static inline double warp_turn_of(double y, double x)
{
    double ay = fabs(y), ax = fabs(x);
    double low = ay < ax ? ay : ax, high = ay < ax ? ax : ay;
    /* Above half of the eighth from its end: tan(a - pi/4) = (tan a - 1) / (tan a + 1). */
    bool upper = low > high * 0.41421356237309503;
    double over = upper ? low - high : low, under = upper ? low + high : high;
    double z = over / (under > 0 ? under : 1);
    double t = z * z;
    double p = -0.00402924286585152567;
    p = p * t + 0.00799715729090227499;
    p = p * t - 0.0103545934889691539;
    p = p * t + 0.0122128109438615359;
    p = p * t - 0.0144664362296875191;
    p = p * t + 0.0176837834801005637;
    p = p * t - 0.0227364178569761201;
    p = p * t + 0.0318309885839899207;
    p = p * t - 0.053051647697120352;
    p = p * t + 0.159154943091895183;
    double turn = z * p + (upper ? 0.125 : 0);
    turn = ay > ax ? 0.25 - turn : turn;
    turn = x < 0 ? 0.5 - turn : turn;
    double back = turn > 0 ? 1 - turn : turn;
    return y < 0 ? back : turn;
}

/* Shirley and Chiu 1997: concentric squares to concentric circles. */
static inline void warp_disk(double u, double v, double *x, double *y)
{
    double a = 2 * u - 1, b = 2 * v - 1;
    bool wide = fabs(a) > fabs(b);
    double radius = warp_pick(wide, a, b);
    double ratio = radius == 0 ? 0 : warp_pick(wide, b, a) / radius;
    double s, c;
    warp_sincos_eighth(ratio, &s, &c);
    *x = radius * warp_pick(wide, c, s);
    *y = radius * warp_pick(wide, s, c);
}

/* Density cos / pi about +z. */
static inline vec3 warp_cosine_hemisphere(double u, double v)
{
    vec3 d;
    warp_disk(u, v, &d.x, &d.y);
    double z2 = 1.0 - d.x * d.x - d.y * d.y;
    d.z = sqrt(z2 > 0 ? z2 : 0);
    return d;
}

/* Density 1 / (4 pi). */
static inline vec3 warp_sphere(double u, double v)
{
    double z = 1 - 2 * u;
    double r2 = 1 - z * z;
    double r = sqrt(r2 > 0 ? r2 : 0);
    double s, c;
    warp_sincos_turn(v, &s, &c);
    return v3(r * c, r * s, z);
}

/* Weights of the vertices 1 and 2 of a uniform point of a triangle. Heitz 2019, "A Low-Distortion
 * Map Between Triangle and Square". */
static inline void warp_triangle(double u, double v, double *b1, double *b2)
{
    if (v > u) {
        double half = u * 0.5;
        *b1 = half;
        *b2 = v - half;
    } else {
        double half = v * 0.5;
        *b1 = u - half;
        *b2 = half;
    }
}

#endif
