/* The builder's inner loops for SSE2: see bvh_split.h. */
#define BVH_SPLITTER bvh_split_sse2
#include "worker/render/bvh_split.h"
