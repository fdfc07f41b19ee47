#include "client/cmd_wait.h"

#include <errno.h>
#include <string.h>
#include <unistd.h>

#include "client/command.h"
#include "client/follow.h"
#include "client/preview.h"
#include "client/report_text.h"
#include "client/shot.h"
#include "client/signals.h"
#include "client/term.h"
#include "common/file_io.h"

enum { PATIENCE_S = 300 };

int command_progress_mode(const struct cli *cli)
{
    static const enum progress_mode modes[] = {PROGRESS_NONE, PROGRESS_BAR, PROGRESS_LINES,
                                               PROGRESS_NONE};
    int choice = cli_has(&cli->line, CLI_PROGRESS) ? cli_choice(&cli->line, CLI_PROGRESS) : 0;
    if (cli->json)
        return PROGRESS_JSON;
    if (cli->quiet)
        return PROGRESS_NONE;
    if (choice == 0)
        return term_is_smart(STDERR_FILENO) ? PROGRESS_BAR : PROGRESS_LINES;
    return (int)modes[choice];
}

static int write_report(const struct farm *farm, const struct cli *cli)
{
    if (!cli_has(&cli->line, CLI_REPORT))
        return EXIT_DONE;
    const char *path = cli_text(&cli->line, CLI_REPORT);
    if (strcmp(path, "-") == 0)
        return command_put_reply(farm) ? EXIT_DONE : EXIT_MACHINE;
    enum err e = file_write(path, farm->reply.body.data, farm->reply.body.bytes);
    return e == ERR_OK ? EXIT_DONE : cli_cannot_write(path, e, 0, 0, NULL);
}

/* False when it could not be written; a reader that left early has what it wanted. */
static bool print_json_end(const struct farm *farm, double start_s, int exit_status)
{
    struct buf line;
    buf_init(&line);
    buf_printf(&line,
               "{\"event\":\"end\",\"t\":%.3f,\"exit\":%d,\"report\":", follow_now_s() - start_s,
               exit_status);
    buf_put(&line, farm->reply.body.data, farm->reply.body.bytes);
    while (line.bytes > 0 && line.data[line.bytes - 1] == '\n')
        line.bytes--;
    buf_printf(&line, "}\n");
    errno = 0;
    bool written = cli_put_buf(&line) || errno == EPIPE;
    buf_release(&line);
    return written;
}

static void print_block(const struct json *report, const char *title)
{
    struct buf text;
    buf_init(&text);
    report_text(report, title, &text);
    if (buf_status(&text) == ERR_OK)
        (void)fwrite(text.data, 1, text.bytes, stderr);
    buf_release(&text);
}

static void say_failure(const struct json *report, const char *job)
{
    const char *state = reply_text(report, "state", "failed");
    const char *cause = reply_text(report, "failure", reply_text(report, "note", ""));
    if (strcmp(state, "cancelled") == 0)
        cli_error("cancelled", NULL, "%s was cancelled", job);
    else
        cli_error("job-failed", NULL, "%s failed%s%s", job, cause[0] ? ": " : "", cause);
}

/* What a run that says nothing else must still say. */
static void warn_nonfinite(const struct json *report)
{
    double bad = reply_number(report, "nonfinite_samples", 0);
    if (bad > 0)
        cli_warn("%.0f non-finite sample%s counted as black", bad, bad == 1 ? "" : "s");
}

/* Our own children without memory are this machine's trouble, not the job's. */
static int failed_status(const struct farm *farm, const struct json *report)
{
    const char *cause = reply_text(report, "failure", reply_text(report, "note", ""));
    return farm->is_private && strstr(cause, err_text(ERR_NOMEM)) ? EXIT_MACHINE : EXIT_FAILED;
}

/* As the report's last member. */
static enum err add_start(struct farm *farm, const struct json *report,
                          const struct cmd_start *start)
{
    struct buf *body = &farm->reply.body;
    const struct json *seconds = json_get_member(report, "seconds");
    double begun = reply_number(report, "started", 0);
    double first = seconds ? reply_number(seconds, "first_result", 0) : 0;
    while (body->bytes > 0 && body->data[body->bytes - 1] != '}')
        body->bytes--;
    body->bytes -= body->bytes > 0;
    buf_printf(body, ",\"start\":{\"read\":%.6f,\"pack\":%.6f,\"ready\":%.6f,\"send\":%.6f,",
               start->read, start->pack, start->ready, start->send);
    if (begun > 0 && first > 0)
        buf_printf(body, "\"first_pixel\":%.6f}}\n", begun + first - start->begun_at);
    else
        buf_printf(body, "\"first_pixel\":null}}\n");
    return buf_status(body);
}

int cmd_wait_report(struct farm *farm, const struct cli *cli, const char *job, const char *title,
                    double start_s, const struct cmd_start *start, bool job_ok)
{
    struct farm_json reply;
    char path[FARM_PATH_BYTES];
    int status = farm_job_path(job, "", path);
    if (status == EXIT_DONE)
        status = farm_call(farm, "GET", path, NULL, &reply);
    if (status != EXIT_DONE)
        return status;
    if (start && add_start(farm, reply.json.root, start) != ERR_OK) {
        farm_json_release(&reply);
        return farm_explain(farm, ERR_NOMEM);
    }
    status = write_report(farm, cli);
    if (status == EXIT_DONE && !job_ok)
        status = failed_status(farm, reply.json.root);
    if (cli->json) {
        if (!print_json_end(farm, start_s, status) && status == EXIT_DONE)
            status = EXIT_MACHINE;
    } else if (!cli->quiet) {
        print_block(reply.json.root, title);
    } else {
        warn_nonfinite(reply.json.root);
    }
    if (!job_ok)
        say_failure(reply.json.root, job);
    farm_json_release(&reply);
    return status;
}

