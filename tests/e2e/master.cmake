# The master's API over HTTP, and its worker wire against scripted workers.
if(TILERY_TESTS AND TARGET tilery AND TARGET tilery-master AND TARGET tilery-worker)
  foreach(part http wire hostile disk keeps)
    tilery_script_test(master_${part} LABEL e2e TIMEOUT 600
      COMMAND /usr/bin/python3 -m pytest -q -p no:cacheprovider
              ${PROJECT_SOURCE_DIR}/tests/e2e/test_master_${part}.py)
  endforeach()
endif()
