/* common/json_text.h: JSON text into a tree, strictly RFC 8259, without recursion.
 *
 * Refused with line and column: anything after the value, depth over JSON_DEPTH_MAX,
 * invalid UTF-8, control characters in strings, lone surrogates, `01`, `+1`, `1.`, NaN,
 * comments, a byte order mark. Every value keeps its place, so that problems carry JSON
 * paths. Whole numbers stay exact over 2^53, and `1e999` is told from a number.
 *
 * (cJSON, the first choice, cuts numbers at 63 characters, texts at \u0000, and takes
 * 01, 1e999, bad UTF-8 and trailing bytes; a strict check in front of it would be this
 * parser without its tree.)
 *
 * The document owns all values and texts. Reading a finished document: any thread.
 */
#ifndef COMMON_JSON_TEXT_H
#define COMMON_JSON_TEXT_H

#include "common/diag.h"

enum {
    JSON_DEPTH_MAX = 64,
    JSON_BYTES_MAX = 64 << 20, /* a scene of 200,000 objects is 40 MB */
    JSON_VALUES_MAX = 8 << 20, /* bounds the memory of hostile text at 1 GB */
};

enum json_type { JSON_NULL, JSON_BOOL, JSON_NUMBER, JSON_STRING, JSON_ARRAY, JSON_OBJECT };

/* A value; all fields are read-only. */
struct json {
    enum json_type type;
    bool truth;       /* JSON_BOOL */
    bool has_nul;     /* JSON_STRING: contains U+0000, so `text` is cut there */
    bool is_whole;    /* JSON_NUMBER: written as digits alone and within `whole` */
    uint32_t line;    /* 1-based line of its first character */
    const char *key;  /* member of an object: its name; else NULL */
    const char *text; /* JSON_STRING: UTF-8 */
    double number;    /* JSON_NUMBER: nearest double, may be infinite */
    uint64_t whole;   /* JSON_NUMBER with is_whole: exactly */
    uint32_t index;   /* position in its array or object */
    uint32_t count;   /* members or elements */
    const struct json *parent, *next, *first; /* next: following sibling */
};

struct json_doc {
    struct json *root;
    struct json_chunk *chunks; /* memory, owned */
    size_t value_count;
};

/* Syntax only: duplicate keys pass. `file` (may be NULL) names the text in problems.
 * ERR_INPUT (one problem added), ERR_LIMIT (too long), ERR_NOMEM. */
TL_NODISCARD enum err json_doc_parse(struct json_doc *doc, const char *text, size_t bytes,
                                     const char *file, struct diag_list *problems);
void json_doc_release(struct json_doc *doc);

/* "$.objects[2].material_name"; ends in "..." when over the size. */
enum { JSON_PATH_BYTES = 512 };
void json_path(const struct json *v, char out[JSON_PATH_BYTES]);

#endif
