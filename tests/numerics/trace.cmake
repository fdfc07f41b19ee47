# The tracing core against Embree and __float128; `test_accel_oracle --long` takes hours.
if(TARGET trace_peer)
  set(counted ${PROJECT_SOURCE_DIR}/tests/numerics/test_accel_counted)
  set(counted_avx2_flags -mavx2 -mfma -mbmi -mbmi2 -mlzcnt -mpopcnt)
  set_source_files_properties(${counted}_avx2.c PROPERTIES COMPILE_OPTIONS "${counted_avx2_flags}")
  set_source_files_properties(${counted}_avx512.c PROPERTIES
    COMPILE_OPTIONS "${counted_avx2_flags};-mavx512f;-mavx512vl")
  tilery_test(test_accel_oracle LABEL numerics TIMEOUT 300 LINKS trace_peer
    SOURCES ${PROJECT_SOURCE_DIR}/tests/numerics/test_accel_oracle.c
      ${PROJECT_SOURCE_DIR}/tests/prop/test_accel_kit.c
      ${counted}_sse2.c ${counted}_avx2.c ${counted}_avx512.c)
endif()
