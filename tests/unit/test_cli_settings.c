/* Where a setting comes from: option, environment, file; and what is refused in a file. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "client/cli_settings.h"
#include "client/preset.h"
#include "common/mem.h"

static void release(struct cli *cli)
{
    for (int i = 0; i < CLI_OPTION_COUNT; i++)
        mem_free(cli->owned[i]);
}

static void test_file(void **state)
{
    struct cli cli = {.line = {.command = CLI_RENDER}};
    struct diag_list problems;
    char text[] = "# comment\n\n  workers = 3  # of four\nmaster=http://a:1\nthreads =2\r\n"
                  "workers = 9\n";
    (void)state;
    diag_init(&problems);
    cli_settings_read(&cli, CLI_FROM_USER_FILE, "config", text, &problems);
    assert_int_equal(problems.error_count, 0);
    assert_string_equal(cli.line.values[CLI_WORKER_COUNT], "3");
    assert_string_equal(cli.line.values[CLI_MASTER], "http://a:1");
    assert_string_equal(cli.line.values[CLI_THREADS], "2");
    assert_int_equal(cli.origins[CLI_THREADS], CLI_FROM_USER_FILE);
    diag_release(&problems);
    release(&cli);
}

static void test_problems(void **state)
{
    struct cli cli = {.line = {.command = CLI_RENDER}};
    struct diag_list problems;
    char text[] = "worker = 3\nthreads = many\njust words\nspp = 4\n";
    (void)state;
    diag_init(&problems);
    cli_settings_read(&cli, CLI_FROM_USER_FILE, "config", text, &problems);
    assert_int_equal(problems.error_count, 4);
    assert_string_equal(problems.items[0].id, "unknown-setting");
    assert_non_null(strstr(problems.items[0].hint, "workers"));
    assert_int_equal(problems.items[1].line, 2);
    assert_non_null(strstr(problems.items[1].text, "whole number"));
    assert_int_equal(problems.items[2].line, 3);
    assert_string_equal(problems.items[3].id, "unknown-setting");
    diag_release(&problems);
    release(&cli);
}

static void preset(struct cli *cli, const char *words, struct diag_list *problems)
{
    char text[400];
    (void)snprintf(text, sizeof text, "%s", words);
    diag_init(problems);
    preset_read(cli, "p.preset", text, problems);
}

static void test_preset(void **state)
{
    struct cli cli = {.line = {.command = CLI_RENDER}};
    struct diag_list problems;
    (void)state;
    cli.line.values[CLI_SAMPLER] = "halton"; /* the command line wins */
    cli.origins[CLI_SAMPLER] = CLI_FROM_OPTION;
    preset(&cli, "# draft\nspp = 12\nmax-depth= 5 \r\nsampler = sobol\nhalf = true\nprofile = NEE",
           &problems);
    assert_int_equal(problems.error_count, 0);
    assert_int_equal(cli_count(&cli.line, CLI_SPP), 12);
    assert_int_equal(cli_count(&cli.line, CLI_MAX_DEPTH), 5);
    assert_string_equal(cli.line.values[CLI_SAMPLER], "halton");
    assert_true(cli_flag(&cli.line, CLI_HALF));
    assert_int_equal(cli_choice(&cli.line, CLI_PROFILE), JOB_PROFILE_NEE);
    diag_release(&problems);
    release(&cli);
}

static void test_preset_problems(void **state)
{
    struct cli cli = {.line = {.command = CLI_RENDER}};
    struct diag_list problems;
    (void)state;
    preset(&cli,
           "spq = 3\nspp = -1\nwords\noutput = a.exr\nhalf = maybe\nspp = 3\nspp = 4\n"
           "preset = other\n",
           &problems);
    assert_int_equal(problems.error_count, 7);
    for (size_t i = 0; i < problems.count; i++)
        assert_string_equal(problems.items[i].id, "bad-preset");
    assert_non_null(strstr(problems.items[0].hint, "spp"));
    assert_int_equal(problems.items[6].line, 8);
    assert_int_equal(cli_count(&cli.line, CLI_SPP), 3);
    assert_false(cli_has(&cli.line, CLI_OUTPUT) || cli_has(&cli.line, CLI_PRESET));
    diag_release(&problems);
    release(&cli);
}

/* When to stop is one question: an answer on the command line replaces the file's. */
static void test_preset_until(void **state)
{
    struct cli cli = {.line = {.command = CLI_RENDER}};
    struct diag_list problems;
    (void)state;
    cli.line.values[CLI_TARGET_ERROR] = "0.1";
    cli.origins[CLI_TARGET_ERROR] = CLI_FROM_OPTION;
    preset(&cli, "spp = 12\nmax-depth = 5\n", &problems);
    assert_int_equal(problems.error_count, 0);
    assert_false(cli_has(&cli.line, CLI_SPP));
    assert_true(cli_has(&cli.line, CLI_MAX_DEPTH));
    diag_release(&problems);
    release(&cli);
}

/* The option wins over the environment; what the command does not take is dropped. */
static void test_order(void **state)
{
    struct cli cli = {.line = {.command = CLI_RENDER}};
    struct diag_list problems;
    (void)state;
    (void)setenv("TILERY_WORKERS", "5", 1);
    (void)setenv("TILERY_THREADS", "6", 1);
    (void)setenv("TILERY_MASTER", "http://b:2", 1);
    (void)setenv("XDG_CONFIG_HOME", "/nonexistent", 1);
    cli.line.values[CLI_WORKER_COUNT] = "7";
    diag_init(&problems);
    assert_true(cli_settings_load(&cli, &problems));
    assert_string_equal(cli.line.values[CLI_WORKER_COUNT], "7");
    assert_int_equal(cli.origins[CLI_WORKER_COUNT], CLI_FROM_OPTION);
    assert_string_equal(cli.line.values[CLI_THREADS], "6");
    assert_int_equal(cli.origins[CLI_THREADS], CLI_FROM_ENVIRONMENT);
    assert_null(cli.line.values[CLI_MASTER]); /* render ignores it */
    diag_release(&problems);
    (void)unsetenv("TILERY_WORKERS");
    (void)unsetenv("TILERY_THREADS");
    (void)unsetenv("TILERY_MASTER");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_file),         cmocka_unit_test(test_problems),
        cmocka_unit_test(test_preset),       cmocka_unit_test(test_preset_problems),
        cmocka_unit_test(test_preset_until), cmocka_unit_test(test_order),
    };
    return cmocka_run_group_tests_name("cli_settings", tests, NULL, NULL);
}
