set(unit ${PROJECT_SOURCE_DIR}/tests/unit)
tilery_test(test_sched_parts LABEL unit LINKS tl_sched SOURCES ${unit}/test_sched_parts.c)
tilery_test(test_sched_eta LABEL unit LINKS tl_sched m SOURCES ${unit}/test_sched_eta.c)
tilery_test(test_sched LABEL unit LINKS tl_sched
  SOURCES ${unit}/test_sched.c ${unit}/sched_rig.c)
tilery_test(test_sched_faults LABEL unit LINKS tl_sched
  SOURCES ${unit}/test_sched_faults.c ${unit}/sched_rig.c)
tilery_test(test_sched_restart LABEL unit LINKS tl_sched
  SOURCES ${unit}/test_sched_restart.c ${unit}/sched_rig.c)
tilery_test(test_sched_limits LABEL unit LINKS tl_sched
  SOURCES ${unit}/test_sched_limits.c ${unit}/sched_rig.c)
tilery_test(test_sched_adopt LABEL unit LINKS tl_sched
  SOURCES ${unit}/test_sched_adopt.c ${unit}/sched_rig.c)
tilery_test(test_sched_tags LABEL unit LINKS tl_sched
  SOURCES ${unit}/test_sched_tags.c ${unit}/sched_rig.c)
