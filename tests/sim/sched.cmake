# The simulated farm over the production objects of scheduler, wire and journal.
set(sim ${PROJECT_SOURCE_DIR}/tests/sim)
set(sim_main ${sim}/sim_main.c)
if(TILERY_TESTS)
  add_library(sim_core STATIC ${sim}/sim.c ${sim}/sim_book.c ${sim}/sim_master.c ${sim}/sim_net.c
    ${sim}/sim_worker.c ${PROJECT_SOURCE_DIR}/master/journal.c)
  target_link_libraries(sim_core PUBLIC tilery_flags tl_sched tl_proto)
endif()
tilery_test(sim_farm PLAIN LABEL sim LINKS sim_core SOURCES ${sim_main} ARGS --count 200
  TIMEOUT 300)
if(TARGET sim_farm)
  add_test(NAME sim_farm_10000 COMMAND sim_farm --workers 10000)
  set_tests_properties(sim_farm_10000 PROPERTIES LABELS sim TIMEOUT 300)
endif()

# Canaries: the same program with one bug of one patch each; the patched file stands before the
# scheduler's archive, so that its object is the one that is linked.
file(GLOB canaries CONFIGURE_DEPENDS ${sim}/canaries/*.patch)
foreach(patch ${canaries})
  if(NOT TILERY_TESTS)
    break()
  endif()
  get_filename_component(name ${patch} NAME_WE)
  file(STRINGS ${patch} target REGEX "^\\+\\+\\+ b/")
  string(REGEX REPLACE "^\\+\\+\\+ b/" "" target "${target}")
  get_filename_component(file ${target} NAME)
  set(bugged ${CMAKE_CURRENT_BINARY_DIR}/canaries/${name}/${file})
  add_custom_command(OUTPUT ${bugged}
    COMMAND ${CMAKE_COMMAND} -E make_directory ${CMAKE_CURRENT_BINARY_DIR}/canaries/${name}
    COMMAND patch --quiet --fuzz=3 -o ${bugged} ${PROJECT_SOURCE_DIR}/${target} ${patch}
    DEPENDS ${patch} ${PROJECT_SOURCE_DIR}/${target}
    COMMENT "Putting a bug into ${file}: ${name}" VERBATIM)
  add_executable(sim_canary_${name} ${sim_main} ${bugged})
  target_link_libraries(sim_canary_${name} PRIVATE sim_core)
  # A source's options come after those of the libraries, which would turn the warning on again.
  set_source_files_properties(${bugged} PROPERTIES
    COMPILE_OPTIONS "-Wno-error;-Wno-unused-parameter")
  tilery_script_test(sim_canary_${name} LABEL sim
    COMMAND ${sim}/canary.sh $<TARGET_FILE:sim_canary_${name}>)
endforeach()
