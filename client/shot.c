#include "client/shot.h"

#include <string.h>

#include "common/mem.h"

static void read_frame(const struct json *job, struct shot_frame *out)
{
    const char *id = reply_text(job, "id", reply_text(job, "job", ""));
    (void)snprintf(out->id, sizeof out->id, "%s", id);
    (void)snprintf(out->state, sizeof out->state, "%s", reply_text(job, "state", ""));
    out->number = (uint32_t)reply_number(job, "frame", 0);
    out->done = reply_number(job, "done", 0);
}

static int one(const struct json *job, struct shot *out)
{
    out->frames = mem_calloc(1, sizeof *out->frames);
    if (!out->frames) {
        cli_error("no-memory", NULL, "out of memory");
        return EXIT_MACHINE;
    }
    read_frame(job, out->frames);
    out->count = 1;
    return EXIT_DONE;
}

static int all(struct farm *f, const char *id, struct shot *out)
{
    char path[FARM_PATH_BYTES];
    struct farm_json reply;
    int status = farm_job_path(id, "/frames", path);
    if (status == EXIT_DONE)
        status = farm_call(f, "GET", path, NULL, &reply);
    if (status != EXIT_DONE)
        return status;
    const struct json *items = json_get_member(reply.json.root, "items");
    size_t count = items && items->type == JSON_ARRAY ? items->count : 0;
    out->frames = mem_calloc(count + 1, sizeof *out->frames);
    const struct json *v = out->frames && count > 0 ? items->first : NULL;
    for (; v; v = v->next)
        read_frame(v, &out->frames[out->count++]);
    farm_json_release(&reply);
    if (out->frames)
        return EXIT_DONE;
    cli_error("no-memory", NULL, "out of memory");
    return EXIT_MACHINE;
}

/* Leaves only the frame of that number. */
static int keep_frame(struct shot *s, const char *job, uint32_t number)
{
    for (size_t i = 0; i < s->count; i++) {
        if (s->frames[i].number != number)
            continue;
        s->frames[0] = s->frames[i];
        s->count = 1;
        return EXIT_DONE;
    }
    if (s->count == 0)
        cli_error("unknown-frame", NULL, "%s is one picture and has no frames", job);
    else
        cli_error("unknown-frame", NULL, "%s has no frame %u: its frames are %u to %u", job, number,
                  s->frames[0].number, s->frames[s->count - 1].number);
    return EXIT_FARM;
}

int shot_find(struct farm *f, const struct cli *cli, struct shot *out)
{
    const char *id = cli->line.arguments[0];
    bool named = cli_has(&cli->line, CLI_FRAME);
    char path[FARM_PATH_BYTES];
    struct farm_json reply;
    *out = (struct shot){0};
    int status = farm_job_path(id, "", path);
    if (status == EXIT_DONE)
        status = farm_call(f, "GET", path, NULL, &reply);
    if (status != EXIT_DONE)
        return status;
    out->whole = json_get_member(reply.json.root, "frames") != NULL && !named;
    status = out->whole || named ? all(f, id, out) : one(reply.json.root, out);
    farm_json_release(&reply);
    if (status == EXIT_DONE && named)
        status = keep_frame(out, cli_safe(id), (uint32_t)cli_count(&cli->line, CLI_FRAME));
    if (status != EXIT_DONE)
        shot_release(out);
    return status;
}

void shot_release(struct shot *s)
{
    mem_free(s->frames);
    *s = (struct shot){0};
}
