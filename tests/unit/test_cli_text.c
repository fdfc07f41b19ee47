/* What people read: the progress line, tables, durations, the report block. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "client/human.h"
#include "client/preview.h"
#include "client/progress.h"
#include "client/report_text.h"
#include "client/text_table.h"
#include "common/diag.h"
#include "common/mem.h"
#include "common/utf8.h"

static struct progress_now example(void)
{
    return (struct progress_now){.state = "rendering",
                                 .done = 0.579,
                                 .has_left = true,
                                 .left_s = {38.2, 51.9},
                                 .relmse = 0.021,
                                 .rays_s = 119e6,
                                 .workers = 8};
}

static void test_mask(void **state)
{
    static const char *const cases[][2] = {
        {"gr\u00f6\u00dfer \u6f22 \U0001f600", "gr\u00f6\u00dfer \u6f22 \U0001f600"},
        {"a\x1b[31m\r\n\t\x7f", "a?[31m????"},
        {"\u202egnp.exe\u2066", "?gnp.exe?"},
        {"\xc2\x85\xc2\x9b\u2028\ufeff", "????"},
        {"cut \xe6\xbc", "cut ??"},
        {"\xff\xc0\x80", "???"},
    };
    (void)state;
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        char text[64];
        (void)snprintf(text, sizeof text, "%s", cases[i][0]);
        utf8_mask(text);
        assert_string_equal(text, cases[i][1]);
    }
}

/* Slips of the keyboard are found; words that merely are short too are not. */
static void test_nearest(void **state)
{
    static const char *const known[] = {"spp",   "png",        "aov",          "seed",   "size",
                                        "crop",  "tile",       "plan",         "output", "report",
                                        "quiet", "glass",      "MIS",          "NEE",    "RW",
                                        "path",  "time-limit", "target-error", "max-spp"};
    static const struct {
        const char *word, *nearest;
    } cases[] = {
        {"sp", "spp"},
        {"ssp", "spp"},
        {"pgn", "png"},
        {"sede", "seed"},
        {"sed", "seed"},
        {"galss", "glass"},
        {"mis", "MIS"},
        {"rw", "RW"},
        {"out", "output"},
        {"outptu", "output"},
        {"Report", "report"},
        {"timelimit", "time-limit"},
        {"target-eror", "target-error"},
        {"x", NULL},
        {"hi", NULL},
        {"fps", NULL},
        {"dpi", NULL},
        {"gpu", NULL},
        {"ldr", NULL},
        {"cats", NULL},
        {"foo", NULL},
        {"scenes", NULL},
        {"", NULL},
    };
    (void)state;
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        const char *found = diag_nearest(cases[i].word, known, sizeof known / sizeof *known);
        if (!cases[i].nearest)
            assert_null(found);
        else
            assert_string_equal(found ? found : "nothing", cases[i].nearest);
    }
}

static void test_progress_widths(void **state)
{
    struct progress_now now = example();
    char text[PROGRESS_COLUMNS_MAX];
    (void)state;
    progress_text(&now, 200, text);
    assert_string_equal(text, " 57% [=========>       ] 38-52 s left  relMSE 0.0210  119 Mray/s"
                              "  8 workers");
    progress_text(&now, 70, text);
    assert_string_equal(text, " 57% [=========>       ] 38-52 s left  relMSE 0.0210  119 Mray/s");
    progress_text(&now, 60, text);
    assert_string_equal(text, " 57% [=========>       ] 38-52 s left  relMSE 0.0210");
    progress_text(&now, 40, text);
    assert_string_equal(text, " 57% [=========>       ] 38-52 s left");
    progress_text(&now, 30, text);
    assert_string_equal(text, " 57% 38-52 s left");
    progress_text(&now, 8, text);
    assert_string_equal(text, " 57%");
}

static void test_progress_states(void **state)
{
    struct progress_now now = example();
    char text[PROGRESS_COLUMNS_MAX];
    (void)state;
    now.has_left = false;
    now.relmse = (double)NAN;
    now.rays_s = 0;
    now.workers = 1;
    now.done = 0.9999;
    progress_text(&now, 0, text);
    assert_string_equal(text, " 99% [================>]  1 worker");
    now.done = 0;
    now.rays_s = 400; /* would be shown as none */
    progress_text(&now, 0, text);
    assert_string_equal(text, "  0% [>                ] starting  1 worker");
    now.done = 0.999;
    now.rays_s = 0;
    now.waiting_s = 12;
    now.advice = "start one: tilery-worker --master 10.0.0.5:7000";
    progress_text(&now, 0, text);
    assert_string_equal(text, " 99% stalled 12 s: no worker; start one: tilery-worker --master "
                              "10.0.0.5:7000");
    (void)snprintf(now.note, sizeof now.note, "behind 2 jobs");
    progress_text(&now, 0, text);
    assert_string_equal(text, " 99% stalled 12 s: behind 2 jobs");
    (void)snprintf(now.note, sizeof now.note, "no worker has the tags big");
    progress_text(&now, 50, text);
    assert_string_equal(text, " 99% stalled 12 s: no worker has the tags big; sta");
    now.note[0] = '\0';
    (void)snprintf(now.state, sizeof now.state, "paused");
    (void)snprintf(now.job, sizeof now.job, "j7");
    progress_text(&now, 0, text);
    assert_string_equal(text, " 99% paused; go on: tilery resume j7");
}

