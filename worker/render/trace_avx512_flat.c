/* Few triangles, for AVX512: see trace_flat.h. */
#define TRACE_KERNEL trace_avx512_flat
#define TRACE_NAME   "avx512"
#include "worker/render/trace_flat.h"
