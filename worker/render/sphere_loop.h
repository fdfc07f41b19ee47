/* The body of sphere_sse2.c, sphere_avx2.c and sphere_avx512.c: eight draws of sphere_draw() in a
 * loop that becomes vectors. The including file defines SPHERE_LOOP, the function's name; the
 * instruction set is the compiler's business. */
#include "worker/render/sphere_parts.h"

void SPHERE_LOOP(vec3 p, struct sphere_batch *b)
{
    for (int i = 0; i < SPHERE_MANY; i++) {
        struct sphere_view view = {.cap = b->cap[i],
                                   .distance2 = b->distance2[i],
                                   .distance = b->distance[i],
                                   .towards = {v3(b->s[0][i], b->s[1][i], b->s[2][i]),
                                               v3(b->t[0][i], b->t[1][i], b->t[2][i]),
                                               v3(b->n[0][i], b->n[1][i], b->n[2][i])}};
        vec3 center = v3(b->center[0][i], b->center[1][i], b->center[2][i]), wi, target;
        double pdf;
        sphere_draw(&view, p, center, b->radius[i], b->error[i], b->u[i], b->v[i], &wi, &target,
                    &pdf);
        b->wi[0][i] = wi.x;
        b->wi[1][i] = wi.y;
        b->wi[2][i] = wi.z;
        b->target[0][i] = target.x;
        b->target[1][i] = target.y;
        b->target[2][i] = target.z;
        b->pdf[i] = pdf;
    }
}
