/* A batch of the sky for SSE2: see sky_loop.h. */
#define SKY_DRAW sky_draw_sse2
#define SKY_LOOK sky_look_sse2
#include "worker/render/sky_loop.h"
