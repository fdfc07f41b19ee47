set(fuzz ${PROJECT_SOURCE_DIR}/tests/fuzz)
foreach(name chunk hdr image job_spec json obj package ply sample_plan)
  tilery_fuzzer(fuzz_${name} LINKS tl_common m SOURCES ${fuzz}/fuzz_${name}.c)
endforeach()
