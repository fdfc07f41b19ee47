#include "worker/render/bsdf.h"

#include "worker/render/bsdf_lobes.h"
#include "worker/render/warp.h"

double bsdf_fresnel(double cosi, double sin2, double eta, double *cost)
{
    double sint2 = sin2 / (eta * eta);
    if (!(sint2 < 1)) {
        *cost = 0;
        return 1;
    }
    *cost = sqrt(1 - sint2);
    double rs = (cosi - eta * *cost) / (cosi + eta * *cost);
    double rp = (eta * cosi - *cost) / (eta * cosi + *cost);
    return 0.5 * (rs * rs + rp * rp);
}

/* Index of the side that wo is not on, relative to its own. */
static double far_index(const struct bsdf *b, vec3 wo)
{
    return wo.z > 0 ? b->material->eta : 1 / b->material->eta;
}

/* wo refracted to a far side of index eta, where its cosine is cost. Equal indices bend nothing,
 * not even by a rounding. */
static vec3 refracted(vec3 wo, double eta, double cost)
{
    if (eta == 1)
        return v3_neg(wo);
    return v3(-wo.x / eta, -wo.y / eta, wo.z > 0 ? -cost : cost);
}

static bool diffuse_sample(const struct bsdf *b, vec3 wo, const double u[3], struct bsdf_sample *s)
{
    vec3 wi = warp_cosine_hemisphere(u[0], u[1]);
    if (!(wi.z > 0))
        return false;
    s->pdf = wi.z * VEC_INV_PI;
    s->wi = v3(wi.x, wi.y, wo.z < 0 ? -wi.z : wi.z);
    s->weight = b->color;
    s->eta2 = 1;
    s->flags = 0;
    return true;
}

static bool delta_sample(vec3 wi, rgb weight, double probability, int flags, double eta2,
                         struct bsdf_sample *s)
{
    s->wi = wi;
    s->weight = weight;
    s->pdf = probability;
    s->flags = BSDF_DELTA | flags;
    s->eta2 = eta2;
    return true;
}

/* bsdf_fresnel for wo; equal indices are no surface at all. */
static double fresnel_at(vec3 wo, double eta, double *cost)
{
    if (eta == 1) {
        *cost = fabs(wo.z);
        return 0;
    }
    return bsdf_fresnel(fabs(wo.z), wo.x * wo.x + wo.y * wo.y, eta, cost);
}

/* The course renderer's: no Fresnel term; total reflection goes to the mirror direction. */
static bool refraction_sample(const struct bsdf *b, vec3 wo, struct bsdf_sample *s)
{
    double eta = far_index(b, wo), cost;
    (void)fresnel_at(wo, eta, &cost);
    if (cost > 0)
        return delta_sample(refracted(wo, eta, cost), b->color, 1, BSDF_TRANSMIT, 1, s);
    return delta_sample(bsdf_mirror(wo), b->color, 1, 0, 1, s);
}

static bool glass_sample(const struct bsdf *b, vec3 wo, const double u[3], struct bsdf_sample *s)
{
    const struct material *m = b->material;
    double eta = far_index(b, wo), cost;
    double f = fresnel_at(wo, eta, &cost);
    double reflect = f * rgb_max(m->R), transmit = (1 - f) * rgb_max(m->T);
    double sum = reflect + transmit;
    if (!(sum > 0))
        return false;
    double p = reflect / sum;
    if (u[2] < p)
        return delta_sample(bsdf_mirror(wo), rgb_scale(m->R, f / p), p, 0, 1, s);
    if (!(cost > 0))
        return false;
    rgb weight = rgb_scale(m->T, (1 - f) / ((1 - p) * eta * eta));
    return delta_sample(refracted(wo, eta, cost), weight, 1 - p, BSDF_TRANSMIT, eta * eta, s);
}

rgb bsdf_eval(const struct bsdf *b, vec3 wo, vec3 wi, double *pdf)
{
    const struct material *m = b->material;
    bool flip = m->twosided && wo.z < 0;
    *pdf = 0;
    switch (m->type) {
    case SCENE_MATERIAL_DIFFUSE:
        return bsdf_diffuse_eval(b, wo.z, wi.z, pdf);
    case SCENE_MATERIAL_ROUGH_CONDUCTOR:
        return flip ? conductor_eval(b, v3_neg(wo), v3_neg(wi), pdf)
                    : conductor_eval(b, wo, wi, pdf);
    case SCENE_MATERIAL_ROUGH_DIELECTRIC:
        return dielectric_eval(b, wo, wi, pdf);
    case SCENE_MATERIAL_PRINCIPLED:
        return principled_eval(b, wo, wi, pdf);
    default:
        return rgb_grey(0);
    }
}

void bsdf_eval_many(const struct bsdf *b, vec3 wo, uint32_t mask, const vec3 wi[BSDF_MANY],
                    rgb f[BSDF_MANY], double pdf[BSDF_MANY])
{
    if (b->material->type == SCENE_MATERIAL_ROUGH_CONDUCTOR && (mask & (mask - 1)) != 0) {
        conductor_eval_many(b, wo, b->material->twosided && wo.z < 0, wi, f, pdf);
        return;
    }
    for (uint32_t k = 0; k < BSDF_MANY; k++)
        if (mask >> k & 1)
            f[k] = bsdf_eval(b, wo, wi[k], &pdf[k]);
}

bool bsdf_sample(const struct bsdf *b, vec3 wo, const double u[3], struct bsdf_sample *s)
{
    const struct material *m = b->material;
    bool flip = m->twosided && wo.z < 0;
    switch (m->type) {
    case SCENE_MATERIAL_DIFFUSE:
        return (wo.z > 0 || flip) && diffuse_sample(b, wo, u, s);
    case SCENE_MATERIAL_MIRROR:
        return wo.z != 0 && delta_sample(bsdf_mirror(wo), rgb_mul(b->color, m->R), 1, 0, 1, s);
    case SCENE_MATERIAL_REFRACTION:
        return wo.z != 0 && refraction_sample(b, wo, s);
    case SCENE_MATERIAL_GLASS:
        return wo.z != 0 && glass_sample(b, wo, u, s);
    case SCENE_MATERIAL_ROUGH_CONDUCTOR:
        if (!conductor_sample(b, flip ? v3_neg(wo) : wo, u, s))
            return false;
        if (flip)
            s->wi = v3_neg(s->wi);
        return true;
    case SCENE_MATERIAL_ROUGH_DIELECTRIC:
        return wo.z != 0 && dielectric_sample(b, wo, u, s);
    case SCENE_MATERIAL_PRINCIPLED:
        return principled_sample(b, wo, u, s);
    default:
        return false;
    }
}
