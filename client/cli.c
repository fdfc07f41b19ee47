#include "client/cli.h"

#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "client/cli_help.h"
#include "client/cli_settings.h"
#include "client/command.h"
#include "client/out_file.h"
#include "client/preset.h"
#include "client/term.h"
#include "common/mem.h"
#include "common/utf8.h"

enum { SAFE_BYTES = 1024, SAFE_BUFFERS = 4 };

const char *cli_safe(const char *text)
{
    static char buffers[SAFE_BUFFERS][SAFE_BYTES];
    static unsigned next;
    char *out = buffers[next++ % SAFE_BUFFERS];
    (void)snprintf(out, SAFE_BYTES, "%s", text);
    utf8_mask(out);
    return out;
}

void cli_error(const char *id, const char *hint, const char *format, ...)
{
    char text[SAFE_BYTES];
    va_list args;
    va_start(args, format);
    (void)vsnprintf(text, sizeof text, format, args);
    va_end(args);
    (void)fprintf(stderr, "tilery: %s\n  %s%s[%s]\n", cli_safe(text), hint ? cli_safe(hint) : "",
                  hint ? "  " : "", id);
}

void cli_warn(const char *format, ...)
{
    char text[SAFE_BYTES];
    va_list args;
    va_start(args, format);
    (void)vsnprintf(text, sizeof text, format, args);
    va_end(args);
    (void)fprintf(stderr, "tilery: warning: %s\n", cli_safe(text));
}

void cli_say(const struct cli *cli, const char *format, ...)
{
    if (cli->quiet)
        return;
    va_list args;
    va_start(args, format);
    (void)vfprintf(stderr, format, args);
    va_end(args);
    (void)fputc('\n', stderr);
}

int cli_problems(const struct diag_list *problems, const char *tail)
{
    diag_print(problems, stderr);
    return cli_problem_count(problems->error_count, tail);
}

int cli_problem_count(size_t errors, const char *tail)
{
    if (errors == 0)
        return EXIT_DONE;
    (void)fprintf(stderr, "%zu problem%s%s%s\n", errors, errors == 1 ? "" : "s", tail ? ", " : "",
                  tail ? tail : "");
    return EXIT_INPUT;
}

bool cli_put(const char *text, size_t bytes)
{
    static bool reported;
    if (fwrite(text, 1, bytes, stdout) == bytes && fflush(stdout) == 0)
        return true;
    int why = errno;
    if (!reported && why != EPIPE)
        cli_error("output", NULL, "cannot write to standard output: %s", strerror(why));
    reported = true;
    errno = why;
    return false;
}

bool cli_put_buf(const struct buf *b)
{
    if (buf_status(b) != ERR_OK) {
        cli_error("no-memory", NULL, "out of memory");
        return false;
    }
    return b->bytes == 0 || cli_put((const char *)b->data, b->bytes);
}

int cli_cannot_write(const char *path, enum err e, int errnum, uint64_t bytes_needed,
                     const char *hint)
{
    uint64_t free_bytes = out_file_free_bytes(path);
    if (e == ERR_NOSPACE && bytes_needed > 0)
        cli_error("disk-full", hint, "cannot write %s: disk full (needs %.1f MB, %.1f MB free)",
                  path, (double)bytes_needed / 1e6, (double)free_bytes / 1e6);
    else if (e == ERR_NOSPACE)
        cli_error("disk-full", hint, "cannot write %s: disk full", path);
    else if (e == ERR_NOT_FOUND)
        cli_error("no-folder", hint ? hint : "make its folder first",
                  "cannot write %s: no such folder", path);
    else
        cli_error("cannot-write", hint, "cannot write %s: %s", path,
                  errnum ? strerror(errnum) : err_text(e));
    return EXIT_MACHINE;
}

static int would_replace(const char *typed, const char *path, const char *what)
{
    cli_error("bad-value", "give the output another name", "%s %s: would replace %s", typed, path,
              what);
    return EXIT_USAGE;
}

static bool ends_in(const char *path, const char *suffix)
{
    size_t bytes = strlen(path), n = strlen(suffix);
    return bytes > n && strcasecmp(path + bytes - n, suffix) == 0;
}

/* What a picture's file holds is told by its name. */
static bool ending_fits(const struct cli_line *line, enum cli_option_id id)
{
    bool exr = id == CLI_OUTPUT && (line->command == CLI_RENDER || line->command == CLI_SUBMIT);
    const char *suffix = exr ? ".exr" : id == CLI_PNG ? ".png" : NULL;
    if (!suffix || !cli_has(line, id) || ends_in(cli_text(line, id), suffix))
        return true;
    cli_error("bad-value", exr ? "for looking at there is --png OUT.png" : NULL,
              "%s %s: must end in %s", cli_typed(line, id), cli_text(line, id), suffix);
    return false;
}

