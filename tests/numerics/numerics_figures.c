/* numerics_figures: what other ways to intersect make of the rows of the matrix.
 *
 *   numerics_figures > figures.csv        (some minutes; tests/numerics/plot.py draws it)
 *   numerics_figures --rows               (a minute: what is no curve)
 *
 * Lines of "figure,method,x,value"; the methods are those of figure_methods.h. Here the curves; the
 * rows of one number each are in figure_rows.c.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/numerics/closed_mesh.h"
#include "tests/numerics/figure_methods.h"

/* --- Figures --------------------------------------------------------------------- */

/* Ray i of closed_ray, in the world. */
static void world_ray(const struct figure_world *w, const struct gen_mesh *m, uint64_t *state,
                      size_t i, double org[3], double dir[3])
{
    struct ray ray;
    closed_ray(m, state, i, &ray);
    for (int k = 0; k < 3; k++) {
        org[k] = ray.org[k] * w->scale + w->offset[k];
        dir[k] = ray.dir[k] * w->scale;
    }
    if (i % 3 == 2)
        return;
    /* Aim at the very point in the world, whatever rounding did to it. */
    for (int k = 0; k < 3; k++) {
        double to = (ray.org[k] + ray.dir[k]) * w->scale + w->offset[k];
        dir[k] = to - org[k];
    }
}

/* Share of rays from inside that hit nothing; vertices and edges only. More rays where there is a
 * tree to find so rare a thing. */
static void leaks(const char *figure, double x, const struct figure_world *w,
                  const struct gen_mesh *m)
{
    enum { RAYS_ALL = 6000, RAYS_TREE = 300000 };
    for (int method = 0; method < METHODS; method++) {
        uint64_t state = 41;
        size_t lost = 0, count = 0, rays = method >= EMBREE ? RAYS_TREE : RAYS_ALL;
        for (size_t i = 0; i < rays; i++) {
            double org[3], dir[3];
            world_ray(w, m, &state, i, org, dir);
            if (i % 3 == 2)
                continue;
            count++;
            lost += isinf(figure_nearest(w, (enum figure_method)method, org, dir, 0).t) != 0;
        }
        printf("%s,\"%s\",%g,%g\n", figure, figure_names[method], x, (double)lost / (double)count);
    }
}

/* Largest error of the hit's place, in radii of the ball. */
static void errors(const char *figure, double x, const struct figure_world *w,
                   const struct gen_mesh *m)
{
    enum { RAYS = 3000 };
    double worst[METHODS] = {0};
    uint64_t state = 42;
    for (size_t i = 2; i < RAYS; i += 3) {
        double org[3], dir[3], length = 0;
        world_ray(w, m, &state, i, org, dir);
        for (int k = 0; k < 3; k++)
            length += dir[k] * dir[k];
        double t = figure_truth(w, org, dir);
        for (int method = 0; method < METHODS; method++) {
            double found = figure_nearest(w, (enum figure_method)method, org, dir, 0).t;
            double off = isinf(found) ? 1 : fabs(found - t) * sqrt(length) / w->scale;
            worst[method] = fmax(worst[method], fmin(off, 1));
        }
    }
    for (int method = 0; method < METHODS; method++)
        printf("%s,\"%s\",%g,%g\n", figure, figure_names[method], x, worst[method]);
}

/* A needle of an aspect in any orientation, as floats, and a ray that grazes it. */
static void needle(uint64_t *state, double aspect, double graze, struct gen_mesh *m, double org[3],
                   double dir[3])
{
    double apex = gen_random(state), turn = gen_random(state), tilt = gen_random(state);
    double c = cos(6.28 * turn), s = sin(6.28 * turn), d = cos(6.28 * tilt), e = sin(6.28 * tilt);
    const double axis[3][3] = {{c, s * d, s * e}, {-s, c * d, c * e}, {0, -e, d}};
    double b1 = 0.1 + 0.4 * gen_random(state), b2 = 0.1 + 0.4 * gen_random(state);
    double at[2] = {b1 + b2 * apex, b2 / aspect}, from[3] = {at[0] - 2, at[1], 2 * graze};
    double e1[3], e2[3];
    from[1] -= gen_random(state);
    for (int k = 0; k < 3; k++) {
        e1[k] = axis[0][k];
        e2[k] = (apex - 1) * axis[0][k] + axis[1][k] / aspect;
        org[k] = from[0] * axis[0][k] + from[1] * axis[1][k] + from[2] * axis[2][k];
        dir[k] = at[0] * axis[0][k] + at[1] * axis[1][k] - org[k];
        org[k] = (double)(float)org[k]; /* the same for all */
        dir[k] = (double)(float)dir[k];
    }
    gen_mesh_init(m);
    if (gen_quad(m, (double[3]){0, 0, 0}, e1, e2) != ERR_OK)
        abort();
    m->triangle_count = 1;
}

/* Our kernel on the very floats that Embree gets, without the scene build, which rounds vertices
 * once more and so makes a needle another one. */
