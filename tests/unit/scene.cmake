set(unit ${PROJECT_SOURCE_DIR}/tests/unit)
foreach(name dmath json job_spec models package pictures scene_json)
  tilery_test(test_${name} LABEL unit LINKS tl_common m SOURCES ${unit}/test_${name}.c)
endforeach()
