# Models: made here, the test data's, and damaged ones.
if(TILERY_TESTS AND TARGET tilery AND TARGET tilery-master AND TARGET tilery-worker)
  tilery_script_test(e2e_import LABEL e2e TIMEOUT 300
    COMMAND /usr/bin/python3 -m pytest -q -p no:cacheprovider
            ${PROJECT_SOURCE_DIR}/tests/e2e/test_import.py)
  tilery_script_test(import_models LABEL e2e TIMEOUT 1800
    COMMAND /usr/bin/python3 ${PROJECT_SOURCE_DIR}/tests/e2e/import_models.py)
  tilery_script_test(import_bad LABEL e2e TIMEOUT 600
    COMMAND /usr/bin/python3 ${PROJECT_SOURCE_DIR}/tests/e2e/import_bad.py)
endif()
