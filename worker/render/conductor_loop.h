/* The body of conductor_sse2.c, conductor_avx2.c and conductor_avx512.c: eight directions of
 * conductor_value() in a loop that becomes vectors. The including file defines CONDUCTOR_LOOP, the
 * function's name; the instruction set is the compiler's business. */
#include "worker/render/conductor_parts.h"

/* Without a copy of its own, and the promise that nothing else is `batch`, gcc makes no vectors. */
static inline void loop(const struct conductor *from, enum scene_distribution distribution,
                        struct conductor_batch *restrict batch)
{
    const struct conductor c = *from;
    for (int i = 0; i < BSDF_MANY; i++) {
        double f[3];
        vec3 wi = v3(batch->x[i], batch->y[i], batch->z[i]);
        batch->pdf[i] = conductor_value(&c, distribution, wi, f);
        batch->f[0][i] = f[0];
        batch->f[1][i] = f[1];
        batch->f[2][i] = f[2];
    }
}

void CONDUCTOR_LOOP(const struct conductor *c, enum scene_distribution distribution,
                    struct conductor_batch *batch)
{
    if (distribution == SCENE_GGX)
        loop(c, SCENE_GGX, batch);
    else
        loop(c, SCENE_BECKMANN, batch);
}
