#include "client/cli_settings.h"

#include <ctype.h>
#include <stdlib.h>
#include <string.h>

#include "client/cli_help.h"
#include "client/human.h"
#include "common/file_io.h"
#include "common/mem.h"

enum { SETTINGS_BYTES_MAX = 1 << 20, TOKEN_BYTES_MAX = 4096, VARIABLE_BYTES = 64 };

#define SYSTEM_FILE "/etc/tilery/config"

static const char *const origin_names[] = {
    [CLI_FROM_DEFAULT] = "default",
    [CLI_FROM_OPTION] = "option",
    [CLI_FROM_PRESET] = "preset",
    [CLI_FROM_ENVIRONMENT] = "environment",
    [CLI_FROM_USER_FILE] = "your settings file",
    [CLI_FROM_SYSTEM_FILE] = SYSTEM_FILE,
};

/* token-file -> TILERY_TOKEN_FILE */
static void variable_name(const struct cli_option *o, char out[VARIABLE_BYTES])
{
    (void)snprintf(out, VARIABLE_BYTES, "TILERY_%s", o->name);
    for (char *p = out; *p; p++)
        *p = *p == '-' ? '_' : (char)toupper((unsigned char)*p);
}

/* Takes `value` (owned by the caller's owner) unless a stronger origin has set the option. */
static bool set_value(struct cli *cli, enum cli_option_id id, const char *value,
                      enum cli_origin origin)
{
    if (cli->line.values[id])
        return false;
    cli->line.values[id] = value;
    cli->origins[id] = origin;
    return true;
}

static void read_environment(struct cli *cli, struct diag_list *problems)
{
    for (int i = 0; i < CLI_OPTION_COUNT; i++) {
        char name[VARIABLE_BYTES];
        bool taken =
            cli->line.command == CLI_HELP || (cli_options[i].commands >> cli->line.command & 1);
        if (!cli_options[i].setting || !taken)
            continue;
        variable_name(&cli_options[i], name);
        const char *value = getenv(name);
        if (!value || !value[0] || cli->line.values[i])
            continue;
        size_t before = problems->error_count;
        if (cli_value_check((enum cli_option_id)i, value, problems))
            (void)set_value(cli, (enum cli_option_id)i, value, CLI_FROM_ENVIRONMENT);
        else if (problems->error_count > before)
            diag_add(problems, DIAG_ERROR, (struct diag_place){0}, "bad-value", NULL,
                     "that value came from %s", name);
    }
}

static char *trim(char *text)
{
    while (isspace((unsigned char)*text))
        text++;
    size_t bytes = strlen(text);
    while (bytes > 0 && isspace((unsigned char)text[bytes - 1]))
        text[--bytes] = '\0';
    return text;
}

static enum cli_option_id setting_find(const char *name)
{
    for (int i = 0; i < CLI_OPTION_COUNT; i++)
        if (cli_options[i].setting && strcmp(cli_options[i].name, name) == 0)
            return (enum cli_option_id)i;
    return CLI_OPTION_COUNT;
}

static void unknown_setting(const char *key, struct diag_place place, struct diag_list *problems)
{
    const char *names[CLI_OPTION_COUNT];
    size_t count = 0;
    for (int i = 0; i < CLI_OPTION_COUNT; i++)
        if (cli_options[i].setting)
            names[count++] = cli_options[i].name;
    const char *nearest = diag_nearest(key, names, count);
    char hint[100];
    (void)snprintf(hint, sizeof hint, "did you mean %s?", nearest ? nearest : "");
    diag_add(problems, DIAG_ERROR, place, "unknown-setting",
             nearest ? hint : "see tilery help settings", "no setting \"%s\"", key);
}

static void read_line(struct cli *cli, enum cli_origin origin, struct diag_place place, char *line,
                      struct diag_list *problems)
{
    line[strcspn(line, "#")] = '\0';
    line = trim(line);
    if (!line[0])
        return;
    char *equals = strchr(line, '=');
    if (!equals) {
        diag_add(problems, DIAG_ERROR, place, "bad-setting", NULL,
                 "must be \"key = value\", found \"%s\"", line);
        return;
    }
    *equals = '\0';
    const char *key = trim(line);
    const char *value = trim(equals + 1);
    enum cli_option_id id = setting_find(key);
    if (id == CLI_OPTION_COUNT) {
        unknown_setting(key, place, problems);
        return;
    }
    struct diag_list found;
    diag_init(&found);
    if (!cli_value_check(id, value, &found))
        diag_add(problems, DIAG_ERROR, place, "bad-setting", NULL, "%s",
                 found.count ? found.items[0].text : "bad value");
    else if (!cli->line.values[id] && (cli->owned[id] = mem_strdup(value)))
        (void)set_value(cli, id, cli->owned[id], origin);
    diag_release(&found);
}

void cli_settings_read(struct cli *cli, enum cli_origin origin, const char *file, char *text,
                       struct diag_list *problems)
{
    uint64_t number = 0;
    while (text && *text) {
        char *end = strchr(text, '\n');
        if (end)
            *end = '\0';
        struct diag_place place = {.file = file, .line = ++number};
        read_line(cli, origin, place, text, problems);
        text = end ? end + 1 : NULL;
    }
}

