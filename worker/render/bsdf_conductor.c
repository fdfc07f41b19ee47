/* Rough conductor: Fresnel of a complex index over the facets of microfacet.h, reflection only.
 * Owns nothing beyond the call; directions are local, the normal is +z. */
#include "worker/render/bsdf_lobes.h"

#include "worker/render/microfacet.h"

/* Reflectance of a conductor with relative index eta and absorption k, one channel. */
static double fresnel_conductor(double cosi, double eta, double k)
{
    double cos2 = cosi * cosi;
    double sin2 = (1 - cosi) * (1 + cosi);
    double eta2 = eta * eta, k2 = k * k;
    double t0 = eta2 - k2 - sin2;
    double a2b2 = sqrt(t0 * t0 + 4 * eta2 * k2);
    double a = sqrt(0.5 * (a2b2 + t0 > 0 ? a2b2 + t0 : 0));
    double t1 = a2b2 + cos2, t2 = 2 * cosi * a;
    double rs = (t1 - t2) / (t1 + t2);
    double t3 = cos2 * a2b2 + sin2 * sin2, t4 = t2 * sin2;
    return 0.5 * rs * (1 + (t3 - t4) / (t3 + t4));
}

static rgb fresnel(const struct bsdf *b, double cosi)
{
    const struct material *m = b->material;
    rgb f = {fresnel_conductor(cosi, m->conductor_eta.r, m->conductor_k.r),
             fresnel_conductor(cosi, m->conductor_eta.g, m->conductor_k.g),
             fresnel_conductor(cosi, m->conductor_eta.b, m->conductor_k.b)};
    return rgb_mul(f, b->color);
}

static struct microfacet facets(const struct bsdf *b)
{
    const struct material *m = b->material;
    return (struct microfacet){m->distribution, m->alpha_x, m->alpha_y};
}

rgb conductor_eval(const struct bsdf *b, vec3 wo, vec3 wi, double *pdf)
{
    *pdf = 0;
    if (wo.z <= 0 || wi.z <= 0)
        return rgb_grey(0);
    vec3 m = v3_unit(v3_add(wo, wi));
    struct microfacet mf = facets(b);
    double g1 = 1 / (1 + microfacet_lambda(&mf, wo));
    *pdf = microfacet_d(&mf, m) * g1 / (4 * wo.z);
    double cosm = v3_dot(wo, m);
    double shadow = 1 / (1 + microfacet_lambda(&mf, wi));
    return rgb_scale(fresnel(b, cosm < 1 ? cosm : 1), *pdf * shadow);
}

bool conductor_sample(const struct bsdf *b, vec3 wo, const double u[3], struct bsdf_sample *s)
{
    if (wo.z <= 0)
        return false;
    struct microfacet mf = facets(b);
    vec3 m = microfacet_sample(&mf, wo, u[0], u[1]);
    s->wi = v3_sub(v3_scale(m, 2 * v3_dot(wo, m)), wo);
    s->eta2 = 1;
    s->flags = 0;
    rgb f = conductor_eval(b, wo, s->wi, &s->pdf);
    if (!(s->pdf > 0))
        return false;
    s->weight = rgb_scale(f, 1 / s->pdf);
    return true;
}
