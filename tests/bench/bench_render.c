/* tests/bench/bench_render.c: pictures: how many seconds until the error is small, beside Mitsuba
 * and Cycles.
 *
 * Renders each scene in this process, on a few threads through render_unit(), at 2, 4, 8, ...
 * samples a pixel until the relMSE against a reference is below the targets, and gives the time at
 * which it crossed each (between two steps as if error and time were powers of each other). After
 * each such series the peers do the same, in processes of their own; and all that several times.
 * The reference is ours, with another seed; its own noise, measured from its halves, is taken off.
 *
 * usage: bench_render [--quick] [--json FILE] [--scene FILE]... [--side N] [--threads N]
 *                     [--reference-spp N] [--runs N] [--peer llvm|scalar|cycles|none] [--cpu]
 * To be run in the top folder. Ours includes building the scene; the peer's time leaves out loading
 * and compiling. --cpu counts processor time over the threads in place of the clock on the wall: on
 * a machine with other work it says what a quiet one would do. Without a peer (tests/mitsuba/run,
 * tests/cycles/run) "theirs" and "ratio" are null; Cycles matches the Cornell boxes. --quick: small
 * pictures, one target, under five minutes.
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
#include "tests/bench/render_peer.h"
#include "worker/render/render.h"
#include "worker/scene/scene_build.h"

enum { THREADS_MAX = 256, SCENES_MAX = 32, TARGETS = 2, STEPS_MAX = 24, PEERS = 3, RUNS_MAX = 99 };

static const double targets[TARGETS] = {0.01, 0.001};
static const char *const default_scenes[] = {
    "scenes/cbox.json", "tests/mitsuba/scenes/glass_block.json", "scenes/glass_cbox.json",
    "tests/mitsuba/scenes/textured_mesh.json", "tests/mitsuba/scenes/veach_plates.json"};
/* Each a command that takes a scene, --size, --threads, and what else stands here. */
static const struct {
    const char *name, *title, *command[3];
} peer_list[PEERS] = {
    {"llvm", "mitsuba llvm", {"tests/mitsuba/run", "bench", "--variant=llvm_ad_rgb"}},
    {"scalar", "mitsuba scalar", {"tests/mitsuba/run", "bench", "--variant=scalar_rgb"}},
    {"cycles", "cycles", {"tests/cycles/run"}},
};

