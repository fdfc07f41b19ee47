/* worker/render/through.h: lamps and sky seen through glass.
 *
 * A shadow ray that glass blocks has aimed at a light that may well be seen through it: behind a
 * pane or a block with parallel sides it is there, a little moved. So what the ray would bring if
 * it went on through the glass, refracted, is a technique of its own beside following a direction
 * that the surface draws: the direction is drawn by the light, and counts if it leads to that same
 * light, with every surface between letting it through. Both are weighed by the balance heuristic,
 * for which a path that arrives through glass asks with what density the light would have drawn
 * the direction in which it set out. That leaves the mean as it is wherever the glass bends light
 * to.
 *
 * Profile MIS, vertices that draw one candidate a point, lamps that shine alike all over, surfaces
 * without pictures, scenes without alpha. Any thread. Tests: test_caustics, test_mitsuba.
 */
#ifndef WORKER_RENDER_THROUGH_H
#define WORKER_RENDER_THROUGH_H

#include "worker/render/next_event.h"

struct render_scratch;

/* True if the scene's job looks through glass. */
bool through_wanted(const struct render_scene *scene);

/* How a path has left its last vertex with a density. */
struct through {
    vec3 org, n, wi; /* as light_sample has them; wi leads to the first surface without density */
    double first;    /* the distance to it */
    double density;  /* of the direction, times the probabilities of going through */
    uint32_t points; /* shadow rays that were cast there; 0: none that look through */
    uint32_t count;  /* surfaces gone through */
};

/* A shadow ray that may look through what blocks it. */
struct through_look {
    uint32_t light;    /* that it aims at; SCENE_NONE: it does not */
    uint32_t depth;    /* edges of the path up to where it leaves */
    vec3 dir;          /* unit */
    rgb value;         /* the path's throughput times what the surfaces so far scatter */
    double density;    /* of a path that goes this way, as above */
    double light_rate; /* shadow rays times the density with which one of them does */
};

/* A path leaves a vertex by wi, drawn with a density; `first`: of its path. */
struct through through_of(const struct render_scene *scene, const struct shade *at, bool first,
                          vec3 wi, double density);

/* It goes on by a sample of a surface without density, at that distance. */
void through_turn(struct through *t, const struct material *m, const struct bsdf_sample *sample,
                  double distance);

/* The weight of a light that a path has found by a direction without density. */
double through_weight(const struct render_scene *scene, const struct through *t, uint32_t light);

/* The number of a lamp in the table of lights. */
uint32_t through_light(const struct render_scene *scene, const struct surface *s);

/* The last shadow ray of the wave, to a light drawn at a vertex at that depth for one of `points`,
 * may look through glass. */
void through_note(const struct render_scene *scene, struct render_scratch *w, uint32_t depth,
                  uint32_t points, const struct light_sample *light,
                  const struct next_event_view *view);

/* After it is known which shadow rays are blocked: adds what arrives through glass. */
void through_gather(const struct render_scene *scene, struct render_scratch *w);

#endif
