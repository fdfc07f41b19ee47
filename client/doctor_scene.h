/* client/doctor_scene.h: a visit of the doctor, and its rules that need no triangles.
 *
 * Internal to doctor.c and doctor_scene.c. One thread.
 */
#ifndef CLIENT_DOCTOR_SCENE_H
#define CLIENT_DOCTOR_SCENE_H

#include "client/doctor.h"

struct doctor_visit {
    const struct scene *scene;
    struct doctor *out;
    uint32_t *uses;   /* objects that show each mesh */
    double center[3]; /* of the scene in the world */
    bool out_of_memory;
};

/* With the step, the distance, the median edge and how many steps that is. */
#define DOCTOR_FAR_TEXT                                                                            \
    "coordinates come in steps of %.2g, up to %.3g from the origin, and half of the edges are "    \
    "shorter than about %.2g: %.2g steps. Detail was lost when the file was written"
#define DOCTOR_FAR_ADVICE                                                                          \
    "export the mesh around its own centre and place it by \"translate\", which is exact here"

/* Appends a finding; NULL when out of memory, which is noted, or when there are DOCTOR_SAME_MAX of
 * that id, which is counted. */
struct doctor_finding *doctor_add(struct doctor_visit *v, const char *id, uint64_t count,
                                  const char *advice, const char *format, ...) TL_PRINTF(5, 6);

/* Light, materials, objects in the same place, and what was said while reading. */
TL_NODISCARD enum err doctor_judge_scene(struct doctor_visit *v, const struct diag_list *loaded);

#endif
