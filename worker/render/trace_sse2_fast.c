/* The kernel for SSE2 that decides in float: see trace_leaf_fast.h. */
#define TRACE_FAST
#define TRACE_KERNEL trace_sse2_fast
#include "worker/render/trace_sse2.c"
