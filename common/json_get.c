#include "common/json_get.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"
#include "common/number.h"

enum { TEXT_BYTES = 600, KNOWN_SHOWN_MAX = 24, NEAREST_MAX = 1000 };

#define WHOLE_MAX (UINT64_C(1) << 53) /* doubles count exactly up to here */

void json_get_problem(struct json_get *g, enum diag_severity severity, const struct json *at,
                      const char *id, const char *hint, const char *format, ...)
{
    char text[TEXT_BYTES], path[JSON_PATH_BYTES];
    va_list args;
    va_start(args, format);
    (void)vsnprintf(text, sizeof text, format, args);
    va_end(args);
    json_path(at, path);
    diag_add(g->problems, severity, (struct diag_place){.file = g->file, .path = path}, id, hint,
             "%s", text);
}

bool json_get_full(const struct json_get *g)
{
    return g->problems->count >= DIAG_MAX;
}

/* --- Opening: duplicate keys --------------------------------------------- */

static int compare_keys(const void *a, const void *b)
{
    const struct json *const *x = a, *const *y = b;
    int order = strcmp((*x)->key, (*y)->key);
    return order ? order : ((*x)->index > (*y)->index) - ((*x)->index < (*y)->index);
}

static enum err refuse_duplicates_in(struct json_get *g, const struct json *object)
{
    const struct json **members = mem_alloc_array(object->count, sizeof *members);
    if (!members)
        return ERR_NOMEM;
    size_t count = 0;
    for (const struct json *m = object->first; m; m = m->next)
        members[count++] = m;
    qsort(members, count, sizeof *members, compare_keys);
    enum err e = ERR_OK;
    for (size_t i = 1; i < count; i++) {
        if (strcmp(members[i - 1]->key, members[i]->key) != 0)
            continue;
        char hint[80];
        (void)snprintf(hint, sizeof hint, "lines %u and %u; keep one of them", members[i - 1]->line,
                       members[i]->line);
        json_get_problem(g, DIAG_ERROR, members[i], "duplicate-key", hint,
                         "the key is there twice, expected once");
        e = ERR_INPUT;
    }
    mem_free(members);
    return e;
}

/* The value after `v` in document order, without recursion. */
static const struct json *next_in_document(const struct json *v)
{
    if (v->first)
        return v->first;
    while (v && !v->next)
        v = v->parent;
    return v ? v->next : NULL;
}

static enum err refuse_duplicates(struct json_get *g)
{
    enum err worst = ERR_OK;
    for (const struct json *v = g->doc.root; v; v = next_in_document(v)) {
        enum err e = v->type == JSON_OBJECT && v->count > 1 ? refuse_duplicates_in(g, v) : ERR_OK;
        if (e == ERR_NOMEM)
            return e;
        if (e != ERR_OK)
            worst = e;
    }
    return worst;
}

enum err json_get_open(struct json_get *g, const char *text, size_t bytes, const char *file,
                       struct diag_list *problems)
{
    *g = (struct json_get){.file = file, .problems = problems};
    TL_TRY(json_doc_parse(&g->doc, text, bytes, file, problems));
    g->root = g->doc.root;
    enum err e = refuse_duplicates(g);
    if (e != ERR_OK)
        json_get_close(g);
    return e;
}

void json_get_close(struct json_get *g)
{
    json_doc_release(&g->doc);
    g->root = NULL;
}

/* --- Members ------------------------------------------------------------- */

const struct json *json_get_member(const struct json *object, const char *key)
{
    if (!object || object->type != JSON_OBJECT)
        return NULL;
    for (const struct json *m = object->first; m; m = m->next)
        if (strcmp(m->key, key) == 0)
            return m;
    return NULL;
}

const struct json *json_get_required(struct json_get *g, const struct json *object, const char *key)
{
    const struct json *m = json_get_member(object, key);
    if (!m)
        json_get_problem(g, DIAG_ERROR, object, "missing-key", NULL,
                         "the key \"%s\" is missing, and it has no default", key);
    return m;
}

