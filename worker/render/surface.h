/* worker/render/surface.h: the point that a ray hit, and how to leave it.
 *
 * Positions come from barycentric weights, not from org + t dir, so they are on the
 * surface to a few units in the last place. A ray that leaves starts off the surface
 * by a bound on that error along the geometric normal, on its own side; there is no
 * absolute epsilon anywhere. Any thread. Tests: test_surface (no self-hits).
 */
#ifndef WORKER_RENDER_SURFACE_H
#define WORKER_RENDER_SURFACE_H

#include "worker/render/render_scene.h"

struct surface {
    vec3 p;        /* scene space */
    vec3 ng;       /* unit geometric normal: the triangle's winding, or outward */
    vec3 ns;       /* unit shading normal, on the side of ng */
    double error;  /* p is at most this far from the true surface, along ng */
    double u, v;   /* only for materials with textures */
    double handed; /* -1 where u and v are a mirror image, else 1; as dpdu */
    rgb color;     /* of the mesh's vertices; only for materials that read it */
    vec3 dpdu;     /* direction of growing u; only for materials that ask for tangents */
    uint32_t object, primitive, material;
};

/* What `hit` of a ray in scene space hit. */
void surface_of_hit(const struct render_scene *scene, const struct hit *hit, struct surface *out);

/* The coordinates of a picture on a sphere where its unit normal is n. */
void surface_sphere_uv(vec3 n, double *u, double *v);

/* The colour of a mesh's vertices at a hit; white where they have none. */
rgb surface_vertex_color(const struct render_scene *scene, const struct hit *hit);

/* How opaque the vertices of the mesh make a hit; 1 where they say nothing. */
double surface_vertex_alpha(const struct render_scene *scene, const struct hit *hit);

/* How the place changes with u and v at a hit. False where there are no such coordinates, or where
 * they fold. */
bool surface_tangents(const struct render_scene *scene, const struct hit *hit, vec3 *dpdu,
                      vec3 *dpdv);

/* A point on the side of the surface to which `w` points, off by the error bound. */
static inline vec3 surface_offset(vec3 p, vec3 ng, double error, vec3 w)
{
    return v3_mad(p, ng, v3_dot(ng, w) < 0 ? -error : error);
}

#endif
