# The wire and what a worker keeps.
set(wire_unit ${PROJECT_SOURCE_DIR}/tests/unit)
tilery_test(test_frame LABEL unit LINKS tl_proto SOURCES ${wire_unit}/test_frame.c)
tilery_test(test_message LABEL unit LINKS tl_proto SOURCES ${wire_unit}/test_message.c)
tilery_test(test_tile_codec LABEL unit LINKS tl_proto SOURCES ${wire_unit}/test_tile_codec.c)
tilery_test(test_wire_conn LABEL unit LINKS tl_proto SOURCES ${wire_unit}/test_wire_conn.c)
tilery_test(test_chunk_cache LABEL unit LINKS tl_worker SOURCES ${wire_unit}/test_chunk_cache.c)
tilery_test(test_pool LABEL unit LINKS tl_worker SOURCES ${wire_unit}/test_pool.c)
