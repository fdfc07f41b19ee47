/* client/cmd_change.c: pause, resume, cancel, retry, priority: one change to a job, to all frames
 * of a shot, or with --frame to one of them. */
#include <string.h>

#include "client/command.h"
#include "client/shot.h"

struct change {
    const char *json;   /* body of the PATCH */
    const char *said;   /* what JOB is called afterwards */
    const char *verb;   /* "there is nothing to VERB" */
    const char *states; /* of a frame to which it can be done; others of a shot are passed over */
    bool strict;        /* a job on its own in another state is refused here, not by the master */
};

static bool fits(const struct shot_frame *frame, const char *states)
{
    return frame->state[0] && strstr(states, frame->state);
}

static int patch(struct farm *farm, const char *id, const struct buf *body)
{
    char path[FARM_PATH_BYTES];
    int status = farm_job_path(id, "", path);
    return status == EXIT_DONE ? farm_call(farm, "PATCH", path, body, NULL) : status;
}

/* The change to each frame that is meant and can take it; counts them. */
static int patch_all(struct farm *farm, const struct shot *shot, const struct change *c,
                     size_t *changed)
{
    int status = EXIT_DONE;
    bool choosy = shot->whole || c->strict;
    struct buf body;
    buf_init(&body);
    buf_printf(&body, "%s", c->json);
    for (size_t i = 0; i < shot->count && status == EXIT_DONE; i++) {
        if (choosy && !fits(&shot->frames[i], c->states))
            continue;
        status = patch(farm, shot->frames[i].id, &body);
        *changed += status == EXIT_DONE;
    }
    buf_release(&body);
    return status;
}

static int say_nothing_fits(const struct cli *cli, const struct shot *shot, const struct change *c)
{
    const char *id = cli_safe(cli->line.arguments[0]);
    if (shot->whole)
        cli_error("wrong-state", NULL, "%s: no frame is %s: there is nothing to %s", id, c->states,
                  c->verb);
    else
        cli_error("wrong-state", NULL, "%s is %s: there is nothing to %s", id,
                  cli_safe(shot->frames[0].state), c->verb);
    return EXIT_FAILED;
}

static int say_changed(const struct cli *cli, const struct farm *farm, const struct shot *shot,
                       const struct change *c, size_t changed)
{
    const char *id = cli->line.arguments[0];
    if (cli->json)
        return command_put_reply(farm) ? EXIT_DONE : EXIT_MACHINE;
    if (shot->whole)
        cli_say(cli, "%s %s: %zu of %zu frames", id, c->said, changed, shot->count);
    else if (cli_has(&cli->line, CLI_FRAME))
        cli_say(cli, "frame %u of %s %s", shot->frames[0].number, id, c->said);
    else
        cli_say(cli, "%s %s", id, c->said);
    return EXIT_DONE;
}

static int change(struct cli *cli, const struct change *c)
{
    struct farm farm;
    struct shot shot;
    size_t changed = 0;
    int status = farm_open(&farm, cli);
    if (status != EXIT_DONE)
        return status;
    status = shot_find(&farm, cli, &shot);
    if (status == EXIT_DONE) {
        status = patch_all(&farm, &shot, c, &changed);
        if (status == EXIT_DONE)
            status = changed ? say_changed(cli, &farm, &shot, c, changed)
                             : say_nothing_fits(cli, &shot, c);
        shot_release(&shot);
    }
    farm_release(&farm);
    return status;
}

int command_cancel(struct cli *cli)
{
    return change(cli, &(struct change){.json = "{\"state\":\"cancelled\"}",
                                        .said = "is cancelled",
                                        .verb = "cancel",
                                        .states = "queued, rendering or paused"});
}

int command_pause(struct cli *cli)
{
    char said[FARM_ID_BYTES + 40];
    (void)snprintf(said, sizeof said, "is paused; go on: tilery resume %s",
                   cli_safe(cli->line.arguments[0]));
    return change(cli, &(struct change){.json = "{\"state\":\"paused\"}",
                                        .said = said,
                                        .verb = "pause",
                                        .states = "queued or rendering"});
}

/* Both resume and retry ask for the state "queued": `strict` keeps the one from doing the
 * other's. */
int command_resume(struct cli *cli)
{
    return change(cli, &(struct change){.json = "{\"state\":\"queued\"}",
                                        .said = "goes on",
                                        .verb = "resume",
                                        .states = "paused",
                                        .strict = true});
}

int command_retry(struct cli *cli)
{
    return change(cli, &(struct change){.json = "{\"state\":\"queued\"}",
                                        .said = "is tried again",
                                        .verb = "retry",
                                        .states = "failed or cancelled",
                                        .strict = true});
}

int command_priority(struct cli *cli)
{
    char json[60], said[60];
    const char *text = cli->line.arguments[1];
    struct diag_list problems;
    diag_init(&problems);
    bool ok = cli_value_check(CLI_PRIORITY_N, text, &problems);
    if (!ok) /* it is said of "--priority": here it is an argument */
        cli_error("bad-value", NULL, "%s",
                  problems.count ? problems.items[0].text + strlen("--") : text);
    diag_release(&problems);
    if (!ok)
        return EXIT_USAGE;
    (void)snprintf(json, sizeof json, "{\"priority\":%s}", text);
    (void)snprintf(said, sizeof said, "has priority %s", text);
    return change(cli, &(struct change){.json = json,
                                        .said = said,
                                        .verb = "put first",
                                        .states = "queued, rendering or paused"});
}
