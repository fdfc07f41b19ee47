/* Eight points on spheres for AVX2: see sphere_loop.h. */
#define SPHERE_LOOP sphere_loop_avx2
#include "worker/render/sphere_loop.h"
