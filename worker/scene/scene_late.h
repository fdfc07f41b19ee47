/* worker/scene/scene_late.h: pictures that a scene gets after it was built.
 *
 * scene_build leaves late pictures out (scene_building.late). A unit that meets one ends with what
 * it lacks (render_lacks); whoever runs units fetches the chunk, makes a picture of it, which any
 * thread may do, and puts it in, whereupon the unit runs again. A picture is never taken out again.
 *
 *   render_scene_need --> fetch --> picture_make (any thread) --> render_scene_put
 *
 * What a unit lacks has a number: that of an image, meaning the whole or, of one in pieces, its
 * base; behind those of all images come the pieces, image by image.
 *
 * Jobs that share a scene share its pictures.
 * Thread: that of render_scene_share, but for picture_make; render threads look on.
 * Tests: test_scene_late.
 */
#ifndef WORKER_SCENE_SCENE_LATE_H
#define WORKER_SCENE_SCENE_LATE_H

#include "worker/scene/scene_build.h"

/* A late picture, or part of one, that is not there: where it is to be had, and what is to be made
 * of it. */
struct picture_need {
    uint32_t number;
    uint32_t image;         /* whose it is */
    digest name;            /* of its chunk */
    uint64_t bytes;         /* of that, plain */
    enum package_kind kind; /* an image, a base or a piece */
    bool pyramid;           /* averages of it will be looked up */
    bool weighed;           /* with its colours by their opacity */
    struct scene_image is;  /* what a base or a piece has to be, but for its pixels */
};

struct picture; /* opaque: made, and in no scene yet */

/* What the chunk has (its plain bytes, all of them) as it is looked up. ERR_CORRUPT: it is not what
 * is needed; ERR_NOMEM. */
TL_NODISCARD enum err picture_read(const struct picture_need *need, const void *data, size_t bytes,
                                   struct picture **out);

/* The same from an image or a piece; `from` satisfies scene_image_valid and is not kept. */
TL_NODISCARD enum err picture_make(const struct picture_need *need, const struct scene_image *from,
                                   struct picture **out);
void picture_free(struct picture *p);

/* How many pictures, bases and pieces are not there yet, touched or not. */
size_t render_scene_late_count(const struct render_scene *rs);

/* Whether what has this number is not there yet; fills *out if so. False also for a number that
 * nothing has. */
bool render_scene_need(const struct render_scene *rs, uint32_t number, struct picture_need *out);

/* Puts a picture in and takes it; one that is there already is freed. */
void render_scene_put(struct render_scene *rs, uint32_t number, struct picture *picture);

/* True if both are views of one scene, made by render_scene_share. */
bool render_scene_is_one(const struct render_scene *a, const struct render_scene *b);

/* One more than the highest number. */
size_t render_scene_late_end(const struct render_scene *rs);

#endif
