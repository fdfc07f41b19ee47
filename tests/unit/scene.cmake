set(unit ${PROJECT_SOURCE_DIR}/tests/unit)
foreach(name json job_spec)
  tilery_test(test_${name} LABEL unit LINKS tl_common SOURCES ${unit}/test_${name}.c)
endforeach()
