# Film, journal and store.
tilery_test(test_film LABEL unit LINKS tl_master m SOURCES ${PROJECT_SOURCE_DIR}/tests/unit/test_film.c)
tilery_test(test_journal LABEL unit LINKS tl_master m SOURCES ${PROJECT_SOURCE_DIR}/tests/unit/test_journal.c)
tilery_test(test_store LABEL unit LINKS tl_master m SOURCES ${PROJECT_SOURCE_DIR}/tests/unit/test_store.c TIMEOUT 300)
tilery_test(test_store_files LABEL unit LINKS tl_master SOURCES ${PROJECT_SOURCE_DIR}/tests/unit/test_store_files.c)
tilery_test(test_provenance LABEL unit LINKS tl_master SOURCES ${PROJECT_SOURCE_DIR}/tests/unit/test_provenance.c)
tilery_test(test_rate LABEL unit LINKS tl_master SOURCES ${PROJECT_SOURCE_DIR}/tests/unit/test_rate.c)
tilery_test(test_tag_table LABEL unit LINKS tl_master SOURCES ${PROJECT_SOURCE_DIR}/tests/unit/test_tag_table.c)
tilery_test(test_sample_plan LABEL unit LINKS tl_master m SOURCES ${PROJECT_SOURCE_DIR}/tests/unit/test_sample_plan.c)
