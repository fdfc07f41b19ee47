/* worker/render/sky_batch.h: a sky that is a picture, for many directions at once.
 *
 * One direction after the other waits for the tables: each step of a search for the line that the
 * last one asked for. A batch goes through its searches side by side, and its angles in vectors,
 * with the bits of environment_radiance() and light_sample() for one. The loops are compiled for
 * each instruction set (sky_loop.h). Any thread. Tests: test_light.
 */
#ifndef WORKER_RENDER_SKY_BATCH_H
#define WORKER_RENDER_SKY_BATCH_H

#include "worker/render/light.h"

enum { SKY_BATCH = 16 };

/* A lane each; in those that nobody reads n and w may be any numbers, x and y in [0,1). */
struct sky_batch {
    double n[3][SKY_BATCH];            /* normals as for light_sample, scene space */
    double w[3][SKY_BATCH];            /* unit directions, scene space */
    double x[SKY_BATCH], y[SKY_BATCH]; /* the points of the map that lie there */
    double pdf[SKY_BATCH];             /* per steradian */
    double density[SKY_BATCH];         /* over the square of the map */
    uint32_t table[SKY_BATCH];
};

typedef void sky_loop(const struct environment *e, struct sky_batch *b);
sky_loop sky_draw_sse2, sky_draw_avx2, sky_draw_avx512;
sky_loop sky_look_sse2, sky_look_avx2, sky_look_avx512;

/* From n and the numbers u in x and v in y to w, x, y and pdf; pdf is 0 where nothing arrives from
 * there. */
void sky_batch_draw(const struct environment *e, struct sky_batch *b);

/* From n and w to x, y and pdf. */
void sky_batch_look(const struct environment *e, struct sky_batch *b);

#endif
