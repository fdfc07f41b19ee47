# The importer: included by client/CMakeLists.txt. assimp is used by this part alone, and
# loaded at run time (import_assimp_library.c): its headers are all that is needed here.
pkg_check_modules(assimp REQUIRED IMPORTED_TARGET assimp)
set(import_sources cmd_import.c import.c import_assimp.c import_assimp_file.c import_assimp_library.c
  import_assimp_material.c import_assimp_mesh.c import_assimp_nodes.c import_child.c
  import_culling.c import_frame.c import_gltf.c import_gltf_check.c import_gltf_data.c import_gltf_float.c
  import_gltf_material.c import_gltf_node.c import_gltf_order.c import_image.c import_obj.c
  import_scene.c import_sky.c import_wire.c import_write.c import_write_files.c)
set(import_links ${CMAKE_DL_LIBS})
if(assimp_INCLUDE_DIRS)
  include_directories(SYSTEM ${assimp_INCLUDE_DIRS})
endif()
