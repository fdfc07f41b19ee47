#include "worker/render/sky_batch.h"

/* The widest of three that this processor has. */
static sky_loop *loop_of_cpu(sky_loop *avx512, sky_loop *avx2, sky_loop *sse2)
{
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl"))
        return avx512;
    return __builtin_cpu_supports("avx2") ? avx2 : sse2;
}

void sky_batch_draw(const struct environment *e, struct sky_batch *b)
{
    loop_of_cpu(sky_draw_avx512, sky_draw_avx2, sky_draw_sse2)(e, b);
}

void sky_batch_look(const struct environment *e, struct sky_batch *b)
{
    loop_of_cpu(sky_look_avx512, sky_look_avx2, sky_look_sse2)(e, b);
}
