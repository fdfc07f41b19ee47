/* client/cmd_get.c: get: the picture of a job, or of each frame of a shot. */
#include <errno.h>
#include <limits.h>
#include <string.h>
#include <strings.h>

#include "client/command.h"
#include "client/frames.h"
#include "client/out_file.h"
#include "client/shot.h"
#include "common/json_put.h"

/* "picture.exr" or the like, by the ending of -o; NULL: has said what is wrong. */
static const char *what_of(const struct cli *cli)
{
    const char *path = cli_text(&cli->line, CLI_OUTPUT);
    const char *dot = strrchr(path, '.');
    bool exr = dot && strcasecmp(dot, ".exr") == 0, png = dot && strcasecmp(dot, ".png") == 0;
    if (!exr && !png)
        cli_error("bad-value", NULL, "-o %s: must end in .exr or .png", path);
    else if (png && cli_flag(&cli->line, CLI_HALF))
        cli_error("bad-value", NULL, "--half is about EXR files, %s is a PNG", path);
    else
        return exr ? farm_exr_of(&cli->line) : "picture.png";
    return NULL;
}

/* For programs: a line a picture. */
static bool put_fetched(const char *job, const char *path)
{
    struct buf b;
    buf_init(&b);
    buf_printf(&b, "{\"id\":");
    json_put_text(&b, job);
    buf_printf(&b, ",\"file\":");
    json_put_text(&b, path);
    buf_printf(&b, "}\n");
    bool ok = cli_put_buf(&b);
    buf_release(&b);
    return ok;
}

static int fetch(struct farm *farm, const struct cli *cli, const char *job, const char *what,
                 const char *path)
{
    enum err e = out_file_check(path, 0);
    if (e != ERR_OK)
        return cli_cannot_write(path, e, errno, 0, NULL);
    int status =
        farm_fetch_picture(farm, job, what, path, "the farm keeps it: try again elsewhere");
    if (status != EXIT_DONE)
        return status;
    if (cli->json)
        return put_fetched(job, path) ? EXIT_DONE : EXIT_MACHINE;
    cli_say(cli, "%s", path);
    return EXIT_DONE;
}

/* All that are done; 1 when some are not. */
static int fetch_frames(struct farm *farm, const struct cli *cli, const struct shot *shot,
                        const char *what)
{
    static char path[PATH_MAX];
    const char *pattern = cli_text(&cli->line, CLI_OUTPUT);
    size_t fetched = 0;
    for (size_t i = 0; i < shot->count; i++) {
        const struct shot_frame *frame = &shot->frames[i];
        if (strcmp(frame->state, "done") != 0)
            continue;
        if (!frames_path(pattern, frame->number, path, sizeof path)) {
            cli_error("bad-value", NULL, "-o %s: the path is too long", pattern);
            return EXIT_USAGE;
        }
        int status = fetch(farm, cli, frame->id, what, path);
        if (status != EXIT_DONE)
            return status;
        fetched++;
    }
    if (fetched == shot->count)
        return EXIT_DONE;
    cli_error("unfinished", "the rest later, with the same command",
              "%s: %zu of %zu frames are done and were fetched", cli->line.arguments[0], fetched,
              shot->count);
    return EXIT_FAILED;
}

static int get(struct farm *farm, const struct cli *cli, const char *what)
{
    const char *path = cli_text(&cli->line, CLI_OUTPUT);
    struct shot shot;
    int status = shot_find(farm, cli, &shot);
    if (status != EXIT_DONE)
        return status;
    if (!shot.whole) {
        status = fetch(farm, cli, shot.frames[0].id, what, path);
    } else if (frames_marked(path)) {
        status = fetch_frames(farm, cli, &shot, what);
    } else {
        cli_error("no-frame-mark", "as in -o out.####.exr for all, or --frame N for one",
                  "%s has %zu frames: -o %s has no #### for their numbers", cli->line.arguments[0],
                  shot.count, path);
        status = EXIT_USAGE;
    }
    shot_release(&shot);
    return status;
}

int command_get(struct cli *cli)
{
    struct farm farm;
    if (!cli_has(&cli->line, CLI_OUTPUT)) {
        cli_error("missing-option", "as in tilery get j42 -o out.png",
                  "get needs -o OUT.exr or -o OUT.png");
        return EXIT_USAGE;
    }
    const char *what = what_of(cli);
    if (!what)
        return EXIT_USAGE;
    int status = farm_open(&farm, cli);
    if (status != EXIT_DONE)
        return status;
    status = get(&farm, cli, what);
    farm_release(&farm);
    return status;
}
