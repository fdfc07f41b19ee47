/* worker/render/light.h: what shines, how it is chosen, and where on it a sample falls.
 *
 * A table of lights in scene space: triangles and parallelograms (two triangles of a
 * mesh that make one), spheres (sampled by the solid angle they fill), points, spots,
 * distant lights, and the environment. Area lights emit on the side of their normal
 * only, unless they are two-sided, and as much as they are opaque: a ray that finds one by chance
 * goes through for the rest. What is clear all over is none. light_pdf gives the density with which
 * light_sample draws a direction, the choice of the light included, for multiple importance
 * sampling.
 *
 * Two or more lights with a place are chosen by a tree (light_tree.h).
 *
 * Read-only after the build; any thread. Tests: test_light, test_light_tree.
 */
#ifndef WORKER_RENDER_LIGHT_H
#define WORKER_RENDER_LIGHT_H

#include "worker/render/bsdf.h"
#include "worker/render/distribution.h"
#include "worker/render/light_tree.h"
#include "worker/render/sky.h"
#include "worker/render/texture.h"
#include "worker/render/vec.h"

enum light_type {
    LIGHT_TRIANGLE,
    LIGHT_QUAD, /* v0 + a e1 + b e2 for a, b in [0,1] */
    LIGHT_SPHERE,
    LIGHT_POINT,
    LIGHT_SPOT,
    LIGHT_DISTANT,
    LIGHT_ENVIRONMENT,
};

/* What makes an area light differ from point to point. */
struct light_surface {
    const struct texture *emission;  /* times radiance; NULL: none */
    const struct material *material; /* whose opacity differs; NULL: it is in the radiance */
    const struct texture *color;     /* of the material, with its opacity; NULL: none */
    bool has_alphas, has_colors;     /* of a triangle's corners */
    float uv[6], alphas[3];
    float colors[9]; /* times radiance */
};

struct light {
    enum light_type type;
    bool twosided;   /* area: shines behind n, too */
    rgb radiance;    /* area: radiance, times an opacity that is the same all over; point, spot:
                        intensity; distant: irradiance */
    vec3 v0, e1, e2; /* triangle, quad; v0: centre of a sphere, place of a point */
    vec3 n;          /* unit: normal of the area; direction of travel of spot and distant light */
    double area;
    double radius; /* sphere */
    double error;  /* of points on the area, along n */
    double cos_inner, cos_outer;
    const struct light_surface *surface; /* triangle, sphere; NULL: the same everywhere */
    double probability;                  /* of being chosen; of the tree's lights unused */
};

/* The sky: a texture on the sphere of directions. */
struct environment {
    bool present;
    rgb factor;                    /* scale times the constant */
    const struct texture *texture; /* an image; NULL: constant */
    double to_local[9];            /* rotation, world to local */
    struct sky_map map;            /* empty when constant */
};

struct light_table {
    struct light *lights;
    size_t count;
    struct distribution_1d choice; /* by power; with a tree: the tree, then the placeless */
    struct light_tree tree;
    uint32_t *placeless; /* with a tree: distant lights and the environment */
    size_t placeless_count;
    struct environment environment;
    uint32_t environment_light; /* its index, or SCENE_NONE */
    bool any_hittable;          /* some light is a surface or the sky: a ray can find it */
    bool any_lamp;              /* some light is a surface */
};

struct light_sample {
    vec3 wi;        /* unit, towards the light */
    vec3 target;    /* end of the shadow ray; scene space; unused when distant */
    bool distant;   /* the shadow ray has no end */
    bool delta;     /* a single direction: no other technique can find it */
    rgb radiance;   /* arriving along wi when nothing is in the way */
    double pdf;     /* per steradian, times the probability of the light; delta: the latter only */
    uint32_t light; /* its number */
};

/* A direction to a light from p on a surface that scatters to the side of the unit normal n, or, if
 * n is zero, anywhere: a sky of one colour is drawn in proportion to the cosine there. `choose`
 * picks the light, u and v the point. False when nothing arrives from there. */
bool light_sample(const struct light_table *t, vec3 p, vec3 n, double choose, double u, double v,
                  struct light_sample *s);

/* `count` of them at once, at most LIGHT_TREE_DRAWS_MAX: sample k has the bits that light_sample
 * gives with choose[k], u[k] and v[k]. choose[] ascends. Bit k of the result: sample k is there. */
uint32_t light_sample_many(const struct light_table *t, vec3 p, vec3 n, uint32_t count,
                           const double choose[], const double u[], const double v[],
                           struct light_sample s[]);

/* A vertex that looks for light: the arguments of light_sample. */
struct light_point {
    vec3 p, n;
    double choose, u, v;
};

enum { LIGHT_POINTS_MAX = 16 };

/* For each of `count` points, at most LIGHT_POINTS_MAX, a sample with the bits that light_sample
 * gives. Bit k of the result: sample k is there. */
uint32_t light_sample_points(const struct light_table *t, uint32_t count,
                             const struct light_point points[], struct light_sample s[]);

/* Density with which light_sample from `p` and `n` draws the direction of a point at distance
 * squared `distance2` on light `index`, seen under the cosine `cos_light` > 0 at its own normal. */
double light_pdf(const struct light_table *t, uint32_t index, vec3 p, vec3 n, double distance2,
                 double cos_light);

/* Density with which light_sample from `p` and `n` draws the unit direction w for light `index`,
 * whatever is in between; 0 where that does not lie there, nor further than `beyond`. */
double light_pdf_towards(const struct light_table *t, uint32_t index, vec3 p, vec3 n, vec3 w,
                         double beyond);

/* True if it is at a place, which all are but distant lights and the environment. */
static inline bool light_has_place(const struct light *l)
{
    return l->type != LIGHT_DISTANT && l->type != LIGHT_ENVIRONMENT;
}

/* What an area light sends out at the weights of its vertices 1 and 2: radiance times opacity. */
rgb light_emission(const struct light *l, double b1, double b2);

/* The same of a sphere where its unit normal is n. */
rgb light_sphere_emission(const struct light *l, vec3 n);

/* Radiance of the sky at a point of its map. */
rgb environment_lookup(const struct environment *e, double u, double v);

/* The direction in scene space of a point of the sky's map, and the sine of its angle to the
 * poles. */
vec3 environment_direction(const struct environment *e, double u, double v, double *sine);

/* From the map's own space to the scene's. */
vec3 environment_to_scene(const struct environment *e, vec3 l);

/* Radiance of the sky in a direction of scene space, and the density of light_sample with n. */
rgb environment_radiance(const struct light_table *t, vec3 n, vec3 w, double *pdf);

/* The same for `count` directions w from points with n, at most LIGHT_POINTS_MAX. */
void environment_radiances(const struct light_table *t, uint32_t count, const vec3 n[],
                           const vec3 w[], rgb radiance[], double pdf[]);

#endif
