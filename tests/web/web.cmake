# The page in a real browser.
if(TILERY_TESTS AND TARGET tilery-master AND NOT TILERY_SANITIZE)
  tilery_script_test(web_page LABEL web TIMEOUT 300 COMMAND ${PROJECT_SOURCE_DIR}/tests/web/run.sh)
endif()
