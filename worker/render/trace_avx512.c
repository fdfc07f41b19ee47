/* The kernel for AVX512: see trace_kernel.h. */
#ifndef TRACE_KERNEL
#define TRACE_KERNEL trace_avx512
#define TRACE_FLAT   &trace_avx512_flat
#endif
#define TRACE_NAME "avx512"
#include "worker/render/trace_kernel.h"
