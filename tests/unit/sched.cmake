foreach(name test_sched_parts test_sched_eta)
  tilery_test(${name} LABEL unit LINKS tl_sched
    SOURCES ${PROJECT_SOURCE_DIR}/tests/unit/${name}.c)
endforeach()
if(TARGET test_sched_eta)
  target_link_libraries(test_sched_eta PRIVATE m)
endif()
