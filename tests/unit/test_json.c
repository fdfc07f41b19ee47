/* JSON: strict syntax, places, checked getters, and the verdicts of JSONTestSuite. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>

#include "common/buf.h"
#include "common/file_io.h"
#include "common/json_get.h"
#include "common/json_put.h"
#include "common/mem.h"
#include "tests/unit/problem_check.h"

static bool parses(const char *text, size_t bytes)
{
    struct json_doc doc;
    struct diag_list problems;
    diag_init(&problems);
    enum err e = json_doc_parse(&doc, text, bytes, "t.json", &problems);
    assert_int_equal(problems.error_count, e == ERR_OK ? 0 : 1);
    if (e == ERR_OK)
        json_doc_release(&doc);
    diag_release(&problems);
    return e == ERR_OK;
}

static void syntax_is_strict(void **state)
{
    (void)state;
    static const char *const good[] = {
        "0",
        "-0.0",
        " [1e5, -0, 1.25E-3] ",
        "\"\\u00e9\\ud834\\udd1e\\/\"",
        "{\"a\":{\"b\":[]}}",
        "[-0.000000000000000000000000000000000000000000000000000000000000000000000000000001]",
        "\"\\u0000\"",
        "{\"a\":1,\"a\":2}"};
    static const char *const bad[] = {"",
                                      " ",
                                      "01",
                                      "+1",
                                      "1.",
                                      ".5",
                                      "1e",
                                      "0x10",
                                      "NaN",
                                      "Infinity",
                                      "-",
                                      "[1,]",
                                      "[,1]",
                                      "{}x",
                                      "[1]]",
                                      "{\"a\":1,}",
                                      "{a:1}",
                                      "{'a':1}",
                                      "{\"a\" 1}",
                                      "[1 2]",
                                      "\"\t\"",
                                      "\"\\x\"",
                                      "\"\\ud834\"",
                                      "\"\\udd1e\"",
                                      "\"\xff\"",
                                      "\"\xc0\xaf\"",
                                      "\"\xed\xa0\x80\"",
                                      "tru",
                                      "[\"a",
                                      "\xef\xbb\xbf{}",
                                      "// c\n1",
                                      "[1]/**/",
                                      "nul",
                                      "\"a\nb\""};
    for (size_t i = 0; i < sizeof good / sizeof *good; i++)
        if (!parses(good[i], strlen(good[i])))
            fail_msg("refused: %s", good[i]);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        if (parses(bad[i], strlen(bad[i])))
            fail_msg("accepted: %s", bad[i]);
    assert_false(parses("1\0", 2));
}

static void depth_has_a_limit(void **state)
{
    (void)state;
    enum { BRACKETS = 100000 };
    char *text = mem_alloc(2 * BRACKETS);
    assert_non_null(text);
    memset(text, '[', BRACKETS);
    memset(text + BRACKETS, ']', BRACKETS);
    assert_false(parses(text, 2 * BRACKETS));
    assert_true(parses(text + BRACKETS - JSON_DEPTH_MAX, 2 * JSON_DEPTH_MAX));
    assert_false(parses(text + BRACKETS - JSON_DEPTH_MAX - 1, 2 * JSON_DEPTH_MAX + 2));
    mem_free(text);
}

static void syntax_problems_have_line_and_column(void **state)
{
    (void)state;
    struct json_doc doc;
    struct diag_list problems;
    const char *text = "{\n  \"a\": 1,\n  \"b\" 2\n}";
    diag_init(&problems);
    assert_int_equal(json_doc_parse(&doc, text, strlen(text), "t.json", &problems), ERR_INPUT);
    assert_int_equal(problems.items[0].line, 3);
    assert_string_equal(problems.items[0].text, "column 7: expected ':' after a key, found '2'");
    diag_release(&problems);
}

struct opened {
    struct json_get g;
    struct diag_list problems;
};

static void open_text(struct opened *o, const char *text)
{
    diag_init(&o->problems);
    assert_int_equal(json_get_open(&o->g, text, strlen(text), "t.json", &o->problems), ERR_OK);
}

static void close_text(struct opened *o)
{
    json_get_close(&o->g);
    diag_release(&o->problems);
}

