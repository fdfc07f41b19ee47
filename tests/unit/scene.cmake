set(unit ${PROJECT_SOURCE_DIR}/tests/unit)
foreach(name checksum dmath file_io half json job_spec models parallel pictures scene_json)
  tilery_test(test_${name} LABEL unit LINKS tl_common m SOURCES ${unit}/test_${name}.c)
endforeach()
tilery_test(test_package_late LABEL unit LINKS tl_common m SOURCES ${unit}/test_package_late.c)
tilery_test(test_package LABEL unit LINKS tl_common m
  SOURCES ${unit}/test_package.c ${unit}/made_scene.c)
tilery_script_test(scene_schema LABEL unit COMMAND ${unit}/check_schema.py ${PROJECT_SOURCE_DIR})
tilery_script_test(error_ids LABEL unit COMMAND ${unit}/check_error_ids.py ${PROJECT_SOURCE_DIR})
