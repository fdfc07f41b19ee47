# Sources of the tracing core, and the instruction sets of its kernels. Included by
# ../CMakeLists.txt into the target tl_render.
set(trace_sources
  ${PROJECT_SOURCE_DIR}/worker/render/accel.c
  ${PROJECT_SOURCE_DIR}/worker/render/bvh_build.c
  ${PROJECT_SOURCE_DIR}/worker/render/bvh_wide.c
  ${PROJECT_SOURCE_DIR}/worker/render/trace.c
  ${PROJECT_SOURCE_DIR}/worker/render/trace_plain.c)
