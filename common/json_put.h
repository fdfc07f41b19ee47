/* common/json_put.h: JSON text out, into a buf. One thread. */
#ifndef COMMON_JSON_PUT_H
#define COMMON_JSON_PUT_H

#include "common/buf.h"

/* Quoted and escaped; bytes that are not UTF-8 become U+FFFD. NULL gives null. */
void json_put_text(struct buf *b, const char *text);

/* The shortest decimal that reads back the same; null when not finite. */
void json_put_number(struct buf *b, double v);

#endif
