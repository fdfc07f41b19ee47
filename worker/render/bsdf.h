/* worker/render/bsdf.h: how a surface scatters.
 *
 * A struct material is a scene material made ready; a struct bsdf is a material at one
 * point, its textures looked up. bsdf_eval, bsdf_sample and bsdf_pdf agree:
 *
 * Directions are unit, local (n = +z), and point away from the surface. wo is towards
 * the camera. `f` already carries |cos(wi)|. pdf is per steradian. For a lobe of one
 * direction ("delta") sample gives pdf = its probability and BSDF_DELTA, and eval and pdf are 0
 * there. Radiance that crosses into a medium of other index is scaled by the square of
 * the ratio of indices (glass, rough dielectric), except by `refraction`, which is the
 * course renderer's and has weight 1.
 *
 * Microfacets: visible normals; GGX Heitz 2018 (JCGT 7:4), Beckmann by inverting the distribution
 * of visible slopes (Heitz and d'Eon 2014); uncorrelated masking-shadowing as in Walter et al.
 * 2007. Pure; any thread. Tests: test_bsdf (chi-square, reciprocity, furnace).
 */
#ifndef WORKER_RENDER_BSDF_H
#define WORKER_RENDER_BSDF_H

#include "common/scene.h"
#include "worker/render/vec.h"

enum { PRINCIPLED_SHEEN_TABLE = 16 };

/* Smoother facets than this are not told apart. */
static const double PRINCIPLED_ALPHA_MIN = 1e-3;

/* Indices are into the render scene's tables; SCENE_NONE when absent. */
struct material {
    uint32_t number; /* in the user's list */
    enum scene_material_type type;
    uint32_t texture;
    rgb color; /* times the texture */
    bool twosided;
    bool vertex_colors;  /* times the mesh's */
    bool filtered;       /* some texture of it is averaged over footprints */
    bool needs_uv;       /* a texture is looked up, or tangents are wanted */
    bool transmits;      /* with a density: light from behind counts */
    bool one_lobe;       /* bsdf_sample never looks at u[2] */
    bool is_anisotropic; /* the local x axis follows growing u */
    bool is_delta;       /* every lobe is: next-event estimation has nothing to do */
    enum scene_distribution distribution;
    double alpha_x, alpha_y, eta;
    rgb R, T;
    rgb conductor_eta, conductor_k; /* relative to the outside */

    /* Principled. */
    double metallic, roughness, transmission;
    uint32_t metallic_roughness_texture, transmission_texture;
    double specular, clearcoat, clearcoat_roughness;
    rgb specular_color, sheen_color;
    double sheen_alpha;
    double sheen_albedo[PRINCIPLED_SHEEN_TABLE]; /* over the cosine, by principled_prepare */

    uint32_t bump_texture;
    double bump_scale; /* scene units of a height of 1 */
    uint32_t normal_texture;
    double normal_scale;
    bool backface_culling; /* from behind it is not there */
    bool has_alpha;        /* lets some light straight through */
    double alpha;
    double alpha_cutoff; /* < 0: blends */
};

/* How opaque the surface is, 0 to 1, where picture and vertices together say `alpha`. */
static inline double material_opacity(const struct material *m, double alpha)
{
    alpha *= m->alpha;
    alpha = alpha > 0 ? (alpha < 1 ? alpha : 1) : 0;
    return m->alpha_cutoff < 0 ? alpha : alpha >= m->alpha_cutoff;
}

/* Fills the tables that a principled material needs, from its other fields. */
void principled_prepare(struct material *m);

/* Of one point; about a cache line or two, made and used on the stack. */
struct bsdf {
    const struct material *material;
    rgb color;                                /* albedo, reflectance, base colour */
    double metallic, roughness, transmission; /* principled */
};

enum {
    BSDF_DELTA = 1,    /* a single direction */
    BSDF_TRANSMIT = 2, /* crosses the surface */
};

struct bsdf_sample {
    vec3 wi;
    rgb weight; /* f / pdf */
    double pdf;
    double eta2; /* square of the index ratio by which radiance was scaled; 1 for a reflection */
    int flags;
};

/* f |cos(wi)|, and the pdf with which bsdf_sample draws wi. */
rgb bsdf_eval(const struct bsdf *b, vec3 wo, vec3 wi, double *pdf);

/* The same of a diffuse surface, which hangs on the local z of both alone. */
static inline rgb bsdf_diffuse_eval(const struct bsdf *b, double wo_z, double wi_z, double *pdf)
{
    *pdf = 0;
    if (!(wo_z > 0 || (b->material->twosided && wo_z < 0)) || wo_z * wi_z <= 0)
        return rgb_grey(0);
    *pdf = fabs(wi_z) * VEC_INV_PI;
    return rgb_scale(b->color, *pdf);
}

/* bsdf_eval of each wi whose bit is set in `mask`, the same bits, in vectors where the CPU has
 * them. */
enum { BSDF_MANY = 8 };
void bsdf_eval_many(const struct bsdf *b, vec3 wo, uint32_t mask, const vec3 wi[BSDF_MANY],
                    rgb f[BSDF_MANY], double pdf[BSDF_MANY]);

/* Draws wi; false when there is none (absorbed). u[0], u[1] place the direction, u[2] chooses
 * the lobe. */
bool bsdf_sample(const struct bsdf *b, vec3 wo, const double u[3], struct bsdf_sample *s);

/* Reflectance of a smooth dielectric whose far side has `eta` times the index of the near side;
 * cosi >= 0 and sin2 = 1 - cosi^2 as the caller knows it best. *cost: cosine on the far side, 0
 * under total reflection (result 1). */
double bsdf_fresnel(double cosi, double sin2, double eta, double *cost);

#endif
