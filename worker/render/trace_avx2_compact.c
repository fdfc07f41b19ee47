/* The kernel for AVX2 over compact trees: see bvh.h. */
#define TRACE_COMPACT
#define TRACE_KERNEL trace_avx2_compact
#include "worker/render/trace_avx2.c"
