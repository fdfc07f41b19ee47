/* A batch of the sky for AVX-512: see sky_loop.h. */
#define SKY_DRAW sky_draw_avx512
#define SKY_LOOK sky_look_avx512
#include "worker/render/sky_loop.h"
