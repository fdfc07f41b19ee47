/* client/import_write.h: the files of an imported scene. Internal to import_write*.c. */
#ifndef CLIENT_IMPORT_WRITE_H
#define CLIENT_IMPORT_WRITE_H

#include "client/import_model.h"
#include "common/buf.h"

struct import_writer {
    const struct import *im;
    const struct job_spec *spec;
    const char *path;    /* of the scene file */
    char *folder, *stem; /* of `path`: its folder, and its name without extension */
    char **mesh_paths;   /* as the scene file names them */
    char **image_paths;
    char *failed; /* the file that could not be written */
    struct buf json;
};

/* Writes meshes and pictures; fills mesh_paths and image_paths. */
TL_NODISCARD enum err import_write_files(struct import_writer *w);

/* Where an image of the scene came from; NULL: it was made here. */
const struct import_source *import_source_of(const struct import *im, uint32_t image);

#endif
