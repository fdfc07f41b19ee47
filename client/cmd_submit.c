#include "client/cmd_submit.h"

#include <errno.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "client/cmd_frames.h"
#include "client/cmd_wait.h"
#include "client/command.h"
#include "client/load.h"
#include "client/out_file.h"
#include "common/utf8.h"

/* "scenes/spot.json" -> "spot" */
static void name_of(const char *path, char *out, size_t bytes)
{
    const char *slash = strrchr(path, '/');
    const char *base = slash ? slash + 1 : path;
    const char *dot = strrchr(base, '.');
    char whole[PATH_MAX];
    (void)snprintf(whole, sizeof whole, "%.*s",
                   (int)(dot && dot != base ? dot - base : (long)strlen(base)), base);
    utf8_copy(out, bytes, whole);
}

int cmd_submit_outputs(const struct cli *cli)
{
    static const enum cli_option_id ids[] = {CLI_OUTPUT, CLI_PNG, CLI_REPORT};
    for (size_t i = 0; i < sizeof ids / sizeof *ids; i++) {
        if (!cli_has(&cli->line, ids[i]) || cli_flag(&cli->line, CLI_WAIT))
            continue;
        cli_error("missing-option", "or fetch it later: tilery get JOB -o OUT.exr",
                  "%s needs --wait", cli_typed(&cli->line, ids[i]));
        return EXIT_USAGE;
    }
    return cli_check_outputs(&cli->line, ids, sizeof ids / sizeof *ids);
}

int cmd_submit_send(struct farm *farm, const struct cli *cli, struct load *load,
                    const struct farm_frame *frame, char id[FARM_ID_BYTES])
{
    char name[JOB_NAME_BYTES_MAX + 1];
    const struct cli_line *line = &cli->line;
    name_of(line->arguments[0], name, sizeof name);
    struct farm_job_request request = {
        .name = cli_has(line, CLI_NAME) ? cli_text(line, CLI_NAME) : name,
        .package = &load->package,
        .spec_json = load->spec_json,
        .frame = frame,
        .plan_json = load->plan_json,
        .priority =
            cli_has(line, CLI_PRIORITY_N) ? strtoll(cli_text(line, CLI_PRIORITY_N), NULL, 10) : 0,
    };
    return farm_submit(farm, &request, id);
}

bool cmd_submit_print(const struct cli *cli, const char *id)
{
    char text[FARM_ID_BYTES + 16];
    int bytes = snprintf(text, sizeof text, cli->json ? "{\"id\":\"%s\"}\n" : "%s\n", id);
    return cli_put(text, (size_t)bytes);
}

static int finish(struct farm *farm, struct cli *cli, const char *id)
{
    struct cmd_wait wait = {.farm = farm, .cli = cli, .job = id};
    bool waits = cli_flag(&cli->line, CLI_WAIT);
    if ((!waits || !cli->json) && !cmd_submit_print(cli, id))
        return EXIT_MACHINE;
    return waits ? cmd_wait_run(&wait) : EXIT_DONE;
}

int command_submit(struct cli *cli)
{
    struct load load;
    struct farm farm;
    char id[FARM_ID_BYTES];
    if (cli_has(&cli->line, CLI_FRAMES))
        return cmd_frames_submit(cli);
    int status = cmd_submit_outputs(cli);
    if (status != EXIT_DONE)
        return status;
    load_scene(&load, &cli->line, false);
    status = load_explain(&load, "no job made");
    if (status == EXIT_DONE)
        status = farm_open(&farm, cli);
    if (status == EXIT_DONE) {
        status = cmd_submit_send(&farm, cli, &load, NULL, id);
        load_release(&load);
        if (status == EXIT_DONE)
            status = finish(&farm, cli, id);
        farm_release(&farm);
        return status;
    }
    load_release(&load);
    return status;
}
