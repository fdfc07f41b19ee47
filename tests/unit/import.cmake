tilery_test(test_mtl LABEL unit LINKS tl_common SOURCES unit/test_mtl.c)
tilery_test(test_import LABEL unit LINKS tl_client SOURCES unit/test_import.c)
