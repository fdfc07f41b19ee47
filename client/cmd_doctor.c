/* client/cmd_doctor.c: `tilery doctor SCENE`: advice about a scene, printed. */
#include "client/command.h"
#include "client/doctor.h"
#include "client/human.h"
#include "client/load.h"
#include "common/json_put.h"

static void put_json_finding(const struct doctor_finding *f, struct buf *out)
{
    buf_printf(out, "{\"id\":\"%s\",\"count\":%llu,\"more\":%llu,\"object\":", f->id,
               (unsigned long long)f->count, (unsigned long long)f->more);
    if (f->object == SCENE_NONE)
        buf_printf(out, "null");
    else
        buf_printf(out, "%u", f->object);
    buf_printf(out, ",\"triangle\":");
    if (f->triangle == SCENE_NONE)
        buf_printf(out, "null");
    else
        buf_printf(out, "%u", f->triangle);
    buf_printf(out, ",\"at\":");
    if (!f->placed)
        buf_printf(out, "null");
    for (int k = 0; f->placed && k < 3; k++) {
        buf_printf(out, k ? "," : "[");
        json_put_number(out, f->at[k]);
        buf_printf(out, k == 2 ? "]" : "");
    }
    buf_printf(out, ",\"where\":");
    json_put_text(out, f->where);
    buf_printf(out, ",\"text\":");
    json_put_text(out, f->text);
    buf_printf(out, ",\"advice\":");
    json_put_text(out, f->advice);
    buf_printf(out, "}");
}

static void put_json(const struct doctor *d, struct buf *out)
{
    buf_printf(out, "{\"meshes\":%llu,\"triangles\":%llu,\"findings\":[",
               (unsigned long long)d->meshes, (unsigned long long)d->triangles);
    for (size_t i = 0; i < d->count; i++) {
        buf_printf(out, i ? "," : "");
        put_json_finding(&d->findings[i], out);
    }
    buf_printf(out, "]}\n");
}

static void put_text(const struct doctor *d, const char *scene, struct buf *out)
{
    char triangles[HUMAN_BYTES];
    for (size_t i = 0; i < d->count; i++) {
        const struct doctor_finding *f = &d->findings[i];
        buf_printf(out, "%s%s%s\n", cli_safe(f->where), f->where[0] ? ": " : "", cli_safe(f->text));
        buf_printf(out, "  %s%s[%s]\n", cli_safe(f->advice), f->advice[0] ? "  " : "", f->id);
        if (f->more)
            buf_printf(out, "  and %llu more of this kind\n", (unsigned long long)f->more);
    }
    human_count((double)d->triangles, triangles);
    buf_printf(out, "%s: %zu finding%s in %llu mesh%s, %s triangle%s\n", cli_safe(scene), d->count,
               d->count == 1 ? "" : "s", (unsigned long long)d->meshes, d->meshes == 1 ? "" : "es",
               triangles, d->triangles == 1 ? "" : "s");
}

static int examine(const struct cli *cli, const struct load *load)
{
    struct doctor doctor;
    struct buf out;
    if (doctor_examine(&load->scene, &load->problems, &doctor) != ERR_OK) {
        doctor_release(&doctor);
        cli_error("no-memory", NULL, "the scene cannot be examined: %s", err_text(ERR_NOMEM));
        return EXIT_MACHINE;
    }
    buf_init(&out);
    if (cli->json)
        put_json(&doctor, &out);
    else
        put_text(&doctor, cli->line.arguments[0], &out);
    int status = cli_put_buf(&out) ? EXIT_DONE : EXIT_MACHINE;
    buf_release(&out);
    doctor_release(&doctor);
    return status;
}

int command_doctor(struct cli *cli)
{
    struct load load;
    load_scene(&load, &cli->line, true);
    /* Warnings are findings here; errors are told as everywhere. */
    int status = load.status == EXIT_DONE ? examine(cli, &load) : load_explain(&load, NULL);
    load_release(&load);
    return status;
}
