/* Sobol sets for AVX2: see sampler_sobol.h. */
#define SAMPLER_SOBOL sampler_sobol_avx2
#include "worker/render/sampler_sobol.h"
