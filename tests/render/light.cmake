set(render_kit ${PROJECT_SOURCE_DIR}/tests/render/render_kit.c)
tilery_test(test_transport LABEL render TIMEOUT 600 LINKS tl_worker
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_transport.c ${render_kit})
tilery_test(test_bsdf LABEL render TIMEOUT 300 LINKS tl_render m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_bsdf.c)
tilery_test(test_sampler LABEL render LINKS tl_render m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_sampler.c)
tilery_test(test_light LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_light.c ${render_kit})
tilery_test(test_identity LABEL render TIMEOUT 600 LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_identity.c ${render_kit})
tilery_test(test_surface LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_surface.c ${render_kit})
tilery_test(test_scene_build LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_scene_build.c ${render_kit})
