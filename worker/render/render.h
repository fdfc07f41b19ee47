/* worker/render/render.h: render_unit(), the one pixel loop of the whole program.
 *
 * The farm, `tilery render`, the tests and the benchmarks all call it. A pixel
 * sample is a pure function of (scene, job spec, x, y, half, sample index), so any
 * worker gives the same bits. Input: a built scene and a unit (a run of cells
 * times one sample block). Output: the block's sums per pixel and counters. No
 * sockets, threads, files, clock, environment, locale, logging or malloc; but trees that
 * wait for their first ray are built here (accel_lazy.h).
 */
#ifndef WORKER_RENDER_RENDER_H
#define WORKER_RENDER_RENDER_H

#include <stdatomic.h>

#include "common/grid.h"

struct render_scene; /* made by worker/scene (scene_build.h), read-only from then on */

struct render_counters {
    uint64_t samples, rays; /* rays: camera, bounce and shadow rays cast */
    uint64_t nonfinite;     /* samples beyond float, counted as zero radiance */
    uint64_t
        nonfinite_pixel; /* y * width + x in the full picture, of the first; UINT64_MAX: none */
    uint64_t nonfinite_sample; /* its job_sample_number */
};

/* Memory of one render thread. */
struct render_scratch; /* opaque */
TL_NODISCARD enum err render_scratch_new(struct render_scratch **out);
void render_scratch_free(struct render_scratch *s);

/* So many late pictures and pieces of such are noted in one run of a unit; what else it lacks, the
 * next run finds. */
enum { RENDER_LACKS_MAX = 256 };

/* Renders one unit. `grid` and the spec inside `scene` are of the same job. `out` has
 * job_plane_count planes of grid_pixels(unit) floats: sums of radiance over the block's
 * samples, made in double, rounded once, then the AOVs' (aov.h), which change no bit of it. Sets
 * the thread's MXCSR for its time (round to nearest, no flush to zero). Returns ERR_CANCELLED soon
 * after *stop (may be NULL) became true, and ERR_NOMEM when a tree that a ray met could not be
 * built, ERR_NOT_FOUND when paths met pictures that are not there yet (render_lacks); then `out` is
 * garbage. From the first of these on, only one sample of each group is followed, to find the
 * others. */
TL_NODISCARD enum err render_unit(const struct render_scene *scene, const struct grid *grid,
                                  struct unit unit, struct render_scratch *scratch,
                                  const atomic_bool *stop, float *out,
                                  struct render_counters *counters);

/* What the unit lacked which has just ended with ERR_NOT_FOUND: pictures, as numbers of the scene's
 * images, and pieces of pictures, numbered behind them (scene_late.h); at least one, each once.
 * Valid until the scratch memory is used again. */
size_t render_lacks(const struct render_scratch *s, const uint32_t **numbers);

/* The bits of a start-up self-test of everything that decides bits (tracing, samplers, BSDFs,
 * transcendentals): part of the determinism id. */
TL_NODISCARD enum err render_self_test(struct render_scratch *scratch, unsigned char out[32]);

#endif
