/* worker/render/bsdf_lobes.h: the lobes behind bsdf_eval and bsdf_sample, a file each.
 *
 * Directions and results as in bsdf.h; wo and wi as given there, already checked for
 * nothing. Any thread.
 */
#ifndef WORKER_RENDER_BSDF_LOBES_H
#define WORKER_RENDER_BSDF_LOBES_H

#include "worker/render/bsdf.h"

rgb conductor_eval(const struct bsdf *b, vec3 wo, vec3 wi, double *pdf);
bool conductor_sample(const struct bsdf *b, vec3 wo, const double u[3], struct bsdf_sample *s);

/* wo mirrored at the normal (0, 0, 1). */
static inline vec3 bsdf_mirror(vec3 wo)
{
    return v3(-wo.x, -wo.y, wo.z);
}

#endif
