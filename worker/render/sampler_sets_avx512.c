/* Sobol and Halton sets for AVX-512: see sampler_lanes.h. */
#define SAMPLER_SOBOL  sampler_sobol_avx512
#define SAMPLER_HALTON sampler_halton_avx512
#include "worker/render/sampler_lanes.h"
