/* worker/render/outline.h: pixels that the outline of a lamp crosses.
 *
 * What such a pixel shows hangs on where in it the film point lies more than on all else, and by a
 * hundred times what its neighbours show; a few film points a sample carry most of a picture's
 * error. So each sample of such a pixel has twigs: paths from film points of their own that end
 * where the first direction drawn with a density has led them. The light up to there is the mean of
 * the path's and its twigs', what comes after is the path's alone. Which pixels those are is seen
 * from rays through their corners, the same for all samples, so the mean is that of any pixel.
 *
 * Any thread. Tests: test_outline.
 */
#ifndef WORKER_RENDER_OUTLINE_H
#define WORKER_RENDER_OUTLINE_H

#include "common/grid.h"
#include "worker/render/render_scene.h"

struct render_scratch;

/* With the path itself a power of two, so that light which is the same all over stays so bit for
 * bit. */
enum { OUTLINE_TWIGS = 3 };

/* Bit y * width + x: the outline of a lamp crosses pixel x, y of a group, which is at most
 * WAVE_GROUP_SIDE wide and high. Uses rays and hits of the scratch memory. */
uint32_t outline_pixels(const struct render_scene *scene, struct render_scratch *w,
                        struct grid_rect group);

#endif
