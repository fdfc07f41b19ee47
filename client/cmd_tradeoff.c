/* client/cmd_tradeoff.c: speed against accuracy of one scene, measured, as tables, plot and page.
 *
 * Ctrl-C ends the measuring; what there is is written, and the exit status is 130.
 */
#include <errno.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "client/command.h"
#include "client/follow.h"
#include "client/human.h"
#include "client/out_file.h"
#include "client/signals.h"
#include "client/study_page.h"
#include "client/study_plan.h"
#include "client/study_plot.h"
#include "client/study_run.h"
#include "client/study_write.h"
#include "common/file_io.h"
#include "common/mem.h"

#define BUDGET_S 60.0

/* --- Before ----------------------------------------------------------------- */

/* Makes the folder where there is none; says what is wrong with it. */
static int make_folder(const char *path)
{
    struct stat info;
    char *probe = mem_sprintf("%s/tradeoff.csv", path);
    if (!probe) {
        cli_error("no-memory", NULL, "out of memory");
        return EXIT_MACHINE;
    }
    enum err e = ERR_OK;
    int errnum = 0;
    if (mkdir(path, 0777) != 0 && errno != EEXIST) {
        errnum = errno;
        e = err_from_errno(errnum);
    } else if (stat(path, &info) == 0 && !S_ISDIR(info.st_mode)) {
        errnum = ENOTDIR;
        e = ERR_IO;
    } else {
        e = out_file_check(probe, 0);
        errnum = errno;
    }
    mem_free(probe);
    return e == ERR_OK ? EXIT_DONE : cli_cannot_write(path, e, errnum, 0, NULL);
}

static int check_line(const struct cli_line *line)
{
    uint64_t pixels = 0;
    if (!cli_has(line, CLI_OUTPUT)) {
        cli_error("missing-option", "as in tilery tradeoff scene.json -o study",
                  "tradeoff needs -o DIR");
        return EXIT_USAGE;
    }
    if (cli_has(line, CLI_SIZE_WH)) {
        uint32_t width, height;
        cli_size(line, &width, &height);
        pixels = (uint64_t)width * height;
    }
    if (cli_has(line, CLI_CROP_XYWH)) {
        struct job_crop crop = cli_crop(line);
        pixels = (uint64_t)crop.width * crop.height;
    }
    if (pixels > STUDY_PIXELS_ASKED_MAX) {
        cli_error("bad-value", "--crop X,Y,W,H studies a part of the large picture",
                  "a study renders hundreds of pictures: at most %d pixels each, not %llu",
                  STUDY_PIXELS_ASKED_MAX, (unsigned long long)pixels);
        return EXIT_USAGE;
    }
    return make_folder(cli_text(line, CLI_OUTPUT));
}

/* --- Files ------------------------------------------------------------------ */

static int write_one(const char *folder, const char *name, enum err made, const struct buf *data)
{
    char *path = mem_sprintf("%s/%s", folder, name);
    enum err e = made != ERR_OK ? made : path ? buf_status(data) : ERR_NOMEM;
    if (e == ERR_NOMEM)
        cli_error("no-memory", NULL, "out of memory while making %s", name);
    int status = e == ERR_OK ? EXIT_DONE : EXIT_MACHINE;
    if (e == ERR_OK) {
        e = file_write(path, data->data, data->bytes);
        status = e == ERR_OK ? EXIT_DONE : cli_cannot_write(path, e, 0, 0, NULL);
    } else if (e != ERR_NOMEM) {
        cli_error("machine", NULL, "%s cannot be made: %s", name, err_text(e));
    }
    mem_free(path);
    return status;
}

static enum err make_png(const struct study *s, struct buf *out)
{
    struct canvas canvas;
    TL_TRY(canvas_init_raster(&canvas, STUDY_PLOT_WIDTH, STUDY_PLOT_HEIGHT));
    study_plot(s, &canvas);
    return canvas_finish_png(&canvas, out);
}

static enum err make_svg(const struct study *s, struct buf *out)
{
    struct canvas canvas;
    canvas_init_svg(&canvas, STUDY_PLOT_WIDTH, STUDY_PLOT_HEIGHT, out);
    study_plot(s, &canvas);
    return canvas_finish_svg(&canvas);
}

