/* tests/numerics/closed_mesh.h: closed surfaces, and rays from inside that must hit them.
 *
 * The caller owns what is made (gen_mesh_release). Aborts when memory runs out. Tests only.
 */
#ifndef TESTS_NUMERICS_CLOSED_MESH_H
#define TESTS_NUMERICS_CLOSED_MESH_H

#include "scenes/gen_mesh.h"
#include "worker/render/accel.h"

enum closed_kind {
    CLOSED_ICOSPHERE, /* 1,280 triangles of nearly one size */
    CLOSED_HULL,      /* convex hull of 64 points on a sphere: 124 triangles, some thin */
    CLOSED_NOISY,     /* 1,728 triangles, radius moved by up to 0.3 of it */
    CLOSED_KINDS
};
extern const char *const closed_names[CLOSED_KINDS];

/* About the origin, of radius about 1. */
void closed_make(enum closed_kind kind, struct gen_mesh *out);

/* Ray i from a point within 0.05 of the origin; by i % 3 at a vertex, at a point of an edge, or
 * anywhere. dir is not unit. */
void closed_ray(const struct gen_mesh *m, uint64_t *state, size_t i, struct ray *out);

#endif
