/* worker/render/microfacet.h: distributions of facet normals, Beckmann and GGX.
 *
 * Local directions, n = +z; wo above the surface (z > 0). Anisotropic roughness along
 * x and y. Any thread. Tests: test_bsdf.
 */
#ifndef WORKER_RENDER_MICROFACET_H
#define WORKER_RENDER_MICROFACET_H

#include "common/scene.h"
#include "worker/render/vec.h"

struct microfacet {
    enum scene_distribution distribution;
    double ax, ay;
};

/* Area density of facets with normal m, m.z > 0. */
double microfacet_d(const struct microfacet *mf, vec3 m);

/* Smith's auxiliary function of w, w.z != 0; masking is 1 / (1 + lambda). */
double microfacet_lambda(const struct microfacet *mf, vec3 w);

/* A facet normal visible from wo, density d(m) max(0, wo.m) / (wo.z (1 + lambda(wo))). */
vec3 microfacet_sample(const struct microfacet *mf, vec3 wo, double u, double v);

#endif
