/* Fuzzes what the API reads: bodies of POST and PATCH, query values, ids. First byte: which. */
#include <stdint.h>
#include <string.h>

#include "common/mem.h"
#include "master/http_body.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

static void fuzz_job(struct json_get *g)
{
    struct http_job_body body;
    if (http_body_job(g, &body) == ERR_OK) {
        TL_ASSERT(job_spec_valid(&body.spec, NULL));
        TL_ASSERT(memchr(body.name, '\0', sizeof body.name));
        TL_ASSERT(body.priority >= -1000000 && body.priority <= 1000000);
        TL_ASSERT(body.shot == 0 || body.is_frame);
        TL_ASSERT(body.frame <= UINT32_MAX && (body.is_frame || body.frame == 0));
        TL_ASSERT(!body.has_plan || (body.plan.columns > 0 && body.plan.rows > 0));
    }
    http_body_job_release(&body);
}

static void fuzz_change(struct json_get *g)
{
    struct http_change_body body;
    if (http_body_change(g, &body) == ERR_OK)
        TL_ASSERT(body.has_priority || (unsigned)body.state < JOB_STATE_COUNT);
}

static void fuzz_digests(struct json_get *g)
{
    struct buf names;
    buf_init(&names);
    if (http_body_digests(g, &names) == ERR_OK)
        TL_ASSERT(names.bytes % DIGEST_BYTES == 0);
    buf_release(&names);
}

static void fuzz_body(unsigned which, const uint8_t *data, size_t bytes)
{
    static const char *const change_keys[] = {"state", "priority"};
    static const char *const digest_keys[] = {"sha256"};
    static const struct {
        const char *const *keys;
        size_t count;
        void (*run)(struct json_get *g);
    } bodies[] = {{http_job_keys, HTTP_JOB_KEYS, fuzz_job},
                  {change_keys, 2, fuzz_change},
                  {digest_keys, 1, fuzz_digests}};
    struct json_get g;
    struct diag_list problems;
    diag_init(&problems);
    if (http_body_open(&g, data, bytes, bodies[which].keys, bodies[which].count, &problems) ==
        ERR_OK) {
        bodies[which].run(&g);
        json_get_close(&g);
    }
    diag_release(&problems);
}

static void fuzz_query(const uint8_t *data, size_t bytes)
{
    char *text = mem_alloc(bytes + 1);
    uint64_t count = 0;
    if (!text)
        return;
    memcpy(text, data, bytes);
    text[bytes] = '\0';
    TL_ASSERT(http_query_states(text) < 1U << JOB_STATE_COUNT);
    if (http_query_count(text, 1000, &count))
        TL_ASSERT(count >= 1 && count <= 1000);
    if (http_query_count(text, UINT64_MAX / 100, &count))
        TL_ASSERT(count >= 1 && count <= UINT64_MAX / 100);
    TL_ASSERT(http_id(text, 'j') == 0 || http_id(text, 'w') == 0);
    mem_free(text);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    if (bytes < 1)
        return 0;
    unsigned which = data[0] & 3;
    if (which < 3)
        fuzz_body(which, data + 1, bytes - 1);
    else
        fuzz_query(data + 1, bytes - 1);
    return 0;
}
