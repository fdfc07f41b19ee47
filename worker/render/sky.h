/* worker/render/sky.h: drawing directions to a sky that is a picture.
 *
 * The map is cut into cells, as fine as its picture, and the cells into a few blocks. A block is
 * drawn in proportion to its light times the mean cosine at the normal of the surface, for which
 * there is a table for each of a grid of normals over the octahedron; within the block a cell is
 * drawn in proportion to its light alone. The density is then near that of what a diffuse surface
 * reflects, visibility left out, and it is exact: a normal has the table of the nearest grid point,
 * and a block has no share only if none of it is above the horizon of any normal of that table.
 * All steps invert cumulated sums, so that strata of u and v survive.
 *
 * Positions are in the unit square of the map, x along u = phi / 2 pi, y along v = theta / pi.
 * Memory is the scene's arena; worker/scene/scene_sky.c fills it. Read-only after that; any thread.
 * Tests: test_light.
 */
#ifndef WORKER_RENDER_SKY_H
#define WORKER_RENDER_SKY_H

#include "worker/render/vec.h"

enum {
    SKY_BLOCKS_ACROSS = 32,
    SKY_BLOCKS_DOWN = 16,
    SKY_BLOCKS = SKY_BLOCKS_ACROSS * SKY_BLOCKS_DOWN,
    /* Normals along an edge of the unfolded octahedron; odd: the axes are among them. */
    SKY_GRID = 17,
    SKY_NORMALS = SKY_GRID * SKY_GRID,
    SKY_ANYWHERE = SKY_NORMALS, /* the table of surfaces that take light from all sides */
    SKY_TABLES = SKY_NORMALS + 1,
};

/* How blocks are drawn at a normal: cumulated, from 0 to 1. */
struct sky_choice {
    double row[SKY_BLOCKS_DOWN + 1];
    double column[SKY_BLOCKS_DOWN][SKY_BLOCKS_ACROSS + 1];
};

struct sky_map {
    uint32_t width, height;             /* cells */
    uint32_t block_width, block_height; /* in cells */
    const double *along; /* height rows of width + 1: weights of the cells, cumulated; all > 0 */
    const double *down;  /* SKY_BLOCKS_ACROSS columns of height + 1: those of the rows of a column
                            of blocks, cumulated */
    const struct sky_choice *choices; /* SKY_TABLES */
    double mean;                      /* luminance over the sphere */
};

/* The table of a surface that scatters to the side of the unit normal n; of SKY_ANYWHERE if n is
 * zero. */
uint32_t sky_table(vec3 n);

/* The normal of a point of the unfolded octahedron, -1 to 1 both ways. */
vec3 sky_unfolded(double x, double y);

/* A point (x, y) by u and v in [0,1); returns its density over the unit square. */
double sky_draw(const struct sky_map *m, uint32_t table, double u, double v, double *x, double *y);

/* The density with which sky_draw draws a point. */
double sky_density(const struct sky_map *m, uint32_t table, double x, double y);

#endif
