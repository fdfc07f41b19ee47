/* worker/render/lanes.h: for which instruction set a loop that becomes vectors is to be taken.
 *
 * Such a loop is compiled once for each (conductor_loop.h, sky_loop.h, sphere_loop.h), with the
 * same bits. Any thread.
 */
#ifndef WORKER_RENDER_LANES_H
#define WORKER_RENDER_LANES_H

enum lanes_level { LANES_SSE2, LANES_AVX2, LANES_AVX512, LANES_LEVELS };

/* The widest that this processor has; it has those below, too. */
static inline enum lanes_level lanes_level(void)
{
    if (!__builtin_cpu_supports("avx2"))
        return LANES_SSE2;
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") ? LANES_AVX512
                                                                                   : LANES_AVX2;
}

#endif
