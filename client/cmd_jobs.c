/* client/cmd_jobs.c: jobs and status: what the farm has and how far it is. */
#include <errno.h>
#include <math.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "client/command.h"
#include "client/farm_api.h"
#include "client/human.h"
#include "client/report_text.h"
#include "client/shot.h"
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
    double frame = reply_number(job, "frame", (double)NAN);
    if (isnan(frame))
        text_table_add(t, reply_text(job, "name", NULL));
    else
        text_table_addf(t, "%s #%.0f", reply_text(job, "name", ""), frame);
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
    l.table.name_column = 1;
    l.table.color_column = 2;
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

/* Of a shot: its frames by state, those that there are. */
static void put_frames(const struct json *job, struct buf *out)
{
    static const char *const states[] = {"done",   "rendering", "queued",
                                         "paused", "failed",    "cancelled"};
    const struct json *frames = json_get_member(job, "frames");
    bool any = false;
    if (!frames || frames->type != JSON_OBJECT)
        return;
    buf_printf(out, "  frames   %.0f:", reply_number(frames, "total", 0));
    for (size_t i = 0; i < sizeof states / sizeof *states; i++) {
        double count = reply_number(frames, states[i], 0);
        if (count > 0)
            buf_printf(out, "%s %.0f %s", any ? "," : "", count, states[i]);
        any |= count > 0;
    }
    buf_printf(out, "\n");
}

static bool print_status(const struct cli *cli, const struct farm *f, const struct json *job)
{
    struct text_table table;
    struct buf out;
    const char *id = cli->line.arguments[0];
    text_table_init(&table, job_headings, job_align);
    table.name_column = 1;
    table.color_column = 2;
    add_job(&table, job);
    bool ok = command_put_table(cli, &table);
    text_table_release(&table);
    buf_init(&out);
    buf_printf(&out, "\n");
    report_text(job, reply_text(job, "name", id), &out);
    put_frames(job, &out);
    put_events(job, &out);
    buf_printf(&out, "page: %s/#%s\n", http_client_url(f->http), id);
    ok = ok && cli_put_buf(&out);
    buf_release(&out);
    return ok;
}

bool command_put_reply(const struct farm *f)
{
    const struct buf *body = &f->reply.body;
    bool ended = body->bytes > 0 && body->data[body->bytes - 1] == '\n';
    return cli_put((const char *)body->data, body->bytes) && (ended || cli_put("\n", 1));
}

int command_status(struct cli *cli)
{
    struct farm farm;
    struct farm_json reply;
    struct shot shot = {0};
    char path[FARM_PATH_BYTES];
    int status = farm_open(&farm, cli);
    if (status != EXIT_DONE)
        return status;
    if (cli_has(&cli->line, CLI_FRAME))
        status = shot_find(&farm, cli, &shot);
    if (status == EXIT_DONE)
        status = farm_job_path(shot.count ? shot.frames[0].id : cli->line.arguments[0], "", path);
    shot_release(&shot);
    if (status == EXIT_DONE)
        status = farm_call(&farm, "GET", path, NULL, &reply);
    if (status == EXIT_DONE) {
        bool ok = cli->json ? command_put_reply(&farm) : print_status(cli, &farm, reply.json.root);
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
        status = command_put_reply(&farm) ? EXIT_DONE : EXIT_MACHINE;
    else if (status == EXIT_DONE)
        cli_say(cli, "%s %s", cli->line.arguments[0], said);
    farm_release(&farm);
    return status;
}
