# The program; read by CMakeLists.txt beside it.
tilery_program(tilery-worker LINKS tl_worker SOURCES main.c)
