# Sources of the tracing core, and the instruction sets of its kernels. Included by
# ../CMakeLists.txt into the target tl_render. Nothing but the kernels' intrinsics is
# compiled for more than the baseline.
set(trace_dir ${PROJECT_SOURCE_DIR}/worker/render)
set(trace_sources
  ${trace_dir}/accel.c
  ${trace_dir}/accel_flat.c
  ${trace_dir}/accel_instance.c
  ${trace_dir}/accel_lazy.c
  ${trace_dir}/accel_trees.c
  ${trace_dir}/bvh_build.c
  ${trace_dir}/bvh_spatial.c
  ${trace_dir}/bvh_split_avx2.c
  ${trace_dir}/bvh_split_sse2.c
  ${trace_dir}/bvh_wide.c
  ${trace_dir}/conductor_avx2.c
  ${trace_dir}/conductor_avx512.c
  ${trace_dir}/conductor_sse2.c
  ${trace_dir}/sampler_sets_avx2.c
  ${trace_dir}/sampler_sets_avx512.c
  ${trace_dir}/sky_avx2.c
  ${trace_dir}/sky_avx512.c
  ${trace_dir}/sky_sse2.c
  ${trace_dir}/sphere_avx2.c
  ${trace_dir}/sphere_avx512.c
  ${trace_dir}/sphere_sse2.c
  ${trace_dir}/trace.c
  ${trace_dir}/trace_avx2.c
  ${trace_dir}/trace_avx2_compact.c
  ${trace_dir}/trace_avx2_fast.c
  ${trace_dir}/trace_avx2_flat.c
  ${trace_dir}/trace_avx512.c
  ${trace_dir}/trace_avx512_compact.c
  ${trace_dir}/trace_avx512_fast.c
  ${trace_dir}/trace_avx512_flat.c
  ${trace_dir}/trace_compress.c
  ${trace_dir}/trace_far.c
  ${trace_dir}/trace_plain.c
  ${trace_dir}/trace_sse2.c
  ${trace_dir}/trace_sse2_compact.c
  ${trace_dir}/trace_sse2_fast.c)
# gcc unrolls the loops over three axes only at -O3.
set(trace_fast $<$<CONFIG:Release>:-O3>)
set(trace_avx2_flags -mavx2 -mfma -mbmi -mbmi2 -mlzcnt -mpopcnt)
set_source_files_properties(${trace_dir}/accel.c ${trace_dir}/accel_instance.c ${trace_dir}/trace.c ${trace_dir}/trace_far.c
  ${trace_dir}/trace_sse2.c
  ${trace_dir}/trace_sse2_compact.c ${trace_dir}/trace_sse2_fast.c PROPERTIES
  COMPILE_OPTIONS "${trace_fast}")
set_source_files_properties(${trace_dir}/bvh_split_avx2.c PROPERTIES COMPILE_OPTIONS -mavx2)
set_source_files_properties(${trace_dir}/trace_avx2.c ${trace_dir}/trace_avx2_compact.c
  ${trace_dir}/trace_avx2_fast.c ${trace_dir}/trace_avx2_flat.c PROPERTIES
  COMPILE_OPTIONS "${trace_fast};${trace_avx2_flags}")
set_source_files_properties(${trace_dir}/trace_avx512.c ${trace_dir}/trace_avx512_compact.c
  ${trace_dir}/trace_avx512_fast.c ${trace_dir}/trace_avx512_flat.c PROPERTIES
  COMPILE_OPTIONS "${trace_fast};${trace_avx2_flags};-mavx512f;-mavx512vl")
set_source_files_properties(${trace_dir}/sampler_sets_avx2.c PROPERTIES COMPILE_OPTIONS
  "${trace_fast};-mavx2")
set_source_files_properties(${trace_dir}/sampler_sets_avx512.c PROPERTIES COMPILE_OPTIONS
  "${trace_fast};-mavx2;-mavx512f;-mavx512vl")
# Both sides of a choice may be worked out where only one is wanted, or there are no vectors.
set(conductor_flags "${trace_fast};-fno-trapping-math")
set_source_files_properties(${trace_dir}/conductor_sse2.c ${trace_dir}/sky_sse2.c
  ${trace_dir}/sphere_sse2.c PROPERTIES COMPILE_OPTIONS
  "${conductor_flags}")
set_source_files_properties(${trace_dir}/conductor_avx2.c ${trace_dir}/sky_avx2.c
  ${trace_dir}/sphere_avx2.c PROPERTIES COMPILE_OPTIONS
  "${conductor_flags};-mavx2")
set_source_files_properties(${trace_dir}/conductor_avx512.c ${trace_dir}/sky_avx512.c
  ${trace_dir}/sphere_avx512.c PROPERTIES COMPILE_OPTIONS
  "${conductor_flags};-mavx2;-mavx512f;-mavx512vl")
