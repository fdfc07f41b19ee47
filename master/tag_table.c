#include "master/tag_table.h"

#include <stdio.h>
#include <string.h>

enum { NONE = TAG_TABLE_WORDS };

static int find(const struct tag_table *t, const char *word)
{
    for (int i = 0; i < TAG_TABLE_WORDS; i++)
        if (strcmp(t->bits[i].word, word) == 0)
            return i;
    return NONE;
}

static int find_free(const struct tag_table *t)
{
    for (int i = 0; i < TAG_TABLE_WORDS; i++)
        if (t->bits[i].jobs == 0)
            return i;
    return NONE;
}

bool tag_table_take(struct tag_table *t, const struct tags *tags, uint64_t *bits, bool *moved)
{
    uint64_t taken = 0;
    *moved = false;
    for (uint32_t i = 0; i < tags->count; i++) {
        int bit = find(t, tags->words[i]);
        if (bit == NONE) {
            bit = find_free(t);
            if (bit == NONE) {
                tag_table_give(t, taken);
                return false;
            }
            (void)snprintf(t->bits[bit].word, TAG_BYTES, "%s", tags->words[i]);
            *moved = true;
        }
        t->bits[bit].jobs++;
        taken |= UINT64_C(1) << bit;
    }
    *bits = taken;
    return true;
}

void tag_table_give(struct tag_table *t, uint64_t bits)
{
    for (int i = 0; i < TAG_TABLE_WORDS; i++)
        if (bits >> i & 1)
            t->bits[i].jobs--;
}

uint64_t tag_table_bits(const struct tag_table *t, const struct tags *tags)
{
    uint64_t bits = 0;
    for (uint32_t i = 0; i < tags->count; i++) {
        int bit = find(t, tags->words[i]);
        if (bit != NONE)
            bits |= UINT64_C(1) << bit;
    }
    return bits;
}
