/* client/doctor_mesh.h: what is odd about one mesh, counted.
 *
 * One pass over the triangles, and two sorts for what takes two of them to see: duplicates and
 * edges. Vertices at the same place count as one, whatever their uvs and normals. In the mesh's
 * own space; scale changes nothing but lengths. About a second for a million triangles. Pure; one
 * thread. Tests: tests/numerics/test_numerics_doctor.py.
 */
#ifndef CLIENT_DOCTOR_MESH_H
#define CLIENT_DOCTOR_MESH_H

#include "common/err.h"
#include "common/scene.h"

/* How often, and the first triangle where. */
struct doctor_count {
    uint64_t count;
    uint32_t first;
};

/* Longest edge over height: a needle from here on. */
#define DOCTOR_NEEDLE_ASPECT 1e4

struct doctor_mesh {
    double low[3], high[3];
    double edge_median;   /* of edges that are not 0, to a factor of 2; 0: there is none */
    double step;          /* coordinates of one axis are multiples of this, of floats or decimals;
                             the axis where it is coarsest; 0 where all numbers are round */
    double reach;         /* largest |coordinate| on that axis */
    double aspect_max;    /* of triangles with an area */
    double volume_signed; /* enclosed, when closed, in some unit; negative: inside out */
    struct doctor_count flat;       /* no area: repeated or collinear corners */
    struct doctor_count needles;    /* over DOCTOR_NEEDLE_ASPECT */
    struct doctor_count duplicates; /* the same three corners as another triangle */
    struct doctor_count open_edges; /* that belong to one triangle */
    struct doctor_count fans;       /* edges that belong to three or more */
    struct doctor_count turned;     /* edges that both triangles run along in the same direction */
    struct doctor_count against;    /* triangles with vertex normals on both their sides */
    bool closed;                    /* every edge belongs to two triangles, or to pairs of them */
};

/* The mesh is valid. ERR_NOMEM. */
TL_NODISCARD enum err doctor_mesh_examine(const struct scene_mesh *mesh, struct doctor_mesh *out);

/* The same but for the fields after volume_signed that need pairs: one pass, some milliseconds for
 * a million triangles. */
TL_NODISCARD enum err doctor_mesh_measure(const struct scene_mesh *mesh, struct doctor_mesh *out);

/* True if the mesh lies so far from its origin that the steps of its coordinates are coarse beside
 * its edges: the file has lost detail. Looks at low, high, reach, step and edge_median. */
bool doctor_mesh_is_coarse(const struct doctor_mesh *m);

/* False: its place alone says that it is not coarse, without a look at its triangles. */
bool doctor_mesh_may_be_coarse(const struct scene_mesh *mesh);

#endif
