/* Server-sent events in any split of their bytes. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#include "client/sse.h"

static char seen[2000];

static void on_event(void *ctx, const char *name, const char *data, size_t bytes)
{
    size_t used = strlen(seen);
    (void)ctx;
    assert_int_equal(strlen(data), bytes);
    (void)snprintf(seen + used, sizeof seen - used, "<%s|%s>", name, data);
}

static const char stream[] = ": hello\n\nretry: 1000\nid: 5-1\nevent: job\ndata: {\"a\":1}\n\n"
                             "id: 5-2\r\ndata: one\r\ndata:two\r\n\r\n"
                             "event: empty\n\n"
                             "id: 5-3\revent: log\rdata: x:y \r\r"
                             "id: 5-4\ndata: never ended";

static void test_any_split(void **state)
{
    (void)state;
    for (size_t split = 0; split < sizeof stream; split++) {
        struct sse s;
        seen[0] = '\0';
        sse_init(&s, on_event, NULL);
        sse_feed(&s, stream, split);
        sse_feed(&s, stream + split, sizeof stream - 1 - (split < sizeof stream ? split : 0));
        assert_string_equal(seen, "<job|{\"a\":1}><message|one\ntwo><log|x:y >");
        assert_string_equal(s.last_id, "5-3");
        sse_release(&s);
    }
}

static void test_byte_by_byte(void **state)
{
    struct sse s;
    (void)state;
    seen[0] = '\0';
    sse_init(&s, on_event, NULL);
    for (size_t i = 0; i + 1 < sizeof stream; i++)
        sse_feed(&s, stream + i, 1);
    assert_string_equal(seen, "<job|{\"a\":1}><message|one\ntwo><log|x:y >");
    sse_release(&s);
}

/* A new connection drops what was half read and keeps the last whole id. */
static void test_restart(void **state)
{
    struct sse s;
    (void)state;
    seen[0] = '\0';
    sse_init(&s, on_event, NULL);
    sse_feed(&s, stream, sizeof stream - 1);
    seen[0] = '\0';
    sse_restart(&s);
    assert_string_equal(s.last_id, "5-3");
    sse_feed(&s, "data: new\n\n", 11);
    assert_string_equal(seen, "<message|new>");
    sse_release(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_any_split),
        cmocka_unit_test(test_byte_by_byte),
        cmocka_unit_test(test_restart),
    };
    return cmocka_run_group_tests_name("cli_stream", tests, NULL, NULL);
}
