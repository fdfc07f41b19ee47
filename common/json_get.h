/* common/json_get.h: checked getters: the only way to take values out of JSON.
 *
 * Used for scenes, job specs, the API and configuration. A getter either gives a value
 * that is of the right type, finite and in range, or adds a problem with file, line and
 * JSON path and returns false. A missing optional key leaves *out as it was (so: store
 * the default first) and is no problem. Duplicate and unknown keys are problems.
 *
 *     struct json_get g;
 *     if (json_get_open(&g, text, bytes, "scene.json", problems) != ERR_OK) ...
 *     json_get_keys(&g, g.root, known, known_count);
 *     json_get_number(&g, g.root, "fov", 0, 180, &fov);
 *     json_get_close(&g);
 *
 * One thread at a time.
 */
#ifndef COMMON_JSON_GET_H
#define COMMON_JSON_GET_H

#include "common/json_text.h"

struct json_get {
    struct json_doc doc;
    const struct json *root;
    const char *file;           /* borrowed; may be NULL */
    struct diag_list *problems; /* borrowed */
};

/* Parses and refuses duplicate keys anywhere. On failure there is nothing to close. */
TL_NODISCARD enum err json_get_open(struct json_get *g, const char *text, size_t bytes,
                                    const char *file, struct diag_list *problems);
void json_get_close(struct json_get *g);

/* Adds a problem at a value. */
void json_get_problem(struct json_get *g, enum diag_severity severity, const struct json *at,
                      const char *id, const char *hint, const char *format, ...) TL_PRINTF(6, 7);

/* True when further problems are only counted, so that costly hints are for nobody. */
bool json_get_full(const struct json_get *g);

/* A member by name, or NULL. No problem is added. */
const struct json *json_get_member(const struct json *object, const char *key);

/* A member that must be there. */
const struct json *json_get_required(struct json_get *g, const struct json *object,
                                     const char *key);

/* Every member not in `known` is a problem that names the nearest known key. */
void json_get_keys(struct json_get *g, const struct json *object, const char *const *known,
                   size_t known_count);

/* "did you mean "a"? known: a, b, c" for a hint; looks at the first 1,000 known words. */
enum { JSON_HINT_BYTES = 600 };
void json_hint_known(const char *word, const char *const *known, size_t known_count,
                     char out[JSON_HINT_BYTES]);

/* True if `v` is of that type; else a problem saying what was found. `v` may be NULL (false, no
 * problem). */
bool json_get_is(struct json_get *g, const struct json *v, enum json_type type);

/* Getters of a value. */
bool json_value_number(struct json_get *g, const struct json *v, double low, double high,
                       double *out);
bool json_value_uint(struct json_get *g, const struct json *v, uint64_t low, uint64_t high,
                     uint64_t *out);
bool json_value_bool(struct json_get *g, const struct json *v, bool *out);
/* The text lives as long as the document; never empty unless `may_be_empty`; no U+0000. */
bool json_value_text(struct json_get *g, const struct json *v, bool may_be_empty, const char **out);
/* An array of exactly `count` finite numbers in [low, high]. */
bool json_value_numbers(struct json_get *g, const struct json *v, size_t count, double low,
                        double high, double *out);
/* One of a table of names; problem lists them and the nearest. */
bool json_value_choice(struct json_get *g, const struct json *v, const char *const *names,
                       int name_count, int *out);

/* Getters of an optional member: true when absent (then *out is unchanged) or good; false when a
 * problem was added. */
bool json_get_number(struct json_get *g, const struct json *object, const char *key, double low,
                     double high, double *out);
bool json_get_u64(struct json_get *g, const struct json *object, const char *key, uint64_t low,
                  uint64_t high, uint64_t *out);
bool json_get_u32(struct json_get *g, const struct json *object, const char *key, uint32_t low,
                  uint32_t high, uint32_t *out);
bool json_get_bool(struct json_get *g, const struct json *object, const char *key, bool *out);
bool json_get_text(struct json_get *g, const struct json *object, const char *key,
                   const char **out);
bool json_get_numbers(struct json_get *g, const struct json *object, const char *key, size_t count,
                      double low, double high, double *out);
bool json_get_choice(struct json_get *g, const struct json *object, const char *key,
                     const char *const *names, int name_count, int *out);
/* A 64-bit number in a string of decimal digits, or a JSON integer. */
bool json_get_u64_text(struct json_get *g, const struct json *object, const char *key,
                       uint64_t *out);

#endif
