/* scenes/gen_mesh.h: meshes made by rule, too big to keep as files.
 *
 * The same vertices on every machine: nothing but + - * / and sqrt. Used by the
 * benchmarks and tests and, through the program gen_mesh, for PLY files. Each
 * function appends to `m`; the caller owns it and calls gen_mesh_release. ERR_NOMEM.
 */
#ifndef SCENES_GEN_MESH_H
#define SCENES_GEN_MESH_H

#include "common/err.h"

struct gen_mesh {
    float *positions;  /* 3 * vertex_count */
    uint32_t *indices; /* 3 * triangle_count */
    size_t vertex_count, vertex_capacity, triangle_count, triangle_capacity;
};

void gen_mesh_init(struct gen_mesh *m);
void gen_mesh_release(struct gen_mesh *m);

/* A corner and two edges; two triangles. */
TL_NODISCARD enum err gen_quad(struct gen_mesh *m, const double corner[3], const double edge1[3],
                               const double edge2[3]);

/* The report's Cornell box without its lamp: five walls and two boxes, 30 triangles. */
TL_NODISCARD enum err gen_cornell(struct gen_mesh *m);

/* Five walls around [-1, 1]^3, open towards +z; 10 triangles. */
TL_NODISCARD enum err gen_room(struct gen_mesh *m);

/* A closed ball of 12 * side^2 triangles, its radius moved by up to `bumps` of it in noise of
 * several octaves. */
TL_NODISCARD enum err gen_ball(struct gen_mesh *m, uint32_t side, const double center[3],
                               double radius, double bumps, uint32_t seed);

/* Thin triangles of the given length and width, at random in the ball of that radius. */
TL_NODISCARD enum err gen_needles(struct gen_mesh *m, uint32_t count, double radius, double length,
                                  double width, uint32_t seed);

/* The bare frame of a house that stands askew: columns, beams and rails on a grid of side * side
 * and so many storeys, `width` wide; long thin boxes, whose own boxes overlap. Some 36 side^2
 * triangles a storey. */
TL_NODISCARD enum err gen_frame(struct gen_mesh *m, uint32_t side, uint32_t storeys, double width);

/* [0, 1), the same on every machine; state must not be 0. */
double gen_random(uint64_t *state);

#endif
