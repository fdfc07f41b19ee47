/* client/doctor.h: what in a scene may hurt its picture, with numbers and advice.
 *
 * Reads a loaded scene and never changes it. A finding says what, how often, where it is first
 * and what to do; no finding is an error, since each scene that loads can be rendered. Ids are
 * anchors of docs/ERRORS.md. One thread.
 */
#ifndef CLIENT_DOCTOR_H
#define CLIENT_DOCTOR_H

#include "common/diag.h"
#include "common/scene.h"

enum {
    DOCTOR_TEXT_BYTES = 400,
    DOCTOR_SAME_MAX = 16, /* findings of one id; what is beyond is counted in the last of them */
};

struct doctor_finding {
    const char *id;    /* static, kebab-case */
    uint64_t count;    /* how many of what the text names */
    uint64_t more;     /* findings of this id that are not listed */
    uint32_t object;   /* index in the scene's objects, or SCENE_NONE */
    uint32_t triangle; /* the first of them, or SCENE_NONE */
    bool placed;
    double at[3]; /* where the first is, in the world */
    char where[DOCTOR_TEXT_BYTES];
    char text[DOCTOR_TEXT_BYTES];
    char advice[DOCTOR_TEXT_BYTES];
};

struct doctor {
    struct doctor_finding *findings; /* owned */
    size_t count, capacity;
    uint64_t meshes, triangles; /* looked at */
};

/* `loaded`: the warnings that reading gave, which become findings too. ERR_NOMEM: what was found
 * is kept. Release in any case. */
TL_NODISCARD enum err doctor_examine(const struct scene *s, const struct diag_list *loaded,
                                     struct doctor *out);
void doctor_release(struct doctor *d);

/* Adds a warning for each mesh that lies so far from its file's origin that the steps in which
 * the file gives coordinates are coarse beside its edges: detail that was lost before reading. */
TL_NODISCARD enum err doctor_warn_precision(const struct scene *s, struct diag_list *problems);

#endif
