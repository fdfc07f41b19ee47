#include "client/command.h"

#include <string.h>

#include "client/cli_help.h"
#include "client/cli_settings.h"

int command_run(struct cli *cli)
{
    static int (*const commands[CLI_COMMAND_COUNT])(struct cli *) = {
        [CLI_RENDER] = command_render,   [CLI_EXPLAIN] = command_explain,
        [CLI_DOCTOR] = command_doctor,   [CLI_TRADEOFF] = command_tradeoff,
        [CLI_IMPORT] = command_import,   [CLI_COMPARE] = command_compare,
        [CLI_SUBMIT] = command_submit,   [CLI_JOBS] = command_jobs,
        [CLI_STATUS] = command_status,   [CLI_WATCH] = command_watch,
        [CLI_GET] = command_get,         [CLI_PAUSE] = command_pause,
        [CLI_RESUME] = command_resume,   [CLI_CANCEL] = command_cancel,
        [CLI_RETRY] = command_retry,     [CLI_PRIORITY] = command_priority,
        [CLI_WORKERS] = command_workers, [CLI_DRAIN] = command_drain,
        [CLI_HELP] = command_help,
    };
    return commands[cli->line.command](cli);
}

static int unknown_topic(const char *topic)
{
    const char *nearest = cli_command_nearest(topic);
    char hint[100];
    (void)snprintf(hint, sizeof hint, "did you mean tilery help %s?", nearest ? nearest : "");
    cli_error("unknown-command", nearest ? hint : "see tilery --help", "no command \"%s\"", topic);
    return EXIT_USAGE;
}

int command_help(struct cli *cli)
{
    const char *topic = cli->line.argument_count ? cli->line.arguments[0] : NULL;
    struct buf out;
    buf_init(&out);
    if (!topic)
        cli_help_overview(&out);
    else if (strcmp(topic, "settings") == 0)
        cli_settings_print(cli, &out);
    else if (strcmp(topic, "completion") == 0)
        cli_help_completion(&out);
    else if (strcmp(topic, "man") == 0)
        cli_help_man(&out);
    else if (cli_command_find(topic) != CLI_COMMAND_COUNT)
        cli_help_long(cli_command_find(topic), &out);
    else
        return unknown_topic(topic);
    bool ok = cli_put_buf(&out);
    buf_release(&out);
    return ok ? EXIT_DONE : EXIT_MACHINE;
}
