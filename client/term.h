/* client/term.h: what standard error and output are connected to. One thread. */
#ifndef CLIENT_TERM_H
#define CLIENT_TERM_H

#include <stdbool.h>
#include <stddef.h>

/* A terminal that understands more than lines: isatty and TERM is not "dumb" or unset. */
bool term_is_smart(int fd);

/* Width in characters now; 80 when unknown. Asked at each paint, since windows are resized. */
int term_columns(int fd);
int term_rows(int fd); /* 24 when unknown */

/* Writes all, in one call where the system allows; talk that cannot be heard is dropped. */
void term_write(int fd, const char *text, size_t bytes);

/* Whether state words are coloured on `fd`: "always", "never", or "auto" (a smart terminal and no
 * NO_COLOR). */
bool term_wants_color(int fd, const char *setting);

/* Whether the locale says UTF-8, and whether the terminal says it has 24-bit colour. */
bool term_is_utf8(void);
bool term_is_truecolor(void);

/* The cursor is hidden while a bar is painted; show is safe in a signal handler, does nothing
 * when it is not hidden, and is run at exit. */
void term_cursor_hide(int fd);
void term_cursor_show(void);

#endif
