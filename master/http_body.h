/* master/http_body.h: what bodies and query strings of the API say, as typed values.
 *
 * Hostile bytes in, checked values or a list of problems out: nothing of the farm or of
 * libmicrohttpd, so that fuzz_api runs exactly what the routes run. Pure; any thread.
 * Tests: tests/fuzz/fuzz_api.c, tests/e2e/test_master_http.py.
 */
#ifndef MASTER_HTTP_BODY_H
#define MASTER_HTTP_BODY_H

#include "common/digest.h"
#include "common/job_spec.h"
#include "common/json_get.h"
#include "common/sample_plan.h"
#include "master/job_record.h"

/* Opens a body as a JSON object with only these keys. ERR_INPUT with problems, ERR_NOMEM; then `g`
 * is closed. */
TL_NODISCARD enum err http_body_open(struct json_get *g, const void *data, size_t bytes,
                                     const char *const *keys, size_t key_count,
                                     struct diag_list *problems);

/* POST /api/v1/jobs: the members that a body may have, and what they say. */
enum { HTTP_JOB_KEYS = 7 };
extern const char *const http_job_keys[HTTP_JOB_KEYS];
struct http_job_body {
    char name[JOB_NAME_BYTES];
    struct job_spec spec;
    digest package;
    int32_t priority;
    bool is_frame;
    uint64_t shot, frame; /* of a frame; shot 0: it begins one */
    bool has_plan;
    struct sample_plan plan; /* owned */
};
/* Each of these: ERR_INPUT with problems, ERR_NOMEM; `out` then holds nothing of use. Release a job
 * in any case. */
TL_NODISCARD enum err http_body_job(struct json_get *g, struct http_job_body *out);
void http_body_job_release(struct http_job_body *body);

/* PATCH /api/v1/jobs/{id}: one of the two. */
struct http_change_body {
    bool has_priority; /* else `state` */
    enum job_state state;
    int32_t priority;
};
TL_NODISCARD enum err http_body_change(struct json_get *g, struct http_change_body *out);

/* POST /api/v1/chunks/missing: digest values appended to `out`. */
TL_NODISCARD enum err http_body_digests(struct json_get *g, struct buf *out);

/* The states of "a,b" as bits; 0 when one is unknown. */
unsigned http_query_states(const char *text);
/* A number in [1, high]. */
bool http_query_count(const char *text, uint64_t high, uint64_t *out);
/* "j42" or "w3" as a number; 0: neither. */
uint64_t http_id(const char *text, char letter);

/* A value as compact JSON text (http_json.c); you own it; NULL: out of memory. Texts that contain
 * U+0000 are cut there. */
char *http_json_text(const struct json *top);

#endif
