/* tests/numerics/figure_methods.h: other ways to intersect, side by side with ours.
 *
 * `seed`: the source report's Moeller-Trumbore in double, with its absolute epsilon of 1e-8 on the
 * determinant, and the same with epsilon 0; Woop's test in float, without the second look in
 * double; Embree in its default and its ROBUST mode; and ours, through the whole scene build. All
 * get the same triangles and rays, made in double, and round where they must. Those without a tree
 * of their own look at every triangle. Aborts when memory runs out. One thread; measuring programs
 * only.
 */
#ifndef TESTS_NUMERICS_FIGURE_METHODS_H
#define TESTS_NUMERICS_FIGURE_METHODS_H

#include "scenes/gen_mesh.h"
#include "tests/bench/trace_peer.h"
#include "worker/render/render_scene.h"

enum figure_method { SEED, EPSILON_0, WOOP_FLOAT, EMBREE, EMBREE_ROBUST, OURS, METHODS };
extern const char *const figure_names[METHODS];

struct figure_triangle {
    double v[3][3];
};

/* Triangles in the world, ready for every method. */
struct figure_world {
    struct figure_triangle *triangles;
    size_t count;
    double scale, offset[3]; /* world = mesh * scale + offset */
    struct trace_scene floats;
    struct trace_peer *peer[2]; /* default, ROBUST */
    struct render_scene *ours;
};

struct figure_hit {
    double t; /* in lengths of dir; infinite: none */
    uint32_t triangle;
};

/* Moeller-Trumbore; compiled twice, the second time with contraction to fused operations, as a
 * compiler does by itself for a processor that has them (figure_fma.c). */
bool figure_moller_trumbore(const struct figure_triangle *f, const double org[3],
                            const double dir[3], double epsilon, double *t);
bool figure_moller_trumbore_fma(const struct figure_triangle *f, const double org[3],
                                const double dir[3], double epsilon, double *t);

/* A mesh `away` from the origin, `scale` times as large. */
void figure_world_make(struct figure_world *w, const struct gen_mesh *m, double scale, double away);
/* The same of triangles in double; copies both. */
void figure_world_of(struct figure_world *w, const double *positions, size_t vertex_count,
                     const uint32_t *indices, size_t triangle_count);
void figure_world_free(struct figure_world *w);

/* The nearest hit by a method, beyond t = tmin. */
struct figure_hit figure_nearest(const struct figure_world *w, enum figure_method method,
                                 const double org[3], const double dir[3], double tmin);

/* A path of rays. A method restarts a ray where it found the last, p = org + t dir in its own
 * precision, and looks beyond an absolute distance, as is usual; ours starts beyond the bound of
 * the place's error, and so looks beyond 0. */
struct figure_path {
    enum figure_method method;
    double beyond;         /* of the others' rays from the second on, in the world's lengths */
    double org[3], dir[3]; /* in the world; ours in the scene's space */
    bool started;
};
void figure_path_begin(struct figure_path *p, const struct figure_world *w,
                       enum figure_method method, double beyond, const double org[3],
                       const double dir[3]);
/* The nearest hit, and the path goes on from there into direction `to`. */
struct figure_hit figure_path_step(struct figure_path *p, const struct figure_world *w,
                                   const double to[3]);
/* Where it stands, in the world. */
void figure_path_at(const struct figure_path *p, const struct figure_world *w, double out[3]);

/* The truth: t by the triangles as they are, in quad precision; 1e300: none. */
double figure_truth(const struct figure_world *w, const double org[3], const double dir[3]);

/* A line of the table: figure, method, x, value. */
void figure_put(const char *figure, enum figure_method method, double x, double value);

/* The rows that are not curves. */
void figure_rows(void);

#endif
