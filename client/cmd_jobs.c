/* client/cmd_jobs.c: jobs, status, get and what changes a job. */
#include <errno.h>
#include <math.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "client/command.h"
#include "client/farm_api.h"
#include "client/human.h"
#include "client/out_file.h"
#include "client/report_text.h"
#include "client/term.h"
#include "client/text_table.h"

enum { ROWS_SHOWN = 50, PAGE_ROWS = 200, EVENTS_SHOWN = 5 };

static const char *const job_headings[] = {"JOB",  "NAME",    "STATE", "DONE", "ERROR",
                                           "LEFT", "WORKERS", "PRI",   "AGE",  "NOTE"};
static const char job_align[] = "lllrrrrrrl";

static void add_error(struct text_table *t, const struct json *job)
{
    char text[HUMAN_BYTES];
    const struct json *error = json_get_member(job, "error");
    double value = reply_number(job, "relmse", reply_number(job, "error", (double)NAN));
    if (error && error->type == JSON_OBJECT)
        value = reply_number(error, "relmse", value);
    human_error(value, text);
    text_table_add(t, text);
}

static void add_job(struct text_table *t, const struct json *job)
{
    char text[HUMAN_BYTES] = "-";
    double left[2];
    double done = reply_number(job, "done", 0);
    const char *state = reply_text(job, "state", "");
    text_table_add(t, reply_text(job, "id", reply_text(job, "job", NULL)));
    text_table_add(t, reply_text(job, "name", NULL));
    text_table_add(t, state);
    if (strcmp(state, "queued") == 0 && done <= 0)
        text_table_add(t, NULL);
    else
        text_table_addf(t, "%.0f%%", done >= 1 ? 100 : floor(done * 100));
    add_error(t, job);
    if (strcmp(state, "rendering") == 0 && reply_range(job, "left_s", left))
        human_left_short(left[0], left[1], text);
    text_table_add(t, text);
    double workers = reply_number(job, "workers_now", reply_number(job, "workers", 0));
    if (workers > 0)
        text_table_addf(t, "%.0f", workers);
    else
        text_table_add(t, NULL);
    text_table_addf(t, "%.0f", reply_number(job, "priority", 0));
    /* A report gives the time of birth, by the master's clock. */
    double created = reply_number(job, "created", (double)NAN);
    human_age(reply_number(job, "age_s", fmax(0, (double)time(NULL) - created)), text);
    text_table_add(t, text);
    text_table_add(t, reply_text(job, "note", NULL));
}

bool command_put_table(const struct cli *cli, struct text_table *t)
{
    struct buf out;
    buf_init(&out);
    t->color_column = 2;
    text_table_print(t, isatty(STDOUT_FILENO) ? term_columns(STDOUT_FILENO) : 0, cli->color_out,
                     &out);
    bool ok = cli_put_buf(&out);
    buf_release(&out);
    return ok;
}

/* Walks the pages of the job list; `rows_max` SIZE_MAX for all. */
struct listing {
    struct text_table table;
    struct buf json;
    size_t rows;
};

static void take_page(struct listing *l, const struct json *items, size_t rows_max)
{
    const struct json *v = items && items->type == JSON_ARRAY ? items->first : NULL;
    for (; v && l->rows < rows_max; v = v->next) {
        if (v->type != JSON_OBJECT)
            continue;
        add_job(&l->table, v);
        buf_printf(&l->json, l->rows ? ",\n " : "");
        reply_put(v, &l->json);
        l->rows++;
    }
}