/* Runs `feed` on a progress in that mode and gives what was written. */
static void captured(enum progress_mode mode, void (*feed)(struct progress *), char *out,
                     size_t bytes)
{
    int fds[2];
    struct progress p;
    assert_int_equal(pipe(fds), 0);
    progress_init(&p, mode, fds[1], 0);
    feed(&p);
    progress_end(&p);
    (void)close(fds[1]);
    ssize_t got = read(fds[0], out, bytes - 1);
    out[got > 0 ? got : 0] = '\0';
    (void)close(fds[0]);
}

static void feed_tenths(struct progress *p)
{
    struct progress_now now = example();
    for (int i = 0; i <= 100; i++) {
        now.done = i / 100.0;
        progress_update(p, &now, i * 0.1);
    }
}

static void test_lines_each_tenth(void **state)
{
    char text[4000];
    size_t lines = 0;
    (void)state;
    captured(PROGRESS_LINES, feed_tenths, text, sizeof text);
    for (const char *c = text; *c; c++)
        lines += *c == '\n';
    assert_int_equal(lines, 10);
    assert_memory_equal(text, " 10%", 4);
    assert_non_null(strstr(text, "\n100%"));
    assert_null(strchr(text, '\r'));
    assert_null(strchr(text, '\x1b'));
}

static void feed_stalls(struct progress *p)
{
    struct progress_now now = example();
    now.done = 0.05;
    now.workers = 0;
    for (int i = 0; i < 80; i++) {
        now.waiting_s = i % 40 * 0.1; /* it comes to life once between */
        p->now.waiting_s = now.waiting_s;
        progress_tick(p, i * 0.1);
    }
}

/* Without a terminal, too, somebody who waits learns for what, and once. */
static void test_lines_when_stalled(void **state)
{
    char text[4000];
    (void)state;
    captured(PROGRESS_LINES, feed_stalls, text, sizeof text);
    assert_string_equal(text, "  0% stalled 2 s: no worker\n  0% stalled 2 s: no worker\n");
}

static void feed_backwards(struct progress *p)
{
    struct progress_now now = example();
    now.done = 0.5;
    progress_update(p, &now, 0);
    now.done = 0.3;
    progress_update(p, &now, 1);
    now.done = 0.31;
    progress_update(p, &now, 302);
}

static void test_never_back(void **state)
{
    char text[4000];
    (void)state;
    captured(PROGRESS_LINES, feed_backwards, text, sizeof text);
    assert_non_null(strstr(text, "more samples needed"));
    assert_null(strstr(text, " 30%"));
    assert_null(strstr(text, " 31%"));
    assert_non_null(strstr(strstr(text, "more"), " 50%")); /* the line due after 5 minutes */
}

static void feed_events(struct progress *p)
{
    for (int i = 0; i < 7; i++) {
        char line[80];
        (void)snprintf(line, sizeof line, "unit %d failed on w%d: out of \x1b[31m memory", i, i);
        progress_event(p, line, i);
    }
    progress_event(p, "w9 joined", 8);
}

static void test_events_counted(void **state)
{
    char text[4000];
    (void)state;
    captured(PROGRESS_LINES, feed_events, text, sizeof text);
    assert_non_null(strstr(text, "unit 2 failed"));
    assert_null(strstr(text, "unit 3 failed"));
    assert_non_null(strstr(text, "and 4 more like: unit N failed"));
    assert_non_null(strstr(text, "w9 joined"));
    assert_null(strchr(text, '\x1b'));
}

static void feed_json(struct progress *p)
{
    struct progress_now now = example();
    (void)snprintf(now.job, sizeof now.job, "j42");
    progress_update(p, &now, 12.4);
    progress_event(p, "say \"hi\"", 13);
}

static void test_json_lines(void **state)
{
    char text[4000];
    (void)state;
    captured(PROGRESS_JSON, feed_json, text, sizeof text);
    assert_string_equal(text, "{\"event\":\"progress\",\"t\":12.400,\"job\":\"j42\",\"done\":0.579,"
                              "\"left_s\":[38.2,51.9],\"relmse\":0.021,\"workers\":8}\n"
                              "{\"event\":\"log\",\"t\":13.000,\"line\":\"say \\\"hi\\\"\"}\n");
}

