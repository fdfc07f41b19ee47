#include "client/preset.h"

#include <string.h>

#include "common/file_io.h"
#include "common/mem.h"

enum { PRESET_BYTES_MAX = 1 << 16 };

bool preset_holds(enum cli_option_id id)
{
    uint32_t render = UINT32_C(1) << CLI_RENDER, explain = UINT32_C(1) << CLI_EXPLAIN;
    bool job = (cli_options[id].commands & render) && (cli_options[id].commands & explain) &&
               cli_options[id].kind != CLI_PATH && cli_options[id].kind != CLI_FLAG;
    return job || id == CLI_HALF;
}

static enum cli_option_id option_of(const char *key)
{
    for (int i = 0; i < CLI_OPTION_COUNT; i++)
        if (preset_holds((enum cli_option_id)i) && strcmp(cli_options[i].name, key) == 0)
            return (enum cli_option_id)i;
    return CLI_OPTION_COUNT;
}

static void unknown_key(const char *key, struct diag_place place, struct diag_list *problems)
{
    const char *names[CLI_OPTION_COUNT];
    size_t count = 0;
    char hint[100];
    for (int i = 0; i < CLI_OPTION_COUNT; i++)
        if (preset_holds((enum cli_option_id)i))
            names[count++] = cli_options[i].name;
    const char *nearest = diag_nearest(key, names, count);
    (void)snprintf(hint, sizeof hint, "did you mean %s?", nearest ? nearest : "");
    diag_add(problems, DIAG_ERROR, place, "bad-preset",
             nearest ? hint : "a preset holds job options, as in spp = 64", "no job option \"%s\"",
             key);
}

/* Without blanks around it; cuts the text. */
static char *trimmed(char *text)
{
    text += strspn(text, " \t\r");
    size_t bytes = strlen(text);
    while (bytes > 0 && strchr(" \t\r", text[bytes - 1]))
        text[--bytes] = '\0';
    return text;
}

static bool is_until(int id)
{
    return id != CLI_PRESET && strcmp(cli_options[id].section, "until") == 0;
}

/* The command line says itself when to stop: it says all of it. */
static bool until_given(const struct cli *cli)
{
    for (int i = 0; i < CLI_OPTION_COUNT; i++)
        if (is_until(i) && cli->line.values[i] && cli->origins[i] == CLI_FROM_OPTION)
            return true;
    return false;
}

static void take(struct cli *cli, enum cli_option_id id, const char *value, struct diag_place place,
                 struct diag_list *problems)
{
    if (cli->line.values[id] && cli->origins[id] == CLI_FROM_PRESET) {
        diag_add(problems, DIAG_ERROR, place, "bad-preset", NULL, "%s is given twice",
                 cli_options[id].name);
        return;
    }
    if (cli->line.values[id] || (is_until((int)id) && until_given(cli)))
        return;
    cli->owned[id] = mem_strdup(value);
    if (!cli->owned[id]) {
        diag_add(problems, DIAG_ERROR, place, "no-memory", NULL, "out of memory");
        return;
    }
    cli->line.values[id] = cli->owned[id];
    cli->origins[id] = CLI_FROM_PRESET;
}

static bool flag_value_ok(const char *value)
{
    static const char *const words[] = {"true", "yes", "on", "1", "false", "no", "off", "0"};
    for (size_t i = 0; i < sizeof words / sizeof *words; i++)
        if (strcmp(value, words[i]) == 0)
            return true;
    return false;
}

static void read_line(struct cli *cli, struct diag_place place, char *line,
                      struct diag_list *problems)
{
    line[strcspn(line, "#")] = '\0';
    line = trimmed(line);
    if (!line[0])
        return;
    char *equals = strchr(line, '=');
    if (!equals) {
        diag_add(problems, DIAG_ERROR, place, "bad-preset", NULL,
                 "must be \"key = value\", found \"%s\"", line);
        return;
    }
    *equals = '\0';
    const char *key = trimmed(line), *value = trimmed(equals + 1);
    enum cli_option_id id = option_of(key);
    if (id == CLI_OPTION_COUNT) {
        unknown_key(key, place, problems);
        return;
    }
    struct diag_list found;
    diag_init(&found);
    if (!cli_value_check(id, value, &found))
        diag_add(problems, DIAG_ERROR, place, "bad-preset",
                 found.count ? found.items[0].hint : NULL, "%s",
                 found.count ? found.items[0].text : "bad value");
    else if (cli_options[id].kind == CLI_FLAG && !flag_value_ok(value))
        diag_add(problems, DIAG_ERROR, place, "bad-preset", NULL, "%s = %s: must be true or false",
                 key, value);
    else
        take(cli, id, value, place, problems);
    diag_release(&found);
}

void preset_read(struct cli *cli, const char *file, char *text, struct diag_list *problems)
{
    uint64_t number = 0;
    while (text && *text) {
        char *end = strchr(text, '\n');
        if (end)
            *end = '\0';
        read_line(cli, (struct diag_place){.file = file, .line = ++number}, text, problems);
        text = end ? end + 1 : NULL;
    }
}

int preset_apply(struct cli *cli)
{
    const char *path = cli_text(&cli->line, CLI_PRESET);
    struct diag_list problems;
    char *text;
    size_t bytes;
    diag_init(&problems);
    enum err e = file_read(path, PRESET_BYTES_MAX, &text, &bytes);
    if (e == ERR_OK) {
        if (strlen(text) != bytes)
            diag_add(&problems, DIAG_ERROR, (struct diag_place){.file = path}, "bad-preset", NULL,
                     "holds a zero byte: this is no text");
        else
            preset_read(cli, path, text, &problems);
        mem_free(text);
    } else {
        diag_add(&problems, DIAG_ERROR, (struct diag_place){.file = path}, "bad-preset",
                 "tilery tradeoff SCENE -o DIR writes presets", "cannot be read: %s",
                 file_read_why(path, e));
    }
    int status = cli_problems(&problems, "nothing done");
    diag_release(&problems);
    return status;
}
