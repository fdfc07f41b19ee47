/* Eight points on spheres for AVX-512: see sphere_loop.h. */
#define SPHERE_LOOP sphere_loop_avx512
#include "worker/render/sphere_loop.h"
