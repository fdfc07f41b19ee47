/* Rough conductor: Fresnel of a complex index over the facets of microfacet.h, reflection only.
 * Owns nothing beyond the call; directions are local, the normal is +z. */
#include "worker/render/bsdf_lobes.h"

#include "worker/render/conductor_parts.h"
#include "worker/render/lanes.h"

static struct microfacet facets(const struct bsdf *b)
{
    const struct material *m = b->material;
    return (struct microfacet){m->distribution, m->alpha_x, m->alpha_y};
}

static struct conductor conductor_of(const struct bsdf *b, vec3 wo)
{
    const struct material *m = b->material;
    struct microfacet mf = facets(b);
    struct conductor c = {.ax = m->alpha_x, .ay = m->alpha_y, .wo = wo};
    const double eta[3] = {m->conductor_eta.r, m->conductor_eta.g, m->conductor_eta.b};
    const double k[3] = {m->conductor_k.r, m->conductor_k.g, m->conductor_k.b};
    for (int i = 0; i < 3; i++) {
        c.eta2[i] = eta[i] * eta[i];
        c.k2[i] = k[i] * k[i];
    }
    c.reach = 1 / ((1 + microfacet_lambda(&mf, wo)) * 4 * wo.z);
    return c;
}

rgb conductor_eval(const struct bsdf *b, vec3 wo, vec3 wi, double *pdf)
{
    *pdf = 0;
    if (wo.z <= 0 || wi.z <= 0)
        return rgb_grey(0);
    struct conductor c = conductor_of(b, wo);
    double f[3];
    /* The distribution is a constant in either. */
    if (b->material->distribution == SCENE_GGX)
        *pdf = conductor_value(&c, SCENE_GGX, wi, f);
    else
        *pdf = conductor_value(&c, SCENE_BECKMANN, wi, f);
    return rgb_mul(rgb_of(f), b->color);
}

void conductor_eval_many(const struct bsdf *b, vec3 wo, bool flip, const vec3 wi[], rgb f[],
                         double pdf[])
{
    static conductor_loop *const loops[LANES_LEVELS] = {conductor_loop_sse2, conductor_loop_avx2,
                                                        conductor_loop_avx512};
    double side = flip ? -1 : 1;
    struct conductor_batch batch;
    memset(pdf, 0, BSDF_MANY * sizeof *pdf);
    memset(f, 0, BSDF_MANY * sizeof *f);
    if (wo.z * side <= 0)
        return;
    struct conductor c = conductor_of(b, v3_scale(wo, side));
    for (int i = 0; i < BSDF_MANY; i++) {
        batch.x[i] = wi[i].x * side;
        batch.y[i] = wi[i].y * side;
        batch.z[i] = wi[i].z * side;
    }
    loops[lanes_level()](&c, b->material->distribution, &batch);
    for (int i = 0; i < BSDF_MANY; i++) {
        pdf[i] = batch.pdf[i];
        f[i] = rgb_mul((rgb){batch.f[0][i], batch.f[1][i], batch.f[2][i]}, b->color);
    }
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
