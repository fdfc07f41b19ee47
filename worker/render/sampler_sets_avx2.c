/* Sobol and Halton sets for AVX2: see sampler_lanes.h. */
#define SAMPLER_SOBOL  sampler_sobol_avx2
#define SAMPLER_HALTON sampler_halton_avx2
#include "worker/render/sampler_lanes.h"
