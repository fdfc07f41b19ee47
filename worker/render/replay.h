/* worker/render/replay.h: a way that found a lamp through mirrors and glass, tried by the whole
 * group.
 *
 * A lamp behind a surface with no density is found by chance alone, seldom and bright: a caustic.
 * From the first vertex x that scatters into a density such a way is told by the direction in which
 * it left and by which of the surfaces let it through ("random replay" of the shift mappings of
 * Hua et al. 2019, "A Survey on Gradient-Domain Rendering"). The others of the path's cluster
 * (reuse.h) leave their own x in the same direction and are let through by the same surfaces; where
 * that leads to a lamp too they have found one as well. The estimates are combined by the balance
 * heuristic over the densities with which each x would have drawn the way, 0 where it finds no
 * lamp, so the mean does not change. Roulette is left out of those densities: it divides what the
 * way brings.
 *
 * For lamps that shine alike all over, and surfaces without pictures. Any thread. Tests:
 * test_caustics, test_mitsuba.
 */
#ifndef WORKER_RENDER_REPLAY_H
#define WORKER_RENDER_REPLAY_H

#include "worker/render/shade.h"

struct render_scratch;
struct reuse;

/* The way of a path from its x. */
struct replay {
    vec3 wi;         /* in which it left x */
    uint32_t turns;  /* bit k: surface k let it through, else it reflected it */
    uint32_t count;  /* of those surfaces so far */
    double density;  /* with which x draws the way: per steradian, times the turns' probabilities */
    double survival; /* the probability with which roulette left it */
    rgb found;       /* the lamp's light at its end; the path has not got it yet */
};

enum { REPLAY_TURNS_MAX = 32 };

/* A ray that tries a way. */
struct replay_lane {
    uint32_t from, way; /* the path whose x it leaves, and that whose way it goes */
    vec3 dir;
    double first;   /* how far it is to the first surface */
    double density; /* with which its own path would draw it */
    rgb value;      /* the path's throughput times that density */
    bool there;     /* at a lamp; value is then its light */
};

/* True for a surface that a way may lead over. */
bool replay_passes(const struct material *m);

/* The light of a lamp that ends ways, seen along `dir`; false if it is none, or turned away. */
bool replay_lamp(const struct render_scene *scene, const struct surface *s, vec3 dir,
                 rgb *radiance);

/* Turns *dir by the surface that it has met: through it, or reflected. *value is multiplied by what
 * the surface scatters there, *density by the probability of the turn. False where there is no such
 * turn. */
bool replay_take(const struct shade *at, bool through, vec3 *dir, rgb *value, double *density);

/* Tells that a path on its way (REUSE_WAY) has gone on by a sample, which roulette left with that
 * probability. */
void replay_turn(struct reuse *r, const struct bsdf_sample *sample, double survival);

/* Tells that it has arrived behind a turn. True if its way ends here at a lamp, whose light it is
 * given by replay_combine. */
bool replay_arrive(const struct render_scene *scene, struct render_scratch *w, uint32_t index,
                   const struct shade *at, vec3 dir);

/* Gives what was found at the ends of ways to the paths of each group. */
void replay_combine(const struct render_scene *scene, struct render_scratch *w);

#endif
