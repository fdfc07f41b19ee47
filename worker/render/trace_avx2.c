/* The kernel for AVX2: see trace_kernel.h. */
#ifndef TRACE_KERNEL
#define TRACE_KERNEL trace_avx2
#endif
#define TRACE_NAME "avx2"
#include "worker/render/trace_kernel.h"
