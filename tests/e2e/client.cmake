# The programs as people use them, driven by pytest.
if(TILERY_TESTS AND TARGET tilery AND TARGET tilery-master AND TARGET tilery-worker)
  find_program(TILERY_PYTEST_PYTHON NAMES python3 PATHS /usr/bin NO_DEFAULT_PATH REQUIRED)
  foreach(part render input farm faults proxy campaign terminal rude tls tradeoff adaptive tags late)
    tilery_script_test(e2e_${part} LABEL e2e TIMEOUT 900
      COMMAND ${TILERY_PYTEST_PYTHON} -m pytest -q -p no:cacheprovider
              ${PROJECT_SOURCE_DIR}/tests/e2e/test_e2e_${part}.py)
  endforeach()
  tilery_script_test(e2e_docs LABEL e2e TIMEOUT 900
    COMMAND ${TILERY_PYTEST_PYTHON} -m pytest -q -p no:cacheprovider
            ${PROJECT_SOURCE_DIR}/tests/e2e/test_e2e_docs.py)
  if(TILERY_SANITIZE)
    set_tests_properties(e2e_docs PROPERTIES DISABLED TRUE) # minutes, and nothing of its own to find
  endif()
endif()
