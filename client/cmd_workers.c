/* client/cmd_workers.c: workers and drain. */
#include <math.h>
#include <string.h>

#include "client/command.h"
#include "client/farm_api.h"
#include "client/human.h"
#include "client/text_table.h"

static const char *const worker_headings[] = {"WORKER", "NAME",  "HOST", "STATE", "JOB", "THREADS",
                                              "SPEED",  "UNITS", "LOST", "SEEN",  "NOTE"};
static const char worker_align[] = "lllllrrrrrl";

/* Why it does not render; else the tags that it has. */
static void add_note(struct text_table *t, const struct json *w)
{
    const char *note = reply_text(w, "note", "");
    const struct json *tags = json_get_member(w, "tags");
    struct buf list;
    buf_init(&list);
    const struct json *v = !note[0] && tags && tags->type == JSON_ARRAY ? tags->first : NULL;
    for (const char *before = "tags "; v; v = v->next) {
        if (v->type != JSON_STRING)
            continue;
        buf_printf(&list, "%s%s", before, v->text);
        before = ", ";
    }
    buf_put_u8(&list, '\0');
    bool tagged = buf_status(&list) == ERR_OK && list.data[0] != '\0';
    text_table_add(t, tagged ? (const char *)list.data : note);
    buf_release(&list);
}

/* Who left in order is not lost. */
static const char *shown_state(const char *state, const char *note)
{
    if (!state)
        return NULL;
    if (strcmp(state, "lost") == 0 && strcmp(note, "left") == 0)
        return note;
    return strcmp(state, "set-aside") == 0 ? "set aside" : state;
}

static void add_worker(struct text_table *t, const struct json *w)
{
    char text[HUMAN_BYTES];
    const char *state = reply_text(w, "state", NULL);
    text_table_add(t, reply_text(w, "id", NULL));
    text_table_add(t, reply_text(w, "name", NULL));
    text_table_add(t, reply_text(w, "host", NULL));
    text_table_add(t, shown_state(state, reply_text(w, "note", "")));
    text_table_add(t, reply_text(w, "job", NULL));
    text_table_addf(t, "%.0f", reply_number(w, "threads", 0));
    double speed = reply_number(w, "speed_rays_s", 0);
    if (speed > 0)
        text_table_addf(t, speed < 9.95e6 ? "%.1f Mr/s" : "%.0f Mr/s", speed / 1e6);
    else
        text_table_add(t, NULL);
    text_table_addf(t, "%.0f", reply_number(w, "units", 0));
    text_table_addf(t, "%.0f", reply_number(w, "lost", 0));
    human_age(reply_number(w, "seen_s", (double)NAN), text);
    text_table_add(t, text);
    add_note(t, w);
}

static int print_workers(const struct cli *cli, const struct json *items)
{
    bool array = items && items->type == JSON_ARRAY;
    bool ok = true;
    if (cli->json) {
        struct buf out;
        buf_init(&out);
        if (array)
            reply_put(items, &out);
        else
            buf_printf(&out, "[]");
        buf_printf(&out, "\n");
        ok = cli_put_buf(&out);
        buf_release(&out);
    } else if (!array || items->count == 0) {
        cli_say(cli, "no workers yet; start one: tilery-worker --master HOST:PORT");
    } else {
        struct text_table table;
        text_table_init(&table, worker_headings, worker_align);
        table.name_column = 1;
        table.color_column = 3;
        for (const struct json *v = items->first; v; v = v->next)
            if (v->type == JSON_OBJECT)
                add_worker(&table, v);
        ok = command_put_table(cli, &table);
        text_table_release(&table);
    }
    return ok ? EXIT_DONE : EXIT_MACHINE;
}

int command_workers(struct cli *cli)
{
    struct farm farm;
    struct farm_json reply;
    int status = farm_open(&farm, cli);
    if (status != EXIT_DONE)
        return status;
    status = farm_call(&farm, "GET", "/api/v1/workers", NULL, &reply);
    if (status == EXIT_DONE) {
        status = print_workers(cli, json_get_member(reply.json.root, "items"));
        farm_json_release(&reply);
    }
    farm_release(&farm);
    return status;
}

int command_drain(struct cli *cli)
{
    char path[FARM_PATH_BYTES];
    struct buf body;
    const char *id = cli->line.arguments[0];
    if (strlen(id) >= FARM_ID_BYTES || strpbrk(id, "/?#% ") || !id[0]) {
        cli_error("unknown-worker", "see tilery workers", "no worker \"%s\"", id);
        return EXIT_FARM;
    }
    (void)snprintf(path, sizeof path, "/api/v1/workers/%s", id);
    buf_init(&body);
    buf_printf(&body, "{\"state\":\"draining\"}");
    int status = command_patch(cli, path, &body, "finishes what it holds and takes no more");
    buf_release(&body);
    return status;
}
