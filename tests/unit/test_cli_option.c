/* The tables of commands and options, and how a command line is read. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#include "client/cli_help.h"

enum { WORDS_MAX = 32 };

/* Splits at blanks; "tilery" stands before. */
static bool parse(const char *text, struct cli_line *line, struct diag_list *problems)
{
    static char storage[400];
    char *words[WORDS_MAX] = {(char *)"tilery"};
    int count = 1;
    (void)snprintf(storage, sizeof storage, "%s", text);
    for (char *at = storage; *at && count < WORDS_MAX;) {
        words[count++] = at;
        at += strcspn(at, " ");
        if (*at)
            *at++ = '\0';
    }
    diag_init(problems);
    return cli_line_parse(line, count, words, problems);
}

static void refused(const char *text, const char *id, const char *part)
{
    struct cli_line line;
    struct diag_list problems;
    bool found = false;
    assert_false(parse(text, &line, &problems));
    assert_true(problems.error_count > 0);
    for (size_t i = 0; i < problems.count; i++) {
        const struct diag *d = &problems.items[i];
        found |=
            strcmp(d->id, id) == 0 && (strstr(d->text, part) || (d->hint && strstr(d->hint, part)));
    }
    if (!found) {
        diag_print(&problems, stderr);
        fail_msg("\"%s\" gave no [%s] with \"%s\"", text, id, part);
    }
    diag_release(&problems);
}

static void accepted(const char *text, struct cli_line *line)
{
    struct diag_list problems;
    bool ok = parse(text, line, &problems);
    if (!ok)
        diag_print(&problems, stderr);
    assert_true(ok);
    diag_release(&problems);
}

static void test_values(void **state)
{
    struct cli_line line;
    uint32_t width, height;
    (void)state;
    accepted("render a.json -o out.exr --spp=64 --seed 18446744073709551615 --size 640x480 "
             "--crop 1,2,3,4 --integrator path --quiet",
             &line);
    assert_int_equal(line.command, CLI_RENDER);
    assert_string_equal(line.arguments[0], "a.json");
    assert_string_equal(cli_text(&line, CLI_OUTPUT), "out.exr");
    assert_true(cli_count(&line, CLI_SPP) == 64);
    assert_true(cli_count(&line, CLI_SEED) == UINT64_MAX);
    cli_size(&line, &width, &height);
    assert_int_equal(width, 640);
    assert_int_equal(height, 480);
    struct job_crop crop = cli_crop(&line);
    assert_true(crop.x == 1 && crop.y == 2 && crop.width == 3 && crop.height == 4);
    assert_int_equal(cli_choice(&line, CLI_INTEGRATOR), JOB_INTEGRATOR_PATH);
    assert_true(cli_flag(&line, CLI_QUIET));
    assert_false(cli_flag(&line, CLI_JSON));
}

static void test_forms(void **state)
{
    struct cli_line line;
    (void)state;
    accepted("render -oout.exr a.json", &line);
    assert_string_equal(cli_text(&line, CLI_OUTPUT), "out.exr");
    accepted("render -o out.exr -- -odd-name.json", &line);
    assert_string_equal(line.arguments[0], "-odd-name.json");
    accepted("render a.json --integrator bdpt --precision exact", &line);
    assert_string_equal(cli_text(&line, CLI_INTEGRATOR), "bdpt");
    accepted("render a.json --precision fast", &line);
    assert_string_equal(cli_text(&line, CLI_PRECISION), "fast");
    accepted("priority j1 -5", &line);
    assert_string_equal(line.arguments[1], "-5");
    accepted("render --help --nonsense", &line);
    assert_true(cli_has(&line, CLI_HELP_FLAG));
}

