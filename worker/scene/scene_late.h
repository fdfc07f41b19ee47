/* worker/scene/scene_late.h: pictures that a scene gets after it was built.
 *
 * scene_build leaves late pictures out (scene_building.late). A unit that meets one ends with what
 * it lacks (render_lacks); whoever runs units fetches the chunk, makes a picture of it, which any
 * thread may do, and puts it in, whereupon the unit runs again. A picture is never taken out again.
 *
 *   render_scene_need --> fetch --> picture_make (any thread) --> render_scene_put
 *
 * Jobs that share a scene share its pictures.
 * Thread: that of render_scene_share, but for picture_make; render threads look on.
 * Tests: test_scene_late.
 */
#ifndef WORKER_SCENE_SCENE_LATE_H
#define WORKER_SCENE_SCENE_LATE_H

#include "common/digest.h"
#include "worker/scene/scene_build.h"

/* A late picture that is not there: where it is to be had, and what is to be made of it. */
struct picture_need {
    uint32_t image; /* number in the scene */
    digest name;    /* of its chunk */
    uint64_t bytes; /* of that, plain */
    bool pyramid;   /* averages of it will be looked up */
    bool weighed;   /* with its colours by their opacity */
};

struct picture; /* opaque: made, and in no scene yet */

/* The image as it is looked up; `from` satisfies scene_image_valid and is not kept. ERR_NOMEM. */
TL_NODISCARD enum err picture_make(const struct picture_need *need, const struct scene_image *from,
                                   struct picture **out);
void picture_free(struct picture *p);

/* How many pictures are not there yet, touched or not. */
size_t render_scene_late_count(const struct render_scene *rs);

/* Whether an image is not there yet; fills *out if so. False also for a number that is no image's.
 */
bool render_scene_need(const struct render_scene *rs, uint32_t image, struct picture_need *out);

/* Puts a picture in and takes it; one that is there already is freed. */
void render_scene_put(struct render_scene *rs, uint32_t image, struct picture *picture);

/* True if both are views of one scene, made by render_scene_share. */
bool render_scene_is_one(const struct render_scene *a, const struct render_scene *b);

/* Images of the scene, there or not. */
size_t render_scene_image_count(const struct render_scene *rs);

#endif
