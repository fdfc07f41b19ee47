tilery_fuzzer(fuzz_sse LINKS tl_client SOURCES ${PROJECT_SOURCE_DIR}/tests/fuzz/fuzz_sse.c)
tilery_fuzzer(fuzz_preset LINKS tl_client SOURCES ${PROJECT_SOURCE_DIR}/tests/fuzz/fuzz_preset.c)
