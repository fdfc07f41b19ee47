# The worker against a scripted master.
if(TILERY_TESTS AND TARGET tilery-worker)
  tilery_program(wire_fixture LINKS tl_worker
    SOURCES ${PROJECT_SOURCE_DIR}/tests/e2e/wire_fixture.c
            ${PROJECT_SOURCE_DIR}/tests/render/render_kit.c)
  tilery_script_test(worker_wire LABEL e2e TIMEOUT 300
    COMMAND /usr/bin/python3 ${PROJECT_SOURCE_DIR}/tests/e2e/test_worker_wire.py)
endif()
