/* common/utf8.h: is it UTF-8 (RFC 3629)? Pure; any thread. */
#ifndef COMMON_UTF8_H
#define COMMON_UTF8_H

#include <stddef.h>
#include <stdint.h>

/* Bytes (1..4) of the well-formed character at `at`; 0 when there is none: truncated, overlong,
 * a surrogate, or over U+10FFFF. */
size_t utf8_length(const char *at, const char *end);

/* Writes a code point that is no surrogate, <= 0x10FFFF; returns how many bytes (1..4). */
size_t utf8_encode(uint32_t code, char out[4]);

#endif