static void duration(double seconds, const char *expected)
{
    char text[HUMAN_BYTES];
    human_duration(seconds, text);
    assert_string_equal(text, expected);
}

static void test_human(void **state)
{
    char text[HUMAN_BYTES];
    (void)state;
    duration(0.25, "0.2 s");
    duration(59.4, "59 s");
    duration(59.7, "1 min 0 s");
    duration(72.3, "1 min 12 s");
    duration(7500, "2 h 5 min");
    human_left(38.2, 51.9, text);
    assert_string_equal(text, "38-52 s");
    human_left(100, 200, text);
    assert_string_equal(text, "2-3 min");
    human_left(9000, 9100, text);
    assert_string_equal(text, "3 h");
    human_count(1234567, text);
    assert_string_equal(text, "1,234,567");
    human_things(1, "mesh", "meshes", text);
    assert_string_equal(text, "1 mesh");
    human_things(1234, "mesh", "meshes", text);
    assert_string_equal(text, "1,234 meshes");
    human_count(12, text);
    assert_string_equal(text, "12");
    human_error(0.0000123, text);
    assert_string_equal(text, "1.2e-05");
    human_rays(4.1e9, text);
    assert_string_equal(text, "4.1 Gray/s");
}

static void test_table(void **state)
{
    static const char *const headings[] = {"JOB", "DONE", "NOTE"};
    struct text_table t;
    struct buf out;
    (void)state;
    text_table_init(&t, headings, "lrl");
    text_table_add(&t, "j1");
    text_table_addf(&t, "%d%%", 5);
    text_table_add(&t, "behind 1 job\x1b");
    text_table_add(&t, "j1000");
    text_table_add(&t, NULL);
    text_table_add(&t, "\xc3\xa4\xc3\xb6 words that are long");
    buf_init(&out);
    text_table_print(&t, 0, false, &out);
    buf_put_u8(&out, 0);
    assert_string_equal((const char *)out.data,
                        "JOB    DONE  NOTE\n"
                        "j1       5%  behind 1 job?\n"
                        "j1000     -  \xc3\xa4\xc3\xb6 words that are long\n");
    buf_clear(&out);
    text_table_print(&t, 20, false, &out);
    buf_put_u8(&out, 0);
    assert_string_equal((const char *)out.data, "JOB    DONE  NOTE\n"
                                                "j1       5%  behind \n"
                                                "j1000     -  \xc3\xa4\xc3\xb6 word\n");
    /* A long name gives way before the note does; whole when piped. */
    buf_clear(&out);
    t.name_column = 0;
    mem_free(t.cells[0]);
    t.cells[0] = mem_strndup("a name that is long", 99);
    text_table_print(&t, 36, false, &out);
    buf_put_u8(&out, 0);
    assert_string_equal((const char *)out.data,
                        "JOB           DONE  NOTE\n"
                        "a name tha..    5%  behind 1 job?\n"
                        "j1000            -  \xc3\xa4\xc3\xb6 words that ar\n");
    buf_clear(&out);
    text_table_print(&t, 0, false, &out);
    buf_put_u8(&out, 0);
    assert_non_null(strstr((const char *)out.data, "a name that is long    5%  behind 1 job?\n"));
    buf_release(&out);
    text_table_release(&t);
}

/* Columns stand under each other where characters are two columns wide, or none. */
static void test_table_of_wide_characters(void **state)
{
    static const char *const headings[] = {"NAME", "DONE"};
    struct text_table t;
    struct buf out;
    (void)state;
    text_table_init(&t, headings, "ll");
    t.name_column = 0;
    text_table_add(&t, "\xe8\xbb\x8a\xe3\x81\xae\xe5\xba\xab"); /* a car's shed: six columns */
    text_table_add(&t, "1%");
    text_table_add(&t, "cafe\xcc\x81"); /* its accent apart */
    text_table_add(&t, "2%");
    buf_init(&out);
    text_table_print(&t, 0, false, &out);
    buf_put_u8(&out, 0);
    assert_string_equal((const char *)out.data, "NAME    DONE\n"
                                                "\xe8\xbb\x8a\xe3\x81\xae\xe5\xba\xab  1%\n"
                                                "cafe\xcc\x81    2%\n");
    /* Half a wide character is none. */
    mem_free(t.cells[0]);
    t.cells[0] = mem_strndup("a23456789\xe8\xbb\x8a\xe8\xbb\x8a\xe8\xbb\x8a", 99);
    buf_clear(&out);
    text_table_print(&t, 18, false, &out);
    buf_put_u8(&out, 0);
    assert_string_equal((const char *)out.data, "NAME          DONE\n"
                                                "a23456789..   1%\n"
                                                "cafe\xcc\x81          2%\n");
    buf_release(&out);
    text_table_release(&t);
}

