# The importer's own parsers; assimp runs in a child and is not fuzzed here.
tilery_fuzzer(fuzz_mtl LINKS tl_common SOURCES ${PROJECT_SOURCE_DIR}/tests/fuzz/fuzz_mtl.c)
tilery_fuzzer(fuzz_gltf LINKS tl_client SOURCES ${PROJECT_SOURCE_DIR}/tests/fuzz/fuzz_gltf.c)
