/* worker/render/sampler_parts.h: the kernels behind sampler_sets(), and which of them run here.
 *
 * A kernel gives the values of its sampler, the bits of sampler_set(), for the first so many of `s`
 * as it returns: whole vectors, up to the first index beyond 2^16. Any thread. Tests: test_sampler.
 */
#ifndef WORKER_RENDER_SAMPLER_PARTS_H
#define WORKER_RENDER_SAMPLER_PARTS_H

#include <stdbool.h>
#include <string.h>

#include "worker/render/sampler.h"

/* u[k][i]: value k of s[i]. */
uint32_t sampler_sobol_avx2(const struct sampler s[], uint32_t count, uint32_t set,
                            double *const u[]);
uint32_t sampler_sobol_avx512(const struct sampler s[], uint32_t count, uint32_t set,
                              double *const u[]);

/* u[i]: the dimension of s[i]; `base` is its prime. */
uint32_t sampler_halton_avx2(const struct sampler s[], uint32_t count, uint32_t dimension,
                             uint32_t base, double u[]);
uint32_t sampler_halton_avx512(const struct sampler s[], uint32_t count, uint32_t dimension,
                               uint32_t base, double u[]);

static inline bool sampler_has_avx2(void)
{
    return __builtin_cpu_supports("avx2");
}

static inline bool sampler_has_avx512(void)
{
    return sampler_has_avx2() && __builtin_cpu_supports("avx512f") &&
           __builtin_cpu_supports("avx512vl");
}

#endif
