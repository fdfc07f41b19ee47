/* The kernel for SSE2 over compact trees: see bvh.h. */
#define TRACE_COMPACT
#define TRACE_KERNEL trace_sse2_compact
#include "worker/render/trace_sse2.c"
