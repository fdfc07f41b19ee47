# The tracing core against brute force; `test_accel --long` takes about twenty minutes on two cores.
set(trace_kit ${PROJECT_SOURCE_DIR}/tests/prop/test_accel_kit.c
  ${PROJECT_SOURCE_DIR}/tests/bench/trace_scene.c ${PROJECT_SOURCE_DIR}/scenes/gen_mesh.c)
tilery_test(test_accel LABEL prop TIMEOUT 300 LINKS tl_render Threads::Threads m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/prop/test_accel.c ${trace_kit})
# Trees built when a ray first meets them.
tilery_test(test_accel_lazy LABEL prop TIMEOUT 300 LINKS tl_render Threads::Threads m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/prop/test_accel_lazy.c ${trace_kit})
# Instances of every shape.
tilery_test(test_accel_stretched LABEL prop TIMEOUT 300 LINKS tl_render Threads::Threads m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/prop/test_accel_stretched.c ${trace_kit})
# Hits where spatial splits need them.
tilery_test(test_accel_split LABEL prop TIMEOUT 300 LINKS tl_render Threads::Threads m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/prop/test_accel_split.c ${trace_kit})
