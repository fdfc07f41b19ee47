/* common/utf8.h: is it UTF-8 (RFC 3629), and may a terminal see it? Pure; any thread. Tests:
 * test_message, test_json, test_file_io. */
#ifndef COMMON_UTF8_H
#define COMMON_UTF8_H

#include <stddef.h>
#include <stdint.h>

/* Bytes (1..4) of the well-formed character at `at`; 0 when there is none: truncated, overlong,
 * a surrogate, or over U+10FFFF. */
size_t utf8_length(const char *at, const char *end);

/* Copies a text into `bytes` of room, its end included, cut at the last whole character that fits;
 * bytes that are no UTF-8 become '?'. */
void utf8_copy(char *out, size_t bytes, const char *text);

/* Makes a foreign text fit to be shown on one line of a terminal, in place: what steers it (control
 * characters, line separators), what turns or hides text (marks of direction, of no width) and
 * bytes that are no UTF-8 become '?' each, so the text may get shorter. */
void utf8_mask(char *text);

/* Writes a code point that is no surrogate, <= 0x10FFFF; returns how many bytes (1..4). */
size_t utf8_encode(uint32_t code, char out[4]);

#endif
