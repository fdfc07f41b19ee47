foreach(part frames option settings text stream files metrics)
  tilery_test(test_cli_${part} LABEL unit LINKS tl_client SOURCES unit/test_cli_${part}.c)
endforeach()
tilery_test(test_study LABEL unit LINKS tl_client SOURCES unit/test_study.c)
