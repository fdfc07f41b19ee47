/* client/cli.h: one run of `tilery`: the command line, its settings, and how it talks.
 *
 * Data goes to standard output, talk to standard error. Every error says what happened,
 * what next, and an id that is an anchor of docs/ERRORS.md. One thread.
 */
#ifndef CLIENT_CLI_H
#define CLIENT_CLI_H

#include "client/cli_option.h"
#include "common/buf.h"

/* Exit statuses that are not an `enum err` (contract: ARCHITECTURE.md). */
enum {
    EXIT_DONE = 0,
    EXIT_FAILED = 1,
    EXIT_USAGE = 2,
    EXIT_INPUT = 3,
    EXIT_FARM = 4,
    EXIT_MACHINE = 5,
    EXIT_INTERRUPTED = 130
};

enum cli_origin {
    CLI_FROM_DEFAULT,
    CLI_FROM_OPTION,
    CLI_FROM_PRESET,
    CLI_FROM_ENVIRONMENT,
    CLI_FROM_USER_FILE,
    CLI_FROM_SYSTEM_FILE
};

struct cli {
    struct cli_line line;
    enum cli_origin origins[CLI_OPTION_COUNT]; /* of settings */
    char *owned[CLI_OPTION_COUNT];             /* values that came from files; freed at the end */
    bool quiet, json;
    bool color_out, color_err;
};

/* Runs a whole command line; the exit status. */
int cli_main(int argc, char **argv);

/* "tilery: text", then "  hint  [id]" (hint may be NULL). Never silenced. */
void cli_error(const char *id, const char *hint, const char *format, ...) TL_PRINTF(3, 4);
void cli_warn(const char *format, ...) TL_PRINTF(1, 2);

/* A line of talk, dropped under --quiet. */
void cli_say(const struct cli *cli, const char *format, ...) TL_PRINTF(2, 3);

/* Prints the problems of an input and "N problems, TAIL"; the exit status. Under --quiet too:
 * these are errors and warnings. */
int cli_problems(const struct diag_list *problems, const char *tail);

/* The line of the count alone, where inputs are more than one. */
int cli_problem_count(size_t errors, const char *tail);

/* Writes to standard output; a failure there (disk full, closed pipe) is reported once. False if
 * it failed. */
bool cli_put(const char *text, size_t bytes);
bool cli_put_buf(const struct buf *b);

/* Says why `path` cannot be written, in errno's words where `errnum` is not 0; exit status 5. */
int cli_cannot_write(const char *path, enum err e, int errnum, uint64_t bytes_needed,
                     const char *hint);

/* Whether the files that these options name can be written, and differ from each other and from
 * what the command reads: its arguments and the plan. EXIT_USAGE, and said, if one would be
 * replaced. */
int cli_check_outputs(const struct cli_line *line, const enum cli_option_id *ids, size_t count);

/* A name from the farm or a file, safe for a terminal: what utf8_mask takes becomes '?'. Static
 * buffers, four in turn. */
const char *cli_safe(const char *text);

#endif
