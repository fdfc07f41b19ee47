#include "client/cli_option.h"

#include "client/until.h"

#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

static const struct diag_place nowhere;

#define complain(problems, id, hint, ...)                                                          \
    diag_add((problems), DIAG_ERROR, nowhere, (id), (hint), __VA_ARGS__)

bool cli_parse_count(const char *text, uint64_t max, uint64_t *out)
{
    if (text[0] < '0' || text[0] > '9')
        return false;
    char *end;
    errno = 0;
    unsigned long long value = strtoull(text, &end, 10);
    if (errno != 0 || *end != '\0' || value > max)
        return false;
    *out = value;
    return true;
}

bool cli_parse_number(const char *text, double *out)
{
    if (text[0] == '\0' || strspn(text, "0123456789.eE+-") != strlen(text))
        return false;
    char *end;
    double value = strtod(text, &end);
    if (*end != '\0' || !isfinite(value))
        return false;
    *out = value;
    return true;
}

/* N numbers with one separator between each two, e.g. 640x480. */
static bool parse_list(const char *text, char separator, uint32_t *out, int count)
{
    for (int i = 0; i < count; i++) {
        char word[16];
        const char *end = i + 1 < count ? strchr(text, separator) : text + strlen(text);
        uint64_t value;
        if (!end || (size_t)(end - text) >= sizeof word)
            return false;
        memcpy(word, text, (size_t)(end - text));
        word[end - text] = '\0';
        if (!cli_parse_count(word, UINT32_MAX, &value))
            return false;
        out[i] = (uint32_t)value;
        text = end + 1;
    }
    return true;
}

static bool check_count(const struct cli_option *o, const char *text, struct diag_list *problems)
{
    uint64_t value;
    bool negative = text[0] == '-' && o->low < 0;
    bool number = cli_parse_count(text + negative, UINT64_MAX, &value);
    double signed_value = number ? (negative ? -(double)value : (double)value) : 0;
    if (number && signed_value >= o->low && signed_value <= o->high)
        return true;
    /* A double has no room for the largest of 64 bits: it would show one more. */
    char high[32];
    (void)snprintf(high, sizeof high, "%.0f", o->high);
    if (o->high >= (double)UINT64_MAX)
        (void)snprintf(high, sizeof high, "%" PRIu64, UINT64_MAX);
    complain(problems, "bad-value", o->help, "--%s %s: must be a whole number from %.0f to %s",
             o->name, text, o->low, high);
    return false;
}

static bool check_choice(const struct cli_option *o, const char *text, struct diag_list *problems)
{
    if (job_choice_find(o->choices, o->choice_count, text) >= 0)
        return true;
    char known[300] = "known: ";
    for (int i = 0; i < o->choice_count; i++) {
        size_t used = strlen(known);
        (void)snprintf(known + used, sizeof known - used, "%s%s", i ? ", " : "", o->choices[i]);
    }
    const char *nearest = diag_nearest(text, o->choices, (size_t)o->choice_count);
    char hint[400];
    (void)snprintf(hint, sizeof hint, "%s%s%s%s", nearest ? "did you mean " : "",
                   nearest ? nearest : "", nearest ? "? " : "", known);
    complain(problems, "bad-value", hint, "--%s: no \"%s\"", o->name, text);
    return false;
}

static bool check_rectangle(const struct cli_option *o, const char *text,
                            struct diag_list *problems)
{
    uint32_t v[4] = {0, 0, 1, 1};
    bool crop = o->kind == CLI_CROP;
    bool ok = crop ? parse_list(text, ',', v, 4) : parse_list(text, 'x', v + 2, 2);
    if (ok && v[2] >= 1 && v[3] >= 1 && v[0] <= JOB_SIDE_MAX && v[1] <= JOB_SIDE_MAX &&
        v[2] <= JOB_SIDE_MAX && v[3] <= JOB_SIDE_MAX)
        return true;
    complain(problems, "bad-value", o->help, "--%s %s: must be %s, as in %s, sides from 1 to %d",
             o->name, text, o->argument, crop ? "100,80,64,64" : "640x480", JOB_SIDE_MAX);
    return false;
}

static bool check_number(const struct cli_option *o, const char *text, struct diag_list *problems)
{
    double value;
    if (cli_parse_number(text, &value) && value >= o->low && value <= o->high)
        return true;
    complain(problems, "bad-value", o->help, "--%s %s: must be a number from %g to %g", o->name,
             text, o->low, o->high);
    return false;
}

