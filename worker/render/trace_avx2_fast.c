/* The kernel for AVX2 that decides in float: see trace_leaf_fast.h. */
#define TRACE_FAST
#define TRACE_KERNEL trace_avx2_fast
#include "worker/render/trace_avx2.c"
