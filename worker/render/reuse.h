/* worker/render/reuse.h: paths of neighbouring pixels share what they found.
 *
 * After Bekaert, Sbert and Halton 2002, "Accelerating Path Tracing by Re-Using Paths". A path
 * leaves its first vertex x that scatters into a density, and finds at y what light goes
 * out from there. If y is diffuse, that light is the same for every pixel whose own x sees
 * y: for the price of a shadow ray each path of a group gets the y of all others. The
 * estimates are combined by the balance heuristic over the densities with which each x
 * would have drawn y, visibility included, so the mean does not change.
 *
 * Paths share within a cluster: those whose x lie on the same object at the same depth
 * with similar normals. Clusters depend on the x alone, never on the y.
 *
 * Where direct light is most of a picture, that costs more than it gains: a y is shared only if the
 * light that it sends is more than the direct light about the x, else its path keeps it.
 * Either estimate has the same mean, and the bound knows nothing of any y.
 */
#ifndef WORKER_RENDER_REUSE_H
#define WORKER_RENDER_REUSE_H

#include "worker/render/replay.h"

struct render_scratch;

enum reuse_state {
    REUSE_NONE,  /* no x yet */
    REUSE_LEFT,  /* left x, at no y yet */
    REUSE_FOUND, /* at a y that can be shared; what follows is the light going out from it */
    REUSE_ALONE, /* at a y that cannot be shared */
    REUSE_WAY,   /* on a way over surfaces without density (replay.h) */
    REUSE_LAMP,  /* and at its end */
};

struct reuse {
    enum reuse_state state;
    uint32_t depth; /* edges up to x */
    struct shade x;
    rgb beta_x;  /* throughput up to x */
    bool landed; /* the ray from x arrived somewhere, or nowhere */
    rgb direct;  /* then: what the path had gathered when the ray from x arrived */
    /* The rest from REUSE_FOUND on. */
    rgb beta;       /* throughput up to y */
    rgb radiance;   /* what the path had gathered before y */
    vec3 y, ng, ns; /* of y; the normals are on the side that the light goes out from */
    double error;
    bool kept;         /* worth too little to the others for their shadow rays */
    double pdf;        /* with which this path drew y, per area */
    double pdf_sum;    /* and that of all paths of the cluster that see y */
    rgb shared;        /* the light that leaves y, over pdf_sum */
    struct replay way; /* from REUSE_WAY on */
};

enum { REUSE_CONNECTIONS = 4096 };

/* Shadow rays from the x of paths `from` to the y of paths `to`, and what they would bring. */
struct reuse_connections {
    uint32_t count;
    uint32_t from[REUSE_CONNECTIONS], to[REUSE_CONNECTIONS];
    rgb factor[REUSE_CONNECTIONS]; /* of the light that leaves y */
    double pdf[REUSE_CONNECTIONS]; /* with which x would have drawn y, per area */
    struct ray rays[REUSE_CONNECTIONS];
    uint8_t occluded[REUSE_CONNECTIONS];
};

/* True if the scene's job shares paths. */
bool reuse_wanted(const struct render_scene *scene);

/* Tells that path `index` is about to draw a direction at its first vertex with a density. */
void reuse_leave(struct render_scratch *w, uint32_t index, const struct shade *x, uint32_t depth);

/* Tells that the ray from there has been cast, before anything is added for what it met. */
void reuse_land(struct render_scratch *w, uint32_t index);

/* Tells that it has arrived from there, in direction `dir`, after emission was added. */
void reuse_arrive(struct render_scratch *w, uint32_t index, const struct shade *y, vec3 dir);

/* Numbers the clusters of a group's paths. Paths without x get none of others. */
void reuse_cluster(const struct reuse *r, uint32_t count, uint32_t cluster[]);

/* Shares: afterwards path.radiance is complete. */
void reuse_combine(const struct render_scene *scene, struct render_scratch *w);

#endif
