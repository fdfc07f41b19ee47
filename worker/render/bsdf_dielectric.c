/* Rough dielectric: reflection and refraction at the facets of microfacet.h, with the compression
 * of radiance. Owns nothing beyond the call; directions are local, the normal is +z. */
#include "worker/render/bsdf_lobes.h"

#include "worker/render/microfacet.h"

/* Rough dielectric, Walter et al. 2007. Both directions are turned so that wo is above; `eta` is
 * the index of the far side over that of wo's. */
struct interface {
    struct microfacet facets;
    double eta;
    rgb R, T;
};

static struct interface interface_of(const struct bsdf *b, bool below)
{
    const struct material *m = b->material;
    return (struct interface){.facets = {m->distribution, m->alpha_x, m->alpha_y},
                              .eta = below ? 1 / m->eta : m->eta,
                              .R = m->R,
                              .T = rgb_mul(m->T, b->color)};
}

/* Reflectance at a facet under the cosine cosm, and the probability with which it is chosen. */
static double facet_fresnel(const struct interface *f, double cosm, double *reflect, double *cost)
{
    double fresnel = bsdf_fresnel(cosm, (1 - cosm) * (1 + cosm), f->eta, cost);
    double r = fresnel * rgb_max(f->R), t = (1 - fresnel) * rgb_max(f->T);
    *reflect = r + t > 0 ? r / (r + t) : 1;
    return fresnel;
}

static rgb eval_above(const struct interface *f, vec3 wo, vec3 wi, double *pdf)
{
    *pdf = 0;
    bool reflected = wi.z > 0;
    vec3 m = v3_add(wo, reflected ? wi : v3_scale(wi, f->eta));
    m = v3_unit(m.z < 0 ? v3_neg(m) : m);
    double o = v3_dot(wo, m), i = v3_dot(wi, m);
    if (!(o > 0) || (i > 0) != reflected || wi.z == 0)
        return rgb_grey(0);
    o = o < 1 ? o : 1;
    double reflect, cost;
    double fresnel = facet_fresnel(f, o, &reflect, &cost);
    double d = microfacet_d(&f->facets, m) / (1 + microfacet_lambda(&f->facets, wo)) / wo.z;
    double shadow = 1 / (1 + microfacet_lambda(&f->facets, wi));
    if (reflected) {
        *pdf = reflect * d * 0.25;
        return rgb_scale(f->R, fresnel * d * shadow * 0.25);
    }
    double denominator = o + f->eta * i;
    double jacobian = d * o * -i / (denominator * denominator);
    *pdf = (1 - reflect) * jacobian * f->eta * f->eta;
    return rgb_scale(f->T, (1 - fresnel) * jacobian * shadow);
}

rgb dielectric_eval(const struct bsdf *b, vec3 wo, vec3 wi, double *pdf)
{
    *pdf = 0;
    if (wo.z == 0)
        return rgb_grey(0);
    struct interface f = interface_of(b, wo.z < 0);
    return wo.z < 0 ? eval_above(&f, v3_neg(wo), v3_neg(wi), pdf) : eval_above(&f, wo, wi, pdf);
}

bool dielectric_sample(const struct bsdf *b, vec3 wo, const double u[3], struct bsdf_sample *s)
{
    bool below = wo.z < 0;
    struct interface f = interface_of(b, below);
    vec3 o = below ? v3_neg(wo) : wo;
    if (!(o.z > 0))
        return false;
    vec3 m = microfacet_sample(&f.facets, o, u[0], u[1]);
    double cosm = v3_dot(o, m), reflect, cost;
    if (!(cosm > 0))
        return false;
    (void)facet_fresnel(&f, cosm < 1 ? cosm : 1, &reflect, &cost);
    vec3 wi;
    bool transmit = u[2] >= reflect;
    if (transmit)
        wi = v3_sub(v3_scale(m, cosm / f.eta - cost), v3_scale(o, 1 / f.eta));
    else
        wi = v3_sub(v3_scale(m, 2 * cosm), o);
    if ((wi.z < 0) != transmit)
        return false;
    rgb value = eval_above(&f, o, wi, &s->pdf);
    if (!(s->pdf > 0))
        return false;
    s->wi = below ? v3_neg(wi) : wi;
    s->weight = rgb_scale(value, 1 / s->pdf);
    s->eta2 = transmit ? f.eta * f.eta : 1;
    s->flags = transmit ? BSDF_TRANSMIT : 0;
    return true;
}
