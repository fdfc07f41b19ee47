#include "client/load.h"

#include <string.h>

#include "client/cli.h"
#include "client/doctor.h"
#include "client/follow.h"
#include "client/import.h"
#include "client/quiet_thread.h"
#include "client/until.h"
#include "common/mem.h"
#include "common/scene_json.h"

static enum err read_scene(struct load *load, const char *path)
{
    if (import_is_model(path))
        return import_model(path, &load->scene, &load->spec, &load->problems);
    return scene_json_read_file(path, &load->scene, &load->spec, &load->problems);
}

/* Names of the scene format that ask for the same light by other means mean path, with the
 * warning that the scene's key gives. */
static void take_integrator(struct load *load, const struct cli_line *line)
{
    int choice = cli_choice(line, CLI_INTEGRATOR);
    load->spec.integrator =
        choice < JOB_INTEGRATOR_COUNT ? (enum job_integrator)choice : JOB_INTEGRATOR_PATH;
    if (choice >= JOB_INTEGRATOR_COUNT)
        diag_add(&load->problems, DIAG_WARNING, (struct diag_place){0}, "integrator-replaced", NULL,
                 "--integrator %s is rendered by the path integrator: the same light by other "
                 "means",
                 cli_text(line, CLI_INTEGRATOR));
}

static void take_choices(struct job_spec *spec, const struct cli_line *line)
{
    if (cli_has(line, CLI_SAMPLER))
        spec->sampler = (enum job_sampler)cli_choice(line, CLI_SAMPLER);
    if (cli_has(line, CLI_PROFILE))
        spec->profile = (enum job_profile)cli_choice(line, CLI_PROFILE);
    if (cli_has(line, CLI_PRECISION))
        spec->precision = (enum job_precision)cli_choice(line, CLI_PRECISION);
    if (cli_has(line, CLI_BUILDER))
        spec->builder = (enum job_builder)cli_choice(line, CLI_BUILDER);
    if (cli_has(line, CLI_INTERSECTOR))
        spec->intersector = (enum job_intersector)cli_choice(line, CLI_INTERSECTOR);
    if (cli_has(line, CLI_LIGHT_CHOICE))
        spec->light_choice = (enum job_light_choice)cli_choice(line, CLI_LIGHT_CHOICE);
}

static void take_size(struct job_spec *spec, const struct cli_line *line)
{
    if (cli_has(line, CLI_SIZE_WH)) {
        cli_size(line, &spec->width, &spec->height);
        spec->crop = (struct job_crop){.width = spec->width, .height = spec->height};
    }
    if (cli_has(line, CLI_CROP_XYWH))
        spec->crop = cli_crop(line);
    if (cli_has(line, CLI_AOV))
        spec->aov = cli_aovs(line);
}

static void apply_options(struct load *load, const struct cli_line *line)
{
    struct job_spec *spec = &load->spec;
    take_size(spec, line);
    if (cli_has(line, CLI_INTEGRATOR))
        take_integrator(load, line);
    take_choices(spec, line);
    if (cli_has(line, CLI_SEED))
        spec->seed = cli_count(line, CLI_SEED);
    if (cli_has(line, CLI_MAX_DEPTH))
        spec->max_depth = (uint32_t)cli_count(line, CLI_MAX_DEPTH);
    if (cli_has(line, CLI_RR_THRESHOLD))
        spec->rr_threshold = cli_number(line, CLI_RR_THRESHOLD);
    if (cli_has(line, CLI_TILE))
        spec->tile = (uint32_t)cli_count(line, CLI_TILE);
    if (cli_has(line, CLI_VERIFY))
        spec->verify = cli_share(line, CLI_VERIFY);
    spec->tags = cli_tags(line);
}

/* Problems that come from the options and not from the file. */
static bool options_fit(struct load *load, const struct cli_line *line)
{
    const struct job_spec *s = &load->spec;
    const struct job_crop *c = &s->crop;
    if (cli_has(line, CLI_CROP_XYWH) &&
        ((uint64_t)c->x + c->width > s->width || (uint64_t)c->y + c->height > s->height)) {
        diag_add(&load->problems, DIAG_ERROR, (struct diag_place){0}, "bad-value",
                 "X,Y is the upper left corner, W,H the size",
                 "--crop %s reaches over the %ux%u picture", cli_text(line, CLI_CROP_XYWH),
                 s->width, s->height);
        return false;
    }
    return job_spec_valid(s, &load->problems);
}

static void check_light(struct load *load, const char *path, const struct cli_line *line)
{
    if (!cli_has(line, CLI_INTEGRATOR) || scene_can_be_lit(&load->scene, load->spec.integrator))
        return;
    diag_add(&load->problems, DIAG_ERROR, (struct diag_place){.file = path}, "no-light",
             "another --integrator may see the scene's lights",
             "nothing could ever light this scene under --integrator %s",
             job_integrator_names[load->spec.integrator]);
    load->status = EXIT_INPUT;
}

