# What surrounds the tracing core in a worker process; read by CMakeLists.txt beside it.
set(session_sources
  chunk_cache.c job_table.c pool.c scene_fetcher.c
  scene_fetcher_bring.c session.c tree_cache.c work.c)
set(session_links tl_proto Threads::Threads)
