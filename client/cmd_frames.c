#include "client/cmd_frames.h"

#include <limits.h>

#include "client/cmd_submit.h"
#include "client/cmd_wait.h"
#include "client/frames.h"
#include "common/mem.h"

static const enum cli_option_id outputs[] = {CLI_OUTPUT, CLI_PNG, CLI_REPORT};
enum { OUTPUT_COUNT = sizeof outputs / sizeof *outputs };

/* The command line as it is for one frame: the numbers stand in its paths. */
struct framed {
    struct cli cli;
    char scene[PATH_MAX], paths[OUTPUT_COUNT][PATH_MAX];
};

static int too_long(const char *path)
{
    cli_error("bad-value", NULL, "%s: the path is too long", path);
    return EXIT_USAGE;
}

static int framed_make(struct framed *out, const struct cli *cli, uint32_t frame)
{
    const char *scene = cli->line.arguments[0];
    out->cli = *cli;
    if (!frames_path(scene, frame, out->scene, sizeof out->scene))
        return too_long(scene);
    out->cli.line.arguments[0] = out->scene;
    for (int i = 0; i < OUTPUT_COUNT; i++) {
        const char *path = cli->line.values[outputs[i]];
        if (!path)
            continue;
        if (!frames_path(path, frame, out->paths[i], sizeof out->paths[i]))
            return too_long(path);
        out->cli.line.values[outputs[i]] = out->paths[i];
    }
    return EXIT_DONE;
}

/* Without a place for the number every frame would be the same, or overwrite the one before. */
static int check_marks(const struct cli *cli)
{
    const char *scene = cli->line.arguments[0];
    if (!frames_marked(scene)) {
        cli_error("no-frame-mark", "as in shot.####.json",
                  "%s: --frames needs #### in the scene's "
                  "name, where the frame's number goes",
                  scene);
        return EXIT_USAGE;
    }
    for (int i = 0; i < OUTPUT_COUNT; i++) {
        const char *path = cli->line.values[outputs[i]];
        if (path && !frames_marked(path)) {
            cli_error("no-frame-mark", "as in out.####.exr",
                      "%s %s: needs #### for the frame's number", cli_typed(&cli->line, outputs[i]),
                      path);
            return EXIT_USAGE;
        }
    }
    return EXIT_DONE;
}

/* Every scene, read and dropped; all problems are printed, and their count last. */
static int check_scenes(const struct cli *cli, struct frames frames)
{
    static struct framed framed; /* too large for the stack; one thread */
    int worst = EXIT_DONE;
    size_t errors = 0;
    for (uint64_t n = frames.first; n <= frames.last; n++) {
        struct load load;
        int status = framed_make(&framed, cli, (uint32_t)n);
        if (status == EXIT_DONE && n == frames.first)
            status = cmd_submit_outputs(&framed.cli);
        if (status != EXIT_DONE)
            return status;
        load_scene(&load, &framed.cli.line, false);
        if (load.status == EXIT_MACHINE) {
            status = load_explain(&load, "no job made");
            load_release(&load);
            return status;
        }
        diag_print(&load.problems, stderr);
        errors += load.problems.error_count;
        if (load.status > worst)
            worst = load.status;
        load_release(&load);
    }
    (void)cli_problem_count(errors, "no job made");
    return worst;
}

/* The jobs of a shot as they are made. */
struct making {
    struct farm *farm;
    const struct cli *cli;
    struct frames frames;
    char (*ids)[FARM_ID_BYTES]; /* one a frame; the first is the shot's */
    uint32_t count;
};

static int make_next(struct making *m, struct framed *framed)
{
    struct load load;
    uint32_t number = m->frames.first + m->count;
    struct farm_frame frame = {.number = number, .shot = m->count > 0 ? m->ids[0] : NULL};
    int status = framed_make(framed, m->cli, number);
    if (status != EXIT_DONE)
        return status;
    load_scene(&load, &framed->cli.line, false);
    status = load.status; /* its warnings were printed before */
    if (status != EXIT_DONE)
        status = load_explain(&load, "the shot is not whole");
    else
        status = cmd_submit_send(m->farm, &framed->cli, &load, &frame, m->ids[m->count]);
    load_release(&load);
    if (status == EXIT_DONE)
        m->count++;
    else if (m->count > 0)
        cli_warn("frames from %u on were not submitted; those before are %s: tilery cancel %s",
                 number, m->ids[0], m->ids[0]);
    return status;
}

static int make_all(struct making *m)
{
    static struct framed framed;
    uint32_t total = m->frames.last - m->frames.first + 1;
    int status = EXIT_DONE;
    m->ids = mem_calloc(total, sizeof *m->ids);
    if (!m->ids) {
        cli_error("no-memory", NULL, "out of memory");
        return EXIT_MACHINE;
    }
    while (status == EXIT_DONE && m->count < total)
        status = make_next(m, &framed);
    return status;
}

/* Frame after frame to its end; the worst status. */
static int wait_for_all(const struct making *m)
{
    static struct framed framed;
    int worst = EXIT_DONE;
    for (uint32_t i = 0; i < m->count; i++) {
        struct cmd_wait wait = {.farm = m->farm, .cli = &framed.cli, .job = m->ids[i]};
        int status = framed_make(&framed, m->cli, m->frames.first + i);
        if (status == EXIT_DONE)
            status = cmd_wait_run(&wait);
        if (status == EXIT_INTERRUPTED || status == EXIT_FARM)
            return status;
        if (status > worst)
            worst = status;
    }
    return worst;
}

int cmd_frames_submit(struct cli *cli)
{
    struct frames frames;
    struct farm farm;
    const char *text = cli_text(&cli->line, CLI_FRAMES);
    if (!frames_parse(text, &frames)) {
        cli_error("bad-value", NULL, "--frames %s: must be A-B with A <= B, at most %d frames",
                  text, (int)FRAMES_MAX);
        return EXIT_USAGE;
    }
    int status = check_marks(cli);
    if (status == EXIT_DONE)
        status = check_scenes(cli, frames);
    if (status == EXIT_DONE)
        status = farm_open(&farm, cli);
    if (status != EXIT_DONE)
        return status;
    struct making making = {.farm = &farm, .cli = cli, .frames = frames};
    status = make_all(&making);
    bool waits = cli_flag(&cli->line, CLI_WAIT);
    if (status == EXIT_DONE && (!waits || !cli->json) && !cmd_submit_print(cli, making.ids[0]))
        status = EXIT_MACHINE;
    if (status == EXIT_DONE && waits)
        status = wait_for_all(&making);
    mem_free(making.ids);
    farm_release(&farm);
    return status;
}