/* As a path draws them: triangles and spheres that emit, lights without a surface, the sky. */
static uint64_t count_lights(const struct scene *s)
{
    uint64_t count = s->light_count + (s->envmap.texture != SCENE_NONE);
    for (size_t i = 0; i < s->object_count; i++) {
        const struct scene_object *o = &s->objects[i];
        if (o->emits && o->type == SCENE_OBJECT_MESH)
            count += s->meshes[o->mesh].triangle_count;
        else if (o->emits)
            count++;
    }
    return count;
}

static void make_package(struct load *load)
{
    double begun = follow_now_s();
    load->spec_json = job_spec_to_json(&load->spec);
    if (!load->spec_json || package_write(&load->scene, load->spec.aov, &load->package) != ERR_OK) {
        load->status = EXIT_MACHINE;
        load->trouble = ERR_NOMEM;
        return;
    }
    load->has_package = true;
    load->pack_s = follow_now_s() - begun;
}

/* What ends the job; false: the status says why not. */
static bool take_until(struct load *load, const struct cli_line *line)
{
    mem_free(load->plan_json);
    enum err e = until_apply(line, &load->spec, &load->plan_json, &load->problems);
    if (e != ERR_OK)
        load->status = e == ERR_USAGE ? EXIT_USAGE : err_exit_status(e);
    if (load->status == EXIT_MACHINE)
        load->trouble = e;
    return e == ERR_OK;
}

/* Coordinates that floats cannot tell apart, looked for while the package is made: on large meshes
 * both take as long. */
struct doctor_thread {
    const struct scene *scene;
    struct diag_list problems;
    enum err error;
    pthread_t thread;
    bool runs;
};

static void *doctor_run(void *ctx)
{
    struct doctor_thread *d = ctx;
    d->error = doctor_warn_precision(d->scene, &d->problems);
    return NULL;
}

/* No thread: done at once. */
static void doctor_begin(struct doctor_thread *d, const struct scene *scene)
{
    *d = (struct doctor_thread){.scene = scene};
    diag_init(&d->problems);
    d->runs = quiet_thread_begin(&d->thread, doctor_run, d) == 0;
    if (!d->runs)
        (void)doctor_run(d);
}

static void doctor_end(struct doctor_thread *d, struct load *load)
{
    if (d->runs)
        (void)pthread_join(d->thread, NULL);
    diag_append(&load->problems, &d->problems);
    if (d->error != ERR_OK && load->status == EXIT_DONE) {
        load->status = EXIT_MACHINE;
        load->trouble = d->error;
    }
}

static void drop_scene(struct load *load)
{
    if (load->has_scene)
        scene_release(&load->scene);
    load->has_scene = false;
}

void load_scene(struct load *load, const struct cli_line *line, bool keep_scene)
{
    const char *path = line->arguments[0];
    *load = (struct load){0};
    diag_init(&load->problems);
    double begun = follow_now_s();
    enum err e = read_scene(load, path);
    load->read_s = follow_now_s() - begun;
    if (e != ERR_OK) {
        load->status = err_exit_status(e);
        if (load->status == EXIT_MACHINE)
            load->trouble = e;
        return;
    }
    load->has_scene = true;
    struct doctor_thread doctor;
    doctor_begin(&doctor, &load->scene);
    load->scene_spec = load->spec;
    load->light_count = count_lights(&load->scene);
    apply_options(load, line);
    if (!take_until(load, line))
        ; /* said already */
    else if (!options_fit(load, line))
        load->status = EXIT_USAGE;
    else
        check_light(load, path, line);
    if (load->status == EXIT_DONE)
        make_package(load);
    doctor_end(&doctor, load);
    if (!keep_scene)
        drop_scene(load);
}

int load_respec(struct load *load, const struct cli_line *line)
{
    diag_release(&load->problems);
    diag_init(&load->problems);
    load->spec = load->scene_spec;
    load->status = EXIT_DONE;
    apply_options(load, line);
    if (!take_until(load, line))
        return load->status;
    if (!options_fit(load, line))
        return load->status = EXIT_USAGE;
    char *json = job_spec_to_json(&load->spec);
    if (!json) {
        load->trouble = ERR_NOMEM;
        return load->status = EXIT_MACHINE;
    }
    mem_free(load->spec_json);
    load->spec_json = json;
    return load->status = EXIT_DONE;
}

void load_drop_package(struct load *load)
{
    if (load->has_package)
        package_release(&load->package);
    load->has_package = false;
}

void load_release(struct load *load)
{
    drop_scene(load);
    load_drop_package(load);
    mem_free(load->spec_json);
    mem_free(load->plan_json);
    diag_release(&load->problems);
    *load = (struct load){0};
}

int load_explain(const struct load *load, const char *tail)
{
    (void)cli_problems(&load->problems, load->status ? tail : NULL);
    if (load->status == EXIT_MACHINE)
        cli_error(load->trouble == ERR_NOMEM ? "no-memory" : "machine", NULL,
                  "the scene cannot be read: %s", err_text(load->trouble));
    return load->status;
}
