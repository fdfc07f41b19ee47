/* The avx2 kernel once more, with counters. */
#define TRACE_COUNT
#define TRACE_KERNEL counted_avx2
#include "worker/render/trace_avx2.c"
