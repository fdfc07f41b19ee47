/* client/text_table.h: rows of words under headings, columns two spaces apart.
 *
 * Numbers right, words left; the last column is cut to the window on a terminal and whole when
 * piped. One column may be coloured by its word. One thread.
 */
#ifndef CLIENT_TEXT_TABLE_H
#define CLIENT_TEXT_TABLE_H

#include "common/buf.h"

enum { TEXT_TABLE_COLUMNS_MAX = 16 };

struct text_table {
    const char *const *headings;
    const char *align; /* a letter a column: 'l' or 'r' */
    size_t column_count;
    char **cells; /* row by row; owned */
    size_t cell_count, capacity;
    int color_column; /* holds a state word; -1: none */
    int name_column;  /* on a terminal it gives way, before the last one does; -1: none */
    bool failed;
};

void text_table_init(struct text_table *t, const char *const *headings, const char *align);
void text_table_release(struct text_table *t);

/* The next cell of the row; what utf8_mask takes becomes '?'. NULL: "-". */
void text_table_add(struct text_table *t, const char *text);
void text_table_addf(struct text_table *t, const char *format, ...) TL_PRINTF(2, 3);

/* Appends the table. columns 0: do not cut. */
void text_table_print(const struct text_table *t, int columns, bool color, struct buf *out);

#endif
