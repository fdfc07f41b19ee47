/* client/cli_option.h: the commands and options of `tilery`, in two tables.
 *
 * Help texts, shell completion, error messages and the names of settings are all
 * made from these tables, so that they cannot disagree. Parsing checks every value
 * against its option's kind and range, and reports all problems of a command line in
 * one run. Values stay the texts that were given (borrowed from argv); the getters
 * convert a text that parsing has already checked. Pure; one thread.
 */
#ifndef CLIENT_CLI_OPTION_H
#define CLIENT_CLI_OPTION_H

#include <stdio.h>

#include "common/diag.h"
#include "common/err.h"
#include "common/job_spec.h"

/* X(id, name, section of the short help, arguments, fewest, most, one line) */
#define CLI_COMMANDS(X)                                                                            \
    X(RENDER, "render", "here", "SCENE -o OUT.exr [options]", 1, 1, "render here")                 \
    X(EXPLAIN, "explain", "here", "SCENE [--numerics] [--json]", 1, 1,                             \
      "what a scene needs and leaves out")                                                         \
    X(DOCTOR, "doctor", "here", "SCENE [--json]", 1, 1, "what in a scene may hurt its picture")    \
    X(TRADEOFF, "tradeoff", "here", "SCENE -o DIR [options]", 1, 1,                                \
      "speed against accuracy, measured")                                                          \
    X(IMPORT, "import", "here", "MODEL -o scene.json", 1, 1, "make a scene from a model")          \
    X(COMPARE, "compare", "here", "A REFERENCE [options]", 2, 2, "how far two pictures differ")    \
    X(SUBMIT, "submit", "jobs", "SCENE [options]", 1, 1, "give a scene to the farm")               \
    X(JOBS, "jobs", "jobs", "[--all] [--json]", 0, 0, "list the jobs, newest first")               \
    X(STATUS, "status", "jobs", "JOB [--json]", 1, 1, "how far one job is")                        \
    X(WATCH, "watch", "jobs", "JOB [--json]", 1, 1, "see a job render; end with it")               \
    X(GET, "get", "jobs", "JOB -o OUT.exr|OUT.png", 1, 1, "fetch the picture of a job")            \
    X(PAUSE, "pause", "jobs", "JOB", 1, 1, "lease no more units of a job")                         \
    X(RESUME, "resume", "jobs", "JOB", 1, 1, "go on with a paused job")                            \
    X(CANCEL, "cancel", "jobs", "JOB", 1, 1, "stop a job")                                         \
    X(RETRY, "retry", "jobs", "JOB", 1, 1, "try a failed or cancelled job again")                  \
    X(PRIORITY, "priority", "jobs", "JOB N", 2, 2, "higher goes first; 0 is usual")                \
    X(WORKERS, "workers", "workers", "[--json]", 0, 0, "list the workers")                         \
    X(DRAIN, "drain", "workers", "WORKER", 1, 1, "finish what it holds, take no more")             \
    X(HELP, "help", "help", "[COMMAND | settings | completion]", 0, 1, "examples and options")

enum cli_command_id {
#define CLI_COMMAND_ENUM(id, ...) CLI_##id,
    CLI_COMMANDS(CLI_COMMAND_ENUM)
#undef CLI_COMMAND_ENUM
        CLI_COMMAND_COUNT
};

struct cli_command {
    const char *name, *section, *arguments, *summary;
    int argument_min, argument_max;
};

extern const struct cli_command cli_commands[CLI_COMMAND_COUNT];

/* Lines for the help of a command, or NULL. */
extern const char *const cli_examples[CLI_COMMAND_COUNT];

enum cli_kind {
    CLI_FLAG,
    CLI_TEXT,
    CLI_PATH,
    CLI_COUNT,  /* whole number within low..high */
    CLI_NUMBER, /* finite, above low and at most high */
    CLI_SHARE,  /* 0 to 1, or 0% to 100% */
    CLI_SIZE,   /* WxH */
    CLI_CROP,   /* X,Y,W,H */
    CLI_CHOICE,
    CLI_AOVS, /* names of aov.h, with commas */
    CLI_TAGS, /* words of tags.h, with commas */
};

