/* The kernel for AVX512 that decides in float: see trace_leaf_fast.h. */
#define TRACE_FAST
#define TRACE_KERNEL trace_avx512_fast
#include "worker/render/trace_avx512.c"
