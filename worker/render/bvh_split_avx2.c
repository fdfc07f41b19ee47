/* The builder's inner loops for AVX2: see bvh_split.h. */
#define BVH_SPLITTER bvh_split_avx2
#include "worker/render/bvh_split.h"
