/* The material of glTF 2.0: metallic-roughness with KHR clearcoat, sheen, transmission (thin),
 * specular and ior. Five lobes over a two-sided surface; wo is turned above.
 *
 * Where glTF leaves energy to chance it is kept here: what lies under a layer gets what that layer
 * lets in and out, (1 - F(wo)) (1 - F(wi)), which is reciprocal. */
#include "worker/render/bsdf_lobes.h"

#include "common/dmath.h"
#include "worker/render/microfacet.h"
#include "worker/render/warp.h"

enum lobe { LOBE_COAT, LOBE_SPECULAR, LOBE_TRANSMIT, LOBE_DIFFUSE, LOBE_COUNT };

struct lobes {
    rgb f0, f90; /* of the specular lobe */
    rgb diffuse, transmit, sheen;
    double coat;
    struct microfacet facets, coat_facets;
    double choice[LOBE_COUNT]; /* probabilities */
};

/* Reflectance of the coat at normal incidence: an index of 1.5. */
static const double COAT_F0 = 0.04;

static double schlick5(double cosine)
{
    double x = cosine < 1 ? 1 - cosine : 0;
    double x2 = x * x;
    return x2 * x2 * x;
}

/* What a layer that takes `part` leaves to those below. */
static double left_by(double part)
{
    return part < 1 ? 1 - part : 0;
}

static rgb specular_fresnel(const struct lobes *l, double cosine)
{
    return rgb_mix(l->f0, l->f90, schlick5(cosine));
}

static double coat_fresnel(double cosine)
{
    return COAT_F0 + (1 - COAT_F0) * schlick5(cosine);
}

static struct microfacet facets_of(double roughness)
{
    double alpha = roughness * roughness;
    alpha = alpha > PRINCIPLED_ALPHA_MIN ? alpha : PRINCIPLED_ALPHA_MIN;
    return (struct microfacet){SCENE_GGX, alpha, alpha};
}

double principled_sheen_albedo(const struct material *m, double cosine)
{
    double at = (cosine < 0 ? 0 : cosine > 1 ? 1 : cosine) * (PRINCIPLED_SHEEN_TABLE - 1);
    int i = at > 0 ? (int)at : 0; /* not a number: 0 */
    i = i < PRINCIPLED_SHEEN_TABLE - 1 ? i : PRINCIPLED_SHEEN_TABLE - 2;
    double t = at - i;
    return m->sheen_albedo[i] * (1 - t) + m->sheen_albedo[i + 1] * t;
}

/* Estevez and Kulla 2017, "Production Friendly Microfacet Sheen BRDF", with the visibility term
 * of Ashikhmin and Premoze: value times cos(wi), for a sheen of colour 1. */
double principled_sheen_value(const struct material *m, vec3 wo, vec3 wi)
{
    vec3 h = v3_unit(v3_add(wo, wi));
    double inverse = 1 / m->sheen_alpha;
    double sine2 = h.x * h.x + h.y * h.y;
    if (!(sine2 > 0))
        return 0;
    double d = (2 + inverse) * dmath_exp(0.5 * inverse * dmath_log(sine2)) / (2 * VEC_PI);
    return d * wi.z / (4 * (wo.z + wi.z - wo.z * wi.z));
}

