/* worker/render/conductor_parts.h: the rough conductor in one direction and in eight, the same
 * bits.
 *
 * The loop over eight is compiled for each instruction set (conductor_loop.h). Any thread. Tests:
 * test_bsdf.
 */
#ifndef WORKER_RENDER_CONDUCTOR_PARTS_H
#define WORKER_RENDER_CONDUCTOR_PARTS_H

#include "worker/render/bsdf.h"
#include "worker/render/microfacet_parts.h"

/* What does not hang on wi. */
struct conductor {
    double ax, ay;
    double eta2[3], k2[3]; /* squares of index and absorption */
    vec3 wo;               /* above */
    double reach;          /* the share of wo's facets that it sees, over 4 wo.z */
};

struct conductor_batch {
    double x[BSDF_MANY], y[BSDF_MANY], z[BSDF_MANY]; /* wi */
    double pdf[BSDF_MANY];
    double f[3][BSDF_MANY]; /* times cos(wi), without the colour */
};

typedef void conductor_loop(const struct conductor *c, enum scene_distribution distribution,
                            struct conductor_batch *batch);
conductor_loop conductor_loop_sse2, conductor_loop_avx2, conductor_loop_avx512;

/* Reflectance of a conductor whose relative index and absorption have these squares. */
static inline double conductor_fresnel(double cosi, double eta2, double k2)
{
    double cos2 = cosi * cosi;
    double sin2 = (1 - cosi) * (1 + cosi);
    double t0 = eta2 - k2 - sin2;
    double a2b2 = sqrt(t0 * t0 + 4 * eta2 * k2);
    double a = sqrt(0.5 * (a2b2 + t0 > 0 ? a2b2 + t0 : 0));
    double t1 = a2b2 + cos2, t2 = 2 * cosi * a;
    double rs = (t1 - t2) / (t1 + t2);
    double t3 = cos2 * a2b2 + sin2 * sin2, t4 = t2 * sin2;
    return 0.5 * rs * (1 + (t3 - t4) / (t3 + t4));
}

/* f cos(wi), without the colour, and the pdf; 0 for wi below. */
static inline double conductor_value(const struct conductor *c,
                                     enum scene_distribution distribution, vec3 wi, double f[3])
{
    bool above = wi.z > 0;
    wi.z = above ? wi.z : 1;
    vec3 m = v3_unit(v3_add(c->wo, wi));
    double d = microfacet_part_d(distribution, c->ax, c->ay, m) * c->reach;
    double pdf = above ? d : 0;
    double seen = pdf / (1 + microfacet_part_lambda(distribution, c->ax, c->ay, wi));
    double cosm = v3_dot(c->wo, m);
    cosm = cosm < 1 ? cosm : 1;
    for (int k = 0; k < 3; k++)
        f[k] = conductor_fresnel(cosm, c->eta2[k], c->k2[k]) * seen;
    return pdf;
}

#endif
