tilery_test(prop_frame PLAIN LABEL prop LINKS tl_proto
  SOURCES ${PROJECT_SOURCE_DIR}/tests/prop/prop_frame.c)
