/* The rough conductor in eight directions for AVX-512: see conductor_loop.h. */
#define CONDUCTOR_LOOP conductor_loop_avx512
#include "worker/render/conductor_loop.h"
