#include "client/until.h"

#include <string.h>

#include "common/file_io.h"
#include "common/mem.h"
#include "common/sample_plan.h"

static const enum cli_option_id until_ids[] = {CLI_SPP, CLI_TARGET_ERROR, CLI_TIME_LIMIT, CLI_PLAN};

void until_check(const struct cli_line *line, struct diag_list *problems)
{
    const struct diag_place nowhere = {0};
    const char *first = NULL;
    for (size_t i = 0; i < sizeof until_ids / sizeof *until_ids; i++) {
        if (!cli_has(line, until_ids[i]))
            continue;
        if (first)
            diag_add(problems, DIAG_ERROR, nowhere, "bad-value",
                     "one of --spp, --target-error, --time-limit and --plan ends a job",
                     "--%s and --%s do not go together", first, cli_options[until_ids[i]].name);
        first = cli_options[until_ids[i]].name;
    }
    for (size_t i = 0; i < sizeof until_ids / sizeof *until_ids; i++) {
        enum cli_option_id id = until_ids[i];
        if (cli_has(line, id) && cli_options[id].kind == CLI_NUMBER && !(cli_number(line, id) > 0))
            diag_add(problems, DIAG_ERROR, nowhere, "bad-value", NULL, "--%s %s: must be over 0",
                     cli_options[id].name, cli_text(line, id));
    }
    if (cli_has(line, CLI_MAX_SPP) && !cli_has(line, CLI_TARGET_ERROR) &&
        !cli_has(line, CLI_TIME_LIMIT))
        diag_add(problems, DIAG_ERROR, nowhere, "bad-value", "--spp gives every pixel that many",
                 "--max-spp goes with --target-error or --time-limit");
}

/* The plan as the API takes it, for the squares that the crop meets. */
static enum err plan_text(const struct sample_plan *plan, const struct job_spec *spec, char **out,
                          struct diag_list *problems)
{
    struct grid grid;
    struct job_blocks blocks = job_spec_blocks(spec);
    TL_TRY(grid_init(&grid, spec));
    uint32_t x = 0, y = 0;
    uint16_t *limits = mem_alloc_array(grid.cell_count, sizeof *limits);
    enum err e = limits ? ERR_OK : ERR_NOMEM;
    if (limits && !sample_plan_limits(plan, &grid, &blocks, limits, &x, &y)) {
        diag_add(problems, DIAG_ERROR, (struct diag_place){0}, "bad-plan",
                 "a plan is for a picture of one size, or a part of it",
                 "the plan says nothing that fits for the square at pixel %u,%u", x, y);
        e = ERR_USAGE;
    }
    if (e == ERR_OK) {
        struct buf b;
        buf_init(&b);
        sample_plan_put(&b, &grid, &blocks, limits, plan->pilot_kept);
        buf_put_u8(&b, 0);
        e = buf_status(&b);
        *out = (char *)b.data;
        if (e != ERR_OK)
            buf_release(&b);
    }
    mem_free(limits);
    grid_release(&grid);
    return e;
}

static enum err take_plan(const char *path, struct job_spec *spec, char **out,
                          struct diag_list *problems)
{
    char *text;
    size_t bytes;
    struct json_get g;
    struct sample_plan plan;
    enum err e = file_read(path, JSON_BYTES_MAX, &text, &bytes);
    if (e != ERR_OK) {
        diag_add(problems, DIAG_ERROR, (struct diag_place){.file = path}, "bad-plan",
                 "a plan is the report of a render by --target-error or --time-limit",
                 "cannot be read: %s", file_read_why(path, e));
        return e == ERR_NOMEM ? e : ERR_INPUT;
    }
    e = json_get_open(&g, text, bytes, path, problems);
    if (e == ERR_OK) {
        e = sample_plan_read(&g, g.root, &plan);
        json_get_close(&g);
    }
    mem_free(text);
    if (e != ERR_OK)
        return e;
    spec->spp = plan.max_spp;
    if (job_spec_valid(spec, NULL)) /* what else is wrong is said later */
        e = plan_text(&plan, spec, out, problems);
    sample_plan_release(&plan);
    return e;
}

enum err until_apply(const struct cli_line *line, struct job_spec *spec, char **plan_json,
                     struct diag_list *problems)
{
    *plan_json = NULL;
    if (cli_has(line, CLI_SPP))
        spec->spp = cli_count(line, CLI_SPP);
    if (cli_has(line, CLI_TARGET_ERROR) || cli_has(line, CLI_TIME_LIMIT))
        spec->spp =
            cli_has(line, CLI_MAX_SPP) ? cli_count(line, CLI_MAX_SPP) : JOB_ADAPTIVE_SPP_DEFAULT;
    if (cli_has(line, CLI_TARGET_ERROR)) {
        spec->stop = JOB_STOP_ERROR;
        spec->target_error = cli_number(line, CLI_TARGET_ERROR);
    } else if (cli_has(line, CLI_TIME_LIMIT)) {
        spec->stop = JOB_STOP_TIME;
        spec->time_limit_s = cli_number(line, CLI_TIME_LIMIT);
    } else if (cli_has(line, CLI_PLAN)) {
        spec->stop = JOB_STOP_PLAN;
        return take_plan(cli_text(line, CLI_PLAN), spec, plan_json, problems);
    }
    return ERR_OK;
}
