/* The rough conductor in eight directions for AVX2: see conductor_loop.h. */
#define CONDUCTOR_LOOP conductor_loop_avx2
#include "worker/render/conductor_loop.h"
