# After every room: the plan is made by the client and judged by the worker's pictures.
tilery_test(test_plan LABEL render TIMEOUT 300 LINKS tl_client tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_plan.c ${render_kit})
