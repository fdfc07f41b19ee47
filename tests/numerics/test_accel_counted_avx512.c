/* The avx512 kernel once more, with counters. */
#define TRACE_COUNT
#define TRACE_KERNEL counted_avx512
#include "worker/render/trace_avx512.c"
