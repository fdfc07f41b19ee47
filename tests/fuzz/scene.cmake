set(fuzz ${PROJECT_SOURCE_DIR}/tests/fuzz)
foreach(name chunk hdr image job_spec json obj package ply sample_plan)
  tilery_fuzzer(fuzz_${name} LINKS tl_common m SOURCES ${fuzz}/fuzz_${name}.c)
endforeach()
tilery_test(package_seeds PLAIN LABEL fuzz LINKS tl_common m
  SOURCES ${fuzz}/package_seeds.c ${PROJECT_SOURCE_DIR}/tests/unit/made_scene.c
  ARGS ${fuzz}/corpus)
