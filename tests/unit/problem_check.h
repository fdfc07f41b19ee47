/* tests/unit/problem_check.h: what the tests of the parsers ask of a list of problems. */
#ifndef TESTS_UNIT_PROBLEM_CHECK_H
#define TESTS_UNIT_PROBLEM_CHECK_H

#include <string.h>

#include "common/diag.h"

/* The first problem of that id whose place (JSON path, or file) ends as given; NULL: none. */
static inline const struct diag *problem_find(const struct diag_list *list, const char *id,
                                              const char *place_end)
{
    for (size_t i = 0; i < list->count; i++) {
        const struct diag *d = &list->items[i];
        const char *place = d->path ? d->path : d->file ? d->file : "";
        size_t bytes = strlen(place), tail = strlen(place_end);
        if (strcmp(d->id, id) == 0 && bytes >= tail && strcmp(place + bytes - tail, place_end) == 0)
            return d;
    }
    return NULL;
}

#endif
