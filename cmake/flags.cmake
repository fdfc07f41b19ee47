# Compiler flags. What decides bits is compiled for one fixed baseline
# (x86-64), never contracted, never reassociated: DESIGN decisions in
# ARCHITECTURE.md, "floating point". Wider kernels are files of intrinsics
# with target attributes, chosen at run time.

add_library(tilery_flags INTERFACE)
target_compile_definitions(tilery_flags INTERFACE _GNU_SOURCE
  TILERY_VERSION="${PROJECT_VERSION}")
target_include_directories(tilery_flags INTERFACE ${PROJECT_SOURCE_DIR} ${PROJECT_BINARY_DIR})
target_compile_options(tilery_flags INTERFACE
  -ffp-contract=off -fno-fast-math -fno-math-errno -fno-strict-aliasing -fstack-protector-strong
  -Wall -Wextra -Wconversion -Wshadow -Wstrict-prototypes -Wmissing-prototypes -Wvla
  -Wdouble-promotion -Wundef)
# gcc 12.2's SLP vectoriser drops the rounding of a double stored to a float
# and read back when the target has AVX-512.
if(CMAKE_C_COMPILER_ID STREQUAL "GNU")
  target_compile_options(tilery_flags INTERFACE -fno-tree-slp-vectorize)
else()
  target_compile_options(tilery_flags INTERFACE -fno-slp-vectorize)
endif()
if(TILERY_WERROR)
  target_compile_options(tilery_flags INTERFACE -Werror)
endif()
if(CMAKE_BUILD_TYPE STREQUAL "Debug")
  target_compile_definitions(tilery_flags INTERFACE TL_DEBUG=1)
endif()
if(TILERY_SANITIZE)
  target_compile_options(tilery_flags INTERFACE -fsanitize=${TILERY_SANITIZE}
    -fno-sanitize-recover=all -fno-omit-frame-pointer)
  target_link_options(tilery_flags INTERFACE -fsanitize=${TILERY_SANITIZE})
endif()
set(CMAKE_C_FLAGS_RELEASE "-O2 -g1")
set(CMAKE_C_FLAGS_DEBUG "-Og -g")

# tilery_library(NAME LINKS lib... SOURCES file...): a layer.
function(tilery_library name)
  cmake_parse_arguments(arg "" "" "LINKS;SOURCES" ${ARGN})
  add_library(${name} STATIC ${arg_SOURCES})
  target_link_libraries(${name} PUBLIC tilery_flags ${arg_LINKS})
endfunction()

# tilery_program(NAME LINKS lib... SOURCES file...): lands in bin/.
function(tilery_program name)
  cmake_parse_arguments(arg "" "" "LINKS;SOURCES" ${ARGN})
  add_executable(${name} ${arg_SOURCES})
  target_link_libraries(${name} PRIVATE tilery_flags ${arg_LINKS})
endfunction()
