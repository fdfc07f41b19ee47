# Ray throughput against Embree, which only this benchmark and the oracle tests link.
find_library(EMBREE_LIBRARY embree3)
find_path(EMBREE_INCLUDE embree3/rtcore.h)
if(TILERY_TESTS AND EMBREE_LIBRARY AND EMBREE_INCLUDE)
  set(bench_dir ${PROJECT_SOURCE_DIR}/tests/bench)
  add_library(trace_peer STATIC ${bench_dir}/trace_peer.c ${bench_dir}/trace_scene.c
    ${bench_dir}/trace_agree.c ${bench_dir}/trace_judge.c
    ${PROJECT_SOURCE_DIR}/scenes/gen_mesh.c)
  target_include_directories(trace_peer SYSTEM PRIVATE ${EMBREE_INCLUDE})
  target_link_libraries(trace_peer PUBLIC tl_render ${EMBREE_LIBRARY} ${CMAKE_DL_LIBS}
    Threads::Threads m)
  tilery_program(bench_trace LINKS trace_peer
    SOURCES ${bench_dir}/bench_trace.c ${bench_dir}/trace_pool.c)
  tilery_script_test(bench_trace_arguments LABEL unit
    COMMAND ${bench_dir}/bench_trace_arguments.py $<TARGET_FILE:bench_trace>)
  tilery_program(gen_mesh LINKS tl_common
    SOURCES ${PROJECT_SOURCE_DIR}/scenes/gen_mesh.c ${PROJECT_SOURCE_DIR}/scenes/gen_mesh_main.c)
  target_link_libraries(gen_mesh PRIVATE m)
endif()
