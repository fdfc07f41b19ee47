/* Sobol sets for AVX-512: see sampler_sobol.h. */
#define SAMPLER_SOBOL sampler_sobol_avx512
#include "worker/render/sampler_sobol.h"
