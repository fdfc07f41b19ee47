/* worker/render/wave.h: the samples that one thread has in flight, and their memory.
 *
 * An integrator gets a wave of samples with their camera rays and what these hit, follows them all
 * at once through the batch calls of accel.h, and leaves the radiance of each in path.radiance. A
 * wave consists of whole groups; the order of work within it never reaches the result: a path's
 * numbers depend on its group alone. One thread.
 *
 * A group is one sample of each pixel of a square of the full picture, aligned to it
 * and cut only by its border, whatever the cells and the crop; its paths may share
 * what they found (reuse.h). Without sharing a group is one pixel.
 */
#ifndef WORKER_RENDER_WAVE_H
#define WORKER_RENDER_WAVE_H

#include "worker/render/render.h"
#include "worker/render/reuse.h"
#include "worker/render/sampler.h"
#include "worker/render/through.h"

enum {
    WAVE_PATHS = 1024,
    WAVE_GROUP_SIDE = 4, /* pixels */
    WAVE_GROUP_PATHS = WAVE_GROUP_SIDE * WAVE_GROUP_SIDE,
};

struct path {
    struct sampler sampler; /* of the group */
    struct sampler own; /* of the pixel: the camera's numbers, and points on lights at vertex 0 */
    rgb radiance;
    rgb beta; /* throughput */
    double filter_weight;
    double eta2;    /* product of the index ratios that beta was scaled by, undone in roulette */
    double carried; /* what beta is multiplied by in roulette: throughput set aside by reuse */
    double pdf;     /* with which the last direction was drawn; 0: by a delta lobe, or camera */
    vec3 org, n;    /* where the last direction left from, and light_sample's n there */
    const struct material *last; /* of the surface there, once pdf is not 0 */
    uint32_t candidates;         /* samples of lights that were drawn there */
    double light_u[2];           /* where on a light the next vertex looks */
    uint32_t asked;              /* surfaces met that are not quite opaque */
    struct through through;      /* from the last vertex with a density */
    bool twig;                   /* of another path (outline.h) */
    uint32_t owner;              /* that, of a twig */
    double share;  /* of the light found next that is this path's: less than 1 beside twigs */
    rgb twigs;     /* what its twigs have found, times their filter weights */
    uint32_t x, y; /* pixel of the full picture */
};

struct render_scratch {
    struct path paths[WAVE_PATHS];
    struct reuse reuse[WAVE_PATHS];          /* of the path of the same number */
    struct footprint footprints[WAVE_PATHS]; /* and its ray's; only where scene->has_filtered */
    uint32_t path_count; /* twigs apart, which are the last of paths, from twig_begin on */
    uint32_t twig_begin;
    uint32_t groups[WAVE_PATHS + 1]; /* the first path of each group, then path_count */
    uint32_t group_count;

    /* Rays under way: rays[i] belongs to paths[active[i]]. */
    struct ray rays[WAVE_PATHS];
    struct hit hits[WAVE_PATHS];
    uint32_t active[WAVE_PATHS];
    uint32_t active_count;

    /* Rays towards lights: what shadow_radiance[i] adds to paths[shadow_path[i]] if nothing is
     * in the way. */
    struct ray shadow_rays[WAVE_PATHS];
    rgb shadow_radiance[WAVE_PATHS];
    uint32_t shadow_path[WAVE_PATHS];
    struct through_look looks[WAVE_PATHS];
    uint8_t occluded[WAVE_PATHS];
    uint32_t shadow_count;

    /* The samplers that wave_draw asks, or of the cameras, and values of sets: of the ray of the
     * same number. */
    struct sampler samplers[WAVE_PATHS];
    double vertex_u[SAMPLER_SET_VALUES][WAVE_PATHS];
    double choice_u[SAMPLER_SET_VALUES][WAVE_PATHS];

    /* Where alpha lets rays through: which go on, and of shadow rays what they hit, what is left of
     * their light and where they end. */
    uint8_t passing[WAVE_PATHS];
    struct hit shadow_hits[WAVE_PATHS];
    double shadow_left[WAVE_PATHS];
    double shadow_end[WAVE_PATHS][3];

