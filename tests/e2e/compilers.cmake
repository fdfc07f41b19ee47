tilery_script_test(compilers LABEL e2e COMMAND ${PROJECT_SOURCE_DIR}/tests/e2e/compilers.sh)
if(TILERY_SANITIZE AND TILERY_TESTS)
  set_tests_properties(compilers PROPERTIES DISABLED TRUE)
endif()
