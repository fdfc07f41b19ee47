/* Messages: each type there and back, its maxima, its texts, its ranges. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <string.h>

#include "proto/message.h"

/* A message of the type that message_check accepts, its fields away from their defaults. */
static struct message sample(enum frame_type type)
{
    struct message m = {.type = type};
    switch (type) {
    case FRAME_HELLO:
        m.hello.protocol_min = 1;
        m.hello.protocol_max = 3;
        m.hello.threads = 8;
        m.hello.instance = UINT64_MAX;
        m.hello.determinism_id[31] = 0xff;
        m.hello.tags_count = 2;
        MESSAGE_TEXT(m.hello.tags[0], "gross");
        MESSAGE_TEXT(m.hello.tags[1], "größer");
        MESSAGE_TEXT(m.hello.name, "anna");
        break;
    case FRAME_WELCOME:
        m.welcome = (tilery_Welcome){
            .protocol = 1, .worker_id = "w3", .heartbeat_ms = 1000, .farm = UINT64_MAX - 1};
        break;
    case FRAME_JOB_INFO:
        m.job_info.job = 4;
        m.job_info.package[0] = 1;
        m.job_info.spec_json.size = 4096;
        memset(m.job_info.spec_json.bytes, 'x', 4096);
        break;
    case FRAME_JOB_READY:
        m.job_ready = (tilery_JobReady){.job = 1, .load_seconds = 0.25, .scene_bytes = 77};
        break;
    case FRAME_CHUNK_DATA:
        m.chunk_data.raw_bytes = LIMIT_CHUNK_RAW_BYTES;
        m.chunk_data.sha256[5] = 9;
        break;
    case FRAME_LEASE:
        m.lease = (tilery_Lease){.job = 1, .cell_begin = 5, .cell_count = 6, .epoch = 1ull << 60};
        break;
    case FRAME_RESULT:
        m.result = (tilery_Result){.cell_count = 1,
                                   .raw_bytes = 12,
                                   .samples = 3,
                                   .nonfinite = 3,
                                   .nonfinite_pixel = UINT64_MAX};
        break;
    case FRAME_REFUSE:
        m.refuse.reason = tilery_REFUSE_TOKEN;
        MESSAGE_TEXT(m.refuse.text, "no");
        break;
    default:
        break;
    }
    return m;
}

static void there_and_back(void **state)
{
    (void)state;
    for (int type = 1; type < 256; type++) {
        if (frame_type_side(type) == 0)
            continue;
        struct message m = sample((enum frame_type)type), back;
        unsigned char meta[MESSAGE_BYTES_MAX];
        size_t bytes;
        assert_int_equal(message_encode(&m, meta, &bytes), ERR_OK);
        assert_true(bytes <= MESSAGE_BYTES_MAX);
        assert_int_equal(message_decode(m.type, meta, bytes, &back), ERR_OK);
        unsigned char again[MESSAGE_BYTES_MAX];
        size_t again_bytes;
        assert_int_equal(message_encode(&back, again, &again_bytes), ERR_OK);
        assert_int_equal(again_bytes, bytes);
        assert_memory_equal(again, meta, bytes);
    }
    struct message hello = sample(FRAME_HELLO), back;
    unsigned char meta[MESSAGE_BYTES_MAX];
    size_t bytes;
    assert_int_equal(message_encode(&hello, meta, &bytes), ERR_OK);
    assert_int_equal(message_decode(FRAME_HELLO, meta, bytes, &back), ERR_OK);
    assert_string_equal(back.hello.tags[1], "größer");
    assert_true(back.hello.instance == UINT64_MAX);
    assert_int_equal(back.hello.determinism_id[31], 0xff);
}

/* Truncating a message anywhere gives an error or a shorter message, and never more. */
static void every_prefix(void **state)
{
    (void)state;
    for (int type = 1; type < 256; type++) {
        if (frame_type_side(type) == 0)
            continue;
        struct message m = sample((enum frame_type)type), back;
        unsigned char meta[MESSAGE_BYTES_MAX];
        size_t bytes;
        assert_int_equal(message_encode(&m, meta, &bytes), ERR_OK);
        for (size_t cut = 0; cut < bytes; cut++) {
            enum err e = message_decode(m.type, meta, cut, &back);
            assert_true(e == ERR_OK || e == ERR_CORRUPT);
        }
    }
}

static enum err decode_hello_name(const char *name, size_t name_bytes)
{
    unsigned char meta[400] = {0x08, 1, 0x10, 1, 0x38, 1, 0x2a}; /* min, max, threads; name */
    meta[7] = (unsigned char)name_bytes;
    memcpy(meta + 8, name, name_bytes);
    struct message m;
    return message_decode(FRAME_HELLO, meta, 8 + name_bytes, &m);
}