struct options {
    const char *json, *scenes[SCENES_MAX];
    int scene_count, threads, runs;
    bool peers[PEERS], cpu;
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

static double now_s(clockid_t clock)
{
    struct timespec t;
    (void)clock_gettime(clock, &t);
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

static struct picture render(const struct scene *scene, const struct job_spec *spec, int threads,
                             bool cpu)
{
    clockid_t clock = cpu ? CLOCK_PROCESS_CPUTIME_ID : CLOCK_MONOTONIC;
    struct picture p = {.spp = spec->spp};
    struct render_scene *built;
    struct grid grid;
    p.values = (size_t)spec->crop.width * spec->crop.height * 3;
    p.half[0] = need(mem_calloc(p.values, sizeof **p.half));
    p.half[1] = need(mem_calloc(p.values, sizeof **p.half));
    double start = now_s(clock);
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
    p.seconds = (now_s(clock) - start) / (cpu ? threads : 1);
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

/* One scene under way. */
struct contest {
    const struct options *options;
    struct scene scene;
    struct job_spec spec;
    struct picture reference;
    double noise; /* relMSE of the reference */
};

/* A picture of a peer as one of ours. */
static bool render_theirs(const struct contest *c, struct render_peer *peer, uint64_t spp,
                          uint64_t seed, struct picture *p)
{
    *p = (struct picture){.values = c->reference.values, .spp = spp};
    double seconds, cpu;
    p->half[0] = need(mem_calloc(p->values, sizeof **p->half));
    p->half[1] = need(mem_calloc(p->values, sizeof **p->half));
    if (!render_peer_render(peer, spp, seed, p->values / 3, p->half[0], &seconds, &cpu)) {
        picture_release(p);
        return false;
    }
    for (size_t i = 0; i < p->values; i++)
        p->half[0][i] *= (double)spp;
    p->seconds = c->options->cpu ? cpu / c->options->threads : seconds;
    return true;
}

/* Doubles the samples until the last target is met; ours if `peer` is NULL. The times at which the
 * targets were met, NaN where they were not. */
static void race(struct contest *c, struct render_peer *peer, uint64_t seed, const char *name,
                 double times[TARGETS])
{
    const struct options *o = c->options;
    struct step steps[STEPS_MAX];
    int count = 0;
    c->spec.seed = seed;
    for (c->spec.spp = 2; count < STEPS_MAX; c->spec.spp *= 2) {
        struct picture p;
        if (!peer)
            p = render(&c->scene, &c->spec, o->threads, o->cpu);
        else if (!render_theirs(c, peer, c->spec.spp, seed, &p))
            break;
        double samples = (double)c->spec.spp * o->side * o->side;
        steps[count] = (struct step){p.seconds, relmse(&p, &c->reference) - c->noise};
        printf("  %-14s %5llu spp %8.3f s %7.2f Msamples/s  relMSE %.3g\n", name,
               (unsigned long long)c->spec.spp, p.seconds, samples / p.seconds * 1e-6,
               steps[count].error);
        picture_release(&p);
        if (steps[count++].error <= o->target_least || c->spec.spp * 2 > o->reference_spp)
            break;
    }
    for (int t = 0; t < TARGETS; t++)
        times[t] = targets[t] >= o->target_least ? crossing(steps, count, targets[t]) : (double)NAN;
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Median of those that are numbers; they are sorted to the front. NaN if there is none. */
static double median(double *v, int *count)
{
    int kept = 0;
    for (int i = 0; i < *count; i++)
        if (!isnan(v[i]))
            v[kept++] = v[i];
    *count = kept;
    qsort(v, (size_t)kept, sizeof *v, compare_doubles);
    if (kept == 0)
        return (double)NAN;
    return kept % 2 ? v[kept / 2] : 0.5 * (v[kept / 2 - 1] + v[kept / 2]);
}

static void put_number(FILE *json, const char *key, double v)
{
    fprintf(json, "\"%s\": ", key);
    if (isnan(v))
        fprintf(json, "null");
    else
        fprintf(json, "%.6g", v);
}

/* One line and one case: times [run], with `theirs` NULL without a peer. */
static void report(FILE *json, const struct options *o, const char *scene, double target,
                   const char *peer, double (*ours)[TARGETS], double (*theirs)[TARGETS], int t,
                   bool *first)
{
    double a[RUNS_MAX], b[RUNS_MAX], r[RUNS_MAX];
    int a_count = o->runs, b_count = o->runs, r_count = o->runs;
    for (int i = 0; i < o->runs; i++) {
        a[i] = ours[i][t];
        b[i] = theirs ? theirs[i][t] : (double)NAN;
        r[i] = b[i] / a[i];
    }
    double mine = median(a, &a_count), other = median(b, &b_count), ratio = median(r, &r_count);
    printf("%s: relMSE %g on %d threads: %.3g s", scene, target, o->threads, mine);
    if (theirs)
        printf(", %s %.3g s, ratio %.2f", peer, other, ratio);
    if (r_count > 0)
        printf(" (%.2f to %.2f)", r[0], r[r_count - 1]);
    printf(", %d runs\n", o->runs);
    if (!json)
        return;
    fprintf(json, "%s\n  {\"scene\": \"%s\", \"work\": \"relMSE %g\", \"threads\": %d, ",
            *first ? "" : ",", scene, target, o->threads);
    fprintf(json, theirs ? "\"peer\": \"%s\", " : "\"peer\": null, ", peer);
    fprintf(json, "\"unit\": \"%s\", ", o->cpu ? "processor s / threads" : "s");
    put_number(json, "ours", mine);
    fprintf(json, ", ");
    put_number(json, "theirs", other);
    fprintf(json, ", \"ratio\": ");
    if (r_count > 0)
        fprintf(json, "{\"median\": %.4f, \"min\": %.4f, \"max\": %.4f}", ratio, r[0],
                r[r_count - 1]);
    else
        fprintf(json, "null");
    fprintf(json, ", \"runs\": %d}", o->runs);
    *first = false;
}

static bool start_peer(const struct options *o, const char *path, int which,
                       struct render_peer *peer)
{
    char size[32], threads[16];
    snprintf(size, sizeof size, "%ux%u", o->side, o->side);
    snprintf(threads, sizeof threads, "%d", o->threads);
    const char *argv[9] = {NULL};
    size_t count = 0;
    while (count < 3 && peer_list[which].command[count]) {
        argv[count] = peer_list[which].command[count];
        count++;
    }
    const char *const rest[] = {path, "--size", size, "--threads", threads};
    for (size_t i = 0; i < sizeof rest / sizeof *rest; i++)
        argv[count++] = rest[i];
    *peer = (struct render_peer){0};
    if (!o->peers[which])
        return false;
    if (render_peer_start(peer, argv))
        return true;
    printf("%s: no %s to compare with\n", path, peer_list[which].title);
    return false;
}

static void bench_rounds(struct contest *c, const char *path, FILE *json, bool *first)
{
    static double ours[RUNS_MAX][TARGETS], theirs[PEERS][RUNS_MAX][TARGETS];
    const struct options *o = c->options;
    struct render_peer peers[PEERS];
    bool there[PEERS], any = false;
    for (int k = 0; k < PEERS; k++) {
        there[k] = start_peer(o, path, k, &peers[k]);
        any |= there[k];
    }
    for (int run = 0; run < o->runs; run++) {
        race(c, NULL, (uint64_t)run + 1, "ours", ours[run]);
        for (int k = 0; k < PEERS; k++)
            if (there[k])
                race(c, &peers[k], (uint64_t)run + 1, peer_list[k].title, theirs[k][run]);
    }
    for (int t = 0; t < TARGETS && targets[t] >= o->target_least; t++) {
        for (int k = 0; k < PEERS; k++)
            if (there[k])
                report(json, o, path, targets[t], peer_list[k].title, ours, theirs[k], t, first);
        if (!any)
            report(json, o, path, targets[t], "", ours, NULL, t, first);
    }
    for (int k = 0; k < PEERS; k++)
        render_peer_stop(&peers[k]);
}

static int bench_scene(const struct options *o, const char *path, FILE *json, bool *first)
{
    struct contest c = {.options = o};
    struct diag_list problems;
    diag_init(&problems);
    if (scene_json_read_file(path, &c.scene, &c.spec, &problems) != ERR_OK) {
        diag_print(&problems, stderr);
        diag_release(&problems);
        return 3;
    }
    diag_release(&problems);
    c.spec.width = c.spec.height = o->side;
    c.spec.crop = (struct job_crop){.width = o->side, .height = o->side};
    struct job_spec other = c.spec;
    other.seed = c.spec.seed + 1000;
    other.spp = o->reference_spp;
    c.reference = render(&c.scene, &other, o->threads, o->cpu);
    c.noise = relmse(NULL, &c.reference);
    printf("%s: reference of %.0f s, relMSE %.2g\n", path, c.reference.seconds, c.noise);
    bench_rounds(&c, path, json, first);
    picture_release(&c.reference);
    scene_release(&c.scene);
    return 0;
}

static int usage(void)
{
    fprintf(stderr, "usage: bench_render [--quick] [--json FILE] [--scene FILE]... [--side N] "
                    "[--threads N] [--reference-spp N] [--runs N] "
                    "[--peer llvm|scalar|cycles|none] [--cpu]\n");
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
    static const struct option names[] = {
        {"quick", no_argument, NULL, 'q'},         {"json", required_argument, NULL, 'j'},
        {"scene", required_argument, NULL, 's'},   {"side", required_argument, NULL, 'w'},
        {"threads", required_argument, NULL, 't'}, {"reference-spp", required_argument, NULL, 'r'},
        {"runs", required_argument, NULL, 'n'},    {"peer", required_argument, NULL, 'p'},
        {"cpu", no_argument, NULL, 'c'},           {NULL, 0, NULL, 0}};
    *o = (struct options){.threads = 2,
                          .runs = 3,
                          .peers = {true, true, true},
                          .side = 256,
                          .reference_spp = 2048,
                          .target_least = 0.001};
    for (int c; (c = getopt_long(argc, argv, "", names, NULL)) != -1;) {
        if (c == 'q') {
            o->side = 128;
            o->reference_spp = 512;
            o->target_least = 0.01;
        } else if (c == 'j') {
            o->json = optarg;
        } else if (c == 's' && o->scene_count < SCENES_MAX) {
            o->scenes[o->scene_count++] = optarg;
        } else if (c == 'w') {
            o->side = (uint32_t)count_of(optarg, 4096);
        } else if (c == 't') {
            o->threads = (int)count_of(optarg, THREADS_MAX);
        } else if (c == 'n') {
            o->runs = (int)count_of(optarg, RUNS_MAX);
        } else if (c == 'c') {
            o->cpu = true;
        } else if (c == 'p') {
            bool any = false;
            for (int k = 0; k < PEERS; k++)
                any |= o->peers[k] = strcmp(optarg, peer_list[k].name) == 0;
            if (!any && strcmp(optarg, "none") != 0)
                return false;
        } else if (c == 'r') {
            o->reference_spp = count_of(optarg, 1 << 20);
        } else {
            return false;
        }
    }
    return optind == argc && o->side && o->side % 8 == 0 && o->threads && o->runs &&
           o->reference_spp >= 2;
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
