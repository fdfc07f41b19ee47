/* tests/bench/bench_render.c: pictures: how many seconds until the error is small.
 *
 * Renders each scene in this process, on a few threads through render_unit(), at 1, 2, 4, ...
 * samples a pixel until the relMSE against a reference is below the targets, and gives the time at
 * which it crossed each (between two steps as if error and time were powers of each other). The
 * reference is ours, with another sampler and seed (light sampling alone would miss the glints of
 * smooth plates for thousands of samples); its own noise, measured from its halves, is taken off.
 *
 * usage: bench_render [--quick] [--json FILE] [--scene FILE]... [--side N] [--threads N]
 *                     [--reference-spp N]
 * Peers are not measured here: "theirs" and "ratio" are null.
 */
#include <errno.h>
#include <getopt.h>
#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/utsname.h>
#include <time.h>

#include "common/grid.h"
#include "common/mem.h"
#include "common/scene_json.h"
#include "worker/render/render.h"
#include "worker/scene/scene_build.h"

enum { THREADS_MAX = 256, SCENES_MAX = 32, TARGETS = 2, STEPS_MAX = 24 };

static const double targets[TARGETS] = {0.01, 0.001};
static const char *const default_scenes[] = {"scenes/cbox.json", "scenes/glass_cbox.json",
                                             "scenes/veach.json"};

struct options {
    const char *json, *scenes[SCENES_MAX];
    int scene_count, threads;
    uint32_t side;
    uint64_t reference_spp;
    double target_least; /* the last target that is gone for */
};

struct picture {
    double *half[2]; /* sums of the halves, planar RGB */
    size_t values;
    uint64_t spp, rays;
    double seconds;
};

struct job {
    const struct render_scene *scene;
    const struct grid *grid;
    struct picture *picture;
    atomic_uint next_cell;
    atomic_ullong rays;
};

