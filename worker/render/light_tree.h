/* worker/render/light_tree.h: choosing one of many lights by where it is and where it shines.
 *
 * After Conty and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree
 * Splitting" (without the splitting), with the bounds on angles of pbrt-v4, 12.6.3: a
 * binary tree over the lights that have a place; a node knows the sphere about its lights,
 * the cone of their axes, how far from an axis they shine, and their intensity. A light
 * is drawn by walking down in proportion to a bound-like estimate of what each child
 * sends to the point. It is 0 only where nothing can arrive, so every light that
 * counts can be drawn; with equal arguments, light_tree_probability is the probability with
 * which light_tree_draw gives a light.
 *
 * Read-only after the build (worker/scene/scene_light_tree.c); any thread. Tests: test_light_tree.
 */
#ifndef WORKER_RENDER_LIGHT_TREE_H
#define WORKER_RENDER_LIGHT_TREE_H

#include <stddef.h>
#include <stdint.h>

#include "worker/render/vec.h"

struct light_node {
    vec3 center; /* of the sphere about the lights */
    double radius, radius2;
    vec3 axis;           /* of the cone of the lights' axes */
    double cos_o, sin_o; /* its half angle; cos_o -1: all directions */
    double cos_e;        /* nothing shines further from its own axis than this */
    double intensity;    /* sum over the lights, along their axes */
    uint32_t parent;     /* of the root: itself */
    uint32_t right;      /* second child; the first is the next node. 0: a leaf */
    uint32_t light;      /* of a leaf: index in the table of lights */
};

struct light_tree {
    const struct light_node *nodes; /* the root first; NULL: no tree */
    const uint32_t *leaf_of;        /* by light; UINT32_MAX: not in the tree */
    double probability;             /* that the light drawn is one of the tree's */
};

/* A light for the point p on a surface that scatters to the side of the unit normal n, or anywhere
 * if n is zero; its index, or UINT32_MAX where none sends anything. *probability: with which u
 * uniform in [0,1) gives it. */
uint32_t light_tree_draw(const struct light_tree *t, vec3 p, vec3 n, double u, double *probability);

/* The same for several u in ascending order, at most LIGHT_TREE_DRAWS_MAX: each gets the bits that
 * it gets alone, but what a node sends is worked out once. */
enum { LIGHT_TREE_DRAWS_MAX = 8 };
void light_tree_draw_many(const struct light_tree *t, vec3 p, vec3 n, uint32_t count,
                          const double u[], uint32_t lights[], double probabilities[]);

/* 0 for a light that is not in the tree. */
double light_tree_probability(const struct light_tree *t, uint32_t light, vec3 p, vec3 n);

#endif
