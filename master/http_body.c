#include "master/http_body.h"

#include <stdio.h>
#include <string.h>

#include "common/mem.h"
#include "common/utf8.h"

#define PRIORITY_MAX 1000000.0

enum err http_body_open(struct json_get *g, const void *data, size_t bytes, const char *const *keys,
                        size_t key_count, struct diag_list *problems)
{
    TL_TRY(json_get_open(g, bytes ? data : "", bytes, NULL, problems));
    if (json_get_is(g, g->root, JSON_OBJECT))
        json_get_keys(g, g->root, keys, key_count);
    if (problems->error_count == 0)
        return ERR_OK;
    json_get_close(g);
    return ERR_INPUT;
}

/* ERR_NOMEM; what is wrong with it is among the problems. */
static enum err read_spec(struct json_get *g, struct job_spec *out)
{
    const struct json *spec = json_get_required(g, g->root, "spec");
    if (!json_get_is(g, spec, JSON_OBJECT))
        return ERR_OK;
    char *text = http_json_text(spec);
    enum err e = text ? job_spec_from_json(text, strlen(text), out, g->problems) : ERR_NOMEM;
    mem_free(text);
    return e == ERR_NOMEM ? e : ERR_OK;
}

/* "frame": the number of a frame; "shot": the job of the shot's first frame, which has none. */
static void read_frame(struct json_get *g, struct http_job_body *out)
{
    const struct json *shot = json_get_member(g->root, "shot");
    const char *id = NULL;
    out->is_frame = json_get_member(g->root, "frame") != NULL;
    (void)json_get_u64(g, g->root, "frame", 0, UINT32_MAX, &out->frame);
    if (!shot || !json_value_text(g, shot, false, &id))
        return;
    out->shot = http_id(id, 'j');
    if (out->shot == 0)
        json_get_problem(g, DIAG_ERROR, shot, "unknown-job", NULL, "no job \"%.40s\"", id);
    else if (!out->is_frame)
        json_get_problem(g, DIAG_ERROR, shot, "bad-frame", NULL, "a shot needs a \"frame\"");
}

const char *const http_job_keys[HTTP_JOB_KEYS] = {"name", "package", "spec", "priority",
                                                  "shot", "frame",   "plan"};

enum err http_body_job(struct json_get *g, struct http_job_body *out)
{
    const char *name = "", *package = NULL;
    const struct json *plan = json_get_member(g->root, "plan");
    double priority = 0;
    *out = (struct http_job_body){0};
    (void)json_get_text(g, g->root, "name", &name);
    (void)json_get_number(g, g->root, "priority", -PRIORITY_MAX, PRIORITY_MAX, &priority);
    out->priority = (int32_t)priority;
    utf8_copy(out->name, sizeof out->name, name);
    const struct json *p = json_get_required(g, g->root, "package");
    if (json_value_text(g, p, false, &package) && !digest_from_hex(package, &out->package))
        json_get_problem(g, DIAG_ERROR, p, "bad-digest", NULL,
                         "\"%.80s\" is not 64 hexadecimal digits", package);
    read_frame(g, out);
    TL_TRY(read_spec(g, &out->spec));
    if (plan && sample_plan_read(g, plan, &out->plan) == ERR_NOMEM)
        return ERR_NOMEM;
    out->has_plan = plan != NULL;
    return g->problems->error_count == 0 ? ERR_OK : ERR_INPUT;
}

void http_body_job_release(struct http_job_body *body)
{
    sample_plan_release(&body->plan);
    *body = (struct http_job_body){0};
}

enum err http_body_change(struct json_get *g, struct http_change_body *out)
{
    int state = -1;
    double priority = 0;
    bool has_priority = json_get_member(g->root, "priority") != NULL;
    (void)json_get_choice(g, g->root, "state", job_state_names, JOB_STATE_COUNT, &state);
    (void)json_get_number(g, g->root, "priority", -PRIORITY_MAX, PRIORITY_MAX, &priority);
    if (g->problems->error_count == 0 && (state >= 0) == has_priority)
        json_get_problem(g, DIAG_ERROR, g->root, "bad-change", NULL,
                         "must have one of \"state\" and \"priority\"");
    if (g->problems->error_count > 0)
        return ERR_INPUT;
    *out = (struct http_change_body){.has_priority = has_priority, .priority = (int32_t)priority};
    if (!has_priority)
        out->state = (enum job_state)state;
    return ERR_OK;
}

enum err http_body_digests(struct json_get *g, struct buf *out)
{
    const struct json *list = json_get_required(g, g->root, "sha256");
    if (json_get_is(g, list, JSON_ARRAY)) {
        for (const struct json *v = list->first; v; v = v->next) {
            const char *hex = NULL;
            digest name;
            if (!json_value_text(g, v, false, &hex))
                continue;
            if (digest_from_hex(hex, &name))
                buf_put(out, &name, sizeof name);
            else
                json_get_problem(g, DIAG_ERROR, v, "bad-digest", NULL,
                                 "\"%.80s\" is not 64 hexadecimal digits", hex);
        }
    }
    if (g->problems->error_count > 0)
        return ERR_INPUT;
    return buf_status(out);
}

unsigned http_query_states(const char *text)
{
    unsigned states = 0;
    while (text) {
        size_t bytes = strcspn(text, ",");
        unsigned found = 0;
        for (unsigned i = 0; i < JOB_STATE_COUNT; i++)
            if (strlen(job_state_names[i]) == bytes && memcmp(job_state_names[i], text, bytes) == 0)
                found = 1U << i;
        if (!found)
            return 0;
        states |= found;
        text = text[bytes] ? text + bytes + 1 : NULL;
    }
    return states;
}

bool http_query_count(const char *text, uint64_t high, uint64_t *out)
{
    uint64_t v = 0;
    if (!*text)
        return false;
    for (; *text; text++) {
        if (*text < '0' || *text > '9' || v > high)
            return false;
        v = v * 10 + (uint64_t)(*text - '0');
    }
    *out = v;
    return v >= 1 && v <= high;
}

uint64_t http_id(const char *text, char letter)
{
    uint64_t id = 0;
    if (text[0] != letter || text[1] == '0' || text[1] == '\0')
        return 0;
    for (const char *c = text + 1; *c; c++) {
        if (*c < '0' || *c > '9' || id > UINT64_MAX / 100)
            return 0;
        id = id * 10 + (uint64_t)(*c - '0');
    }
    return id;
}