static double kernel_nearest(const struct figure_world *w, const double org[3], const double dir[3])
{
    struct accel_options options = {.builder = JOB_BUILDER_SAH};
    struct ray ray = {{org[0], org[1], org[2]}, {dir[0], dir[1], dir[2]}, 0, (double)INFINITY};
    struct accel *a;
    struct hit hit;
    if (accel_new(&w->floats.input, &options, NULL, &a) != ERR_OK)
        abort();
    accel_closest(a, &ray, &hit);
    accel_free(a);
    return hit.object == SCENE_NONE ? (double)INFINITY : hit.t;
}

/* T8: of the rays that truly meet the needle, those that miss it, and the largest error of t. */
static void needles(double aspect, double graze)
{
    enum { COUNT = 1000 };
    size_t missed[METHODS] = {0}, met = 0;
    double worst[METHODS] = {0};
    uint64_t state = 43;
    for (int i = 0; i < COUNT; i++) {
        struct gen_mesh m;
        struct figure_world w;
        double org[3], dir[3];
        needle(&state, aspect, graze, &m, org, dir);
        figure_world_make(&w, &m, 1, 0);
        double t = figure_truth(&w, org, dir);
        for (int method = 0; method < METHODS && t < 1e300; method++) {
            double found = method == OURS
                               ? kernel_nearest(&w, org, dir)
                               : figure_nearest(&w, (enum figure_method)method, org, dir, 0).t;
            if (isinf(found))
                missed[method]++;
            else
                worst[method] = fmax(worst[method], fabs(found - t) / t);
        }
        met += t < 1e300;
        figure_world_free(&w);
        gen_mesh_release(&m);
    }
    for (int method = 0; method < METHODS && met > 0; method++) {
        printf("needles missed at %g rad,\"%s\",%g,%g\n", graze, figure_names[method], aspect,
               (double)missed[method] / (double)met);
        printf("needles t error at %g rad,\"%s\",%g,%g\n", graze, figure_names[method], aspect,
               worst[method]);
    }
}

/* --- T7: the slab test alone ------------------------------------------------------ */

/* Of rays parallel to an axis that start on a plane of a box and meet it: lost by the usual forms.
 */
static void slabs(void)
{
    enum { COUNT = 200000 };
    size_t lost[2] = {0}, met = 0;
    uint64_t state = 44;
    for (int i = 0; i < COUNT; i++) {
        int axis = i % 3;
        double org[3], dir[3] = {0, 0, 0}, from[2] = {0, 0}, to[2];
        to[0] = to[1] = (double)INFINITY;
        for (int k = 0; k < 3; k++)
            org[k] = gen_random(&state);
        org[(axis + 1) % 3] = i & 8 ? 1 : 0; /* on a plane of the unit box */
        org[axis] = -1;
        dir[axis] = 1;
        for (int k = 0; k < 3; k++)
            if (dir[k] == 0 && i & 16)
                dir[k] = -0.0;
        met++;
        for (int k = 0; k < 3; k++) {
            double inverse = 1 / dir[k], a = (0 - org[k]) * inverse, b = (1 - org[k]) * inverse;
            from[0] = fmax(from[0], fmin(a, b));
            to[0] = fmin(to[0], fmax(a, b));
            double low = a < b ? a : b, high = a < b ? b : a; /* swap, then compare */
            from[1] = from[1] > low ? from[1] : low;
            to[1] = to[1] < high ? to[1] : high;
        }
        for (int form = 0; form < 2; form++)
            lost[form] += !(from[form] <= to[form]);
    }
    printf("slabs,\"fmin/fmax\",0,%g\nslabs,\"swap and compare\",0,%g\n",
           (double)lost[0] / (double)met, (double)lost[1] / (double)met);
}

int main(int argc, char **argv)
{
    struct gen_mesh ball;
    if (argc > 1 && strcmp(argv[1], "--rows") == 0) {
        figure_rows();
        return 0;
    }
    closed_make(CLOSED_ICOSPHERE, &ball);
    for (int k = -12; k <= 12; k++) {
        struct figure_world w;
        figure_world_make(&w, &ball, pow(10, k), 0);
        leaks("leaks by scale", pow(10, k), &w, &ball);
        figure_world_free(&w);
        (void)fflush(stdout);
    }
    for (int k = 0; k <= 10; k++) {
        struct figure_world w;
        figure_world_make(&w, &ball, 0.9, pow(10, k)); /* 0.9: no vertex is a float by chance */
        leaks("leaks by distance", pow(10, k), &w, &ball);
        errors("error by distance", pow(10, k), &w, &ball);
        figure_world_free(&w);
        (void)fflush(stdout);
    }
    for (int k = 0; k <= 6; k += 2) {
        needles(pow(10, k), 1e-2);
        needles(pow(10, k), 1e-4);
    }
    slabs();
    figure_rows();
    gen_mesh_release(&ball);
    return 0;
}