/* "0.05" or "5%". */
static bool parse_share(const char *text, double *out)
{
    char number[32];
    size_t bytes = strlen(text);
    bool percent = bytes > 0 && text[bytes - 1] == '%';
    bytes -= percent;
    if (bytes >= sizeof number)
        return false;
    memcpy(number, text, bytes);
    number[bytes] = '\0';
    if (!cli_parse_number(number, out))
        return false;
    *out /= percent ? 100 : 1;
    return *out >= 0 && *out <= 1;
}

static bool check_share(const struct cli_option *o, const char *text, struct diag_list *problems)
{
    double value;
    if (parse_share(text, &value))
        return true;
    complain(problems, "bad-value", o->help,
             "--%s %s: must be a share from 0 to 1, or 0%% to 100%%, as in 0.05 or 5%%", o->name,
             text);
    return false;
}

static bool check_aovs(const struct cli_option *o, const char *text, struct diag_list *problems)
{
    uint32_t set;
    char bad[AOV_LIST_BYTES], all[AOV_LIST_BYTES + 32];
    if (aov_parse(text, &set, bad))
        return true;
    size_t used = (size_t)snprintf(all, sizeof all, "known: ");
    aov_list((UINT32_C(1) << AOV_COUNT) - 1, all + used);
    if (text[strspn(text, ",")] == '\0')
        complain(problems, "bad-value", all, "--%s: names no channel, as depth,normal does",
                 o->name);
    else
        complain(problems, "bad-value", all, "--%s %s: \"%s\" is none, or comes twice", o->name,
                 text, bad);
    return false;
}

static bool check_tags(const struct cli_option *o, const char *text, struct diag_list *problems)
{
    struct tags tags;
    char bad[TAG_BYTES];
    if (tags_parse(text, &tags, bad) && tags.count > 0)
        return true;
    complain(problems, "bad-value",
             "at most 8 different tags of " TAG_EXPECTED ", as in big,site-b",
             "--%s %s: \"%s\" is no tag, comes twice or is one too many", o->name, text,
             text[0] ? bad : "");
    return false;
}

static bool check_text(const struct cli_option *o, const char *text, struct diag_list *problems)
{
    bool too_long = o->high > 0 && strlen(text) > (size_t)o->high;
    if (text[0] == '\0')
        complain(problems, "bad-value", o->help, "--%s: must not be empty", o->name);
    else if (too_long)
        complain(problems, "bad-value", o->help, "--%s: %zu bytes, must be at most %.0f", o->name,
                 strlen(text), o->high);
    return text[0] != '\0' && !too_long;
}

bool cli_value_check(enum cli_option_id id, const char *text, struct diag_list *problems)
{
    const struct cli_option *o = &cli_options[id];
    switch (o->kind) {
    case CLI_FLAG:
        return true;
    case CLI_COUNT:
        return check_count(o, text, problems);
    case CLI_NUMBER:
        return check_number(o, text, problems);
    case CLI_SHARE:
        return check_share(o, text, problems);
    case CLI_SIZE:
    case CLI_CROP:
        return check_rectangle(o, text, problems);
    case CLI_CHOICE:
        return check_choice(o, text, problems);
    case CLI_AOVS:
        return check_aovs(o, text, problems);
    case CLI_TAGS:
        return check_tags(o, text, problems);
    case CLI_TEXT:
    case CLI_PATH:
        return check_text(o, text, problems);
    }
    return false;
}

enum cli_command_id cli_command_find(const char *name)
{
    for (int i = 0; i < CLI_COMMAND_COUNT; i++)
        if (strcmp(cli_commands[i].name, name) == 0)
            return (enum cli_command_id)i;
    return CLI_COMMAND_COUNT;
}

const char *cli_command_nearest(const char *name)
{
    const char *names[CLI_COMMAND_COUNT];
    for (int i = 0; i < CLI_COMMAND_COUNT; i++)
        names[i] = cli_commands[i].name;
    return diag_nearest(name, names, CLI_COMMAND_COUNT);
}

/* The option of this command with that name of `bytes` length; CLI_OPTION_COUNT if none. */
static enum cli_option_id option_find(enum cli_command_id command, const char *name, size_t bytes)
{
    for (int i = 0; i < CLI_OPTION_COUNT; i++)
        if ((cli_options[i].commands >> command & 1) && strlen(cli_options[i].name) == bytes &&
            memcmp(cli_options[i].name, name, bytes) == 0)
            return (enum cli_option_id)i;
    return CLI_OPTION_COUNT;
}