static void read_file(struct cli *cli, enum cli_origin origin, const char *path,
                      struct diag_list *problems)
{
    char *text;
    size_t bytes;
    enum err e = file_read(path, SETTINGS_BYTES_MAX, &text, &bytes);
    if (e == ERR_NOT_FOUND)
        return;
    if (e != ERR_OK) {
        diag_add(problems, DIAG_ERROR, (struct diag_place){.file = path}, "bad-setting", NULL,
                 "cannot be read: %s", file_read_why(path, e));
        return;
    }
    cli_settings_read(cli, origin, path, text, problems);
    mem_free(text);
}

static char *user_file(void)
{
    const char *base = getenv("XDG_CONFIG_HOME");
    if (base && base[0] == '/')
        return mem_sprintf("%s/tilery/config", base);
    const char *home = getenv("HOME");
    return home && home[0] == '/' ? mem_sprintf("%s/.config/tilery/config", home) : NULL;
}

/* Settings of other commands stay out, so that cli_has() means what it says. */
static void drop_foreign(struct cli *cli)
{
    for (int i = 0; i < CLI_OPTION_COUNT; i++)
        if (cli->line.command != CLI_HELP && !(cli_options[i].commands >> cli->line.command & 1))
            cli->line.values[i] = NULL;
}

bool cli_settings_load(struct cli *cli, struct diag_list *problems)
{
    size_t before = problems->error_count;
    for (int i = 0; i < CLI_OPTION_COUNT; i++)
        cli->origins[i] = cli->line.values[i] ? CLI_FROM_OPTION : CLI_FROM_DEFAULT;
    read_environment(cli, problems);
    char *path = user_file();
    if (path)
        read_file(cli, CLI_FROM_USER_FILE, path, problems);
    mem_free(path);
    read_file(cli, CLI_FROM_SYSTEM_FILE, SYSTEM_FILE, problems);
    drop_foreign(cli);
    return problems->error_count == before;
}

/* What holds where nobody said anything. */
static void default_text(enum cli_option_id id, char out[HUMAN_BYTES])
{
    uint32_t workers = cli_default_workers();
    if (id == CLI_WORKER_COUNT || id == CLI_THREADS)
        (void)snprintf(out, HUMAN_BYTES, "%u",
                       id == CLI_THREADS ? cli_default_threads(workers) : workers);
    else
        (void)snprintf(out, HUMAN_BYTES, "%s",
                       cli_options[id].kind == CLI_CHOICE ? cli_options[id].choices[0]
                       : cli_options[id].kind == CLI_FLAG ? "no"
                                                          : "-");
}

void cli_settings_print(const struct cli *cli, struct buf *out)
{
    buf_printf(out, "%-11s %-28s %-18s %s\n", "SETTING", "VALUE", "VARIABLE", "FROM");
    for (int i = 0; i < CLI_OPTION_COUNT; i++) {
        char name[VARIABLE_BYTES], preset[HUMAN_BYTES];
        if (!cli_options[i].setting)
            continue;
        default_text((enum cli_option_id)i, preset);
        variable_name(&cli_options[i], name);
        const char *value = cli->line.values[i];
        buf_printf(out, "%-11s %-28s %-18s %s\n", cli_options[i].name,
                   value ? cli_safe(value) : preset, name, origin_names[cli->origins[i]]);
    }
    const char *token = getenv("TILERY_TOKEN");
    buf_printf(out, "%-11s %-28s %-18s %s\n", "(token)", token && token[0] ? "(set)" : "-",
               "TILERY_TOKEN", token && token[0] ? "environment" : "default");
    char *path = user_file();
    buf_printf(out, "\nfiles, lines of key = value: %s, then %s\n",
               path ? cli_safe(path) : "(no HOME)", SYSTEM_FILE);
    mem_free(path);
}

static enum err token_from_file(const char *path, char **token, struct diag_list *problems)
{
    char *text;
    size_t bytes;
    enum err e = file_read(path, TOKEN_BYTES_MAX, &text, &bytes);
    const char *why = e == ERR_OK ? NULL : file_read_why(path, e);
    if (e == ERR_OK) {
        text[strcspn(text, "\r\n")] = '\0';
        why = text[0] ? NULL : "is empty";
    }
    if (why) {
        diag_add(problems, DIAG_ERROR, (struct diag_place){.file = path}, "bad-token-file",
                 "one line with the token that the master's --token-file has", "token file: %s",
                 why);
        if (e == ERR_OK)
            mem_free(text);
        return ERR_INPUT;
    }
    *token = text;
    return ERR_OK;
}

enum err cli_settings_token(const struct cli *cli, char **token, struct diag_list *problems)
{
    const char *variable = getenv("TILERY_TOKEN");
    bool has_file = cli_has(&cli->line, CLI_TOKEN_FILE);
    *token = NULL;
    if (has_file && (cli->origins[CLI_TOKEN_FILE] == CLI_FROM_OPTION || !variable || !variable[0]))
        return token_from_file(cli_text(&cli->line, CLI_TOKEN_FILE), token, problems);
    if (!variable || !variable[0])
        return ERR_OK;
    *token = mem_strdup(variable);
    return *token ? ERR_OK : ERR_NOMEM;
}
