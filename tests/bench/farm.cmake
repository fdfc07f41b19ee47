if(TILERY_TESTS AND TARGET tl_worker)
  tilery_program(bench_farm LINKS tl_worker SOURCES ${PROJECT_SOURCE_DIR}/tests/bench/bench_farm.c)
endif()
