/* A batch of the sky for AVX2: see sky_loop.h. */
#define SKY_DRAW sky_draw_avx2
#define SKY_LOOK sky_look_avx2
#include "worker/render/sky_loop.h"