int cli_check_outputs(const struct cli_line *line, const enum cli_option_id *ids, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        const char *path = cli_has(line, ids[i]) ? cli_text(line, ids[i]) : NULL;
        if (!ending_fits(line, ids[i]))
            return EXIT_USAGE;
        for (size_t k = 0; path && k < i; k++) {
            if (cli_has(line, ids[k]) && out_file_same(path, cli_text(line, ids[k]))) {
                cli_error("bad-value", NULL, "%s is named twice", path);
                return EXIT_USAGE;
            }
        }
        for (int k = 0; path && k < line->argument_count; k++)
            if (out_file_same(path, line->arguments[k]))
                return would_replace(cli_typed(line, ids[i]), path, "the file that is read");
        if (path && cli_has(line, CLI_PLAN) && out_file_same(path, cli_text(line, CLI_PLAN)))
            return would_replace(cli_typed(line, ids[i]), path, "the plan that is read");
    }
    for (size_t i = 0; i < count; i++) {
        const char *path = cli_has(line, ids[i]) ? cli_text(line, ids[i]) : NULL;
        /* Reports and heat maps are text and PNG, which pipes and /dev/stdout take as well. */
        bool streams = ids[i] == CLI_REPORT || ids[i] == CLI_HEATMAP;
        if (!path || (streams && out_file_is_stream(path)) ||
            (ids[i] == CLI_REPORT && strcmp(path, "-") == 0))
            continue;
        enum err e = out_file_check(path, 0);
        if (e != ERR_OK)
            return cli_cannot_write(path, e, errno, 0, NULL);
    }
    return EXIT_DONE;
}

static int print_help(enum cli_command_id id)
{
    struct buf out;
    buf_init(&out);
    cli_help_short(id, &out);
    bool ok = cli_put_buf(&out);
    buf_release(&out);
    return ok ? EXIT_DONE : EXIT_MACHINE;
}

static int print_overview(bool asked)
{
    struct buf out;
    buf_init(&out);
    cli_help_overview(&out);
    int status = EXIT_USAGE;
    if (asked)
        status = cli_put_buf(&out) ? EXIT_DONE : EXIT_MACHINE;
    else if (buf_status(&out) == ERR_OK)
        (void)fwrite(out.data, 1, out.bytes, stderr);
    buf_release(&out);
    return status;
}

static int usage_problems(const struct diag_list *problems)
{
    for (size_t i = 0; i < problems->count; i++) {
        const struct diag *d = &problems->items[i];
        if (d->file)
            (void)fprintf(stderr, "%s:%llu: %s\n  %s%s[%s]\n", d->file, (unsigned long long)d->line,
                          d->text, d->hint ? d->hint : "", d->hint ? "  " : "", d->id);
        else
            cli_error(d->id, d->hint, "%s", d->text);
    }
    return EXIT_USAGE;
}

static void apply_settings(struct cli *cli)
{
    const char *color = cli_has(&cli->line, CLI_COLOR) ? cli_text(&cli->line, CLI_COLOR) : "auto";
    cli->quiet = cli_flag(&cli->line, CLI_QUIET);
    cli->json = cli_flag(&cli->line, CLI_JSON);
    cli->color_out = term_wants_color(STDOUT_FILENO, color);
    cli->color_err = term_wants_color(STDERR_FILENO, color);
}

static int run(struct cli *cli, int argc, char **argv)
{
    struct diag_list problems;
    diag_init(&problems);
    bool ok = cli_line_parse(&cli->line, argc, argv, &problems);
    bool help = ok && cli_has(&cli->line, CLI_HELP_FLAG);
    ok = ok && (help || cli_settings_load(cli, &problems));
    int status = ok ? EXIT_DONE : usage_problems(&problems);
    diag_release(&problems);
    if (!ok)
        return status;
    if (help)
        return print_help(cli->line.command);
    status = cli_has(&cli->line, CLI_PRESET) ? preset_apply(cli) : EXIT_DONE;
    if (status != EXIT_DONE)
        return status;
    apply_settings(cli);
    return command_run(cli);
}

int cli_main(int argc, char **argv)
{
    if (argc < 2)
        return print_overview(false);
    if (strcmp(argv[1], "--help") == 0 || strcmp(argv[1], "-h") == 0)
        return print_overview(true);
    if (strcmp(argv[1], "--version") == 0)
        return cli_put("tilery " TILERY_VERSION "\n", strlen("tilery " TILERY_VERSION "\n"))
                   ? EXIT_DONE
                   : EXIT_MACHINE;
    struct cli cli = {0};
    int status = run(&cli, argc, argv);
    for (int i = 0; i < CLI_OPTION_COUNT; i++)
        mem_free(cli.owned[i]);
    return status;
}