static enum cli_option_id letter_find(enum cli_command_id command, char letter)
{
    for (int i = 0; i < CLI_OPTION_COUNT; i++)
        if ((cli_options[i].commands >> command & 1) && cli_options[i].letter == letter)
            return (enum cli_option_id)i;
    return CLI_OPTION_COUNT;
}

static void unknown_option(enum cli_command_id command, const char *word,
                           struct diag_list *problems)
{
    const char *names[CLI_OPTION_COUNT];
    size_t count = 0;
    bool elsewhere = false;
    char name[64];
    (void)snprintf(name, sizeof name, "%.*s", (int)strcspn(word + 2, "="), word + 2);
    for (int i = 0; i < CLI_OPTION_COUNT; i++) {
        if (cli_options[i].commands >> command & 1)
            names[count++] = cli_options[i].name;
        else
            elsewhere |= strcmp(cli_options[i].name, name) == 0;
    }
    const char *nearest = word[1] == '-' && !elsewhere ? diag_nearest(name, names, count) : NULL;
    char hint[120];
    if (nearest)
        (void)snprintf(hint, sizeof hint, "did you mean --%s?", nearest);
    else
        (void)snprintf(hint, sizeof hint, "see tilery %s --help", cli_commands[command].name);
    complain(problems, "unknown-option", hint, "%s takes no option %s", cli_commands[command].name,
             word);
}

/* What a parse remembers while it walks over the words. */
struct walk {
    struct cli_line *line;
    char *const *words;
    int at, count;
    struct diag_list *problems;
};

const char *cli_typed(const struct cli_line *line, enum cli_option_id id)
{
    static char text[80];
    const struct cli_option *o = &cli_options[id];
    if (line->lettered[id])
        (void)snprintf(text, sizeof text, "-%c", o->letter);
    else
        (void)snprintf(text, sizeof text, "--%s", o->name);
    return text;
}

static void take_option(struct walk *w, enum cli_option_id id, const char *attached)
{
    const struct cli_option *o = &cli_options[id];
    const char *value = attached, *typed = cli_typed(w->line, id);
    if (o->kind == CLI_FLAG) {
        if (attached)
            complain(w->problems, "bad-value", NULL, "%s takes no value", typed);
        value = "";
    } else if (!attached) {
        if (w->at >= w->count) {
            complain(w->problems, "missing-value", NULL, "%s needs a value: %s", typed,
                     o->argument);
            return;
        }
        value = w->words[w->at++];
    }
    if (w->line->values[id] && o->kind != CLI_FLAG)
        complain(w->problems, "given-twice", NULL, "%s is given twice", typed);
    if (cli_value_check(id, value, w->problems))
        w->line->values[id] = value;
}

static void take_word(struct walk *w, const char *word, bool *options_over)
{
    struct cli_line *line = w->line;
    /* A negative number is an argument, not an option. */
    bool is_option =
        !*options_over && word[0] == '-' && word[1] != '\0' && !(word[1] >= '0' && word[1] <= '9');
    if (!is_option) {
        if (line->argument_count < CLI_ARGUMENTS_MAX)
            line->arguments[line->argument_count] = word;
        line->argument_count++;
        return;
    }
    if (strcmp(word, "--") == 0) {
        *options_over = true;
        return;
    }
    enum cli_option_id id;
    const char *attached = NULL;
    if (word[1] == '-') {
        size_t bytes = strcspn(word + 2, "=");
        id = option_find(line->command, word + 2, bytes);
        attached = word[2 + bytes] == '=' ? word + 3 + bytes : NULL;
    } else {
        id = letter_find(line->command, word[1]);
        attached = word[2] ? word + 2 : NULL;
    }
    if (id == CLI_OPTION_COUNT) {
        unknown_option(line->command, word, w->problems);
        return;
    }
    line->lettered[id] = word[1] != '-';
    take_option(w, id, attached);
}

