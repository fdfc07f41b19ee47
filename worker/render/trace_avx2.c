/* The kernel for AVX2: see trace_kernel.h. */
#ifndef TRACE_KERNEL
#define TRACE_KERNEL trace_avx2
#define TRACE_FLAT   &trace_avx2_flat
#endif
#define TRACE_NAME "avx2"
#include "worker/render/trace_kernel.h"