static int write_presets(const struct study *s, const char *folder)
{
    int status = EXIT_DONE;
    for (int i = 0; s->has_presets && i < STUDY_LEVELS && status == EXIT_DONE; i++) {
        struct buf out;
        char name[40];
        buf_init(&out);
        (void)snprintf(name, sizeof name, "%s.preset", study_level_names[i]);
        study_put_preset(s, (enum study_level)i, &out);
        status = write_one(folder, name, ERR_OK, &out);
        buf_release(&out);
    }
    return status;
}

static int write_all(const struct study *s, const char *folder)
{
    struct buf data, svg;
    buf_init(&data);
    buf_init(&svg);
    study_put_csv(s, &data);
    int status = write_one(folder, "tradeoff.csv", ERR_OK, &data);
    buf_clear(&data);
    study_put_json(s, &data);
    status = status ? status : write_one(folder, "tradeoff.json", ERR_OK, &data);
    enum err e = make_svg(s, &svg);
    status = status ? status : write_one(folder, "tradeoff.svg", e, &svg);
    buf_clear(&data);
    e = make_png(s, &data);
    status = status ? status : write_one(folder, "tradeoff.png", e, &data);
    buf_clear(&data);
    e = study_put_page(s, &svg, &data);
    status = status ? status : write_one(folder, "index.html", e, &data);
    buf_release(&data);
    buf_release(&svg);
    return status ? status : write_presets(s, folder);
}

/* --- After ------------------------------------------------------------------ */

static void say_presets(const struct cli *cli, const struct study *s, const char *folder)
{
    for (int i = 0; s->has_presets && i < STUDY_LEVELS; i++) {
        const struct study_preset *p = &s->presets[i];
        char relmse[HUMAN_BYTES], time[HUMAN_BYTES], how[60], options[200] = "";
        study_preset_how(p, how, sizeof how);
        human_error(p->expected_relmse, relmse);
        human_duration(p->scene_core_s, time);
        for (uint32_t k = 1; k < p->setting_count; k++) {
            size_t used = strlen(options);
            (void)snprintf(options + used, sizeof options - used, ", %s %s",
                           cli_options[p->settings[k].option].name, p->settings[k].text);
        }
        cli_say(cli, "  %-8s relMSE %s (%s): %s spp%s%s; %s of one core at %ux%u",
                study_level_names[i], relmse, how, p->settings[0].text, options,
                p->half ? ", half" : "", time, s->scene_width, s->scene_height);
    }
    if (s->has_presets)
        cli_say(cli, "  use one: tilery render %s -o OUT.exr --preset %s/standard.preset",
                cli->line.arguments[0], folder);
}

static const char *name_of(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

static int conclude(struct cli *cli, const struct study *s, int status)
{
    const char *folder = cli_text(&cli->line, CLI_OUTPUT);
    char spent[HUMAN_BYTES];
    if (!study_has_results(s)) {
        if (status == EXIT_DONE)
            cli_error("budget-short", "a larger --budget, or a smaller --size",
                      "not even the base was measured twice within %g s", s->budget_s);
        return status == EXIT_DONE ? EXIT_FAILED : status;
    }
    int written = write_all(s, folder);
    if (written != EXIT_DONE)
        return written;
    human_duration(s->spent_s, spent);
    cli_say(cli, "%s/index.html  %u renders of %ux%u%s in %s", folder, s->render_count, s->width,
            s->height, s->reduced ? " (smaller than the scene's, to keep the budget)" : "", spent);
    say_presets(cli, s, folder);
    return status;
}

int command_tradeoff(struct cli *cli)
{
    static struct study study; /* large for a stack */
    struct study_farm farm;
    struct progress progress;
    double budget_s =
        cli_has(&cli->line, CLI_BUDGET) ? cli_number(&cli->line, CLI_BUDGET) : BUDGET_S;
    int status = check_line(&cli->line);
    if (status != EXIT_DONE)
        return status;
    if (signals_install() != ERR_OK) {
        cli_error("machine", NULL, "cannot watch for signals: %s", strerror(errno));
        return EXIT_MACHINE;
    }
    progress_init(&progress, (enum progress_mode)command_progress_mode(cli), STDERR_FILENO,
                  follow_now_s());
    study.scene = name_of(cli->line.arguments[0]);
    status = study_farm_open(&farm, cli, &progress);
    if (status == EXIT_DONE)
        status = study_run(&study, &farm, budget_s);
    progress_end(&progress);
    study_farm_close(&farm);
    status = signals_interrupts > 0 ? EXIT_INTERRUPTED : status;
    if (status == EXIT_DONE || study.truth.weight)
        status = conclude(cli, &study, status);
    study_release(&study);
    return status;
}
