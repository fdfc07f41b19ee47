#include "common/json_text.h"

#include <stdio.h>
#include <string.h>

#include "common/mem.h"
#include "common/number.h"
#include "common/utf8.h"

enum { CHUNK_BYTES = 64 * 1024, CHUNK_ALIGN = 8 };

struct json_chunk {
    struct json_chunk *next;
    size_t used, capacity;
    _Alignas(CHUNK_ALIGN) unsigned char data[];
};

/* Where the parser stands. `error` is set once; then everything unwinds. */
struct parser {
    struct json_doc *doc;
    const char *at, *end, *line_start;
    uint32_t line;
    const char *file;
    struct diag_list *problems;
    enum err error;
    struct json *open[JSON_DEPTH_MAX]; /* containers around the place, outermost first */
    struct json *last[JSON_DEPTH_MAX]; /* their last child so far, or NULL */
    uint32_t depth;
};

static void *take(struct json_doc *doc, size_t bytes)
{
    bytes = (bytes + CHUNK_ALIGN - 1) / CHUNK_ALIGN * CHUNK_ALIGN;
    struct json_chunk *chunk = doc->chunks;
    if (!chunk || chunk->capacity - chunk->used < bytes) {
        size_t capacity = bytes > CHUNK_BYTES ? bytes : CHUNK_BYTES;
        chunk = mem_alloc(sizeof *chunk + capacity);
        if (!chunk)
            return NULL;
        *chunk = (struct json_chunk){.next = doc->chunks, .capacity = capacity};
        doc->chunks = chunk;
    }
    void *p = chunk->data + chunk->used;
    chunk->used += bytes;
    return p;
}

static bool out_of_memory(struct parser *p)
{
    p->error = ERR_NOMEM;
    return false;
}

static bool fail(struct parser *p, const char *at, const char *id, const char *what)
{
    if (p->error != ERR_OK)
        return false;
    p->error = ERR_INPUT;
    diag_add(p->problems, DIAG_ERROR, (struct diag_place){.file = p->file, .line = p->line}, id,
             NULL, "column %zu: %s", (size_t)(at - p->line_start) + 1, what);
    return false;
}

static bool fail_syntax(struct parser *p, const char *what)
{
    char text[160], shown[16];
    if (p->at == p->end)
        (void)snprintf(shown, sizeof shown, "the end");
    else if (*p->at > 0x20 && *p->at < 0x7f)
        (void)snprintf(shown, sizeof shown, "'%c'", *p->at);
    else
        (void)snprintf(shown, sizeof shown, "byte 0x%02x", (unsigned char)*p->at);
    (void)snprintf(text, sizeof text, "expected %s, found %s", what, shown);
    return fail(p, p->at, "json-syntax", text);
}

static void skip_space(struct parser *p)
{
    for (; p->at < p->end; p->at++) {
        if (*p->at == '\n') {
            p->line++;
            p->line_start = p->at + 1;
        } else if (*p->at != ' ' && *p->at != '\t' && *p->at != '\r') {
            return;
        }
    }
}

static bool eat(struct parser *p, char c)
{
    if (p->at == p->end || *p->at != c)
        return false;
    p->at++;
    return true;
}

/* --- Strings ------------------------------------------------------------- */

/* Four hexadecimal digits, or -1. */
static int32_t parse_hex4(struct parser *p)
{
    int32_t code = 0;
    if (p->end - p->at < 4)
        return -1;
    for (int i = 0; i < 4; i++) {
        char c = p->at[i];
        int digit = c >= '0' && c <= '9'   ? c - '0'
                    : c >= 'a' && c <= 'f' ? c - 'a' + 10
                    : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                           : -1;
        if (digit < 0)
            return -1;
        code = code * 16 + digit;
    }
    p->at += 4;
    return code;
}

/* After "\u": a code point, surrogate pairs joined. */
static bool parse_unicode(struct parser *p, uint32_t *code)
{
    int32_t high = parse_hex4(p);
    if (high < 0)
        return fail_syntax(p, "four hexadecimal digits after \\u");
    *code = (uint32_t)high;
    if (high < 0xD800 || high > 0xDFFF)
        return true;
    int32_t low = -1;
    if (high <= 0xDBFF && p->end - p->at >= 2 && p->at[0] == '\\' && p->at[1] == 'u') {
        p->at += 2;
        low = parse_hex4(p);
    }
    if (low < 0xDC00 || low > 0xDFFF)
        return fail(p, p->at, "json-syntax", "a surrogate without its other half");
    *code = 0x10000u + (((uint32_t)high - 0xD800u) << 10) + ((uint32_t)low - 0xDC00u);
    return true;
}

