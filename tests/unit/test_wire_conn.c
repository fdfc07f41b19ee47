/* Connections: two ends on one loop, and a raw socket that is rude to one of them. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <string.h>
#include <uv.h>

#include "common/mem.h"
#include "proto/transport.h"

enum { BODY_BYTES = 300 * 1000 };

/* What one end has seen. */
struct end {
    struct conn *conn;
    int opened, closed, writable;
    int messages[32];
    enum err why;
    uint64_t last_epoch;
    size_t body_bytes;
    bool keep_body, pause_at_first, close_in_callback;
    enum err body_answer;
};

static uv_loop_t loop;
static struct transport *transport;
static struct listener *listener;
static struct end master, worker;
static bool transport_gone;

static void on_open(void *ctx, struct conn *c)
{
    struct end *e = ctx;
    e->opened++;
    e->conn = c;
}

static void on_message(void *ctx, struct conn *c, const struct message *m,
                       const unsigned char *body, size_t body_bytes)
{
    struct end *e = ctx;
    e->messages[m->type]++;
    e->body_bytes += body_bytes;
    if (m->type == FRAME_LEASE) {
        assert_true(m->lease.epoch == e->last_epoch + 1);
        e->last_epoch = m->lease.epoch;
    }
    if (body && e->keep_body) {
        unsigned char *kept = conn_take_body(c);
        assert_ptr_equal(kept, body);
        for (size_t i = 0; i < body_bytes; i++)
            assert_int_equal(kept[i], i % 251);
        mem_free(kept);
    }
    if (e->pause_at_first && e->messages[m->type] == 1)
        conn_pause(c, true);
    if (e->close_in_callback)
        conn_close(c, ERR_STATE);
}

static enum err on_body_wanted(void *ctx, struct conn *c, const struct message *m,
                               uint32_t body_bytes)
{
    (void)c;
    (void)body_bytes;
    assert_int_equal(m->type, FRAME_RESULT);
    return ((struct end *)ctx)->body_answer;
}

static void on_writable(void *ctx, struct conn *c)
{
    (void)c;
    ((struct end *)ctx)->writable++;
}

static void on_close(void *ctx, struct conn *c, enum err why)
{
    struct end *e = ctx;
    assert_true(e->conn == c || e->conn == NULL);
    e->closed++;
    e->why = why;
    e->conn = NULL;
}

static struct conn_options options_of(struct end *e, int peer_side)
{
    return (struct conn_options){.peer_side = peer_side,
                                 .handlers = {.on_open = on_open,
                                              .on_message = on_message,
                                              .body_wanted = on_body_wanted,
                                              .on_writable = on_writable,
                                              .on_close = on_close},
                                 .ctx = e,
                                 .handshake_ms = 300,
                                 .queue_bytes_max = 100 * 1000};
}

static int set_up(void **state)
{
    (void)state;
    master = worker = (struct end){0};
    transport_gone = false;
    struct conn_options options = options_of(&master, FRAME_SIDE_WORKER);
    return uv_loop_init(&loop) < 0 || transport_new(&loop, &transport) != ERR_OK ||
           listener_new(transport, "127.0.0.1:0", 0, &options, &listener) != ERR_OK;
}

static void on_gone(void *ctx)
{
    *(bool *)ctx = true;
}

static int tear_down(void **state)
{
    (void)state;
    transport_close(transport, on_gone, &transport_gone);
    (void)uv_run(&loop, UV_RUN_DEFAULT);
    return !transport_gone || master.opened != master.closed || uv_loop_close(&loop) != 0;
}

/* Turns the loop until *what reaches `count`, or fails after five seconds. */
static void turn_until(const int *what, int count)
{
    uint64_t begun = uv_hrtime();
    while (*what < count) {
        (void)uv_run(&loop, UV_RUN_NOWAIT);
        assert_true(uv_hrtime() - begun < UINT64_C(5000000000));
    }
}

static void turn_for(uint64_t ms)
{
    uint64_t begun = uv_hrtime();
    while (uv_hrtime() - begun < ms * 1000000)
        (void)uv_run(&loop, UV_RUN_NOWAIT);
}

static struct message hello(void)
{
    return (struct message){
        .type = FRAME_HELLO,
        .hello = {.protocol_min = 1, .protocol_max = 1, .threads = 1, .name = "w"}};
}

static struct message lease(uint64_t epoch)
{
    return (struct message){.type = FRAME_LEASE, .lease = {.cell_count = 1, .epoch = epoch}};
}