void json_hint_known(const char *word, const char *const *known, size_t known_count,
                     char out[JSON_HINT_BYTES])
{
    const char *near =
        diag_nearest(word, known, known_count < NEAREST_MAX ? known_count : NEAREST_MAX);
    size_t used = 0;
    out[0] = '\0';
    if (near)
        used = (size_t)snprintf(out, JSON_HINT_BYTES, "did you mean \"%.100s\"? ", near);
    const char *lead = "known: ";
    for (size_t i = 0; i < known_count && used < JSON_HINT_BYTES; i++, lead = ", ") {
        if (i == KNOWN_SHOWN_MAX || used + strlen(known[i]) > JSON_HINT_BYTES - 40) {
            (void)snprintf(out + used, JSON_HINT_BYTES - used, " and %zu more", known_count - i);
            return;
        }
        used += (size_t)snprintf(out + used, JSON_HINT_BYTES - used, "%s%s", lead, known[i]);
    }
}

void json_get_keys(struct json_get *g, const struct json *object, const char *const *known,
                   size_t known_count)
{
    for (const struct json *m = object ? object->first : NULL; m; m = m->next) {
        bool found = false;
        for (size_t i = 0; i < known_count && !found; i++)
            found = strcmp(m->key, known[i]) == 0;
        if (found)
            continue;
        char hint[JSON_HINT_BYTES] = "";
        if (!json_get_full(g))
            json_hint_known(m->key, known, known_count, hint);
        json_get_problem(g, DIAG_ERROR, m, "unknown-key", hint, "unknown key \"%.100s\"", m->key);
    }
}

/* --- Values -------------------------------------------------------------- */

static const char *type_name(enum json_type type)
{
    static const char *const names[] = {"null",   "true or false", "a number",
                                        "a text", "an array",      "an object"};
    return names[type];
}

static bool wrong_type(struct json_get *g, const struct json *v, const char *expected)
{
    json_get_problem(g, DIAG_ERROR, v, "wrong-type", NULL, "expected %s, found %s", expected,
                     type_name(v->type));
    return false;
}

bool json_get_is(struct json_get *g, const struct json *v, enum json_type type)
{
    if (!v)
        return false;
    return v->type == type ? true : wrong_type(g, v, type_name(type));
}

bool json_value_number(struct json_get *g, const struct json *v, double low, double high,
                       double *out)
{
    if (!json_get_is(g, v, JSON_NUMBER))
        return false;
    if (!isfinite(v->number)) {
        json_get_problem(g, DIAG_ERROR, v, "not-finite", NULL,
                         "the number is too large for a double");
        return false;
    }
    if (v->number < low || v->number > high) {
        json_get_problem(g, DIAG_ERROR, v, "out-of-range", NULL,
                         "%.10g is out of range, expected %.10g to %.10g", v->number, low, high);
        return false;
    }
    *out = v->number;
    return true;
}

bool json_value_uint(struct json_get *g, const struct json *v, uint64_t low, uint64_t high,
                     uint64_t *out)
{
    if (!json_get_is(g, v, JSON_NUMBER))
        return false;
    bool whole = v->is_whole || (v->number >= 0 && v->number <= (double)WHOLE_MAX &&
                                 v->number == trunc(v->number));
    uint64_t value = v->is_whole ? v->whole : whole ? (uint64_t)v->number : 0;
    if (!whole || value < low || value > high) {
        json_get_problem(g, DIAG_ERROR, v, "out-of-range", NULL,
                         "%.17g is not a whole number from %llu to %llu", v->number,
                         (unsigned long long)low, (unsigned long long)high);
        return false;
    }
    *out = value;
    return true;
}

bool json_value_bool(struct json_get *g, const struct json *v, bool *out)
{
    if (!json_get_is(g, v, JSON_BOOL))
        return false;
    *out = v->truth;
    return true;
}

bool json_value_text(struct json_get *g, const struct json *v, bool may_be_empty, const char **out)
{
    if (!json_get_is(g, v, JSON_STRING))
        return false;
    if (v->has_nul || (!may_be_empty && !*v->text)) {
        json_get_problem(g, DIAG_ERROR, v, "wrong-type", NULL,
                         v->has_nul ? "the text contains U+0000"
                                    : "the text is empty, expected at least one character");
        return false;
    }
    *out = v->text;
    return true;
}

