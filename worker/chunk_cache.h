/* worker/chunk_cache.h: chunks a worker has been sent once and need not be sent again.
 *
 * Keeps each chunk as the zstd frame that came over the wire, under the SHA-256 of its
 * plain contents: in a folder (DIR/ab/abcd....zst, which several workers may share),
 * or in memory when there is none. What is put in has been checked against its name;
 * what is taken out is checked again, and dropped when the disk has changed it.
 *
 * Bounded: the chunks used longest ago go first, except those used since the last
 * chunk_cache_begin, which one scene needs together. A file is written aside, synced
 * and renamed, so a kill leaves no broken chunk under its name.
 *
 * Any thread; reading and writing happens outside the lock. Tests: test_chunk_cache.
 */
#ifndef WORKER_CHUNK_CACHE_H
#define WORKER_CHUNK_CACHE_H

#include "common/buf.h"
#include "common/digest.h"
#include "worker/tree_cache.h"

struct chunk_cache; /* opaque */

/* `folder` NULL: in memory. Makes the folder, takes stock of what is in it, removes what a killed
 * writer left. ERR_IO, ERR_NOT_FOUND, ERR_NOMEM: cannot be used. */
TL_NODISCARD enum err chunk_cache_new(const char *folder, uint64_t bytes_max,
                                      struct chunk_cache **out);
void chunk_cache_free(struct chunk_cache *c);

/* From now on another scene is loaded: what earlier ones used may go. */
void chunk_cache_begin(struct chunk_cache *c);

/* True if it is there, as far as we know; then it counts as used. */
bool chunk_cache_has(struct chunk_cache *c, const digest *name);

/* Checks that the frame is the chunk of that name with at most `raw_bytes_max` plain bytes, and
 * keeps it. Takes `frame` (mem_free) in any case. A folder that cannot take it (disk full) costs
 * memory, not the chunk. Appends the plain bytes to `plain`. ERR_CORRUPT, ERR_LIMIT: it is not that
 * chunk; ERR_NOMEM. */
TL_NODISCARD enum err chunk_cache_put(struct chunk_cache *c, const digest *name,
                                      unsigned char *frame, size_t frame_bytes,
                                      uint64_t raw_bytes_max, struct buf *plain);

/* Appends the plain contents to `out`. ERR_NOT_FOUND: not there, or no longer itself (and dropped);
 * ERR_NOMEM, ERR_IO. */
TL_NODISCARD enum err chunk_cache_get(struct chunk_cache *c, const digest *name,
                                      uint64_t raw_bytes_max, struct buf *out);

/* Trees are kept in FOLDER/trees (tree_cache.h) instead of beside the chunks. Before anybody asks
 * for one. ERR_NOMEM. */
TL_NODISCARD enum err chunk_cache_keep_trees(struct chunk_cache *c, const char *folder,
                                             uint64_t bytes_max);

/* The trees kept beside the chunks, bounded by as much again, or elsewhere; NULL: none are kept. */
struct tree_cache *chunk_cache_trees(struct chunk_cache *c);

/* Of all chunks, as stored. */
uint64_t chunk_cache_bytes(struct chunk_cache *c);

#endif
