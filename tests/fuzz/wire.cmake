# Parsers of the wire.
foreach(target fuzz_frame fuzz_message fuzz_tile_codec)
  tilery_fuzzer(${target} LINKS tl_proto SOURCES ${PROJECT_SOURCE_DIR}/tests/fuzz/${target}.c)
endforeach()
# What the master's API reads.
if(TARGET tl_master)
  tilery_fuzzer(fuzz_api LINKS tl_master SOURCES ${PROJECT_SOURCE_DIR}/tests/fuzz/fuzz_api.c)
endif()
