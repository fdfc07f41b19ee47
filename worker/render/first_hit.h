/* worker/render/first_hit.h: what camera rays meet first, for the AOVs of a job (common/aov.h).
 *
 * Values of kind MEAN come with the samples of a wave: every path's, weighed and added by
 * render_unit as its radiance is. Those of kind CENTRE come once per pixel, from a ray of
 * their own through its middle and the middle of the lens, with no random number: so they
 * depend on the scene and the picture's size alone. A surface that alpha leaves under half
 * opaque is no first surface for that ray; a sample's path has drawn by opacity already.
 *
 * Where a ray meets nothing, everything is 0. Values beyond float become 0 too. One thread.
 * Tests: test_aov.
 */
#ifndef WORKER_RENDER_FIRST_HIT_H
#define WORKER_RENDER_FIRST_HIT_H

#include "worker/render/wave.h"

/* Sets w->means[i], i < path_count, from w->hits of the camera rays: the planes of kind MEAN
 * in the order of the table. */
void first_hit_means(const struct render_scene *scene, struct render_scratch *w);

/* Writes the planes of kind CENTRE of a rectangle of the full picture, row by row, from
 * planes[k * plane_pixels + place] on. Uses the rays of `w`. */
void first_hit_centres(const struct render_scene *scene, struct render_scratch *w,
                       struct grid_rect rect, float *planes, uint64_t plane_pixels, uint64_t place);

#endif