static struct lobes lobes_of(const struct bsdf *b, vec3 wo)
{
    const struct material *m = b->material;
    struct lobes l;
    double metal = b->metallic;
    double r = (m->eta - 1) / (m->eta + 1);
    rgb f0 = rgb_scale(m->specular_color, r * r * m->specular);
    f0 = (rgb){f0.r < 1 ? f0.r : 1, f0.g < 1 ? f0.g : 1, f0.b < 1 ? f0.b : 1};
    l.f0 = rgb_mix(f0, b->color, metal);
    l.f90 = rgb_grey(m->specular + (1 - m->specular) * metal);
    rgb inner = rgb_scale(b->color, 1 - metal);
    l.diffuse = rgb_scale(inner, 1 - b->transmission);
    l.transmit = rgb_scale(inner, b->transmission);
    l.sheen = m->sheen_color;
    l.coat = m->clearcoat;
    l.facets = facets_of(b->roughness);
    l.coat_facets = facets_of(m->clearcoat_roughness);
    double sheen = rgb_max(l.sheen) > 0 ? rgb_max(l.sheen) * principled_sheen_albedo(m, wo.z) : 0;
    double in = 1 - l.coat * coat_fresnel(wo.z);
    l.choice[LOBE_COAT] = l.coat > 0 ? l.coat * coat_fresnel(wo.z) : 0;
    l.choice[LOBE_SPECULAR] = in * rgb_max(specular_fresnel(&l, wo.z));
    l.choice[LOBE_TRANSMIT] = in * rgb_max(l.transmit);
    l.choice[LOBE_DIFFUSE] = in * rgb_max(l.diffuse) + sheen;
    double sum = 0;
    for (int k = 0; k < LOBE_COUNT; k++)
        sum += l.choice[k];
    for (int k = 0; k < LOBE_COUNT; k++)
        l.choice[k] = sum > 0 ? l.choice[k] / sum : 0;
    return l;
}

/* D G1(wo) / (4 wo.z), the pdf of a reflection at the facets, and G1(wi) beside it. */
static double facet_pdf(const struct microfacet *mf, vec3 wo, vec3 wi, vec3 m, double *shadow)
{
    *shadow = 1 / (1 + microfacet_lambda(mf, wi));
    return microfacet_d(mf, m) / (1 + microfacet_lambda(mf, wo)) / (4 * wo.z);
}

/* What the layers above the diffuse and transmitting ones let in and out. */
static rgb below_specular(const struct lobes *l, double coso, double cosi)
{
    rgb o = specular_fresnel(l, coso), i = specular_fresnel(l, cosi);
    return (rgb){left_by(o.r) * left_by(i.r), left_by(o.g) * left_by(i.g),
                 left_by(o.b) * left_by(i.b)};
}

static rgb eval_reflection(const struct bsdf *b, const struct lobes *l, vec3 wo, vec3 wi,
                           double *pdf)
{
    vec3 m = v3_unit(v3_add(wo, wi));
    double cosm = v3_dot(wo, m), shadow;
    double facets = facet_pdf(&l->facets, wo, wi, m, &shadow);
    rgb f = rgb_scale(specular_fresnel(l, cosm), facets * shadow);
    double cosine_pdf = wi.z * VEC_INV_PI;
    *pdf = l->choice[LOBE_SPECULAR] * facets + l->choice[LOBE_DIFFUSE] * cosine_pdf;
    rgb under = below_specular(l, wo.z, wi.z);
    f = rgb_mad(f, rgb_mul(l->diffuse, under), cosine_pdf);
    double sheen = rgb_max(l->sheen);
    if (sheen > 0) {
        double eo = principled_sheen_albedo(b->material, wo.z);
        double ei = principled_sheen_albedo(b->material, wi.z);
        f = rgb_scale(f, left_by(sheen * (eo > ei ? eo : ei)));
        f = rgb_mad(f, l->sheen, principled_sheen_value(b->material, wo, wi));
    }
    if (l->coat > 0) {
        f = rgb_scale(f, (1 - l->coat * coat_fresnel(wo.z)) * (1 - l->coat * coat_fresnel(wi.z)));
        double coat_shadow;
        double coat = facet_pdf(&l->coat_facets, wo, wi, m, &coat_shadow);
        *pdf += l->choice[LOBE_COAT] * coat;
        f = rgb_add(f, rgb_grey(l->coat * coat_fresnel(cosm) * coat * coat_shadow));
    }
    return f;
}

