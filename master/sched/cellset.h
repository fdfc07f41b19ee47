/* master/sched/cellset.h: a set of cells that finds its next member fast.
 *
 * A bitset with summary levels: a bit of level k+1 says that a word of level k
 * is not zero. The next member of a set of 2^24 cells is found by looking at
 * no more than eight words. The words are the caller's; all sets of one job have
 * one shape. Pure; tests/unit/test_sched_parts.c compares it with a plain array.
 */
#ifndef MASTER_SCHED_CELLSET_H
#define MASTER_SCHED_CELLSET_H

#include "common/err.h"

enum { CELLSET_LEVELS = 4 /* 64^4 = 2^24 cells */ };

struct cellset_shape {
    uint32_t cell_count;
    uint32_t level_count;
    uint32_t level_begin[CELLSET_LEVELS]; /* in words */
    uint32_t word_count;                  /* of one set */
};

/* `cell_count` 1..2^24. */
struct cellset_shape cellset_shape_of(uint32_t cell_count);

bool cellset_has(const struct cellset_shape *s, const uint64_t *words, uint32_t cell);
void cellset_add(const struct cellset_shape *s, uint64_t *words, uint32_t cell);
void cellset_remove(const struct cellset_shape *s, uint64_t *words, uint32_t cell);

/* Makes the set hold every cell. */
void cellset_fill(const struct cellset_shape *s, uint64_t *words);

/* The first member >= from; UINT32_MAX when there is none. */
uint32_t cellset_next(const struct cellset_shape *s, const uint64_t *words, uint32_t from);

/* How many members follow each other from the member `from` on, at most `count_max`. */
uint32_t cellset_run(const struct cellset_shape *s, const uint64_t *words, uint32_t from,
                     uint32_t count_max);

#endif
