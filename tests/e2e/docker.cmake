tilery_script_test(docker_farm LABEL e2e TIMEOUT 1200
  COMMAND ${PROJECT_SOURCE_DIR}/tests/e2e/docker_farm.sh)
tilery_script_test(bare_container LABEL e2e TIMEOUT 1200
  COMMAND ${PROJECT_SOURCE_DIR}/tests/e2e/bare_container.sh)
# The asan build tests the programs, not the containers again.
if(TILERY_SANITIZE AND TILERY_TESTS)
  set_tests_properties(docker_farm bare_container PROPERTIES DISABLED TRUE)
endif()
