/* common/name_table.h: texts to numbers 0, 1, 2 ... in order of first use.
 *
 * Owns copies of the names. One thread.
 */
#ifndef COMMON_NAME_TABLE_H
#define COMMON_NAME_TABLE_H

#include "common/err.h"

struct name_table {
    char **names; /* by number */
    size_t count, capacity;
    uint32_t *slots; /* hash -> number + 1; 0: free */
    size_t slot_count;
};

void name_table_init(struct name_table *t);
void name_table_release(struct name_table *t);

/* The number of a name, or UINT32_MAX. */
uint32_t name_table_find(const struct name_table *t, const char *name, size_t bytes);

/* The number of a name that is added if it is new. ERR_NOMEM; then nothing changed. */
TL_NODISCARD enum err name_table_add(struct name_table *t, const char *name, size_t bytes,
                                     uint32_t *out);

#endif
