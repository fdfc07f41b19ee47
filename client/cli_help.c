#include "client/cli_help.h"

#include <sched.h>
#include <stdlib.h>
#include <string.h>

enum { COLUMNS = 80, SECTION_COLUMNS = 10, HELP_COLUMN = 37 };

static const char *const command_sections[] = {"here", "jobs", "workers"};

/* Cores that this process may use; a container or taskset may leave fewer than there are. */
static uint32_t cores_usable(void)
{
    cpu_set_t set;
    if (sched_getaffinity(0, sizeof set, &set) != 0)
        return 1;
    int count = CPU_COUNT(&set);
    return count > 0 ? (uint32_t)count : 1;
}

uint32_t cli_default_workers(void)
{
    return cores_usable() > 1 ? 2 : 1;
}

uint32_t cli_default_threads(uint32_t workers)
{
    uint32_t each = cores_usable() / (workers ? workers : 1);
    return each ? each : 1;
}

void cli_help_overview(struct buf *out)
{
    const char *master = getenv("TILERY_MASTER");
    buf_printf(out,
               "tilery renders scenes on many cores and machines: same picture, bit for bit\n\n"
               "  tilery render scene.json -o out.exr    render here\n"
               "  tilery explain scene.json              what it needs, what it leaves out\n"
               "  tilery submit scene.json --name spot   give it to the farm\n\n");
    for (size_t s = 0; s < sizeof command_sections / sizeof *command_sections; s++) {
        buf_printf(out, "%-*s", SECTION_COLUMNS - 1, command_sections[s]);
        for (int i = 0; i < CLI_COMMAND_COUNT; i++)
            if (strcmp(cli_commands[i].section, command_sections[s]) == 0)
                buf_printf(out, " %s", cli_commands[i].name);
        buf_printf(out, "\n");
    }
    buf_printf(out, "\ntilery help COMMAND: examples and options.  Farm: %s\n",
               master && master[0] ? cli_safe(master) : "none (TILERY_MASTER unset)");
}

static void put_usage(enum cli_command_id id, struct buf *out)
{
    const struct cli_command *c = &cli_commands[id];
    buf_printf(out, "usage: tilery %s %s\n%s", c->name, c->arguments,
               cli_examples[id] ? cli_examples[id] : "");
}

/* "--spp N", with the machine's default where it has one. */
static void option_text(const struct cli_option *o, char *out, size_t bytes)
{
    char preset[24] = "";
    uint32_t workers = cli_default_workers();
    if (o == &cli_options[CLI_WORKER_COUNT])
        (void)snprintf(preset, sizeof preset, " (%u)", workers);
    if (o == &cli_options[CLI_THREADS])
        (void)snprintf(preset, sizeof preset, " (%u)", cli_default_threads(workers));
    if (o->letter == 'o')
        (void)snprintf(out, bytes, "-o %s", o->argument);
    else
        (void)snprintf(out, bytes, "--%s%s%s%s", o->name, o->argument ? " " : "",
                       o->argument ? o->argument : "", preset);
}

static void put_section(enum cli_command_id id, const char *section, struct buf *out)
{
    int column = 0;
    for (int i = 0; i < CLI_OPTION_COUNT; i++) {
        const struct cli_option *o = &cli_options[i];
        char text[100];
        if (!(o->commands >> id & 1) || strcmp(o->section, section) != 0)
            continue;
        option_text(o, text, sizeof text);
        int bytes = (int)strlen(text);
        if (column == 0)
            buf_printf(out, "%-*s%s", SECTION_COLUMNS, section, text);
        else if (column + 2 + bytes > COLUMNS)
            buf_printf(out, "\n%*s%s", SECTION_COLUMNS, "", text);
        else
            buf_printf(out, "  %s", text);
        bool wrapped = column == 0 || column + 2 + bytes > COLUMNS;
        column = (wrapped ? SECTION_COLUMNS : column + 2) + bytes;
    }
    if (column > 0)
        buf_printf(out, "\n");
}

/* True for the first option of the table that has this section within this command. */
static bool section_begins(enum cli_command_id id, int option)
{
    for (int i = 0; i < option; i++)
        if ((cli_options[i].commands >> id & 1) &&
            strcmp(cli_options[i].section, cli_options[option].section) == 0)
            return false;
    return (cli_options[option].commands >> id & 1) != 0;
}

void cli_help_short(enum cli_command_id id, struct buf *out)
{
    put_usage(id, out);
    buf_printf(out, "\n");
    for (int i = 0; i < CLI_OPTION_COUNT; i++)
        if (section_begins(id, i))
            put_section(id, cli_options[i].section, out);
}

static void put_choices(const struct cli_option *o, struct buf *out)
{
    if (o->kind != CLI_CHOICE || (o->argument && strchr(o->argument, '|')))
        return;
    buf_printf(out, ":");
    for (int i = 0; i < o->choice_count; i++)
        buf_printf(out, "%s %s", i ? "," : "", o->choices[i]);
}

/* The text of an option behind its name, wrapped. */
static void put_wrapped(const char *text, struct buf *out)
{
    int column = HELP_COLUMN;
    while (*text) {
        int bytes = (int)strcspn(text, " ");
        if (column > HELP_COLUMN && column + 1 + bytes > COLUMNS) {
            buf_printf(out, "\n%*s", HELP_COLUMN, "");
            column = HELP_COLUMN;
        }
        buf_printf(out, "%s%.*s", column > HELP_COLUMN ? " " : "", bytes, text);
        column += bytes + (column > HELP_COLUMN);
        text += bytes;
        text += strspn(text, " ");
    }
    buf_printf(out, "\n");
}

