/* master/tag_table.h: a bit for each word that a job of the scheduler asks for.
 *
 * The scheduler compares bits; this numbers the words. A word keeps its bit as long as a job asks
 * for it, then the bit goes to another word: workers are given their bits anew whenever one
 * moved. Words that no job asks for have none. Pure; the caller owns the table; one thread.
 * Tests: tests/unit/test_tag_table.c, tests/e2e/test_e2e_tags.py.
 */
#ifndef MASTER_TAG_TABLE_H
#define MASTER_TAG_TABLE_H

#include "common/tags.h"

enum { TAG_TABLE_WORDS = 64 };

struct tag_table { /* zeroed: empty */
    struct {
        char word[TAG_BYTES]; /* "": none has had the bit */
        uint32_t jobs;        /* that ask for it */
    } bits[TAG_TABLE_WORDS];
};

/* A job comes: the bits it asks for. False when there are too many words: nothing changed. *moved:
 * a bit has another word than before. */
bool tag_table_take(struct tag_table *t, const struct tags *tags, uint64_t *bits, bool *moved);

/* It goes. */
void tag_table_give(struct tag_table *t, uint64_t bits);

/* The bits that a worker has. */
uint64_t tag_table_bits(const struct tag_table *t, const struct tags *tags);

#endif