static void test_refusals(void **state)
{
    (void)state;
    refused("rendr a.json", "unknown-command", "render");
    refused("render a.json --ssp 4 -o x.exr", "unknown-option", "--spp");
    refused("jobs --spp 4", "unknown-option", "--spp");
    refused("render -o x.exr", "missing-argument", "usage");
    refused("render a.json b.json -o x.exr", "extra-argument", "b.json");
    refused("render a.json -o", "missing-value", "-o needs");
    refused("render a.json --output", "missing-value", "--output needs");
    refused("render a.json -o x.exr -o y.exr", "given-twice", "-o is");
    refused("render a.json --spp 0", "bad-value", "from 1");
    refused("render a.json --spp 1e3", "bad-value", "1e3");
    refused("render a.json --spp -1", "bad-value", "-1");
    refused("render a.json --spp 99999999999999999999", "bad-value", "whole number");
    refused("render a.json --seed 18446744073709551616", "bad-value", "to 18446744073709551615");
    refused("render a.json --precision fst", "bad-value", "exact");
    refused("render a.json --size 640", "bad-value", "WxH");
    refused("render a.json --size 640x0", "bad-value", "640x480");
    refused("render a.json --size 70000x1", "bad-value", "65535");
    refused("render a.json --crop 1,2,3", "bad-value", "X,Y,W,H");
    refused("render a.json --integrator paht", "bad-value", "did you mean path");
    refused("render a.json --quiet=yes", "bad-value", "takes no value");
    refused("render a.json --spp 1 --spp 2", "given-twice", "--spp");
    refused("render a.json --aov norml", "bad-value", "known: depth,position");
    refused("render a.json --aov depth,,uv", "bad-value", "--aov");
    refused("render a.json --aov depth,depth", "bad-value", "twice");
    refused("submit a.json --tags big,", "bad-value", "at most 8 different tags");
    refused("submit a.json --tags big,big", "bad-value", "twice");
    refused("render a.json --tags big", "unknown-option", "--tags");
    refused("render a.json --target-error 0", "bad-value", "over 0");
    refused("render a.json --target-error 0.1 --spp 4", "bad-value", "do not go together");
    refused("render a.json --target-error 0.1 --time-limit 5", "bad-value", "--time-limit");
    refused("render a.json --time-limit -5", "bad-value", "-5");
    refused("render a.json --max-spp 64", "bad-value", "--target-error");
    refused("render a.json --target-error 0.1 --max-spp 3", "bad-value", "from 4");
    refused("render a.json --plan p.json --spp 4", "bad-value", "--plan");
}

/* All that is wrong is told at once. */
static void test_all_problems(void **state)
{
    struct cli_line line;
    struct diag_list problems;
    (void)state;
    assert_false(parse("render --spp 0 --size x --foo", &line, &problems));
    assert_int_equal(problems.error_count, 4);
    diag_release(&problems);
}

/* Every option has a place in the help of each command that takes it, and a help line. */
static void test_tables(void **state)
{
    (void)state;
    for (int i = 0; i < CLI_OPTION_COUNT; i++) {
        const struct cli_option *o = &cli_options[i];
        assert_non_null(o->name);
        assert_non_null(o->help);
        assert_non_null(o->section);
        assert_true(o->commands != 0);
        assert_true((o->kind == CLI_FLAG) == (o->argument == NULL));
        assert_true((o->kind == CLI_CHOICE) == (o->choices != NULL));
        for (int k = 0; k < i; k++)
            assert_true(strcmp(cli_options[k].name, o->name) != 0);
    }
    for (int i = 0; i < CLI_COMMAND_COUNT; i++) {
        struct buf out;
        buf_init(&out);
        cli_help_short((enum cli_command_id)i, &out);
        buf_put_u8(&out, 0);
        assert_int_equal(buf_status(&out), ERR_OK);
        assert_non_null(strstr((const char *)out.data, cli_commands[i].name));
        for (const char *line = (const char *)out.data; *line;) {
            size_t bytes = strcspn(line, "\n");
            assert_true(bytes <= 80);
            line += bytes + (line[bytes] == '\n');
        }
        buf_release(&out);
    }
}

/* `tradeoff` took --master but no --tls-ca, so a farm behind its own authority refused the study.
 */
static void test_every_caller_of_a_farm_can_name_its_authority(void **state)
{
    (void)state;
    assert_int_equal(cli_options[CLI_TOKEN_FILE].commands, cli_options[CLI_MASTER].commands);
    assert_int_equal(cli_options[CLI_TLS_CA].commands, cli_options[CLI_MASTER].commands);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_values),
        cmocka_unit_test(test_forms),
        cmocka_unit_test(test_refusals),
        cmocka_unit_test(test_all_problems),
        cmocka_unit_test(test_tables),
        cmocka_unit_test(test_every_caller_of_a_farm_can_name_its_authority),
    };
    return cmocka_run_group_tests_name("cli_option", tests, NULL, NULL);
}
