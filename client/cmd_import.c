/* client/cmd_import.c: a model of another program into a scene file that can be edited. */
#include <errno.h>

#include "client/command.h"
#include "client/human.h"
#include "client/import.h"
#include "client/import_model.h"
#include "common/mem.h"

static void tell_made(const struct cli *cli, const struct scene *s, const char *path)
{
    double triangles = 0;
    for (size_t i = 0; i < s->object_count; i++)
        triangles += s->meshes[s->objects[i].mesh].triangle_count;
    char text[5][HUMAN_BYTES];
    human_things((double)s->object_count, "object", "objects", text[0]);
    human_things((double)s->mesh_count, "mesh", "meshes", text[1]);
    human_things(triangles, "triangle", "triangles", text[2]);
    human_things((double)s->material_count, "material", "materials", text[3]);
    human_things((double)s->image_count, "picture", "pictures", text[4]);
    cli_say(cli, "%s: %s, %s, %s, %s, %s", cli_safe(path), text[0], text[1], text[2], text[3],
            text[4]);
}

static int write_scene(const struct cli *cli, const struct import *im, const struct job_spec *spec)
{
    const char *path = cli_text(&cli->line, CLI_OUTPUT);
    char *failed = NULL;
    errno = 0;
    enum err e = import_write(im, spec, path, &failed);
    int errnum = errno;
    int status = EXIT_DONE;
    if (e == ERR_NOMEM) {
        cli_error("no-memory", NULL, "out of memory while writing the scene");
        status = EXIT_MACHINE;
    } else if (e != ERR_OK) {
        status = cli_cannot_write(failed ? failed : path, e, errnum, 0, NULL);
    } else {
        tell_made(cli, &im->scene, path);
    }
    mem_free(failed);
    return status;
}

int command_import(struct cli *cli)
{
    struct diag_list problems;
    struct import im;
    struct job_spec spec;
    if (!cli_has(&cli->line, CLI_OUTPUT)) {
        cli_error("no-output", "tilery import MODEL -o scene.json", "where shall the scene go?");
        return EXIT_USAGE;
    }
    static const enum cli_option_id output = CLI_OUTPUT;
    int status = cli_check_outputs(&cli->line, &output, 1);
    if (status != EXIT_DONE)
        return status;
    diag_init(&problems);
    enum err e = import_init(&im, cli->line.arguments[0], &problems);
    if (e == ERR_OK) {
        im.keep_bytes = true;
        e = import_run(&im, &spec);
    }
    (void)cli_problems(&problems, e == ERR_OK ? NULL : "nothing written");
    status = err_exit_status(e);
    if (e == ERR_OK)
        status = write_scene(cli, &im, &spec);
    else if (status == EXIT_MACHINE)
        cli_error("no-memory", NULL, "the model cannot be imported: %s", err_text(e));
    import_release(&im);
    diag_release(&problems);
    return status;
}
