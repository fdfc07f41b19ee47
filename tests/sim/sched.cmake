# The simulated farm over the production objects of scheduler, wire and journal.
set(sim ${PROJECT_SOURCE_DIR}/tests/sim)
set(sim_sources ${sim}/sim.c ${sim}/sim_book.c ${sim}/sim_main.c ${sim}/sim_master.c
  ${sim}/sim_net.c ${sim}/sim_worker.c ${PROJECT_SOURCE_DIR}/master/journal.c)
tilery_test(sim_farm PLAIN LABEL sim LINKS tl_sched tl_proto SOURCES ${sim_sources}
  ARGS --count 200 TIMEOUT 300)
