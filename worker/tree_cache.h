/* worker/tree_cache.h: trees a worker has built once and need not build again.
 *
 * A file for each, DIR/trees/KEY.tree, under the SHA-256 of the geometry that it is built
 * over: checksums of what follows, then what accel_trees_save wrote. Several workers may
 * share the folder. A file is written aside, synced and renamed, so a kill leaves no
 * broken tree under its name; one that the disk has changed is dropped. The checksums
 * are against accidents: what somebody wrote on purpose is what accel_new_saved checks.
 * Bounded: the files used longest ago go first.
 *
 * Blocking; any thread, one call at a time; reading is spread over the runner. Tests:
 * test_trees.
 */
#ifndef WORKER_TREE_CACHE_H
#define WORKER_TREE_CACHE_H

#include "common/buf.h"
#include "common/digest.h"
#include "worker/render/accel.h"

struct tree_cache; /* opaque */

/* `folder` is there; DIR/trees is made with the first tree. ERR_NOMEM. */
TL_NODISCARD enum err tree_cache_new(const char *folder, uint64_t bytes_max,
                                     struct tree_cache **out);
void tree_cache_free(struct tree_cache *c);

/* The saved tree of a key; *data is yours (mem_free), at 64 bytes or more. `runner` may be NULL.
 * ERR_NOT_FOUND: none, or no longer itself or larger than the bound (and dropped); ERR_NOMEM,
 * ERR_IO. */
TL_NODISCARD enum err tree_cache_get(struct tree_cache *c, const digest *key,
                                     const struct accel_runner *runner, void **data, size_t *bytes);

/* Makes an empty buf a file for what takes so many bytes; where they go, or NULL without memory. */
unsigned char *tree_cache_room(struct buf *file, size_t bytes);

/* Writes a file whose room is filled. One larger than the bound is not kept. ERR_NOSPACE, ERR_IO,
 * ERR_NOMEM. */
TL_NODISCARD enum err tree_cache_put(struct tree_cache *c, const digest *key, struct buf *file,
                                     size_t bytes);

/* The tree of this key does not hold. */
void tree_cache_drop(struct tree_cache *c, const digest *key);

#endif