    struct reuse_connections connections;
    struct replay_lane lanes[WAVE_PATHS];
    uint32_t lane_count;

    /* AOVs of kind MEAN of the path of the same number; only where some are asked for. */
    double means[WAVE_PATHS][AOV_MEAN_PLANES_MAX];

    uint64_t ray_count; /* cast so far in this unit */

    struct texture_lacks lacks; /* what paths of this unit have met and that is not there yet */
};

/* The sets of the sampler. A direction and the light point at the vertex that it leads to are drawn
 * from one set, since together they make one integrand; so are the film point and the light point
 * at the first vertex. */
enum {
    WAVE_SET_CAMERA = 0, /* light u, v at vertex 0; film x, y (alone: where vertex 0 draws no
                            light point, or several) */
    WAVE_SET_LENS = 1,   /* lens u, v */
    WAVE_SET_VERTEX = 2, /* of vertex 0: bsdf u, v; light u, v at vertex 1 */
    WAVE_SET_CHOICE = 3, /* of vertex 0: bsdf lobe, roulette, which light, which
                            candidate */
    WAVE_SETS_PER_VERTEX = 2,
    WAVE_SET_POINTS = 1 << 28, /* of the pixel: several light points at vertex 0, each a sample */
    WAVE_SET_SHARE = 1 << 29,  /* roulette of reuse */
    WAVE_SET_PASS = 1 << 30,   /* opacity of the first surface that is asked, and so on */
};

/* A path that has met so many surfaces that are not quite opaque, and a shadow ray that has gone
 * through so many, are held by the next. */
enum { WAVE_PASSES_MAX = 1024 };

/* Casts the rays under way; where alpha lets a ray through, it goes on until something holds it. */
void wave_trace(const struct render_scene *scene, struct render_scratch *w);

/* Draws a set for all rays under way into u, one of the arrays of the scratch memory. */
void wave_draw(struct render_scratch *w, uint32_t set, double u[][WAVE_PATHS]);

/* Adds a shadow ray for a path: from `org` to `target`, or along `wi` without end if `distant`. */
void wave_shadow(struct render_scratch *w, uint32_t path, vec3 org, vec3 target, bool distant,
                 vec3 wi, rgb radiance);

/* Casts the shadow rays, adds what arrives, and forgets them. */
void wave_gather(const struct render_scene *scene, struct render_scratch *w);

/* shade_of_hit of ray i; late pictures of it that are not there are noted, and the path goes on
 * with whatever shade_of_hit gives. */
void wave_shade(const struct render_scene *scene, struct render_scratch *w, uint32_t i,
                const struct footprint *footprint, struct shade *out);

/* Moves the footprint of the path of ray i to its hit; NULL where nothing is filtered. */
struct footprint *wave_arrive(const struct render_scene *scene, struct render_scratch *w,
                              uint32_t i);

/* Turns it there by a drawn direction: wi as wave_continue gets it, as `sample` drew it. */
void wave_leave(const struct render_scene *scene, const struct shade *at, const struct hit *hit,
                vec3 dir, vec3 wi, const struct bsdf_sample *sample, struct footprint *f);

/* Sets ray `slot` of the next round, slot <= the index being read. */
static inline void wave_continue(struct render_scratch *w, uint32_t slot, uint32_t path, vec3 org,
                                 vec3 dir)
{
    struct ray *ray = &w->rays[slot];
    v3_put(ray->org, org);
    v3_put(ray->dir, dir);
    ray->tmin = 0;
    ray->tmax = VEC_INFINITY;
    w->active[slot] = path;
}

/* The side of a group of this scene, in pixels. */
uint32_t wave_group_side(const struct render_scene *scene);

/* The integrators. */
void integrate_seed(const struct render_scene *scene, struct render_scratch *w);
void integrate_path(const struct render_scene *scene, struct render_scratch *w);
void integrate_ao(const struct render_scene *scene, struct render_scratch *w);

#endif
