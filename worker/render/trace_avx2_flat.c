/* Few triangles, for AVX2: see trace_flat.h. */
#define TRACE_KERNEL trace_avx2_flat
#define TRACE_NAME   "avx2"
#include "worker/render/trace_flat.h"
