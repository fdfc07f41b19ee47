set(render_kit ${PROJECT_SOURCE_DIR}/tests/render/render_kit.c)
tilery_test(test_transport LABEL render TIMEOUT 600 LINKS tl_worker ARGS --but-rows
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_transport.c ${render_kit})
tilery_test(test_bsdf LABEL render TIMEOUT 300 LINKS tl_render m ARGS --but-rows
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_bsdf.c)
tilery_test(test_sampler LABEL render LINKS tl_render m ARGS --but-rows
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_sampler.c)
tilery_test(test_light LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_light.c ${render_kit})
tilery_test(test_identity LABEL render TIMEOUT 600 LINKS tl_worker m ARGS --but-rows
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_identity.c ${render_kit})
tilery_test(test_surface LABEL render LINKS tl_worker m ARGS --but-rows
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_surface.c ${render_kit})
tilery_test(test_trees LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_trees.c)
tilery_test(test_scene_build LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_scene_build.c ${render_kit})
tilery_test(test_opacity LABEL render TIMEOUT 300 LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_opacity.c ${render_kit})
tilery_test(test_caustics LABEL render TIMEOUT 300 LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_caustics.c ${render_kit})
tilery_test(test_outline LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_outline.c ${render_kit})
tilery_test(test_random_scenes LABEL render TIMEOUT 300 LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_random_scenes.c ${render_kit})
tilery_test(test_light_tree LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_light_tree.c ${render_kit})
tilery_test(test_next_event LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_next_event.c ${render_kit})
tilery_test(test_shade LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_shade.c ${render_kit})
tilery_test(test_texture LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_texture.c ${render_kit})
tilery_test(test_footprint LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_footprint.c ${render_kit})
tilery_test(test_integrators LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_integrators.c ${render_kit})
tilery_test(test_aov LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_aov.c ${render_kit})
tilery_test(test_mitsuba LABEL render TIMEOUT 600 LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_mitsuba.c ${render_kit})

# What of these is a row of the matrix of extremes runs by its id, under both labels.
numerics_rows(test_transport ALSO render ROWS test_t13_integrating_sphere
  test_t13_facets test_t14_furnace_random_walk test_t14_furnace_mis test_t14_furnace_nee
  test_t20_profiles_in_the_box test_t20_profiles_on_metal test_t20_sharing
  test_t20_against_reference)
numerics_rows(test_bsdf ALSO render ROWS test_t15_snell test_t16_total_reflection
  test_t18_chi2 test_t18_wrong_density_fails test_t19_reciprocity)
numerics_rows(test_sampler ALSO unit ROWS test_t22_indices) # which runs under the sanitizers
numerics_rows(test_sampler ALSO render ROWS test_t23_pairs test_t23_dropped_dimension_fails)
numerics_rows(test_identity ALSO render ROWS test_t01_scale test_t21_units test_t21_crops)
numerics_rows(test_surface ALSO render ROWS test_t09_triangles test_t09_spheres)
tilery_test(test_scene_pieces LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_scene_pieces.c ${render_kit})
tilery_test(test_scene_late LABEL render LINKS tl_worker m
  SOURCES ${PROJECT_SOURCE_DIR}/tests/render/test_scene_late.c ${render_kit})
