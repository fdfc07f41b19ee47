/* worker/render/microfacet_parts.h: the formulas of microfacet.h inline and without branches, for
 * loops over many directions. The distribution is a constant where they are used. Any thread.
 */
#ifndef WORKER_RENDER_MICROFACET_PARTS_H
#define WORKER_RENDER_MICROFACET_PARTS_H

#include "worker/render/gauss.h"
#include "worker/render/microfacet.h"

#define SQRT_PI     1.7724538509055160
#define INV_SQRT_PI 0.56418958354775629

static inline double microfacet_part_d(enum scene_distribution distribution, double ax, double ay,
                                       vec3 m)
{
    double sx = m.x / ax, sy = m.y / ay;
    double s2 = sx * sx + sy * sy, z2 = m.z * m.z;
    double ggx = s2 + z2, area = VEC_PI * ax * ay, value;
    if (distribution == SCENE_GGX)
        value = 1 / (area * ggx * ggx);
    else
        value = gauss_exp(-s2 / z2) / (area * z2 * z2);
    return z2 > 0 ? value : 0;
}

static inline double microfacet_part_lambda(enum scene_distribution distribution, double ax,
                                            double ay, vec3 w)
{
    double sx = w.x * ax, sy = w.y * ay;
    double tan2 = (sx * sx + sy * sy) / (w.z * w.z);
    if (distribution == SCENE_GGX)
        return (sqrt(1 + tan2) - 1) * 0.5;
    double a = 1 / sqrt(tan2), bounded = a < 6 ? a : 6;
    double value =
        0.5 * gauss_exp(-bounded * bounded) * (INV_SQRT_PI / bounded - gauss_erfcx(bounded));
    /* Beyond this it is below the last place of 1 + lambda. */
    return a > 6 ? 0 : value;
}

#endif