static void texts_are_utf8(void **state)
{
    (void)state;
    static const char *const good[] = {
        "a", "\xc3\xa9", "\xe2\x82\xac", "\xf0\x9f\x8e\xa8", "\xed\x9f\xbf", "\xf4\x8f\xbf\xbf"};
    static const char *const bad[] = {
        "\xff",  "\xc3",     "\xc0\x80",         "\xed\xa0\x80", "\xf4\x90\x80\x80",
        "a\x80", "\xe2\x82", "\xf5\x80\x80\x80", "\xe0\x80\xaf"};
    for (size_t i = 0; i < sizeof good / sizeof *good; i++)
        assert_int_equal(decode_hello_name(good[i], strlen(good[i])), ERR_OK);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        assert_int_equal(decode_hello_name(bad[i], strlen(bad[i])), ERR_CORRUPT);
    char longest[66];
    memset(longest, 'n', sizeof longest);
    assert_int_equal(decode_hello_name(longest, 64), ERR_OK);
    assert_int_equal(decode_hello_name(longest, 65), ERR_CORRUPT);
    assert_int_equal(decode_hello_name("", 0), ERR_CORRUPT);
}

/* 64 KiB of empty tags cost protobuf-c 3.7 MB; here they are over the maximum. */
static void a_flood_of_tags(void **state)
{
    (void)state;
    static unsigned char meta[LIMIT_META_BYTES];
    for (size_t i = 0; i < sizeof meta; i += 2)
        meta[i] = 0x42; /* tags, length 0 */
    struct message m;
    assert_int_equal(message_decode(FRAME_HELLO, meta, sizeof meta, &m), ERR_CORRUPT);
}

static void ranges(void **state)
{
    (void)state;
    struct message m = sample(FRAME_LEASE);
    m.lease.cell_count = 0;
    assert_non_null(message_check(&m));
    m = sample(FRAME_LEASE);
    m.lease.cell_begin = UINT32_MAX;
    assert_non_null(message_check(&m));
    m = sample(FRAME_RESULT);
    m.result.raw_bytes = 13;
    assert_non_null(message_check(&m));
    m.result.raw_bytes = LIMIT_UNIT_RAW_BYTES + 12;
    assert_non_null(message_check(&m));
    m = sample(FRAME_RESULT);
    m.result.nonfinite = 4;
    assert_non_null(message_check(&m));
    m = sample(FRAME_WELCOME);
    m.welcome.heartbeat_ms = 0;
    assert_non_null(message_check(&m));
    m.welcome.heartbeat_ms = LIMIT_HEARTBEAT_MS + 1;
    assert_non_null(message_check(&m));
    m = sample(FRAME_JOB_READY);
    m.job_ready.load_seconds = (double)NAN;
    assert_non_null(message_check(&m));
    m.job_ready.load_seconds = -1;
    assert_non_null(message_check(&m));
    m = sample(FRAME_HELLO);
    m.hello.protocol_min = 4;
    assert_non_null(message_check(&m));
    m = sample(FRAME_HELLO);
    m.hello.threads = LIMIT_THREADS + 1;
    assert_non_null(message_check(&m));
    m = sample(FRAME_CHUNK_DATA);
    m.chunk_data.raw_bytes++;
    assert_non_null(message_check(&m));
    unsigned char meta[MESSAGE_BYTES_MAX];
    size_t bytes;
    assert_int_equal(message_encode(&m, meta, &bytes), ERR_LIMIT);
}

static void unknown_fields_are_skipped(void **state)
{
    (void)state;
    struct message m = sample(FRAME_LEASE), back;
    unsigned char meta[MESSAGE_BYTES_MAX];
    size_t bytes;
    assert_int_equal(message_encode(&m, meta, &bytes), ERR_OK);
    memcpy(meta + bytes, "\xa2\x06\x03xyz", 6); /* field 100 */
    assert_int_equal(message_decode(FRAME_LEASE, meta, bytes + 6, &back), ERR_OK);
    assert_int_equal(back.lease.cell_count, 6);
}

static void texts_are_cut_at_whole_characters(void **state)
{
    (void)state;
    char field[5];
    MESSAGE_TEXT(field, "abc\xc3\xa9");
    assert_string_equal(field, "abc");
    MESSAGE_TEXT(field, "ab\xc3\xa9z");
    assert_string_equal(field, "ab\xc3\xa9");
    MESSAGE_TEXT(field, "\xff\xc3");
    assert_string_equal(field, "??");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(there_and_back),
        cmocka_unit_test(every_prefix),
        cmocka_unit_test(texts_are_utf8),
        cmocka_unit_test(a_flood_of_tags),
        cmocka_unit_test(ranges),
        cmocka_unit_test(unknown_fields_are_skipped),
        cmocka_unit_test(texts_are_cut_at_whole_characters),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
