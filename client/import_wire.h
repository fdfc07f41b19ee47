/* client/import_wire.h: what the child process tells its parent.
 *
 * One message over a pipe: what was found and left out, the pictures that textures want, and
 * the scene as a package (package.h). The child may have been taken over by its model, so the
 * parent reads the message as hostile: counts, texts and sizes are bounded by what arrived, the
 * scene by package_read. Textures whose picture is still to be read travel as constant white.
 * One thread.
 */
#ifndef CLIENT_IMPORT_WIRE_H
#define CLIENT_IMPORT_WIRE_H

#include "client/import_model.h"
#include "common/buf.h"

enum {
    IMPORT_WIRE_VERSION = 2,
    IMPORT_WIRE_SAID_MAX = 64,
    IMPORT_WIRE_PICTURES_MAX = 1 << 14,
    IMPORT_WIRE_TEXT_BYTES_MAX = 4096,
    IMPORT_CHILD_FD = 3,     /* where the child writes its message */
    IMPORT_CHILD_NOMEM = 5,  /* its exit statuses: out of memory, */
    IMPORT_CHILD_FAILED = 4, /* anything else but 0, a whole message */
};

/* A picture for the texture of that name: a file, or bytes inside the model. */
struct import_picture {
    char *texture;
    char *path;                /* NULL: `data` */
    const unsigned char *data; /* borrowed */
    size_t bytes;
    enum image_use use;
};

struct import_message {
    struct import_picture *pictures;
    size_t count, capacity;
};

void import_message_release(struct import_message *m);

/* Writes the message of a child that ended with `result`: what im->problems holds and, on ERR_OK,
 * the scene, which satisfies scene_check. ERR_NOMEM, ERR_IO. */
TL_NODISCARD enum err import_wire_send(int fd, const struct import *im,
                                       const struct import_message *m, enum err result);

/* Fills an initialised `im`; the pictures borrow from `data`. Problems of the child become
 * problems here. ERR_CORRUPT, ERR_NOMEM, or the child's result. */
TL_NODISCARD enum err import_wire_get(const void *data, size_t bytes, struct import *im,
                                      struct import_message *m);

/* Runs the child on the model of `im` and reads its message. `uv_sets` (a digit for each
 * material) or NULL; `bytes` of the model decide how long it may take. ERR_INPUT with a problem
 * when the child crashed, hung or sent nonsense; ERR_IO when it could not be started. */
TL_NODISCARD enum err import_child_run(struct import *im, const char *uv_sets, uint64_t bytes);

#endif
