set(lint ${PROJECT_SOURCE_DIR}/tests/lint)
tilery_script_test(lint_layers LABEL lint COMMAND ${lint}/layers.py ${PROJECT_SOURCE_DIR})
tilery_script_test(lint_tidy LABEL lint COMMAND ${lint}/tidy.py ${PROJECT_SOURCE_DIR})
tilery_script_test(lint_words LABEL lint COMMAND ${lint}/words.sh ${PROJECT_SOURCE_DIR})
tilery_script_test(lint_tests_exist LABEL lint
  COMMAND ${lint}/tests_exist.py ${PROJECT_SOURCE_DIR} ${PROJECT_BINARY_DIR})
tilery_script_test(lint_format LABEL lint COMMAND ${lint}/format.sh)

# The pure rooms need no symbol of sockets, files, threads, clocks, environment or libm; the
# scheduler allocates only through its arena.
set(impure "uv_.*|socket|connect|open|open64|fopen|fopen64|read|write|time|clock|clock_gettime|gettimeofday|getenv|setlocale|printf|fprintf|puts|rand|random|pthread_.*|log_write|sin|cos|tan|exp|log|pow|sinf|cosf|tanf|expf|logf|powf|acos|asin|atan|atan2|cbrt")
foreach(pure tl_render tl_sched)
  if(TARGET ${pure})
    set(forbidden "${impure}")
    if(pure STREQUAL "tl_sched")
      string(APPEND forbidden "|malloc|calloc|realloc|mem_alloc|mem_calloc|mem_alloc_array|mem_realloc_array")
    endif()
    tilery_script_test(lint_symbols_${pure} LABEL lint
      COMMAND ${lint}/symbols.sh $<TARGET_FILE:${pure}> "${forbidden}")
  endif()
endforeach()
