/* worker/render/shade.h: a hit made ready for scattering: surface, local frame, bsdf.
 *
 * Any thread.
 */
#ifndef WORKER_RENDER_SHADE_H
#define WORKER_RENDER_SHADE_H

#include "worker/render/surface.h"

struct shade {
    struct surface surface;
    frame frame; /* n is the shading normal */
    struct bsdf bsdf;
    vec3 wo;            /* local */
    bool bent;          /* the shading normal was of no use, the geometric one stands for it */
    vec3 smooth;        /* the normal before a normal map tilted it */
    double tilt_alpha2; /* roughness that goes with that tilt, squared; 0: none */
};

/* How opaque the surface is at a hit, 0 to 1, to a ray of direction `dir`, of any length. */
double shade_opacity(const struct render_scene *scene, const struct hit *hit, vec3 dir);

/* `dir` is the unit direction of the ray that hit. `footprint` is what it stands for there, NULL
 * for a point; only scene->has_filtered makes a difference. Textures that are not there yet are
 * noted in `lacks` (not if that is NULL), and the hit is shaded without them. */
void shade_of_hit(const struct render_scene *scene, const struct hit *hit, vec3 dir,
                  const struct footprint *footprint, struct texture_lacks *lacks,
                  struct shade *out);

/* What emitted radiance is multiplied by at the hit: its texture, over the footprint if that is not
 * NULL, and the colours of vertices. Only of objects whose emission differs. */
rgb shade_emission(const struct render_scene *scene, const struct hit *hit, const struct surface *s,
                   const struct footprint *footprint);

/* What a normal map's tilt leaves of light reflected to or from wi (scene space): 1 without one.
 * Facets tilted as a map tilts them hide each other at grazing directions; without this a tilted
 * normal ends in a hard edge where wi sinks below the surface (Conty Estevez, Lecocq and Stein
 * 2019, "A Microfacet-Based Shadowing Function to Solve the Bump Terminator Problem"). A
 * factor of the scattering function, whichever technique finds wi. Tests: test_shade. */
double shade_tilted(const struct shade *s, vec3 wi, double wi_local_z);

static inline double shade_tilt_shadowing(const struct shade *s, vec3 wi, double wi_local_z)
{
    return s->tilt_alpha2 > 0 ? shade_tilted(s, wi, wi_local_z) : 1;
}

/* True if wi (scene space) lies on the same side of shading and geometric normal, so that a
 * reflection stays a reflection and a transmission one. */
static inline bool shade_is_consistent(const struct shade *s, vec3 wi, double wi_local_z)
{
    return (v3_dot(s->surface.ng, wi) > 0) == (wi_local_z > 0);
}

#endif