static bool parse_escape(struct parser *p, char **to, bool *has_nul)
{
    static const char letters[] = "\"\\/bfnrt", meanings[] = "\"\\/\b\f\n\r\t";
    if (p->at == p->end)
        return fail_syntax(p, "an escape");
    const char *found = *p->at ? strchr(letters, *p->at) : NULL;
    if (found) {
        *(*to)++ = meanings[found - letters];
        p->at++;
        return true;
    }
    uint32_t code = 0;
    if (!eat(p, 'u'))
        return fail_syntax(p, "one of \" \\ / b f n r t u after a backslash");
    if (!parse_unicode(p, &code))
        return false;
    *has_nul |= code == 0;
    *to += utf8_encode(code, *to);
    return true;
}

/* Room for the text up to the closing quote; an upper bound, since escapes only shrink. */
static char *string_room(struct parser *p)
{
    const char *scan = p->at;
    while (scan < p->end && *scan != '"')
        scan += *scan == '\\' && p->end - scan > 1 ? 2 : 1;
    char *room = take(p->doc, (size_t)(scan - p->at) + 4);
    if (!room)
        (void)out_of_memory(p);
    return room;
}

/* After the opening quote. */
static bool parse_string(struct parser *p, const char **text, bool *has_nul)
{
    char *to = string_room(p);
    if (!to)
        return false;
    *text = to;
    *has_nul = false;
    for (;;) {
        if (p->at == p->end)
            return fail_syntax(p, "the closing quote of a string");
        if (eat(p, '"'))
            break;
        if (eat(p, '\\')) {
            if (!parse_escape(p, &to, has_nul))
                return false;
            continue;
        }
        if ((unsigned char)*p->at < 0x20)
            return fail_syntax(p, "a control character in a string to be escaped");
        size_t bytes = utf8_length(p->at, p->end);
        if (bytes == 0)
            return fail(p, p->at, "json-syntax", "not UTF-8");
        memcpy(to, p->at, bytes);
        to += bytes;
        p->at += bytes;
    }
    *to = '\0';
    return true;
}

/* --- Values -------------------------------------------------------------- */

static bool is_digit(const struct parser *p)
{
    return p->at < p->end && *p->at >= '0' && *p->at <= '9';
}

static void skip_digits(struct parser *p)
{
    while (is_digit(p))
        p->at++;
}

static bool parse_number(struct parser *p, struct json *v)
{
    const char *start = p->at;
    bool negative = eat(p, '-');
    const char *digits = p->at;
    if (!is_digit(p))
        return fail_syntax(p, "a digit");
    if (eat(p, '0')) {
        if (is_digit(p))
            return fail_syntax(p, "no digit after a leading zero");
    } else {
        skip_digits(p);
    }
    const char *digits_end = p->at;
    if (eat(p, '.')) {
        if (!is_digit(p))
            return fail_syntax(p, "a digit after the decimal point");
        skip_digits(p);
    }
    if (eat(p, 'e') || eat(p, 'E')) {
        if (!eat(p, '-'))
            (void)eat(p, '+');
        if (!is_digit(p))
            return fail_syntax(p, "a digit in the exponent");
        skip_digits(p);
    }
    v->type = JSON_NUMBER;
    (void)number_parse(start, p->at, &v->number);
    v->is_whole = !negative && p->at == digits_end;
    for (const char *c = digits; v->is_whole && c < digits_end; c++)
        v->is_whole = !__builtin_mul_overflow(v->whole, 10u, &v->whole) &&
                      !__builtin_add_overflow(v->whole, (uint64_t)(*c - '0'), &v->whole);
    return true;
}

static bool parse_word(struct parser *p, struct json *v)
{
    static const struct {
        const char *word;
        enum json_type type;
        bool truth;
    } words[] = {
        {"true", JSON_BOOL, true}, {"false", JSON_BOOL, false}, {"null", JSON_NULL, false}};
    for (size_t i = 0; i < sizeof words / sizeof *words; i++) {
        size_t bytes = strlen(words[i].word);
        if ((size_t)(p->end - p->at) >= bytes && memcmp(p->at, words[i].word, bytes) == 0) {
            p->at += bytes;
            v->type = words[i].type;
            v->truth = words[i].truth;
            return true;
        }
    }
    return fail_syntax(p, "a value");
}

/* Appends a new value to the innermost container, or makes it the root. */
static struct json *add_value(struct parser *p, const char *key)
{
    if (++p->doc->value_count > JSON_VALUES_MAX) {
        (void)fail(p, p->at, "json-limit", "too many values (8,388,608 at most)");
        return NULL;
    }
    struct json *v = take(p->doc, sizeof *v);
    if (!v) {
        (void)out_of_memory(p);
        return NULL;
    }
    *v = (struct json){.line = p->line, .key = key};
    if (p->depth == 0) {
        p->doc->root = v;
        return v;
    }
    struct json *parent = p->open[p->depth - 1];
    struct json **last = &p->last[p->depth - 1];
    v->parent = parent;
    v->index = parent->count++;
    if (*last)
        (*last)->next = v;
    else
        parent->first = v;
    *last = v;
    return v;
}