bool json_value_numbers(struct json_get *g, const struct json *v, size_t count, double low,
                        double high, double *out)
{
    double values[16];
    TL_ASSERT(count <= sizeof values / sizeof *values);
    if (!json_get_is(g, v, JSON_ARRAY))
        return false;
    if (v->count != count) {
        json_get_problem(g, DIAG_ERROR, v, "wrong-length", NULL, "expected %zu numbers, found %u",
                         count, v->count);
        return false;
    }
    bool good = true;
    size_t i = 0;
    for (const struct json *e = v->first; e; e = e->next, i++)
        good = json_value_number(g, e, low, high, &values[i]) && good;
    if (good)
        memcpy(out, values, count * sizeof *out);
    return good;
}

bool json_value_choice(struct json_get *g, const struct json *v, const char *const *names,
                       int name_count, int *out)
{
    const char *text;
    if (!json_value_text(g, v, false, &text))
        return false;
    for (int i = 0; i < name_count; i++) {
        if (strcmp(names[i], text) == 0) {
            *out = i;
            return true;
        }
    }
    char hint[JSON_HINT_BYTES];
    json_hint_known(text, names, (size_t)name_count, hint);
    json_get_problem(g, DIAG_ERROR, v, "unknown-name", hint, "unknown name \"%.100s\"", text);
    return false;
}

/* --- Optional members ---------------------------------------------------- */

bool json_get_number(struct json_get *g, const struct json *object, const char *key, double low,
                     double high, double *out)
{
    const struct json *v = json_get_member(object, key);
    return !v || json_value_number(g, v, low, high, out);
}

bool json_get_u64(struct json_get *g, const struct json *object, const char *key, uint64_t low,
                  uint64_t high, uint64_t *out)
{
    const struct json *v = json_get_member(object, key);
    return !v || json_value_uint(g, v, low, high, out);
}

bool json_get_u32(struct json_get *g, const struct json *object, const char *key, uint32_t low,
                  uint32_t high, uint32_t *out)
{
    uint64_t wide = *out;
    if (!json_get_u64(g, object, key, low, high, &wide))
        return false;
    *out = (uint32_t)wide;
    return true;
}

bool json_get_bool(struct json_get *g, const struct json *object, const char *key, bool *out)
{
    const struct json *v = json_get_member(object, key);
    return !v || json_value_bool(g, v, out);
}

bool json_get_text(struct json_get *g, const struct json *object, const char *key, const char **out)
{
    const struct json *v = json_get_member(object, key);
    return !v || json_value_text(g, v, false, out);
}

bool json_get_numbers(struct json_get *g, const struct json *object, const char *key, size_t count,
                      double low, double high, double *out)
{
    const struct json *v = json_get_member(object, key);
    return !v || json_value_numbers(g, v, count, low, high, out);
}

bool json_get_choice(struct json_get *g, const struct json *object, const char *key,
                     const char *const *names, int name_count, int *out)
{
    const struct json *v = json_get_member(object, key);
    return !v || json_value_choice(g, v, names, name_count, out);
}

bool json_get_u64_text(struct json_get *g, const struct json *object, const char *key,
                       uint64_t *out)
{
    const struct json *v = json_get_member(object, key);
    if (!v)
        return true;
    if (v->type == JSON_NUMBER)
        return json_value_uint(g, v, 0, UINT64_MAX, out);
    const char *text;
    if (!json_value_text(g, v, false, &text))
        return false;
    uint64_t value = 0;
    bool good = true;
    for (const char *c = text; *c && good; c++)
        good = *c >= '0' && *c <= '9' && !__builtin_mul_overflow(value, 10u, &value) &&
               !__builtin_add_overflow(value, (uint64_t)(*c - '0'), &value);
    if (!good) {
        json_get_problem(g, DIAG_ERROR, v, "out-of-range", NULL,
                         "\"%.100s\" is not a whole number from 0 to 18446744073709551615", text);
        return false;
    }
    *out = value;
    return true;
}
