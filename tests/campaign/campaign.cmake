# Faults at a chosen step of a program's disk or memory, by LD_PRELOAD: see shim.c.
if(TILERY_TESTS)
  foreach(kind "" _memory)
    add_library(tilery_shim${kind} SHARED ${PROJECT_SOURCE_DIR}/tests/campaign/shim.c)
    target_link_libraries(tilery_shim${kind} PRIVATE ${CMAKE_DL_LIBS})
    set_target_properties(tilery_shim${kind} PROPERTIES
      LIBRARY_OUTPUT_DIRECTORY ${CMAKE_RUNTIME_OUTPUT_DIRECTORY})
  endforeach()
  target_compile_definitions(tilery_shim_memory PRIVATE SHIM_MEMORY)
endif()

# Claims of an error: samples of many seeds, and what --target-error would have made of them.
if(TILERY_TESTS)
  tilery_program(claim_samples LINKS tl_worker m
    SOURCES ${PROJECT_SOURCE_DIR}/tests/campaign/claim_samples.c)
  tilery_program(claim_replay LINKS tl_master m
    SOURCES ${PROJECT_SOURCE_DIR}/tests/campaign/claim_replay.c)
endif()
tilery_script_test(claims_quick LABEL render TIMEOUT 600
  COMMAND ${PROJECT_SOURCE_DIR}/tests/campaign/claims.py --quick)