static void connect_worker(void)
{
    struct conn_options options = options_of(&worker, FRAME_SIDE_MASTER);
    struct conn *c;
    options.handshake_ms = 3000; /* the master's is the one that is tested */
    assert_int_equal(conn_connect(transport, listener_address(listener), &options, &c), ERR_OK);
    turn_until(&worker.opened, 1);
    turn_until(&master.opened, 1);
}

static void connect_accepted(void)
{
    connect_worker();
    conn_accept(worker.conn);
    conn_accept(master.conn);
}

static struct blob *pattern(size_t bytes)
{
    unsigned char *data = mem_alloc(bytes);
    assert_non_null(data);
    for (size_t i = 0; i < bytes; i++)
        data[i] = (unsigned char)(i % 251);
    struct blob *b = blob_new(data, bytes);
    assert_non_null(b);
    return b;
}

static void hello_and_many_leases(void **state)
{
    (void)state;
    connect_worker();
    struct message m = hello();
    assert_int_equal(conn_send(worker.conn, &m, NULL), ERR_OK);
    turn_until(&master.messages[FRAME_HELLO], 1);
    conn_accept(master.conn);
    conn_accept(worker.conn);
    for (uint64_t i = 1; i <= 1000; i++) {
        m = lease(i);
        assert_int_equal(conn_send(master.conn, &m, NULL), ERR_OK);
    }
    turn_until(&worker.messages[FRAME_LEASE], 1000);
    struct conn_counts counts;
    conn_counts_get(worker.conn, &counts);
    assert_int_equal(counts.frames_in, 1000);
    conn_close(worker.conn, ERR_OK);
    turn_until(&master.closed, 1);
    turn_until(&worker.closed, 1);
    assert_int_equal(master.why, ERR_OK);
}

static void a_large_body_arrives_and_can_be_kept(void **state)
{
    (void)state;
    connect_accepted();
    master.keep_body = true;
    struct blob *body = pattern(BODY_BYTES);
    struct message m = {.type = FRAME_RESULT, .result = {.cell_count = 1, .raw_bytes = 12}};
    assert_int_equal(conn_send(worker.conn, &m, body), ERR_OK); /* larger than the queue: alone */
    assert_int_equal(conn_send(worker.conn, &m, body), ERR_AGAIN);
    turn_until(&worker.writable, 1);
    assert_int_equal(conn_send(worker.conn, &m, body), ERR_OK);
    turn_until(&master.messages[FRAME_RESULT], 2);
    assert_int_equal(master.body_bytes, 2 * BODY_BYTES);
    blob_unref(body);
}

static void an_unwanted_body_closes(void **state)
{
    (void)state;
    connect_accepted();
    master.body_answer = ERR_REFUSED;
    struct blob *body = pattern(10);
    struct message m = {.type = FRAME_RESULT, .result = {.cell_count = 1, .raw_bytes = 12}};
    assert_int_equal(conn_send(worker.conn, &m, body), ERR_OK);
    blob_unref(body);
    turn_until(&master.closed, 1);
    assert_int_equal(master.why, ERR_REFUSED);
}

static void silence_before_and_after_the_handshake(void **state)
{
    (void)state;
    connect_worker();
    turn_until(&master.closed, 1);
    assert_int_equal(master.why, ERR_TIMEOUT);
    turn_until(&worker.closed, 1);
    master = worker = (struct end){0};
    connect_accepted();
    turn_for(400);
    assert_int_equal(master.closed + worker.closed, 0); /* accepted: the handshake's limit is off */
    conn_set_silence(master.conn, 100);
    for (int i = 0; i < 6; i++) {
        struct message m = {.type = FRAME_HEARTBEAT};
        assert_int_equal(conn_send(worker.conn, &m, NULL), ERR_OK);
        turn_for(50);
    }
    assert_int_equal(master.closed, 0);
    turn_until(&master.closed, 1);
    assert_int_equal(master.why, ERR_TIMEOUT);
}

static void work_before_the_handshake_closes(void **state)
{
    (void)state;
    connect_worker();
    struct message m = {.type = FRAME_GOODBYE};
    assert_int_equal(conn_send(worker.conn, &m, NULL), ERR_OK);
    turn_until(&master.closed, 1);
    assert_int_equal(master.why, ERR_CORRUPT);
    assert_int_equal(master.messages[FRAME_GOODBYE], 0);
}

static void pausing_holds_messages_back(void **state)
{
    (void)state;
    connect_accepted();
    worker.pause_at_first = true;
    for (uint64_t i = 1; i <= 500; i++) {
        struct message m = lease(i);
        assert_int_equal(conn_send(master.conn, &m, NULL), ERR_OK);
    }
    turn_for(50);
    assert_int_equal(worker.messages[FRAME_LEASE], 1);
    conn_pause(worker.conn, false);
    turn_until(&worker.messages[FRAME_LEASE], 500);
}