static void test_report(void **state)
{
    static const char report[] =
        "{\"job\":\"j1\",\"state\":\"done\",\"width\":1920,\"height\":1080,\"spp_min\":64,"
        "\"spp_max\":912,\"spp_mean\":203,\"image_sha256\":\"4f1c\",\"nonfinite_samples\":2,"
        "\"seconds\":{\"total\":72.3,\"load\":0.2,\"build\":0.9,\"render\":70.1,\"gather\":null},"
        "\"core_seconds\":564,\"workers\":8,\"units\":{\"total\":512,\"retried\":3,\"rejected\":0},"
        "\"error\":{\"relmse\":0.0019,\"relmse_low\":0.0017,\"relmse_high\":0.0021}}";
    struct json_get g;
    struct diag_list problems;
    struct buf out;
    (void)state;
    diag_init(&problems);
    assert_int_equal(json_get_open(&g, report, strlen(report), "r", &problems), ERR_OK);
    buf_init(&out);
    report_text(g.root, "car.exr", &out);
    buf_put_u8(&out, 0);
    assert_string_equal((const char *)out.data,
                        "car.exr  1920x1080, 64 to 912 spp (mean 203), done in 1 min 12 s\n"
                        "  error    relMSE 0.00190 (95 %: 0.00170 to 0.00210)\n"
                        "  time     load 0.20, build 0.90, render 70.1 s; 9.4 core-min\n"
                        "  farm     8 workers; 512 units, 3 retried, 0 rejected\n"
                        "  sha256   4f1c\n"
                        "  note     2 non-finite samples counted as black\n");
    buf_release(&out);
    json_get_close(&g);
    diag_release(&problems);
}

/* Before any result there is no worker to count; "0 workers" frightened people. */
static void test_report_before_the_first_worker(void **state)
{
    static const char *const reports[][2] = {
        {"{\"job\":\"j1\",\"state\":\"queued\",\"workers\":0,\"workers_now\":0,\"units\":{"
         "\"total\":0}}",
         "  farm     no worker yet; 0 units"},
        {"{\"job\":\"j1\",\"state\":\"rendering\",\"workers\":0,\"workers_now\":2,"
         "\"units\":{\"total\":0}}",
         "  farm     2 workers; 0 units"}};
    (void)state;
    for (size_t i = 0; i < 2; i++) {
        struct json_get g;
        struct diag_list problems;
        struct buf out;
        diag_init(&problems);
        buf_init(&out);
        assert_int_equal(json_get_open(&g, reports[i][0], strlen(reports[i][0]), "r", &problems),
                         ERR_OK);
        report_text(g.root, "j1", &out);
        buf_put_u8(&out, 0);
        assert_non_null(strstr((const char *)out.data, reports[i][1]));
        buf_release(&out);
        json_get_close(&g);
        diag_release(&problems);
    }
}

static void test_preview(void **state)
{
    static const unsigned char rgb[2 * 4 * 3] = {
        10, 0, 0, 20, 0, 0, 30, 0, 0, 40, 0, 0,  /* row 0 */
        0,  8, 0, 0,  8, 0, 0,  8, 0, 0,  8, 0}; /* row 1 */
    struct preview_cell cells[2];
    uint32_t columns, rows;
    (void)state;
    preview_scale(rgb, 4, 2, 3, 2, 1, cells);
    assert_int_equal(cells[0].top[0], 15);
    assert_int_equal(cells[1].top[0], 35);
    assert_int_equal(cells[1].bottom[1], 8);
    preview_fit(1920, 1080, 79, 20, &columns, &rows);
    assert_int_equal(rows, 20);
    assert_int_equal(columns, 71);
    preview_fit(1, 65535, 79, 20, &columns, &rows);
    assert_int_equal(columns, 1);
    assert_int_equal(rows, 20);
    preview_fit(3, 3, 79, 20, &columns, &rows);
    assert_int_equal(columns, 3);
    assert_int_equal(rows, 2);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_mask),
        cmocka_unit_test(test_nearest),
        cmocka_unit_test(test_progress_widths),
        cmocka_unit_test(test_progress_states),
        cmocka_unit_test(test_lines_each_tenth),
        cmocka_unit_test(test_lines_when_stalled),
        cmocka_unit_test(test_never_back),
        cmocka_unit_test(test_events_counted),
        cmocka_unit_test(test_json_lines),
        cmocka_unit_test(test_human),
        cmocka_unit_test(test_table),
        cmocka_unit_test(test_table_of_wide_characters),
        cmocka_unit_test(test_report),
        cmocka_unit_test(test_report_before_the_first_worker),
        cmocka_unit_test(test_preview),
    };
    return cmocka_run_group_tests_name("cli_text", tests, NULL, NULL);
}
