# Debian 12's libraries. Each is linked only by the layer that holds its door.
find_package(PkgConfig REQUIRED)
find_package(Threads REQUIRED)
foreach(pair "uv;libuv" "zstd;libzstd" "gnutls;gnutls" "mhd;libmicrohttpd"
             "sqlite;sqlite3" "curl;libcurl" "png;libpng" "turbojpeg;libturbojpeg")
  list(GET pair 0 target)
  list(GET pair 1 module)
  pkg_check_modules(${target} REQUIRED IMPORTED_TARGET ${module})
endforeach()

# OpenEXRCore has no pkg-config file of its own: OpenEXR.pc pulls in the C++ libraries.
find_path(OPENEXR_CORE_INCLUDE openexr.h PATH_SUFFIXES OpenEXR REQUIRED)
find_library(OPENEXR_CORE_LIBRARY OpenEXRCore REQUIRED)
find_path(IMATH_INCLUDE half.h PATH_SUFFIXES Imath REQUIRED)
add_library(openexr_core INTERFACE)
target_include_directories(openexr_core SYSTEM INTERFACE ${OPENEXR_CORE_INCLUDE} ${IMATH_INCLUDE})
target_link_libraries(openexr_core INTERFACE ${OPENEXR_CORE_LIBRARY})

find_path(SLEEF_INCLUDE sleef.h REQUIRED)
find_library(SLEEF_LIBRARY sleef REQUIRED)
add_library(sleef INTERFACE)
target_include_directories(sleef SYSTEM INTERFACE ${SLEEF_INCLUDE})
target_link_libraries(sleef INTERFACE ${SLEEF_LIBRARY})

find_path(NANOPB_INCLUDE pb.h PATH_SUFFIXES nanopb REQUIRED)
find_library(NANOPB_LIBRARY protobuf-nanopb REQUIRED)
find_program(PROTOC protoc REQUIRED)
find_program(PROTOC_NANOPB protoc-gen-nanopb REQUIRED)
