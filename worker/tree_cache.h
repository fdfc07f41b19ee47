/* worker/tree_cache.h: trees a worker has built once and need not build again.
 *
 * A file for each, DIR/trees/KEY.tree, under the SHA-256 of the geometry that it is built
 * over: a SHA-256 of what follows, then what accel_trees_save wrote. Several workers may
 * share the folder. A file is written aside, synced and renamed, so a kill leaves no
 * broken tree under its name; one that the disk has changed is dropped. Bounded: the files
 * used longest ago go first.
 *
 * Blocking; any thread, one call at a time. Tests: test_trees.
 */
#ifndef WORKER_TREE_CACHE_H
#define WORKER_TREE_CACHE_H

#include "common/buf.h"
#include "common/digest.h"

struct tree_cache; /* opaque */

/* `folder` is there; DIR/trees is made with the first tree. ERR_NOMEM. */
TL_NODISCARD enum err tree_cache_new(const char *folder, uint64_t bytes_max,
                                     struct tree_cache **out);
void tree_cache_free(struct tree_cache *c);

/* The saved tree of a key: *data and *bytes lie in *owner, which you free (mem_free).
 * ERR_NOT_FOUND: none, or no longer itself or larger than the bound (and dropped); ERR_NOMEM,
 * ERR_IO. */
TL_NODISCARD enum err tree_cache_get(struct tree_cache *c, const digest *key, char **owner,
                                     const void **data, size_t *bytes);

/* Room for the digest at the front of a file; what is saved is appended to it. */
void tree_cache_head(struct buf *file);

/* Writes a file begun with tree_cache_head. One larger than the bound is not kept. ERR_NOSPACE,
 * ERR_IO, ERR_NOMEM. */
TL_NODISCARD enum err tree_cache_put(struct tree_cache *c, const digest *key, struct buf *file);

/* The tree of this key does not hold. */
void tree_cache_drop(struct tree_cache *c, const digest *key);

#endif