static void getters_check_type_and_range(void **state)
{
    (void)state;
    struct opened o;
    open_text(&o,
              "{\"n\": 1e999, \"s\": \"x\", \"big\": 9007199254740993, \"neg\": -1, \"half\": 0.5,"
              "\"v\": [1, 2, \"3\"], \"w\": [1, 2], \"seed\": \"18446744073709551615\","
              "\"whole\": 3.0, \"nul\": \"a\\u0000b\"}");
    struct json_get *g = &o.g;
    double n = 7, v[3] = {7, 7, 7};
    uint64_t u = 7;
    const char *text = "kept";
    assert_false(json_get_number(g, g->root, "n", 0, 1e300, &n));
    assert_non_null(problem_find(&o.problems, "not-finite", "$.n"));
    assert_false(json_get_number(g, g->root, "s", 0, 1, &n));
    assert_non_null(problem_find(&o.problems, "wrong-type", "$.s"));
    assert_true(n == 7);
    assert_false(json_get_u64(g, g->root, "neg", 0, UINT64_MAX, &u));
    assert_false(json_get_u64(g, g->root, "half", 0, UINT64_MAX, &u));
    assert_non_null(problem_find(&o.problems, "out-of-range", "$.half"));
    assert_int_equal(u, 7);
    assert_true(json_get_u64(g, g->root, "big", 0, UINT64_MAX, &u));
    assert_true(u == UINT64_C(9007199254740993));
    assert_true(json_get_u64(g, g->root, "whole", 0, 9, &u));
    assert_int_equal(u, 3);
    assert_true(json_get_u64_text(g, g->root, "seed", &u));
    assert_true(u == UINT64_MAX);
    assert_false(json_get_numbers(g, g->root, "v", 3, -9, 9, v));
    assert_non_null(problem_find(&o.problems, "wrong-type", "$.v[2]"));
    assert_false(json_get_numbers(g, g->root, "w", 3, -9, 9, v));
    assert_non_null(problem_find(&o.problems, "wrong-length", "$.w"));
    assert_true(v[0] == 7);
    assert_false(json_get_text(g, g->root, "nul", &text));
    assert_string_equal(text, "kept");
    assert_true(json_get_number(g, g->root, "absent", 0, 1, &n));
    close_text(&o);
}

static void keys_are_checked(void **state)
{
    (void)state;
    struct opened o;
    static const char *const known[] = {"position", "look_at", "fov"};
    open_text(&o, "{\"positon\": 1, \"fov\": 2}");
    json_get_keys(&o.g, o.g.root, known, 3);
    const struct diag *d = problem_find(&o.problems, "unknown-key", "$.positon");
    assert_non_null(d);
    assert_string_equal(d->hint, "did you mean \"position\"? known: position, look_at, fov");
    assert_int_equal(o.problems.error_count, 1);
    close_text(&o);
}

static void duplicate_keys_are_problems(void **state)
{
    (void)state;
    struct json_get g;
    struct diag_list problems;
    const char *text = "{\"a\": {\"x\": 1, \"y\": 2, \"x\": 3},\n \"b\": [{\"k\": 1, \"k\": 1}]}";
    diag_init(&problems);
    assert_int_equal(json_get_open(&g, text, strlen(text), "t.json", &problems), ERR_INPUT);
    assert_int_equal(problems.error_count, 2);
    assert_non_null(problem_find(&problems, "duplicate-key", "$.a.x"));
    assert_non_null(problem_find(&problems, "duplicate-key", "$.b[0].k"));
    diag_release(&problems);
}

static void memory_runs_out_cleanly(void **state)
{
    (void)state;
    const char *text = "{\"a\": [1, 2, {\"b\": \"c\"}], \"d\": \"e\"}";
    enum err e = ERR_NOMEM;
    for (uint64_t n = 0; e != ERR_OK; n++) {
        struct json_get g;
        struct diag_list problems;
        diag_init(&problems);
        mem_fail_after(n);
        e = json_get_open(&g, text, strlen(text), "t.json", &problems);
        mem_fail_after(UINT64_MAX);
        assert_true(e == ERR_OK || e == ERR_NOMEM);
        if (e == ERR_OK)
            json_get_close(&g);
        diag_release(&problems);
    }
}

static void texts_are_escaped(void **state)
{
    (void)state;
    struct buf b;
    buf_init(&b);
    json_put_text(&b, "a\"\\\n\x01\xff\xc3\xa9");
    json_put_text(&b, NULL);
    json_put_number(&b, 0.1);
    json_put_number(&b, (double)__builtin_inf());
    buf_put_u8(&b, 0);
    assert_string_equal((char *)b.data,
                        "\"a\\\"\\\\\\u000a\\u0001\xef\xbf\xbd\xc3\xa9\"null0.1null");
    buf_release(&b);
}

static void json_test_suite_agrees(void **state)
{
    (void)state;
    const char *data = getenv("TILERY_TEST_DATA");
    char *folder = data ? mem_sprintf("%s/bad/json/JSONTestSuite", data) : NULL;
    DIR *dir = folder ? opendir(folder) : NULL;
    if (!dir) {
        mem_free(folder);
        skip();
    }
    size_t files = 0;
    for (struct dirent *entry = readdir(dir); entry; entry = readdir(dir)) {
        if (!strstr(entry->d_name, ".json"))
            continue;
        char *path = file_join(folder, entry->d_name), *text;
        size_t bytes;
        assert_int_equal(file_read(path, JSON_BYTES_MAX, &text, &bytes), ERR_OK);
        bool good = parses(text, bytes);
        if ((entry->d_name[0] == 'y' && !good) || (entry->d_name[0] == 'n' && good))
            fail_msg("%s was %s", entry->d_name, good ? "accepted" : "refused");
        mem_free(text);
        mem_free(path);
        files++;
    }
    (void)closedir(dir);
    mem_free(folder);
    assert_true(files > 50);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(syntax_is_strict),
        cmocka_unit_test(depth_has_a_limit),
        cmocka_unit_test(syntax_problems_have_line_and_column),
        cmocka_unit_test(getters_check_type_and_range),
        cmocka_unit_test(keys_are_checked),
        cmocka_unit_test(duplicate_keys_are_problems),
        cmocka_unit_test(memory_runs_out_cleanly),
        cmocka_unit_test(texts_are_escaped),
        cmocka_unit_test(json_test_suite_agrees),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
