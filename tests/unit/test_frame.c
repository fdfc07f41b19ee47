/* Frames: the header's rules, and the decoder fed every split of its bytes. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <string.h>

#include "common/mem.h"
#include "proto/frame.h"

static void header_round_trip(void **state)
{
    (void)state;
    for (int type = 0; type < 256; type++) {
        if (frame_type_side(type) == 0) {
            assert_null(frame_type_name(type));
            continue;
        }
        struct frame_header h = {.type = (enum frame_type)type,
                                 .meta_bytes = 0x1234,
                                 .body_bytes = frame_type_body_max(type)},
                            back;
        unsigned char bytes[FRAME_HEADER_BYTES];
        frame_header_encode(&h, bytes);
        assert_int_equal(frame_header_decode(bytes, &back), ERR_OK);
        assert_int_equal(back.type, h.type);
        assert_int_equal(back.meta_bytes, h.meta_bytes);
        assert_int_equal(back.body_bytes, h.body_bytes);
    }
}

/* The bytes of docs/PROTOCOL.md's example. */
static void header_layout(void **state)
{
    (void)state;
    struct frame_header h = {.type = FRAME_RESULT, .meta_bytes = 0x0102, .body_bytes = 0x030405};
    unsigned char bytes[FRAME_HEADER_BYTES];
    frame_header_encode(&h, bytes);
    static const unsigned char expected[FRAME_HEADER_BYTES] = {
        'T', 'L', 1, 14, 0, 0, 0, 0, 0x02, 0x01, 0, 0, 0x05, 0x04, 0x03, 0};
    assert_memory_equal(bytes, expected, sizeof expected);
}

static void bad_headers(void **state)
{
    (void)state;
    static const unsigned char good[FRAME_HEADER_BYTES] = {'T', 'L', 1, FRAME_LEASE};
    struct {
        size_t at;
        unsigned char value;
        enum err expected;
    } cases[] = {
        {0, 'X', ERR_CORRUPT},  {1, 'X', ERR_CORRUPT}, {2, 0, ERR_CORRUPT},   {2, 2, ERR_VERSION},
        {3, 0, ERR_CORRUPT},    {3, 19, ERR_CORRUPT},  {3, 255, ERR_CORRUPT}, {4, 1, ERR_CORRUPT},
        {5, 0x80, ERR_CORRUPT}, {6, 1, ERR_CORRUPT},   {7, 1, ERR_CORRUPT},   {10, 2, ERR_LIMIT},
        {11, 0xff, ERR_LIMIT},  {12, 1, ERR_LIMIT},    {15, 1, ERR_LIMIT},
    };
    struct frame_header h;
    assert_int_equal(frame_header_decode(good, &h), ERR_OK);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        unsigned char bytes[FRAME_HEADER_BYTES];
        memcpy(bytes, good, sizeof bytes);
        bytes[cases[i].at] = cases[i].value;
        assert_int_equal(frame_header_decode(bytes, &h), cases[i].expected);
    }
}

/* Three frames in a row: meta and body, meta only, neither. */
static size_t stream_of_three(unsigned char *out)
{
    const struct frame_header headers[3] = {
        {.type = FRAME_RESULT, .meta_bytes = 5, .body_bytes = 9},
        {.type = FRAME_GOODBYE, .meta_bytes = 3},
        {.type = FRAME_HEARTBEAT},
    };
    size_t at = 0;
    for (int i = 0; i < 3; i++) {
        frame_header_encode(&headers[i], out + at);
        at += FRAME_HEADER_BYTES;
        for (uint32_t k = 0; k < headers[i].meta_bytes + headers[i].body_bytes; k++)
            out[at++] = (unsigned char)(16 * i + (int)k);
    }
    return at;
}

static const struct frame_rules from_worker = {.peer_side = FRAME_SIDE_WORKER};

static void check_frame(int i, const struct frame *f)
{
    static const enum frame_type types[3] = {FRAME_RESULT, FRAME_GOODBYE, FRAME_HEARTBEAT};
    static const uint32_t metas[3] = {5, 3, 0}, bodies[3] = {9, 0, 0};
    assert_int_equal(f->header.type, types[i]);
    assert_int_equal(f->header.meta_bytes, metas[i]);
    assert_int_equal(f->header.body_bytes, bodies[i]);
    for (uint32_t k = 0; k < metas[i]; k++)
        assert_int_equal(f->meta[k], 16 * i + (int)k);
    for (uint32_t k = 0; k < bodies[i]; k++)
        assert_int_equal(f->body[k], 16 * i + (int)(metas[i] + k));
}

/* Feeds one piece; returns how many frames are known by then. */
static int feed_piece(struct frame_decoder *d, const unsigned char *data, size_t bytes, int known)
{
    while (bytes > 0) {
        size_t used;
        bool ready;
        struct frame f;
        assert_int_equal(frame_decoder_feed(d, data, bytes, &used, &ready, &f), ERR_OK);
        assert_true(used <= bytes);
        assert_true(used > 0 || ready);
        if (ready)
            check_frame(known++, &f);
        assert_true(!ready || frame_decoder_idle(d));
        data += used;
        bytes -= used;
    }
    return known;
}

