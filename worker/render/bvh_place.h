/* worker/render/bvh_place.h: an arena that several trees share, so that a reference in one may
 * lead into another.
 *
 * The arena is as large as all of them together could be; pages that no tree has come to
 * cost nothing. Trees that are there never move. The place owns the arena of its trees; a
 * tree that failed has taken nothing. Thread: trees may be placed by several threads at once.
 */
#ifndef WORKER_RENDER_BVH_PLACE_H
#define WORKER_RENDER_BVH_PLACE_H

#include <stdatomic.h>

#include "worker/render/bvh.h"

/* One tree leads into one other. A deeper one is refused; with bvh_how.median none is. */
enum { BVH_PLACED_DEPTH_MAX = BVH_DEPTH_MAX / 2 };

struct bvh_place {
    unsigned char *arena;
    size_t units;
    atomic_size_t units_used;
    float edge; /* the largest extent of any triangle of any tree: the edge codes' unit */
};

/* Room for trees over so many references together. ERR_NOMEM; ERR_LIMIT: beyond what references
 * reach. */
TL_NODISCARD enum err bvh_place_new(size_t ref_count, float edge, struct bvh_place *out);
void bvh_place_release(struct bvh_place *p);

#endif
