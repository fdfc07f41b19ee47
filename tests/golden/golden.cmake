if(TARGET tl_worker)
  tilery_test(test_golden PLAIN LABEL golden LINKS tl_worker
    SOURCES ${PROJECT_SOURCE_DIR}/tests/golden/test_golden.c)
endif()