void cli_help_long(enum cli_command_id id, struct buf *out)
{
    buf_printf(out, "tilery %s: %s\n", cli_commands[id].name, cli_commands[id].summary);
    put_usage(id, out);
    buf_printf(out, "\n");
    for (int i = 0; i < CLI_OPTION_COUNT; i++) {
        const struct cli_option *o = &cli_options[i];
        char text[100];
        struct buf help;
        if (!(o->commands >> id & 1))
            continue;
        option_text(o, text, sizeof text);
        buf_init(&help);
        buf_printf(&help, "%s", o->help);
        put_choices(o, &help);
        buf_put_u8(&help, '\0');
        buf_printf(out, "  %-*s ", HELP_COLUMN - 3, text);
        if (buf_status(&help) == ERR_OK)
            put_wrapped((const char *)help.data, out);
        buf_release(&help);
    }
}

static void put_completion_options(enum cli_command_id id, struct buf *out)
{
    buf_printf(out, "    %s) words=\"", cli_commands[id].name);
    bool first = true;
    for (int i = 0; i < CLI_OPTION_COUNT; i++) {
        if (!(cli_options[i].commands >> id & 1))
            continue;
        buf_printf(out, "%s--%s", first ? "" : " ", cli_options[i].name);
        first = false;
    }
    buf_printf(out, "\";;\n");
}

static void put_completion_choices(struct buf *out)
{
    for (int i = 0; i < CLI_OPTION_COUNT; i++) {
        const struct cli_option *o = &cli_options[i];
        if (o->kind != CLI_CHOICE)
            continue;
        buf_printf(out, "    --%s) COMPREPLY=($(compgen -W \"", o->name);
        for (int k = 0; k < o->choice_count; k++)
            buf_printf(out, "%s%s", k ? " " : "", o->choices[k]);
        buf_printf(out, "\" -- \"$word\")); return;;\n");
    }
}

void cli_help_completion(struct buf *out)
{
    buf_printf(out, "# bash completion of tilery; load with: source <(tilery help completion)\n"
                    "_tilery() {\n"
                    "    local word=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]}\n"
                    "    local words=\"\"\n"
                    "    if [ \"$COMP_CWORD\" = 1 ]; then\n"
                    "        COMPREPLY=($(compgen -W \"");
    for (int i = 0; i < CLI_COMMAND_COUNT; i++)
        buf_printf(out, "%s%s", i ? " " : "", cli_commands[i].name);
    buf_printf(out, "\" -- \"$word\")); return\n    fi\n    case $before in\n");
    put_completion_choices(out);
    buf_printf(out, "    esac\n    case $word in -*) ;; *)\n"
                    "        case ${COMP_WORDS[1]} in\n"
                    "        status|watch|get|pause|resume|cancel|retry|priority)\n"
                    "            words=$(timeout 0.3 tilery jobs --quiet 2>/dev/null |"
                    " awk 'NR > 1 {print $1}');;\n"
                    "        drain) words=$(timeout 0.3 tilery workers --quiet 2>/dev/null |"
                    " awk 'NR > 1 {print $1}');;\n"
                    "        esac\n"
                    "        COMPREPLY=($(compgen -W \"$words\" -f -- \"$word\")); return;;\n"
                    "    esac\n    case ${COMP_WORDS[1]} in\n");
    for (int i = 0; i < CLI_COMMAND_COUNT; i++)
        put_completion_options((enum cli_command_id)i, out);
    buf_printf(out, "    esac\n    COMPREPLY=($(compgen -W \"$words\" -- \"$word\"))\n}\n"
                    "complete -o filenames -F _tilery tilery\n");
}

static void put_man_options(enum cli_command_id id, struct buf *out)
{
    for (int i = 0; i < CLI_OPTION_COUNT; i++) {
        const struct cli_option *o = &cli_options[i];
        if (!(o->commands >> id & 1))
            continue;
        buf_printf(out, ".TP\n.B \\-\\-%s%s%s\n%s.\n", o->name, o->argument ? " " : "",
                   o->argument ? o->argument : "", o->help);
    }
}

void cli_help_man(struct buf *out)
{
    buf_printf(out,
               ".TH TILERY 1 \"\" \"tilery %s\"\n.SH NAME\ntilery \\- render scenes on many "
               "cores and machines\n.SH SYNOPSIS\n.B tilery\n.I COMMAND\n[options]\n",
               TILERY_VERSION);
    for (int i = 0; i < CLI_COMMAND_COUNT; i++) {
        buf_printf(out, ".SH TILERY %s\n.B tilery %s\n%s\n.PP\n%s.\n", cli_commands[i].name,
                   cli_commands[i].name, cli_commands[i].arguments, cli_commands[i].summary);
        put_man_options((enum cli_command_id)i, out);
    }
    buf_printf(out, ".SH EXIT STATUS\n0 done; 1 the job failed or the comparison did not hold; "
                    "2 wrong usage; 3 bad input; 4 the farm cannot be reached, refused, or knows "
                    "no such job; 5 this machine failed; 130 interrupted.\n"
                    ".SH ENVIRONMENT\n.B TILERY_MASTER\nis the URL of the farm's HTTP side;\n"
                    ".B TILERY_TOKEN\nits token. Settings: tilery help settings.\n");
}