/* What the hooks of the wait see. */
struct watching {
    struct cmd_wait *wait;
    struct progress progress;
    struct preview preview;
};

static bool on_wake(void *ctx)
{
    struct watching *w = ctx;
    signals_clear();
    if (w->wait->preview)
        preview_refresh(&w->preview, w->wait->farm, w->wait->job, &w->progress, follow_now_s());
    return signals_interrupts > 0;
}

static int fetch_pictures(struct cmd_wait *w)
{
    const struct cli_line *line = &w->cli->line;
    char rescue[FARM_PATH_BYTES];
    int status = EXIT_DONE;
    (void)snprintf(rescue, sizeof rescue, "nothing lost: tilery get %s -o ELSEWHERE.exr", w->job);
    if (cli_has(line, CLI_OUTPUT))
        status = farm_fetch_picture(w->farm, w->job, farm_exr_of(line), cli_text(line, CLI_OUTPUT),
                                    rescue);
    if (status == EXIT_DONE && cli_has(line, CLI_PNG))
        status =
            farm_fetch_picture(w->farm, w->job, "picture.png", cli_text(line, CLI_PNG), rescue);
    return status;
}

static int ended(struct cmd_wait *w, enum follow_end end, double start_s)
{
    const struct cli_line *line = &w->cli->line;
    const char *title = cli_has(line, CLI_OUTPUT) ? cli_text(line, CLI_OUTPUT) : w->job;
    int status = EXIT_DONE;
    if (end == FOLLOW_FARM_LOST)
        return EXIT_FARM;
    if (end == FOLLOW_STOPPED) {
        (void)fprintf(stderr, "%s goes on; stop it: tilery cancel %s\n", w->job, w->job);
        return EXIT_INTERRUPTED;
    }
    if (end == FOLLOW_DONE && line->command == CLI_SUBMIT)
        status = fetch_pictures(w);
    int report = cmd_wait_report(w->farm, w->cli, w->job, title, start_s, NULL, end == FOLLOW_DONE);
    return status != EXIT_DONE ? status : report;
}

/* What would end a wait for workers, in the farm's own address. */
static void advice_of(struct farm *farm, char *out, size_t bytes)
{
    struct farm_json reply;
    (void)snprintf(out, bytes, "start one: tilery-worker --master HOST:PORT");
    if (farm_try(farm, "GET", "/api/v1/farm", &reply) != ERR_OK || farm->reply.status != 200)
        return;
    const char *address = reply_text(reply.json.root, "listen", NULL);
    if (address)
        (void)snprintf(out, bytes, "start one: tilery-worker --master %s", cli_safe(address));
    farm_json_release(&reply);
}

int cmd_wait_run(struct cmd_wait *w)
{
    struct watching watching = {.wait = w};
    char advice[200], path[FARM_PATH_BYTES];
    double start_s = follow_now_s();
    int status = farm_job_path(w->job, "", path);
    if (status != EXIT_DONE)
        return status;
    if (signals_install() != ERR_OK) {
        cli_error("machine", NULL, "cannot watch for signals: %s", strerror(errno));
        return EXIT_MACHINE;
    }
    progress_init(&watching.progress, (enum progress_mode)command_progress_mode(w->cli),
                  w->cli->json ? STDOUT_FILENO : STDERR_FILENO, start_s);
    w->preview = w->preview && watching.progress.mode == PROGRESS_BAR;
    preview_init(&watching.preview, STDERR_FILENO);
    advice_of(w->farm, advice, sizeof advice);
    watching.progress.now.advice = advice;
    struct follow follow = {.farm = w->farm,
                            .job = w->job,
                            .progress = &watching.progress,
                            .wake_fd = signals_fd(),
                            .on_wake = on_wake,
                            .ctx = &watching,
                            .patience_s = PATIENCE_S};
    enum follow_end end = follow_job(&follow);
    if (end == FOLLOW_DONE && w->preview)
        preview_refresh(&watching.preview, w->farm, w->job, &watching.progress, 1e300);
    progress_end(&watching.progress);
    preview_release(&watching.preview);
    return ended(w, end, start_s);
}

/* Each in turn; the worst status, at once when the farm is lost or somebody interrupts. */
static int wait_for(struct farm *farm, struct cli *cli, const struct shot *shot)
{
    int worst = EXIT_DONE;
    for (size_t i = 0; i < shot->count; i++) {
        struct cmd_wait wait = {.farm = farm,
                                .cli = cli,
                                .job = shot->frames[i].id,
                                .preview = cli->line.command == CLI_WATCH};
        int status = cmd_wait_run(&wait);
        if (status == EXIT_INTERRUPTED || status == EXIT_FARM)
            return status;
        if (status > worst)
            worst = status;
    }
    return worst;
}

int command_watch(struct cli *cli)
{
    struct farm farm;
    struct shot shot;
    int status = farm_open(&farm, cli);
    if (status != EXIT_DONE)
        return status;
    status = shot_find(&farm, cli, &shot);
    if (status == EXIT_DONE) {
        status = wait_for(&farm, cli, &shot);
        shot_release(&shot);
    }
    farm_release(&farm);
    return status;
}
