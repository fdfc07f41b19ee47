/* The rough conductor in eight directions for SSE2: see conductor_loop.h. */
#define CONDUCTOR_LOOP conductor_loop_sse2
#include "worker/render/conductor_loop.h"
