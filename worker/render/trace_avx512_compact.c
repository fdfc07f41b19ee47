/* The kernel for AVX512 over compact trees: see bvh.h. */
#define TRACE_COMPACT
#define TRACE_KERNEL trace_avx512_compact
#include "worker/render/trace_avx512.c"