static void closing_inside_a_callback(void **state)
{
    (void)state;
    connect_accepted();
    worker.close_in_callback = true;
    for (uint64_t i = 1; i <= 100; i++) {
        struct message m = lease(i);
        assert_int_equal(conn_send(master.conn, &m, NULL), ERR_OK);
    }
    turn_until(&worker.closed, 1);
    assert_int_equal(worker.messages[FRAME_LEASE], 1);
    assert_int_equal(worker.why, ERR_STATE);
    turn_until(&master.closed, 1);
}

/* A Refuse must be read even though its sender closes at once and has unread input. */
static void finishing_delivers_the_last_word(void **state)
{
    (void)state;
    connect_worker();
    struct message m = hello();
    for (int i = 0; i < 20; i++)
        assert_int_equal(conn_send(worker.conn, &m, NULL), ERR_OK);
    m = (struct message){.type = FRAME_REFUSE, .refuse = {.reason = tilery_REFUSE_TOKEN}};
    assert_int_equal(conn_send(master.conn, &m, NULL), ERR_OK);
    conn_finish(master.conn, ERR_REFUSED);
    assert_int_equal(conn_send(master.conn, &m, NULL), ERR_CLOSED);
    turn_until(&worker.messages[FRAME_REFUSE], 1);
    assert_int_equal(master.messages[FRAME_HELLO], 0);
    turn_until(&worker.closed, 1);
    turn_until(&master.closed, 1);
    assert_int_equal(master.why, ERR_REFUSED);
}

static void nobody_there(void **state)
{
    (void)state;
    struct conn_options options = options_of(&worker, FRAME_SIDE_MASTER);
    struct conn *c;
    static const char *const wrong[] = {
        "",        ":",       "host",   "host:", ":1",         "host:65536",
        "host:-1", "host:1x", "::1:80", "[]:80", "host:123456"};
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        assert_false(transport_host_port_valid(wrong[i]));
        assert_int_equal(conn_connect(transport, wrong[i], &options, &c), ERR_USAGE);
    }
    assert_true(transport_host_port_valid("[::1]:80"));
    assert_int_equal(conn_connect(transport, "127.0.0.1:1", &options, &c), ERR_OK);
    turn_until(&worker.closed, 1);
    assert_int_equal(worker.why, ERR_UNREACHABLE);
    assert_int_equal(conn_connect(transport, "no.such.host.invalid:1", &options, &c), ERR_OK);
    turn_until(&worker.closed, 2);
    assert_int_equal(worker.why, ERR_UNREACHABLE);
}

static void closing_while_connecting(void **state)
{
    (void)state;
    struct conn_options options = options_of(&worker, FRAME_SIDE_MASTER);
    struct conn *c;
    for (int turns = 0; turns < 6; turns++) {
        assert_int_equal(conn_connect(transport, listener_address(listener), &options, &c), ERR_OK);
        for (int i = 0; i < turns; i++)
            (void)uv_run(&loop, UV_RUN_NOWAIT);
        if (worker.closed == turns)
            conn_close(c, ERR_STATE);
        turn_until(&worker.closed, turns + 1);
        worker.conn = NULL;
        master.conn = NULL;
        turn_for(5);
    }
}

static void an_address_in_use(void **state)
{
    (void)state;
    struct conn_options options = options_of(&master, FRAME_SIDE_WORKER);
    struct listener *second;
    assert_int_equal(listener_new(transport, listener_address(listener), 0, &options, &second),
                     ERR_ADDRESS);
    assert_int_equal(listener_new(transport, "nonsense", 0, &options, &second), ERR_USAGE);
    assert_int_equal(listener_new(transport, "192.0.2.1:0", 0, &options, &second), ERR_ADDRESS);
}

int main(void)
{
#define ON_LOOP(test) cmocka_unit_test_setup_teardown(test, set_up, tear_down)
    const struct CMUnitTest tests[] = {
        ON_LOOP(hello_and_many_leases),
        ON_LOOP(a_large_body_arrives_and_can_be_kept),
        ON_LOOP(an_unwanted_body_closes),
        ON_LOOP(silence_before_and_after_the_handshake),
        ON_LOOP(work_before_the_handshake_closes),
        ON_LOOP(pausing_holds_messages_back),
        ON_LOOP(closing_inside_a_callback),
        ON_LOOP(finishing_delivers_the_last_word),
        ON_LOOP(nobody_there),
        ON_LOOP(closing_while_connecting),
        ON_LOOP(an_address_in_use),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