static void every_split(void **state)
{
    (void)state;
    unsigned char stream[128];
    size_t bytes = stream_of_three(stream);
    for (size_t a = 0; a <= bytes; a++) {
        for (size_t b = a; b <= bytes; b++) {
            struct frame_decoder d;
            frame_decoder_init(&d, &from_worker);
            int known = feed_piece(&d, stream, a, 0);
            known = feed_piece(&d, stream + a, b - a, known);
            known = feed_piece(&d, stream + b, bytes - b, known);
            assert_int_equal(known, 3);
            frame_decoder_release(&d);
        }
    }
}

static void byte_by_byte(void **state)
{
    (void)state;
    unsigned char stream[128];
    size_t bytes = stream_of_three(stream);
    struct frame_decoder d;
    frame_decoder_init(&d, &from_worker);
    int known = 0;
    for (size_t i = 0; i < bytes; i++)
        known = feed_piece(&d, stream + i, 1, known);
    assert_int_equal(known, 3);
    frame_decoder_release(&d);
}

/* c-ray reserves what a length says; here the longest body claimed costs what came of it. */
static void a_length_takes_no_memory(void **state)
{
    (void)state;
    struct frame_header h = {.type = FRAME_CHUNK_DATA, .body_bytes = UINT32_MAX};
    unsigned char bytes[FRAME_HEADER_BYTES + 100] = {0};
    frame_header_encode(&h, bytes);
    struct frame_rules rules = {.peer_side = FRAME_SIDE_MASTER};
    struct frame_decoder d;
    frame_decoder_init(&d, &rules);
    size_t used;
    bool ready;
    struct frame f;
    assert_int_equal(frame_decoder_feed(&d, bytes, sizeof bytes, &used, &ready, &f), ERR_OK);
    assert_false(ready);
    assert_false(frame_decoder_idle(&d));
    assert_true(frame_decoder_held_bytes(&d) <= 4096);
    frame_decoder_release(&d);
}

static enum err refuse_body(void *ctx, const struct frame *frame)
{
    assert_null(frame->body);
    assert_memory_equal(frame->meta, "abc", 3);
    ++*(int *)ctx;
    return ERR_REFUSED;
}

static void an_unwanted_body_is_refused_before_it_comes(void **state)
{
    (void)state;
    struct frame_header h = {.type = FRAME_RESULT, .meta_bytes = 3, .body_bytes = 1000};
    unsigned char bytes[FRAME_HEADER_BYTES + 3];
    frame_header_encode(&h, bytes);
    memcpy(bytes + FRAME_HEADER_BYTES, "abc", 3);
    int asked = 0;
    struct frame_rules rules = {
        .peer_side = FRAME_SIDE_WORKER, .body_wanted = refuse_body, .ctx = &asked};
    struct frame_decoder d;
    frame_decoder_init(&d, &rules);
    size_t used;
    bool ready;
    struct frame f;
    assert_int_equal(frame_decoder_feed(&d, bytes, sizeof bytes, &used, &ready, &f), ERR_REFUSED);
    assert_int_equal(asked, 1);
    assert_int_equal(frame_decoder_feed(&d, bytes, 1, &used, &ready, &f), ERR_REFUSED); /* sticky */
    frame_decoder_release(&d);
}

static void the_other_sides_types_are_refused(void **state)
{
    (void)state;
    unsigned char bytes[FRAME_HEADER_BYTES];
    frame_header_encode(&(struct frame_header){.type = FRAME_LEASE}, bytes);
    struct frame_decoder d;
    frame_decoder_init(&d, &from_worker);
    size_t used;
    bool ready;
    struct frame f;
    assert_int_equal(frame_decoder_feed(&d, bytes, sizeof bytes, &used, &ready, &f), ERR_CORRUPT);
    frame_decoder_release(&d);
}

static void a_body_can_be_kept(void **state)
{
    (void)state;
    unsigned char stream[128];
    size_t bytes = stream_of_three(stream), used;
    bool ready;
    struct frame f;
    struct frame_decoder d;
    frame_decoder_init(&d, &from_worker);
    assert_int_equal(frame_decoder_feed(&d, stream, bytes, &used, &ready, &f), ERR_OK);
    assert_true(ready);
    unsigned char *body = frame_decoder_take_body(&d);
    assert_int_equal(feed_piece(&d, stream + used, bytes - used, 1), 3);
    for (int k = 0; k < 9; k++)
        assert_int_equal(body[k], 5 + k);
    mem_free(body);
    frame_decoder_release(&d);
}

static void out_of_memory(void **state)
{
    (void)state;
    unsigned char stream[128];
    size_t bytes = stream_of_three(stream);
    for (uint64_t n = 0; n < 2; n++) {
        struct frame_decoder d;
        frame_decoder_init(&d, &from_worker);
        size_t used;
        bool ready;
        struct frame f;
        mem_fail_after(n);
        assert_int_equal(frame_decoder_feed(&d, stream, bytes, &used, &ready, &f), ERR_NOMEM);
        mem_fail_after(UINT64_MAX);
        frame_decoder_release(&d);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(header_round_trip),
        cmocka_unit_test(header_layout),
        cmocka_unit_test(bad_headers),
        cmocka_unit_test(every_split),
        cmocka_unit_test(byte_by_byte),
        cmocka_unit_test(a_length_takes_no_memory),
        cmocka_unit_test(an_unwanted_body_is_refused_before_it_comes),
        cmocka_unit_test(the_other_sides_types_are_refused),
        cmocka_unit_test(a_body_can_be_kept),
        cmocka_unit_test(out_of_memory),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
