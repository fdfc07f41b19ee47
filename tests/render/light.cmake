set(render_kit ${PROJECT_SOURCE_DIR}/tests/render/render_kit.c)
tilery_test(test_transport LABEL render LINKS tl_worker
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_transport.c ${render_kit})
tilery_test(test_bsdf LABEL render LINKS tl_render m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_bsdf.c)
