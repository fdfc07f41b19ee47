/* worker/tree_cache.h: trees a worker has built once and need not build again.
 *
 * A file for each, DIR/trees/KEY.tree, under the SHA-256 of the geometry that it is built
 * over: checksums of what follows, then what accel_trees_save wrote. Several workers may
 * share the folder. A file is written aside and renamed, so a kill leaves no broken tree under
 * its name; one that the disk, or a crash of the machine, has changed is dropped. The checksums
 * are against accidents: what somebody wrote on purpose is what accel_new_saved checks.
 * Bounded: the files used longest ago go first.
 *
 * Blocking; any thread, one call at a time; reading is spread over the runner. Tests:
 * test_trees.
 */
#ifndef WORKER_TREE_CACHE_H
#define WORKER_TREE_CACHE_H

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

/* Gives the bytes [from, from + bytes) of a tree: accel_trees_copy. */
typedef void tree_source(void *ctx, size_t from, size_t bytes, unsigned char *out);

/* Keeps a tree of so many bytes. One larger than the bound is not kept. ERR_NOSPACE: also where it
 * would take more than a quarter of what is free; ERR_IO, ERR_NOMEM. */
TL_NODISCARD enum err tree_cache_put(struct tree_cache *c, const digest *key, size_t bytes,
                                     tree_source *source, void *ctx);

/* Of the workers that share the folder, one builds a tree and the others wait for it. True: the
 * tree is there by now. False: build it, with *out to be released once it is kept or was not built;
 * NULL: another has been at it for longer than patience_ms (it may be stopped, or slow), or there
 * can be no claim. A claim ends with its process. */
struct tree_claim; /* opaque */
bool tree_cache_claim(struct tree_cache *c, const digest *key, uint32_t patience_ms,
                      struct tree_claim **out);
void tree_cache_release(struct tree_claim *claim); /* NULL: nothing */

/* The tree of this key does not hold. */
void tree_cache_drop(struct tree_cache *c, const digest *key);

#endif