static double now_s(void)
{
    struct timespec t;
    (void)clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void *need(void *memory)
{
    if (!memory) {
        fprintf(stderr, "bench_render: out of memory\n");
        exit(5);
    }
    return memory;
}

static void add_cell(const struct job *job, uint32_t cell, uint32_t half, const float *rgb)
{
    struct grid_rect r = grid_cell(job->grid, cell);
    const struct job_crop *crop = &job->grid->crop;
    size_t cell_pixels = (size_t)r.width * r.height, plane = job->picture->values / 3;
    for (size_t i = 0; i < cell_pixels; i++) {
        size_t at = (r.y - crop->y + i / r.width) * crop->width + r.x - crop->x + i % r.width;
        for (size_t k = 0; k < 3; k++)
            job->picture->half[half][k * plane + at] += (double)rgb[k * cell_pixels + i];
    }
}

/* Cells from the counter until none is left, each with all its blocks. */
static void *render_cells(void *arg)
{
    struct job *job = arg;
    struct render_scratch *scratch;
    struct job_blocks blocks = job_blocks_of(job->picture->spp);
    size_t side = job->grid->tile;
    float *rgb = need(mem_alloc_array(side * side, JOB_COLOR_PLANES * sizeof *rgb));
    if (render_scratch_new(&scratch) != ERR_OK)
        need(NULL);
    for (;;) {
        uint32_t cell = atomic_fetch_add(&job->next_cell, 1);
        if (cell >= job->grid->cell_count)
            break;
        for (uint32_t block = 0; block < blocks.count; block++) {
            struct render_counters counters;
            struct unit unit = {cell, 1, block};
            if (render_unit(job->scene, job->grid, unit, scratch, NULL, rgb, &counters) != ERR_OK)
                exit(5);
            atomic_fetch_add(&job->rays, counters.rays);
            add_cell(job, cell, block & 1, rgb);
        }
    }
    render_scratch_free(scratch);
    mem_free(rgb);
    return NULL;
}

static struct picture render(const struct scene *scene, const struct job_spec *spec, int threads)
{
    struct picture p = {.spp = spec->spp};
    struct render_scene *built;
    struct grid grid;
    p.values = (size_t)spec->crop.width * spec->crop.height * 3;
    p.half[0] = need(mem_calloc(p.values, sizeof **p.half));
    p.half[1] = need(mem_calloc(p.values, sizeof **p.half));
    double start = now_s();
    if (scene_build(scene, spec, NULL, &built) != ERR_OK || grid_init(&grid, spec) != ERR_OK)
        need(NULL);
    struct job job = {.scene = built, .grid = &grid, .picture = &p};
    pthread_t ids[THREADS_MAX];
    for (int i = 1; i < threads; i++)
        if (pthread_create(&ids[i], NULL, render_cells, &job) != 0)
            need(NULL);
    (void)render_cells(&job);
    for (int i = 1; i < threads; i++)
        (void)pthread_join(ids[i], NULL);
    p.seconds = now_s() - start;
    p.rays = atomic_load(&job.rays);
    grid_release(&grid);
    render_scene_free(built);
    return p;
}

static void picture_release(struct picture *p)
{
    mem_free(p->half[0]);
    mem_free(p->half[1]);
}

static double mean_of(const struct picture *p, size_t i)
{
    return (p->half[0][i] + p->half[1][i]) / (double)p->spp;
}

/* relMSE of x against r; with x NULL that of r itself, from its halves. */
static double relmse(const struct picture *x, const struct picture *r)
{
    double m = 0, sum = 0;
    for (size_t i = 0; i < r->values; i++)
        m += mean_of(r, i) / (double)r->values;
    double half = (double)r->spp / 2;
    for (size_t i = 0; i < r->values; i++) {
        double v = mean_of(r, i);
        double d = x ? mean_of(x, i) - v : (r->half[0][i] - r->half[1][i]) / half / 2;
        sum += d * d / (v * v + 0.01 * m * m);
    }
    return sum / (double)r->values;
}

struct step {
    double seconds, error;
};

/* When the error crossed the target: between the last step above and the first below. */
static double crossing(const struct step *steps, int count, double target)
{
    for (int i = 0; i < count; i++) {
        if (steps[i].error > target)
            continue;
        if (i == 0)
            return steps[i].seconds;
        double share = log(steps[i - 1].error / target) / log(steps[i - 1].error / steps[i].error);
        return steps[i - 1].seconds * pow(steps[i].seconds / steps[i - 1].seconds, share);
    }
    return (double)NAN;
}

static void report(FILE *json, const char *name, int threads, double target, double seconds,
                   bool *first)
{
    printf("%s: %.3g s to relMSE %g on %d threads\n", name, seconds, target, threads);
    if (!json)
        return;
    fprintf(json, "%s\n  {\"scene\": \"%s\", \"work\": \"relMSE %g\", \"threads\": %d, ",
            *first ? "" : ",", name, target, threads);
    fprintf(json, "\"peer\": null, \"unit\": \"s\", \"ours\": ");
    if (isnan(seconds))
        fprintf(json, "null");
    else
        fprintf(json, "%.6g", seconds);
    fprintf(json, ", \"theirs\": null, \"ratio\": null, \"runs\": 1}");
    *first = false;
}

static int bench_scene(const struct options *o, const char *path, FILE *json, bool *first)
{
    struct scene scene;
    struct job_spec spec;
    struct diag_list problems;
    diag_init(&problems);
    if (scene_json_read_file(path, &scene, &spec, &problems) != ERR_OK) {
        diag_print(&problems, stderr);
        diag_release(&problems);
        return 3;
    }
    diag_release(&problems);
    spec.width = spec.height = o->side;
    spec.crop = (struct job_crop){.width = o->side, .height = o->side};
    struct job_spec other = spec;
    other.seed = spec.seed + 1000;
    other.sampler = JOB_SAMPLER_INDEPENDENT;
    other.spp = o->reference_spp;
    struct picture reference = render(&scene, &other, o->threads);
    double noise = relmse(NULL, &reference);
    printf("%s: reference of %.0f s, relMSE %.2g\n", path, reference.seconds, noise);
    struct step steps[STEPS_MAX];
    int count = 0;
    for (spec.spp = 2; count < STEPS_MAX; spec.spp *= 2) {
        struct picture p = render(&scene, &spec, o->threads);
        double samples = (double)spec.spp * o->side * o->side;
        steps[count] = (struct step){p.seconds, relmse(&p, &reference) - noise};
        printf("  %5llu spp %8.3f s %7.2f Msamples/s %7.2f Mrays/s  relMSE %.3g\n",
               (unsigned long long)spec.spp, p.seconds, samples / p.seconds * 1e-6,
               (double)p.rays / p.seconds * 1e-6, steps[count].error);
        picture_release(&p);
        if (steps[count++].error <= o->target_least || spec.spp * 2 > o->reference_spp)
            break;
    }
    for (int t = 0; t < TARGETS && targets[t] >= o->target_least; t++)
        report(json, path, o->threads, targets[t], crossing(steps, count, targets[t]), first);
    picture_release(&reference);
    scene_release(&scene);
    return 0;
}

static int usage(void)
{
    fprintf(stderr, "usage: bench_render [--quick] [--json FILE] [--scene FILE]... [--side N] "
                    "[--threads N] [--reference-spp N]\n");
    return 2;
}

/* A count between 1 and `most`, or 0. */
static uint64_t count_of(const char *text, uint64_t most)
{
    char *end;
    errno = 0;
    unsigned long long v = strtoull(text, &end, 10);
    return errno || *end || text[0] == '-' || v > most ? 0 : v;
}

static bool options_read(struct options *o, int argc, char **argv)
{
    static const struct option names[] = {{"quick", no_argument, NULL, 'q'},
                                          {"json", required_argument, NULL, 'j'},
                                          {"scene", required_argument, NULL, 's'},
                                          {"side", required_argument, NULL, 'w'},
                                          {"threads", required_argument, NULL, 't'},
                                          {"reference-spp", required_argument, NULL, 'r'},
                                          {NULL, 0, NULL, 0}};
    *o = (struct options){.threads = 2, .side = 512, .reference_spp = 4096, .target_least = 0.001};
    for (int c; (c = getopt_long(argc, argv, "", names, NULL)) != -1;) {
        if (c == 'q') {
            o->side = 128;
            o->reference_spp = 1024;
            o->target_least = 0.01;
        } else if (c == 'j') {
            o->json = optarg;
        } else if (c == 's' && o->scene_count < SCENES_MAX) {
            o->scenes[o->scene_count++] = optarg;
        } else if (c == 'w') {
            o->side = (uint32_t)count_of(optarg, 4096);
        } else if (c == 't') {
            o->threads = (int)count_of(optarg, THREADS_MAX);
        } else if (c == 'r') {
            o->reference_spp = count_of(optarg, 1 << 20);
        } else {
            return false;
        }
    }
    return optind == argc && o->side && o->threads && o->reference_spp >= 2;
}

int main(int argc, char **argv)
{
    struct options o;
    if (!options_read(&o, argc, argv))
        return usage();
    if (o.scene_count == 0) {
        memcpy(o.scenes, default_scenes, sizeof default_scenes);
        o.scene_count = sizeof default_scenes / sizeof *default_scenes;
    }
    struct utsname machine;
    FILE *json = NULL;
    if (o.json && !(json = fopen(o.json, "w"))) {
        fprintf(stderr, "bench_render: %s: %s\n", o.json, strerror(errno));
        return 5;
    }
    (void)uname(&machine);
    if (json)
        fprintf(json, "{\"machine\": \"%s\", \"cases\": [", machine.nodename);
    bool first = true;
    int status = 0;
    for (int i = 0; i < o.scene_count && status == 0; i++)
        status = bench_scene(&o, o.scenes[i], json, &first);
    if (json) {
        fprintf(json, "\n]}\n");
        if (fclose(json) != 0)
            status = 5;
    }
    return status;
}
