# Pictures: seconds to a given error.
if(TILERY_TESTS)
  tilery_program(bench_render LINKS tl_worker Threads::Threads m
    SOURCES ${PROJECT_SOURCE_DIR}/tests/bench/bench_render.c
      ${PROJECT_SOURCE_DIR}/tests/bench/render_peer.c)
endif()
