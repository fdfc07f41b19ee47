/* The sse2 kernel once more, with counters. */
#define TRACE_COUNT
#define TRACE_KERNEL counted_sse2
#include "worker/render/trace_sse2.c"
