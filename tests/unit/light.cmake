tilery_test(test_self_test LABEL unit LINKS tl_render
  SOURCES ${PROJECT_SOURCE_DIR}/tests/unit/test_self_test.c)
