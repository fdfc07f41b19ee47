/* The kernel for SSE2: see trace_kernel.h. */
#ifndef TRACE_KERNEL
#define TRACE_KERNEL trace_sse2
#endif
#define TRACE_NAME "sse2"
#include "worker/render/trace_kernel.h"