/* Thin: the mirror image of a reflection at the same facets, tinted. */
static rgb eval_transmission(const struct bsdf *b, const struct lobes *l, vec3 wo, vec3 wi,
                             double *pdf)
{
    vec3 image = v3(wi.x, wi.y, -wi.z);
    vec3 m = v3_unit(v3_add(wo, image));
    double shadow;
    double facets = facet_pdf(&l->facets, wo, image, m, &shadow);
    *pdf = l->choice[LOBE_TRANSMIT] * facets;
    double layers = (1 - l->coat * coat_fresnel(wo.z)) * (1 - l->coat * coat_fresnel(image.z));
    double sheen = rgb_max(l->sheen);
    if (sheen > 0) {
        double eo = principled_sheen_albedo(b->material, wo.z);
        double ei = principled_sheen_albedo(b->material, image.z);
        layers *= left_by(sheen * (eo > ei ? eo : ei));
    }
    rgb under = below_specular(l, wo.z, image.z);
    return rgb_scale(rgb_mul(l->transmit, under), layers * facets * shadow);
}

static rgb eval_above(const struct bsdf *b, const struct lobes *l, vec3 wo, vec3 wi, double *pdf)
{
    if (wi.z > 0)
        return eval_reflection(b, l, wo, wi, pdf);
    if (wi.z < 0 && b->transmission > 0)
        return eval_transmission(b, l, wo, wi, pdf);
    *pdf = 0;
    return rgb_grey(0);
}

rgb principled_eval(const struct bsdf *b, vec3 wo, vec3 wi, double *pdf)
{
    *pdf = 0;
    vec3 o = wo.z < 0 ? v3_neg(wo) : wo;
    if (!(o.z > 0))
        return rgb_grey(0);
    struct lobes l = lobes_of(b, o);
    return eval_above(b, &l, o, wo.z < 0 ? v3_neg(wi) : wi, pdf);
}

static vec3 sample_lobe(const struct lobes *l, enum lobe lobe, vec3 wo, const double u[3])
{
    if (lobe == LOBE_DIFFUSE)
        return warp_cosine_hemisphere(u[0], u[1]);
    const struct microfacet *mf = lobe == LOBE_COAT ? &l->coat_facets : &l->facets;
    vec3 m = microfacet_sample(mf, wo, u[0], u[1]);
    vec3 wi = v3_sub(v3_scale(m, 2 * v3_dot(wo, m)), wo);
    /* A reflection that goes below is lost, not a transmission. */
    if (!(wi.z > 0))
        return v3(0, 0, 0);
    return lobe == LOBE_TRANSMIT ? v3(wi.x, wi.y, -wi.z) : wi;
}

bool principled_sample(const struct bsdf *b, vec3 wo, const double u[3], struct bsdf_sample *s)
{
    vec3 o = wo.z < 0 ? v3_neg(wo) : wo;
    if (!(o.z > 0))
        return false;
    struct lobes l = lobes_of(b, o);
    int lobe = 0;
    double sum = l.choice[0];
    while (lobe < LOBE_COUNT - 1 && u[2] >= sum)
        sum += l.choice[++lobe];
    vec3 wi = sample_lobe(&l, (enum lobe)lobe, o, u);
    rgb f = eval_above(b, &l, o, wi, &s->pdf);
    if (!(s->pdf > 0))
        return false;
    s->wi = wo.z < 0 ? v3_neg(wi) : wi;
    s->weight = rgb_scale(f, 1 / s->pdf);
    s->eta2 = 1;
    s->flags = wi.z < 0 ? BSDF_TRANSMIT : 0;
    return true;
}

/* Directional albedo of the sheen lobe by midpoint quadrature. */
void principled_prepare(struct material *m)
{
    enum { STEPS = 48 };
    for (int i = 0; i < PRINCIPLED_SHEEN_TABLE; i++) {
        double z = (double)i / (PRINCIPLED_SHEEN_TABLE - 1);
        z = z < 1e-3 ? 1e-3 : z;
        vec3 wo = v3(sqrt(1 - z * z), 0, z);
        double sum = 0;
        for (int k = 0; k < STEPS * STEPS; k++) {
            double cosine = (k % STEPS + 0.5) / STEPS, sine = sqrt(1 - cosine * cosine), s, c;
            warp_sincos_turn((k / STEPS + 0.5) / (2 * STEPS), &s, &c);
            sum += principled_sheen_value(m, wo, v3(sine * c, sine * s, cosine));
        }
        double albedo = sum / (STEPS * STEPS) * 2 * VEC_PI;
        m->sheen_albedo[i] = albedo < 1 ? albedo : 1;
    }
}