static void check_arguments(const struct cli_line *line, struct diag_list *problems)
{
    int held =
        line->argument_count < CLI_ARGUMENTS_MAX ? line->argument_count : (int)CLI_ARGUMENTS_MAX;
    const struct cli_command *c = &cli_commands[line->command];
    char see[80];
    (void)snprintf(see, sizeof see, "see tilery %s --help", c->name);
    if (line->argument_count < c->argument_min)
        complain(problems, "missing-argument", see, "usage: tilery %s %s", c->name, c->arguments);
    for (int i = 0; i < held; i++)
        if (line->arguments[i][0] == '\0')
            complain(problems, "bad-value", see, "%s: an argument must not be empty", c->name);
    if (line->argument_count > c->argument_max) {
        int first = c->argument_max < CLI_ARGUMENTS_MAX ? c->argument_max : 0;
        complain(problems, "extra-argument", see, "%s: \"%s\" is one argument too many", c->name,
                 line->arguments[first]);
    }
}

bool cli_line_parse(struct cli_line *line, int argc, char *const *argv, struct diag_list *problems)
{
    TL_ASSERT(argc >= 2);
    size_t before = problems->error_count;
    *line = (struct cli_line){.command = cli_command_find(argv[1])};
    if (line->command == CLI_COMMAND_COUNT) {
        const char *nearest = cli_command_nearest(argv[1]);
        char hint[120];
        (void)snprintf(hint, sizeof hint, nearest ? "did you mean tilery %s?" : "see tilery --help",
                       nearest);
        complain(problems, "unknown-command", hint, "no command \"%s\"", argv[1]);
        return false;
    }
    struct walk w = {.line = line, .words = argv, .at = 2, .count = argc, .problems = problems};
    bool options_over = false;
    while (w.at < w.count) {
        const char *word = argv[w.at++];
        take_word(&w, word, &options_over);
        if (line->values[CLI_HELP_FLAG])
            return true;
    }
    check_arguments(line, problems);
    until_check(line, problems);
    return problems->error_count == before;
}

bool cli_has(const struct cli_line *line, enum cli_option_id id)
{
    return line->values[id] != NULL;
}

const char *cli_text(const struct cli_line *line, enum cli_option_id id)
{
    TL_ASSERT(line->values[id]);
    return line->values[id];
}

uint64_t cli_count(const struct cli_line *line, enum cli_option_id id)
{
    uint64_t value = 0;
    bool ok = cli_parse_count(cli_text(line, id), UINT64_MAX, &value);
    TL_ASSERT(ok);
    return value;
}

double cli_number(const struct cli_line *line, enum cli_option_id id)
{
    double value = 0;
    bool ok = cli_parse_number(cli_text(line, id), &value);
    TL_ASSERT(ok);
    return value;
}

double cli_share(const struct cli_line *line, enum cli_option_id id)
{
    double value = 0;
    bool ok = parse_share(cli_text(line, id), &value);
    TL_ASSERT(ok);
    return value;
}

int cli_choice(const struct cli_line *line, enum cli_option_id id)
{
    const struct cli_option *o = &cli_options[id];
    int choice = job_choice_find(o->choices, o->choice_count, cli_text(line, id));
    TL_ASSERT(choice >= 0);
    return choice;
}

void cli_size(const struct cli_line *line, uint32_t *width, uint32_t *height)
{
    uint32_t v[2] = {0};
    bool ok = parse_list(cli_text(line, CLI_SIZE_WH), 'x', v, 2);
    TL_ASSERT(ok);
    *width = v[0];
    *height = v[1];
}

uint32_t cli_aovs(const struct cli_line *line)
{
    uint32_t set = 0;
    bool ok = aov_parse(cli_text(line, CLI_AOV), &set, NULL);
    TL_ASSERT(ok);
    return set;
}

struct tags cli_tags(const struct cli_line *line)
{
    struct tags tags = {.count = 0};
    if (cli_has(line, CLI_TAGS_WANTED)) {
        bool ok = tags_parse(cli_text(line, CLI_TAGS_WANTED), &tags, NULL);
        TL_ASSERT(ok);
    }
    return tags;
}

struct job_crop cli_crop(const struct cli_line *line)
{
    uint32_t v[4] = {0};
    bool ok = parse_list(cli_text(line, CLI_CROP_XYWH), ',', v, 4);
    TL_ASSERT(ok);
    return (struct job_crop){.x = v[0], .y = v[1], .width = v[2], .height = v[3]};
}

bool cli_flag(const struct cli_line *line, enum cli_option_id id)
{
    static const char *const words[] = {"", "true", "yes", "on", "1"};
    const char *value = line->values[id];
    for (size_t i = 0; value && i < sizeof words / sizeof *words; i++)
        if (strcmp(value, words[i]) == 0)
            return true;
    return false;
}
