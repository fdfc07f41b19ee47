# Rays made ready as the kernels for AVX2 do it.
set(trace_ready ${PROJECT_SOURCE_DIR}/tests/unit/test_trace_ready)
set_source_files_properties(${trace_ready}_exact.c ${trace_ready}_fast.c PROPERTIES COMPILE_OPTIONS
  "-mavx2;-mfma;-mbmi;-mbmi2;-mlzcnt;-mpopcnt")
tilery_test(test_trace_ready LABEL unit LINKS tl_render m
  SOURCES ${trace_ready}.c ${trace_ready}_exact.c ${trace_ready}_fast.c)