/* Ids of cursors are opaque; those that could not stand in a URL as they are end the walk. */
static bool cursor_is_plain(const char *cursor)
{
    return cursor[0] && strlen(cursor) < 200 &&
           strspn(cursor, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_.~=") ==
               strlen(cursor);
}

static int list_jobs(struct farm *f, struct listing *l, size_t rows_max)
{
    char cursor[256] = "";
    do {
        char path[FARM_PATH_BYTES + 256];
        struct farm_json reply;
        size_t limit = rows_max - l->rows < PAGE_ROWS ? rows_max - l->rows : PAGE_ROWS;
        (void)snprintf(path, sizeof path, "/api/v1/jobs?limit=%zu%s%s", limit,
                       cursor[0] ? "&cursor=" : "", cursor);
        int status = farm_call(f, "GET", path, NULL, &reply);
        if (status != EXIT_DONE)
            return status;
        take_page(l, json_get_member(reply.json.root, "items"), rows_max);
        const char *next = reply_text(reply.json.root, "next", "");
        (void)snprintf(cursor, sizeof cursor, "%s", cursor_is_plain(next) ? next : "");
        farm_json_release(&reply);
    } while (cursor[0] && l->rows < rows_max);
    return EXIT_DONE;
}

static int print_jobs(const struct cli *cli, struct listing *l)
{
    bool ok = true;
    if (cli->json) {
        buf_printf(&l->json, "]\n");
        ok = cli_put_buf(&l->json);
    } else if (l->rows > 0) {
        ok = command_put_table(cli, &l->table);
    } else {
        cli_say(cli, "no jobs yet; try: tilery submit scene.json");
    }
    return ok ? EXIT_DONE : EXIT_MACHINE;
}

int command_jobs(struct cli *cli)
{
    struct farm farm;
    struct listing l = {.rows = 0};
    int status = farm_open(&farm, cli);
    if (status != EXIT_DONE)
        return status;
    text_table_init(&l.table, job_headings, job_align);
    buf_init(&l.json);
    buf_printf(&l.json, "[");
    status = list_jobs(&farm, &l, cli_flag(&cli->line, CLI_ALL) ? SIZE_MAX : ROWS_SHOWN);
    if (status == EXIT_DONE)
        status = print_jobs(cli, &l);
    text_table_release(&l.table);
    buf_release(&l.json);
    farm_release(&farm);
    return status;
}

static void put_events(const struct json *job, struct buf *out)
{
    const struct json *events = json_get_member(job, "events");
    uint32_t skip = events && events->count > EVENTS_SHOWN ? events->count - EVENTS_SHOWN : 0;
    const struct json *v = events && events->type == JSON_ARRAY ? events->first : NULL;
    for (; v; v = v->next) {
        if (v->index < skip || v->type != JSON_OBJECT)
            continue;
        buf_printf(out, "  %7.1f s  %s\n", reply_number(v, "t", 0),
                   cli_safe(reply_text(v, "text", "")));
    }
}

static bool print_status(const struct cli *cli, const struct farm *f, const struct json *job)
{
    struct text_table table;
    struct buf out;
    const char *id = cli->line.arguments[0];
    text_table_init(&table, job_headings, job_align);
    add_job(&table, job);
    bool ok = command_put_table(cli, &table);
    text_table_release(&table);
    buf_init(&out);
    buf_printf(&out, "\n");
    report_text(job, reply_text(job, "name", id), &out);
    put_events(job, &out);
    buf_printf(&out, "page: %s/#%s\n", http_client_url(f->http), id);
    ok = ok && cli_put_buf(&out);
    buf_release(&out);
    return ok;
}

/* The reply's text as it came, on a line of its own. */
static bool put_reply(const struct farm *f)
{
    return cli_put((const char *)f->reply.body.data, f->reply.body.bytes) && cli_put("\n", 1);
}

int command_status(struct cli *cli)
{
    struct farm farm;
    struct farm_json reply;
    char path[FARM_PATH_BYTES];
    int status = farm_open(&farm, cli);
    if (status != EXIT_DONE)
        return status;
    status = farm_job_path(cli->line.arguments[0], "", path);
    if (status == EXIT_DONE)
        status = farm_call(&farm, "GET", path, NULL, &reply);
    if (status == EXIT_DONE) {
        bool ok = cli->json ? put_reply(&farm) : print_status(cli, &farm, reply.json.root);
        status = ok ? EXIT_DONE : EXIT_MACHINE;
        farm_json_release(&reply);
    }
    farm_release(&farm);
    return status;
}

int command_patch(struct cli *cli, const char *path, const struct buf *body, const char *said)
{
    struct farm farm;
    int status = farm_open(&farm, cli);
    if (status != EXIT_DONE)
        return status;
    status = farm_call(&farm, "PATCH", path, body, NULL);
    if (status == EXIT_DONE && cli->json)
        status = put_reply(&farm) ? EXIT_DONE : EXIT_MACHINE;
    else if (status == EXIT_DONE)
        cli_say(cli, "%s %s", cli->line.arguments[0], said);
    farm_release(&farm);
    return status;
}

static int patch_job(struct cli *cli, const char *json, const char *said)
{
    char path[FARM_PATH_BYTES];
    struct buf body;
    int status = farm_job_path(cli->line.arguments[0], "", path);
    if (status != EXIT_DONE)
        return status;
    buf_init(&body);
    buf_printf(&body, "%s", json);
    status = command_patch(cli, path, &body, said);
    buf_release(&body);
    return status;
}

int command_cancel(struct cli *cli)
{
    return patch_job(cli, "{\"state\":\"cancelled\"}", "is cancelled");
}

int command_pause(struct cli *cli)
{
    char said[FARM_ID_BYTES + 40];
    (void)snprintf(said, sizeof said, "is paused; go on: tilery resume %s",
                   cli_safe(cli->line.arguments[0]));
    return patch_job(cli, "{\"state\":\"paused\"}", said);
}

/* Both resume and retry ask for the state "queued": this keeps the one from doing the other's. */
static int queue_again(struct cli *cli, bool retry)
{
    struct farm farm;
    struct farm_json reply;
    char path[FARM_PATH_BYTES];
    const char *id = cli->line.arguments[0];
    int status = farm_open(&farm, cli);
    if (status != EXIT_DONE)
        return status;
    status = farm_job_path(id, "", path);
    if (status == EXIT_DONE)
        status = farm_call(&farm, "GET", path, NULL, &reply);
    if (status == EXIT_DONE) {
        const char *state = reply_text(reply.json.root, "state", "");
        bool paused = strcmp(state, "paused") == 0;
        bool ended = strcmp(state, "failed") == 0 || strcmp(state, "cancelled") == 0;
        if (retry ? !ended : !paused) {
            cli_error("wrong-state", NULL, "%s is %s: there is nothing to %s", id, cli_safe(state),
                      retry ? "retry" : "resume");
            status = EXIT_FAILED;
        }
        farm_json_release(&reply);
    }
    farm_release(&farm);
    return status == EXIT_DONE
               ? patch_job(cli, "{\"state\":\"queued\"}", retry ? "is tried again" : "goes on")
               : status;
}

int command_resume(struct cli *cli)
{
    return queue_again(cli, false);
}

int command_retry(struct cli *cli)
{
    return queue_again(cli, true);
}

int command_priority(struct cli *cli)
{
    char json[60], said[60];
    const char *text = cli->line.arguments[1];
    struct diag_list problems;
    diag_init(&problems);
    bool ok = cli_value_check(CLI_PRIORITY_N, text, &problems);
    if (!ok)
        cli_error("bad-value", NULL, "%s", problems.count ? problems.items[0].text : text);
    diag_release(&problems);
    if (!ok)
        return EXIT_USAGE;
    (void)snprintf(json, sizeof json, "{\"priority\":%s}", text);
    (void)snprintf(said, sizeof said, "has priority %s", text);
    return patch_job(cli, json, said);
}

int command_get(struct cli *cli)
{
    if (!cli_has(&cli->line, CLI_OUTPUT)) {
        cli_error("missing-option", NULL, "get needs -o OUT.exr or -o OUT.png");
        return EXIT_USAGE;
    }
    const char *path = cli_text(&cli->line, CLI_OUTPUT);
    const char *dot = strrchr(path, '.');
    bool exr = dot && strcmp(dot, ".exr") == 0, png = dot && strcmp(dot, ".png") == 0;
    if (!exr && !png) {
        cli_error("bad-value", NULL, "-o %s: must end in .exr or .png", path);
        return EXIT_USAGE;
    }
    if (png && cli_flag(&cli->line, CLI_HALF)) {
        cli_error("bad-value", NULL, "--half is about EXR files, %s is a PNG", path);
        return EXIT_USAGE;
    }
    enum err e = out_file_check(path, 0);
    if (e != ERR_OK)
        return cli_cannot_write(path, e, errno, 0, NULL);
    struct farm farm;
    int status = farm_open(&farm, cli);
    if (status != EXIT_DONE)
        return status;
    status = farm_fetch_picture(&farm, cli->line.arguments[0],
                                exr ? farm_exr_of(&cli->line) : "picture.png", path,
                                "the farm keeps it: try again elsewhere");
    if (status == EXIT_DONE)
        cli_say(cli, "%s", path);
    farm_release(&farm);
    return status;
}
