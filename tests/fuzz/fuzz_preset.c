/* Fuzzes preset files: whatever they hold, the options that they set have values which the command
 * line would take, and what is wrong is said once a line at most. */
#include <stdlib.h>
#include <string.h>

#include "client/preset.h"
#include "common/mem.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes);

/* First byte: options that the command line gave before. */
static void give(struct cli *cli, unsigned which)
{
    static const enum cli_option_id ids[] = {CLI_SPP, CLI_TARGET_ERROR, CLI_MAX_DEPTH, CLI_HALF};
    static const char *const values[] = {"4", "0.5", "3", ""};
    for (size_t i = 0; i < sizeof ids / sizeof *ids; i++) {
        if (!(which >> i & 1))
            continue;
        cli->line.values[ids[i]] = values[i];
        cli->origins[ids[i]] = CLI_FROM_OPTION;
    }
}

static void check(const struct cli *given, const struct cli *cli)
{
    struct diag_list problems;
    for (int i = 0; i < CLI_OPTION_COUNT; i++) {
        enum cli_option_id id = (enum cli_option_id)i;
        const char *value = cli->line.values[i];
        if (given->line.values[i]) {
            TL_ASSERT(value == given->line.values[i] && cli->origins[i] == CLI_FROM_OPTION);
            continue;
        }
        if (!value)
            continue;
        diag_init(&problems);
        TL_ASSERT(preset_holds(id) && cli->origins[i] == CLI_FROM_PRESET);
        TL_ASSERT(cli->owned[i] == value && cli_value_check(id, value, &problems));
        diag_release(&problems);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t bytes)
{
    if (bytes < 1)
        return 0;
    struct cli given = {.line.command = CLI_RENDER};
    struct diag_list problems;
    char *text = mem_strndup((const char *)data + 1, bytes - 1);
    if (!text)
        return 0;
    size_t lines = 1;
    for (const char *c = text; *c; c++)
        lines += *c == '\n';
    diag_init(&problems);
    give(&given, data[0]);
    struct cli cli = given;
    preset_read(&cli, "fuzz.preset", text, &problems);
    check(&given, &cli);
    TL_ASSERT(problems.count <= lines);
    for (int i = 0; i < CLI_OPTION_COUNT; i++)
        mem_free(cli.owned[i]);
    diag_release(&problems);
    mem_free(text);
    return 0;
}
