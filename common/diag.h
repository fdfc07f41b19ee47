/* common/diag.h: what is wrong with the user's input, all of it in one run.
 *
 * Each problem has a place (file, line or JSON path), a text that says what was
 * found and expected, an optional hint that says what to do, and a stable id
 * that is an anchor of docs/ERRORS.md. Printed as
 *
 *   scene.json: $.objects[2].material_name: no material "galss"
 *     did you mean "glass"? known: floor, glass, lamp  [unknown-material]
 *
 * A list belongs to one thread. Adding never fails: when memory runs out or the
 * list is full (DIAG_MAX), the problem is counted only.
 */
#ifndef COMMON_DIAG_H
#define COMMON_DIAG_H

#include <stdio.h>

#include "common/err.h"

enum { DIAG_MAX = 200 };

enum diag_severity { DIAG_WARNING, DIAG_ERROR };

struct diag {
    enum diag_severity severity;
    char *file;     /* as the user named it; may be NULL */
    uint64_t line;  /* 1-based; 0: none */
    char *path;     /* JSON path ("$.film.resolution"); may be NULL */
    char *text;     /* what is wrong and what was expected */
    char *hint;     /* what to do; may be NULL */
    const char *id; /* static, kebab-case */
};

struct diag_list {
    struct diag *items;
    size_t count, capacity;
    size_t error_count, warning_count; /* including those that found no room */
};

void diag_init(struct diag_list *list);
void diag_release(struct diag_list *list);

/* Where a problem is; `file` and `path` are copied, either may be NULL. */
struct diag_place {
    const char *file;
    uint64_t line;
    const char *path;
};

/* `hint` may be NULL; the text is printf-formatted. */
void diag_add(struct diag_list *list, enum diag_severity severity, struct diag_place place,
              const char *id, const char *hint, const char *format, ...) TL_PRINTF(6, 7);

/* Moves the problems of `from` behind those of `list`; `from` is empty then. */
void diag_append(struct diag_list *list, struct diag_list *from);

/* Tells who uses a file that was read: of the problems from number `from` on, those without a line
 * and JSON path move to `user`, the file's name going into the text; the others name `user` in
 * their hint. `user` has a path. */
void diag_name_user(struct diag_list *list, size_t from, struct diag_place user);

/* Prints every problem, warnings marked "warning: "; "tilery: " stands before one without a place.
 * No closing count. */
void diag_print(const struct diag_list *list, FILE *to);

/* The known word that `word` is likely a slip for, or NULL when none is near: at most one letter
 * left out, put in, changed or swapped for each three (of two: one). Capitals are as small ones. */
const char *diag_nearest(const char *word, const char *const *known, size_t known_count);

#endif
