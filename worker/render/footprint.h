/* worker/render/footprint.h: how much of the scene one sample of the picture stands for.
 *
 * A ray has two differentials: by how much its origin and direction change to the ray of the next
 * sample to the right and below (Igehy 1999, "Tracing Ray Differentials"). A pixel of n samples has
 * its samples 1 / sqrt(n) of a pixel apart, so footprints, and with them what filtering blurs,
 * shrink as samples come: the picture converges to the unfiltered one. Where nobody knows n
 * beforehand, at an error or a time, it counts as 64.
 *
 * A camera's differentials are differences between its own rays, so each of its kinds has them;
 * the point on the lens is held. Mirrors and refraction turn them exactly, with the curvature of
 * spheres and of interpolated normals; bumps are flat to them. A direction drawn with a density
 * p stands for 1 / (n p) of the sphere of directions, and opens the footprint to a cone as wide.
 *
 * Only scenes with a texture that is filtered have footprints. Pure; any thread. Tests:
 * test_footprint.
 */
#ifndef WORKER_RENDER_FOOTPRINT_H
#define WORKER_RENDER_FOOTPRINT_H

#include "common/job_spec.h"
#include "worker/render/texture.h"
#include "worker/render/vec.h"

struct hit;
struct ray;
struct render_scene;

/* [0] to the next sample in x, [1] in y. At a hit, org lies in the surface's plane. */
struct footprint {
    vec3 org[2], dir[2];
};

/* The distance between samples of a job, in pixels. */
double footprint_step(const struct job_spec *spec);

/* Moves the footprint of a ray that left `from`, maybe through surfaces since, to what it hit. */
void footprint_arrive(struct footprint *f, vec3 from, const struct ray *ray, const struct hit *hit);

/* In texture coordinates at the hit. */
void footprint_uv(const struct render_scene *scene, const struct hit *hit,
                  const struct footprint *f, struct texture_footprint *out);

/* Turns it, at a hit, by a mirror or by refraction from unit `dir` to unit `wi` about the shading
 * normal n. `eta`: index behind n over that before it. */
void footprint_mirror(const struct render_scene *scene, const struct hit *hit, vec3 n, vec3 dir,
                      struct footprint *f);
void footprint_refract(const struct render_scene *scene, const struct hit *hit, vec3 n, vec3 dir,
                       vec3 wi, double eta, struct footprint *f);

/* Opens it, at a hit, towards unit wi, drawn with a density per steradian. */
void footprint_scatter(vec3 wi, double pdf, double step, struct footprint *f);

#endif