enum cli_option_id {
    CLI_PNG,
    CLI_SPP,
    CLI_TARGET_ERROR,
    CLI_MAX_SPP,
    CLI_TIME_LIMIT,
    CLI_PLAN,
    CLI_SIZE_WH,
    CLI_CROP_XYWH,
    CLI_AOV,
    CLI_SEED,
    CLI_INTEGRATOR,
    CLI_SAMPLER,
    CLI_MAX_DEPTH,
    CLI_RR_THRESHOLD,
    CLI_PROFILE,
    CLI_TILE,
    CLI_VERIFY,
    CLI_PRECISION,
    CLI_BUILDER,
    CLI_INTERSECTOR,
    CLI_LIGHT_CHOICE,
    CLI_PRESET,
    CLI_WORKER_COUNT,
    CLI_THREADS,
    CLI_NAME,
    CLI_PRIORITY_N,
    CLI_TAGS_WANTED,
    CLI_FRAMES,
    CLI_FRAME,
    CLI_WAIT,
    CLI_ALL,
    CLI_NUMERICS,
    CLI_HEATMAP,
    CLI_FLIP,
    CLI_IDENTICAL,
    CLI_MAX_RELMSE,
    CLI_OUTPUT,
    CLI_HALF,
    CLI_BUDGET,
    CLI_REPORT,
    CLI_JSON,
    CLI_MASTER,
    CLI_TOKEN_FILE,
    CLI_TLS_CA,
    CLI_QUIET,
    CLI_PROGRESS,
    CLI_COLOR,
    CLI_HELP_FLAG,
    CLI_OPTION_COUNT
};

struct cli_option {
    const char *name; /* without dashes */
    char letter;      /* short form, or 0 */
    enum cli_kind kind;
    const char *argument; /* as the help shows it; NULL for flags */
    const char *section;  /* line of the short help */
    uint32_t commands;    /* bit per cli_command_id */
    bool setting;         /* may also come from the environment and from a settings file */
    double low, high;     /* CLI_COUNT, CLI_NUMBER; CLI_TEXT: bytes at most, 0 any */
    const char *const *choices;
    int choice_count;
    const char *help;
};

extern const struct cli_option cli_options[CLI_OPTION_COUNT];

enum { CLI_ARGUMENTS_MAX = 4 };

/* One parsed command line. */
struct cli_line {
    enum cli_command_id command;
    const char *values[CLI_OPTION_COUNT]; /* NULL: not given; "" for a flag; borrowed */
    const char *arguments[CLI_ARGUMENTS_MAX];
    int argument_count;
    bool lettered[CLI_OPTION_COUNT]; /* given in its short form */
};

/* Parses argv[1..]. Problems go to `problems` as DIAG_ERRORs without a place; true when there are
 * none. With --help the rest is not checked. argc must be at least 2. */
TL_NODISCARD bool cli_line_parse(struct cli_line *line, int argc, char *const *argv,
                                 struct diag_list *problems);

/* Checks one value against its option, as parsing does; used for settings too. */
TL_NODISCARD bool cli_value_check(enum cli_option_id id, const char *text,
                                  struct diag_list *problems);

/* The command of that name, or CLI_COMMAND_COUNT. */
enum cli_command_id cli_command_find(const char *name);
const char *cli_command_nearest(const char *name);

bool cli_has(const struct cli_line *line, enum cli_option_id id);

/* The option as the user typed it, "-o" or "--output"; a static buffer. */
const char *cli_typed(const struct cli_line *line, enum cli_option_id id);

/* Of an option that was given (or set); asserted. */
const char *cli_text(const struct cli_line *line, enum cli_option_id id);
uint64_t cli_count(const struct cli_line *line, enum cli_option_id id);
double cli_number(const struct cli_line *line, enum cli_option_id id);
double cli_share(const struct cli_line *line, enum cli_option_id id);
int cli_choice(const struct cli_line *line, enum cli_option_id id);
void cli_size(const struct cli_line *line, uint32_t *width, uint32_t *height);
uint32_t cli_aovs(const struct cli_line *line);
struct tags cli_tags(const struct cli_line *line); /* none: not given */
struct job_crop cli_crop(const struct cli_line *line);

/* "true" for a flag given or set to true/yes/1/on in a settings file. */
bool cli_flag(const struct cli_line *line, enum cli_option_id id);

/* Strict readers, also for other texts: the whole text, no sign or blank before. */
TL_NODISCARD bool cli_parse_count(const char *text, uint64_t max, uint64_t *out);
TL_NODISCARD bool cli_parse_number(const char *text, double *out);

#endif
