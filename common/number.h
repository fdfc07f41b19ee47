/* common/number.h: decimal numbers out of text, exactly rounded, never past the end.
 *
 * Shared by the JSON, OBJ, PLY and HDR readers. Grammar of a number: optional sign,
 * digits with an optional point (at least one digit), optional exponent; no hex, no
 * "nan", no "inf". The locale does not matter. Pure; any thread.
 */
#ifndef COMMON_NUMBER_H
#define COMMON_NUMBER_H

#include "common/err.h"

/* Reads the longest number at `at`; returns the place after it and the nearest double
 * (+-infinity on overflow, for the caller to refuse), or NULL when there is no number. */
const char *number_parse(const char *at, const char *end, double *out);

/* Decimal integer with optional sign; NULL when there is none or it leaves int64. */
const char *number_parse_int(const char *at, const char *end, int64_t *out);

/* The shortest decimal that reads back as `v`, which is finite. */
enum { NUMBER_TEXT_BYTES = 32 };
void number_format(double v, char out[NUMBER_TEXT_BYTES]);

#endif
