/* Eight points on spheres for SSE2: see sphere_loop.h. */
#define SPHERE_LOOP sphere_loop_sse2
#include "worker/render/sphere_loop.h"
