/* worker/render/bsdf_lobes.h: the lobes behind bsdf_eval and bsdf_sample, a file each.
 *
 * Directions and results as in bsdf.h; wo and wi as given there, already checked for
 * nothing. Any thread.
 */
#ifndef WORKER_RENDER_BSDF_LOBES_H
#define WORKER_RENDER_BSDF_LOBES_H

#include "worker/render/bsdf.h"

rgb conductor_eval(const struct bsdf *b, vec3 wo, vec3 wi, double *pdf);
/* Of BSDF_MANY wi at once, all finite; `flip` turns both sides. */
void conductor_eval_many(const struct bsdf *b, vec3 wo, bool flip, const vec3 wi[], rgb f[],
                         double pdf[]);
bool conductor_sample(const struct bsdf *b, vec3 wo, const double u[3], struct bsdf_sample *s);

rgb dielectric_eval(const struct bsdf *b, vec3 wo, vec3 wi, double *pdf);
bool dielectric_sample(const struct bsdf *b, vec3 wo, const double u[3], struct bsdf_sample *s);
rgb principled_eval(const struct bsdf *b, vec3 wo, vec3 wi, double *pdf);
bool principled_sample(const struct bsdf *b, vec3 wo, const double u[3], struct bsdf_sample *s);

/* The sheen lobe of colour 1, times cos(wi), and the part of the light it reflects. */
double principled_sheen_value(const struct material *m, vec3 wo, vec3 wi);
double principled_sheen_albedo(const struct material *m, double cosine);

/* wo mirrored at the normal (0, 0, 1). */
static inline vec3 bsdf_mirror(vec3 wo)
{
    return v3(-wo.x, -wo.y, wo.z);
}

#endif
