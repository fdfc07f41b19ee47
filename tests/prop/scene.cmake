tilery_test(prop_package PLAIN LABEL prop LINKS tl_common
  SOURCES ${PROJECT_SOURCE_DIR}/tests/prop/prop_package.c)