static bool parse_key(struct parser *p, const char **key)
{
    bool has_nul;
    *key = NULL;
    if (p->depth == 0 || p->open[p->depth - 1]->type != JSON_OBJECT)
        return true;
    if (!eat(p, '"'))
        return fail_syntax(p, "a key in quotes");
    if (!parse_string(p, key, &has_nul))
        return false;
    skip_space(p);
    if (!eat(p, ':'))
        return fail_syntax(p, "':' after a key");
    skip_space(p);
    return true;
}

/* A scalar, or the opening of a container, which then is the innermost one. */
static bool parse_value(struct parser *p, bool *opened)
{
    const char *key;
    struct json *v = parse_key(p, &key) ? add_value(p, key) : NULL;
    *opened = false;
    if (!v)
        return false;
    if (eat(p, '"')) {
        v->type = JSON_STRING;
        return parse_string(p, &v->text, &v->has_nul);
    }
    bool array = p->at < p->end && *p->at == '[';
    if (array || (p->at < p->end && *p->at == '{')) {
        if (p->depth == JSON_DEPTH_MAX)
            return fail(p, p->at, "json-limit", "nested deeper than 64 levels");
        p->at++;
        v->type = array ? JSON_ARRAY : JSON_OBJECT;
        p->last[p->depth] = NULL;
        p->open[p->depth++] = v;
        *opened = true;
        return true;
    }
    if (is_digit(p) || (p->at < p->end && *p->at == '-'))
        return parse_number(p, v);
    return parse_word(p, v);
}

/* True and *more when another value follows; true and not *more at the end of the text. */
static bool parse_after_value(struct parser *p, bool *more)
{
    for (*more = false; p->depth > 0; p->depth--) {
        bool array = p->open[p->depth - 1]->type == JSON_ARRAY;
        skip_space(p);
        if (eat(p, ',')) {
            skip_space(p);
            *more = true;
            return true;
        }
        if (!eat(p, array ? ']' : '}'))
            return fail_syntax(p, array ? "',' or ']'" : "',' or '}'");
    }
    skip_space(p);
    return p->at == p->end ? true : fail_syntax(p, "nothing after the end of the document");
}

static bool parse_document(struct parser *p)
{
    bool more = true;
    skip_space(p);
    while (more) {
        bool opened;
        if (!parse_value(p, &opened))
            return false;
        skip_space(p);
        bool array = opened && p->open[p->depth - 1]->type == JSON_ARRAY;
        bool empty = opened && p->at < p->end && *p->at == (array ? ']' : '}');
        if (opened && !empty)
            continue;
        if (!parse_after_value(p, &more))
            return false;
    }
    return true;
}

enum err json_doc_parse(struct json_doc *doc, const char *text, size_t bytes, const char *file,
                        struct diag_list *problems)
{
    *doc = (struct json_doc){0};
    struct parser p = {.doc = doc,
                       .at = text,
                       .end = text + bytes,
                       .line_start = text,
                       .line = 1,
                       .file = file,
                       .problems = problems};
    if (bytes > JSON_BYTES_MAX)
        (void)fail(&p, text, "json-limit", "too long (64 MiB at most)");
    if (p.error == ERR_OK && parse_document(&p))
        return ERR_OK;
    json_doc_release(doc);
    return p.error;
}

void json_doc_release(struct json_doc *doc)
{
    while (doc->chunks) {
        struct json_chunk *next = doc->chunks->next;
        mem_free(doc->chunks);
        doc->chunks = next;
    }
    *doc = (struct json_doc){0};
}

/* --- Paths --------------------------------------------------------------- */

static bool is_plain_key(const char *key)
{
    if (!*key)
        return false;
    for (const char *c = key; *c; c++)
        if (!(*c == '_' || *c == '-' || (*c >= '0' && *c <= '9') || (*c >= 'a' && *c <= 'z') ||
              (*c >= 'A' && *c <= 'Z')))
            return false;
    return true;
}

void json_path(const struct json *v, char out[JSON_PATH_BYTES])
{
    const struct json *chain[JSON_DEPTH_MAX + 1];
    size_t count = 0;
    for (; v->parent; v = v->parent)
        chain[count++] = v;
    size_t used = 1;
    memcpy(out, "$", 2);
    while (count-- > 0 && used < JSON_PATH_BYTES - 1) {
        const struct json *step = chain[count];
        int wrote;
        if (!step->key)
            wrote = snprintf(out + used, JSON_PATH_BYTES - used, "[%u]", step->index);
        else if (is_plain_key(step->key))
            wrote = snprintf(out + used, JSON_PATH_BYTES - used, ".%s", step->key);
        else
            wrote = snprintf(out + used, JSON_PATH_BYTES - used, "[\"%s\"]", step->key);
        used += wrote > 0 ? (size_t)wrote : 0;
    }
    if (used >= JSON_PATH_BYTES)
        memcpy(out + JSON_PATH_BYTES - 4, "...", 4);
}
