# The matrix of extremes (docs/NUMERICS.md): every row a test of its own, by its id.
#
# numerics_rows(PROGRAM [ALSO label] ROWS case...): each case of the program as a test; with ALSO it
# counts under that label too. The program runs what is no row under its own name.
function(numerics_rows program)
  cmake_parse_arguments(arg "" "ALSO;TIMEOUT" "ROWS" ${ARGN})
  if(NOT TILERY_TESTS OR NOT TARGET ${program})
    return()
  endif()
  if(NOT arg_TIMEOUT)
    set(arg_TIMEOUT 300)
  endif()
  foreach(row ${arg_ROWS})
    add_test(NAME ${row} COMMAND ${program} ${row} WORKING_DIRECTORY ${PROJECT_SOURCE_DIR})
    set_tests_properties(${row} PROPERTIES LABELS "numerics;${arg_ALSO}" TIMEOUT ${arg_TIMEOUT})
  endforeach()
endfunction()

# numerics_program(NAME LINKS lib... SOURCES file... ROWS case...): a program of nothing but rows.
function(numerics_program name)
  cmake_parse_arguments(arg "" "" "LINKS;SOURCES;ROWS" ${ARGN})
  if(NOT TILERY_TESTS)
    return()
  endif()
  add_executable(${name} ${arg_SOURCES})
  target_link_libraries(${name} PRIVATE tilery_flags ${arg_LINKS} PkgConfig::cmocka m)
  numerics_rows(${name} ROWS ${arg_ROWS})
endfunction()

set(numerics_dir ${PROJECT_SOURCE_DIR}/tests/numerics)
set(numerics_kit ${PROJECT_SOURCE_DIR}/tests/prop/test_accel_kit.c
  ${PROJECT_SOURCE_DIR}/tests/bench/trace_scene.c ${PROJECT_SOURCE_DIR}/scenes/gen_mesh.c)
numerics_program(test_rows_watertight LINKS tl_render Threads::Threads
  SOURCES ${numerics_dir}/test_rows_watertight.c ${numerics_dir}/closed_mesh.c ${numerics_kit}
  ROWS test_t05_leaks test_t05_instances test_t06_lattice test_t07_boxes test_t07_kernels test_t07_no_rays
       test_t08_needles)
set(numerics_scenes ${PROJECT_SOURCE_DIR}/tests/render/render_kit.c)
numerics_program(test_rows_degenerate LINKS tl_worker Threads::Threads
  SOURCES ${numerics_dir}/test_rows_degenerate.c ${numerics_kit} ${numerics_scenes}
  ROWS test_t10_degenerates test_t10_coincident_centres test_t10_none_and_one test_t11_shrinking
       test_t11_clusters test_t12_numbers_stay test_t12_pictures)
numerics_program(test_rows_glass LINKS tl_worker
  SOURCES ${numerics_dir}/test_rows_glass.c ${numerics_scenes}
  ROWS test_t15_slab test_t15_index_one_is_air test_t17_nested_dielectrics test_t17_shared_faces
       test_t22_blocks test_t22_samples)
if(TILERY_TESTS) # also unit: what runs under the sanitizers
  set_tests_properties(test_t22_blocks test_t22_samples PROPERTIES LABELS "numerics;unit")
endif()
numerics_program(test_regressions LINKS tl_worker Threads::Threads
  SOURCES ${numerics_dir}/test_regressions.c ${numerics_dir}/closed_mesh.c ${numerics_kit}
          ${numerics_scenes}
  ROWS test_embree_387_t_within_the_triangle test_embree_423_every_kernel_agrees
       test_mitsuba3_1149_no_light_through_the_diagonal test_mitsuba3_550_emitter_at_right_angles
       test_mitsuba3_1888_no_repeats_beyond_32_bits test_mitsuba_184_threads_change_no_bit
       test_pbrt4_249_huge_triangle test_pbrt4_313_u_all_but_one
       test_pbrt3_182_coincident_centroids test_pbrt3_236_no_structure_in_high_dimensions
       test_povray_469_no_farthest_distance test_moonray_251_degenerate_light_faces
       test_blender_43835_decals_far_out test_fixed_stacks)
