/* worker/scene/scene_build.h: from a scene and a job to what the tracing core reads.
 *
 * Geometry is moved to the scene's centre and scaled by a power of two, in double, and each
 * vertex is rounded once, to float: so walls of different meshes that meet in the
 * world still meet. A mesh that many objects use and that is big is kept once, in its
 * own space, and instanced, and one that is tiny for its place has a space of its own, too; all
 * others are written out. Emitting objects always are.
 *
 * The result borrows nothing: the scene may be released. One thread; `runner` (may be
 * NULL) gives the builder of the tree more.
 */
#ifndef WORKER_SCENE_SCENE_BUILD_H
#define WORKER_SCENE_SCENE_BUILD_H

#include "common/package.h"
#include "common/scene.h"
#include "worker/render/render.h"
#include "worker/render/accel_lazy.h"

/* The scene is valid (scene_check), the spec too. ERR_NOMEM; ERR_LIMIT when the extent of the
 * scene cannot be held in a double; ERR_INPUT when the job shows texture coordinates and the
 * package was made without. */
TL_NODISCARD enum err scene_build(const struct scene *scene, const struct job_spec *spec,
                                  const struct accel_runner *runner, struct render_scene **out);

/* Where built trees are kept. Any member function may be slow. */
struct scene_trees {
    /* The saved trees of a key, which accel_new_saved then takes; false: none. May wait while
     * another builds them; of how many triangles they are says how long that may take. */
    bool (*find)(void *ctx, const digest *key, uint64_t triangles, void **data, size_t *bytes);
    void (*drop)(void *ctx, const digest *key); /* they do not hold */
    /* Offers those just built. */
    void (*keep)(void *ctx, const digest *key, const struct accel *accel);
    void *ctx;
};

/* Where a late picture is to be had. Of one in pieces the scene's image has all but pixels. */
struct late_chunk {
    bool late;
    digest name;    /* of its chunk, or its base */
    uint64_t bytes; /* of that, plain */
    struct package_pieces pieces;
    const struct package_index_entry *entries; /* in which the pieces are; or NULL */
};

/* How scene_build_as goes about it; zeros: as scene_build. */
struct scene_building {
    const struct accel_runner *runner; /* or NULL */

    /* Trees found or kept where that is worth it: a scene of few triangles is built in less time
     * than its tree is read. Or NULL. */
    const struct scene_trees *trees;

    /* Objects of so many triangles may have their trees built when a ray first meets them, by the
     * render thread (accel_lazy.h); such trees are not kept. 0: none. */
    uint32_t lazy_triangles_min;

    /* For each image, whether it comes later (scene_late.h): then it may have no pixels now. Not of
     * one that building reads (package_late.h). Lent for the call. NULL: none does. */
    const struct late_chunk *late;
};

TL_NODISCARD enum err scene_build_as(const struct scene *scene, const struct job_spec *spec,
                                     const struct scene_building *how, struct render_scene **out);

/* The scene of another job on the same package: all tables and the tree are shared, only what
 * depends on size, film and sampling is made anew. ERR_VERSION: the job needs other tables or
 * another tree, build it; ERR_NOMEM. Who shares and who frees is one thread. Test:
 * test_scene_build. */
TL_NODISCARD enum err render_scene_share(struct render_scene *rs, const struct job_spec *spec,
                                         struct render_scene **out);

/* The last that shares frees what is shared; true if this was the last. */
bool render_scene_free(struct render_scene *rs);

/* How many share, this one included. */
uint32_t render_scene_sharers(const struct render_scene *rs);

/* Memory held now, trees included: more while trees are built by the first rays to meet them. */
size_t render_scene_bytes(const struct render_scene *rs);

/* Of the tree; NULL before it is built. */
struct accel *render_scene_accel(const struct render_scene *rs);
void render_scene_stats(const struct render_scene *rs, struct accel_stats *out);

#endif
