/* worker/render/sampler.h: the numbers that place a sample, without any state.
 *
 * value = f(seed, pixel, half, index in half, set, position in the set). Dimensions
 * come in sets of four that belong together (a film point and a lens point; a light
 * point and a bsdf direction); a set is jointly stratified over the samples of a
 * pixel's half. Halves, pixels, seeds and sets are scrambled independently of each
 * other. Values are in [0, 1), never 1. Indices have 64 bits.
 *
 * sobol: the first four Sobol dimensions, Owen-scrambled by hashing (Laine and Karras
 * 2011; Burley, JCGT 9:4, 2020), with the index shuffled anew for each set, so that
 * there is no last dimension. Each run of 2^16 indices is a net; each run of 2^32 is
 * scrambled anew.
 * halton: radical inverses in the first 256 primes with hashed digit permutations that
 * depend on the digits above (Owen); from dimension 256 on as independent.
 * independent: hashed.
 *
 * Pure; any thread. Tests: test_sampler.
 */
#ifndef WORKER_RENDER_SAMPLER_H
#define WORKER_RENDER_SAMPLER_H

#include "common/job_spec.h"

struct sampler {
    uint64_t key;   /* of seed, pixel and half */
    uint64_t index; /* in the half */
    enum job_sampler type;
};

enum { SAMPLER_SET_VALUES = 4, SAMPLER_HALTON_DIMENSIONS = 256 };

/* x and y in the full picture. */
struct sampler sampler_of(enum job_sampler type, uint64_t seed, uint32_t x, uint32_t y,
                          uint32_t half, uint64_t index);

/* The first `count` values of a set, at most four. */
void sampler_some(const struct sampler *s, uint32_t set, uint32_t count, double u[]);

/* The four values of a set. */
void sampler_set(const struct sampler *s, uint32_t set, double u[SAMPLER_SET_VALUES]);

/* The first `values` values of a set of many samplers of one type, in vectors where the CPU has
 * them: u[k][i] is value k of s[i], the bits that sampler_some gives. u[0] to u[3] have room for
 * `count`; those from `values` on may be written, too. */
void sampler_sets(const struct sampler s[], uint32_t count, uint32_t set, uint32_t values,
                  double *const u[SAMPLER_SET_VALUES]);

/* A 64-bit mixing function: every input bit changes half of the output bits. */
static inline uint64_t sampler_mix(uint64_t v)
{
    v ^= v >> 32;
    v *= UINT64_C(0xe9846af9b1a615d);
    v ^= v >> 32;
    v *= UINT64_C(0xe9846af9b1a615d);
    v ^= v >> 28;
    return v;
}

#endif