numerics_program(test_regressions_light LINKS tl_worker Threads::Threads
  SOURCES ${numerics_dir}/test_regressions_light.c ${numerics_kit} ${numerics_scenes}
  ROWS test_mitsuba3_219_lens_far_from_the_origin
       test_mitsuba3_1871_surfaces_closer_than_an_epsilon
       test_mitsuba2_206_what_enters_a_cube_leaves_it test_mitsuba3_512_no_rings_from_far_away
       test_tinybvh_283_small_triangles test_mitsuba2_82_many_samples_do_not_drift)
numerics_program(test_beyond LINKS tl_worker
  SOURCES ${numerics_dir}/test_beyond.c ${numerics_dir}/closed_mesh.c ${numerics_scenes}
          ${PROJECT_SOURCE_DIR}/scenes/gen_mesh.c
  ROWS test_beyond_tiny_lamp test_beyond_inside_glass test_beyond_almost_air
       test_beyond_dim_beside_bright test_beyond_many_samples test_beyond_panorama_poles
       test_beyond_one_bright_texel test_beyond_wide_view test_beyond_wide_lens
       test_beyond_conductor_indices test_beyond_screw_on_a_planet
       test_beyond_screws_of_any_size test_beyond_layers_scatter test_beyond_layers_in_pictures)

# What other methods make of the rows; plot.py draws it.
if(TARGET trace_peer)
  tilery_program(numerics_figures LINKS trace_peer tl_worker
    SOURCES ${numerics_dir}/numerics_figures.c ${numerics_dir}/figure_rows.c
      ${numerics_dir}/figure_methods.c ${numerics_dir}/figure_fma.c ${numerics_dir}/closed_mesh.c
      ${numerics_scenes})
  set_source_files_properties(${numerics_dir}/figure_fma.c PROPERTIES
    COMPILE_OPTIONS "-mfma;-ffp-contract=fast")
endif()

# Rows through the programs: numerics_pytest(FILE ROW...) runs the functions whose names begin so.
function(numerics_pytest file)
  foreach(row ${ARGN})
    tilery_script_test(${row} LABEL numerics TIMEOUT 600
      COMMAND /usr/bin/python3 -m pytest -q -p no:cacheprovider ${numerics_dir}/${file} -k ${row})
  endforeach()
endfunction()

if(TARGET tilery AND TARGET tilery-master AND TARGET tilery-worker)
  tilery_script_test(numerics_doctor LABEL numerics TIMEOUT 300
    COMMAND /usr/bin/python3 -m pytest -q -p no:cacheprovider -k "not test_t04"
            ${numerics_dir}/test_numerics_doctor.py)
  tilery_script_test(numerics_meshes LABEL numerics TIMEOUT 300
    COMMAND /usr/bin/python3 -m pytest -q -p no:cacheprovider
            ${numerics_dir}/test_numerics_meshes.py)
  if(TILERY_TESTS) # also e2e: what runs under the sanitizers
    set_tests_properties(numerics_doctor numerics_meshes PROPERTIES LABELS "numerics;e2e")
  endif()
  numerics_pytest(test_numerics_doctor.py test_t04_lost_precision_is_said)
  tilery_script_test(numerics_input LABEL numerics TIMEOUT 600
    COMMAND /usr/bin/python3 -m pytest -q -p no:cacheprovider -k "not test_t10"
            ${numerics_dir}/test_numerics_input.py)
  tilery_script_test(numerics_everywhere LABEL numerics TIMEOUT 1500
    COMMAND /usr/bin/python3 -m pytest -q -p no:cacheprovider
            ${numerics_dir}/test_numerics_everywhere.py)
  if(TILERY_TESTS)
    set_tests_properties(numerics_everywhere PROPERTIES LABELS "numerics;e2e")
  endif()
  numerics_pytest(test_numerics_farm.py test_t01_scale_by_the_farm test_t02_radiance_by_the_farm
    test_t02_half_is_clamped_and_said test_t03_powers_of_ten test_t04_translated_by_the_farm
    test_t04_dyadic_by_the_farm test_t22_last_pixels_by_the_farm)
  tilery_script_test(numerics_flip LABEL numerics TIMEOUT 600
    COMMAND ${numerics_dir}/flip_peer.py)
  numerics_pytest(test_numerics_input.py test_t10_bad_vertex_is_named_obj
    test_t10_bad_vertex_is_named_ply)
endif()
