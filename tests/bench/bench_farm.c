/* tests/bench/bench_farm.c: what the farm costs over the bare tracing core.
 *
 * overhead   `tilery render` with two one-thread workers against a loop over render_unit() on two
 *            threads of this process without sockets: scene read, built and rendered in both,
 *            runs interleaved, ratio bare / farm (1 would be a farm that costs nothing).
 *            The same for processor seconds of all processes, which say on a machine under load
 *            what wall time cannot; the rest of the wall time is waiting: start, end, hand-over.
 * per job    small jobs one after the other on a running farm: wall time of `tilery submit
 *            --wait` less the same render in this process, in milliseconds a job.
 *
 * usage: bench_farm [--quick] [--json FILE] [--scene FILE] [--spp N] [--runs N]
 */
#include <getopt.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/utsname.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "common/grid.h"
#include "common/mem.h"
#include "common/scene_json.h"
#include "worker/render/render.h"
#include "worker/scene/scene_build.h"

enum { THREADS = 2, CELLS_PER_UNIT = 8, RUNS_MAX = 99, JOBS_PER_RUN = 10, PATH_BYTES = 4096 };

struct options {
    const char *scene, *json;
    uint64_t spp;
    int runs;
    bool quick;
};

static char bin_folder[PATH_BYTES];

static double now_s(void)
{
    struct timespec t;
    (void)clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* What a run took. */
struct cost {
    double wall_s, cpu_s;
};

/* Processor seconds so far: of this process, or of its children that have ended. */
static double cpu_s(int who)
{
    struct rusage u;
    (void)getrusage(who, &u);
    return (double)(u.ru_utime.tv_sec + u.ru_stime.tv_sec) +
           1e-6 * (double)(u.ru_utime.tv_usec + u.ru_stime.tv_usec);
}

static void fail(const char *what)
{
    (void)fprintf(stderr, "bench_farm: %s\n", what);
    exit(1);
}

/* --- The bare loop --------------------------------------------------------- */

struct bare {
    const struct render_scene *scene;
    struct grid grid;
    struct job_blocks blocks;
    uint32_t unit_count, units_per_block;
    atomic_uint next;
    atomic_uint_fast64_t rays;
};

static void *bare_thread(void *arg)
{
    struct bare *b = arg;
    struct render_scratch *scratch;
    uint64_t pixels_max = (uint64_t)b->grid.tile * b->grid.tile * CELLS_PER_UNIT;
    float *rgb = mem_alloc_array(pixels_max * JOB_COLOR_PLANES, sizeof *rgb);
    if (!rgb || render_scratch_new(&scratch) != ERR_OK)
        fail("out of memory");
    for (uint32_t i; (i = atomic_fetch_add(&b->next, 1)) < b->unit_count;) {
        uint32_t begin = i % b->units_per_block * CELLS_PER_UNIT;
        uint32_t left = b->grid.cell_count - begin;
        struct unit unit = {.cell_begin = begin,
                            .cell_count = left < CELLS_PER_UNIT ? left : CELLS_PER_UNIT,
                            .block = i / b->units_per_block};
        struct render_counters counters;
        if (render_unit(b->scene, &b->grid, unit, scratch, NULL, rgb, &counters) != ERR_OK)
            fail("render_unit failed");
        atomic_fetch_add(&b->rays, counters.rays);
    }
    render_scratch_free(scratch);
    mem_free(rgb);
    return NULL;
}

/* To read, build and render the scene on THREADS threads. */
static struct cost bare_cost(const struct options *o, uint32_t side, uint64_t spp)
{
    double start = now_s(), start_cpu = cpu_s(RUSAGE_SELF);
    struct scene scene;
    struct job_spec spec;
    struct diag_list problems;
    diag_init(&problems);
    if (scene_json_read_file(o->scene, &scene, &spec, &problems) != ERR_OK) {
        diag_print(&problems, stderr);
        exit(3);
    }
    spec.spp = spp;
    spec.width = spec.height = side;
    spec.crop = (struct job_crop){.width = side, .height = side};
    struct render_scene *built;
    struct bare b = {.blocks = job_blocks_of(spp)};
    if (scene_build(&scene, &spec, NULL, &built) != ERR_OK || grid_init(&b.grid, &spec) != ERR_OK)
        fail("cannot build the scene");
    b.scene = built;
    b.units_per_block = (b.grid.cell_count + CELLS_PER_UNIT - 1) / CELLS_PER_UNIT;
    b.unit_count = b.units_per_block * b.blocks.count;
    pthread_t threads[THREADS];
    for (int i = 0; i < THREADS; i++)
        if (pthread_create(&threads[i], NULL, bare_thread, &b) != 0)
            fail("cannot start a thread");
    for (int i = 0; i < THREADS; i++)
        (void)pthread_join(threads[i], NULL);
    struct cost cost = {now_s() - start, cpu_s(RUSAGE_SELF) - start_cpu};
    grid_release(&b.grid);
    render_scene_free(built);
    scene_release(&scene);
    diag_release(&problems);
    return cost;
}

/* --- The farm ---------------------------------------------------------------- */

/* Starts bin/NAME; with `out` its standard output is readable there. */
static pid_t start(const char *name, char *const args[], FILE **out)
{
    int ends[2] = {-1, -1};
    if (out && pipe(ends) != 0)
        fail("pipe");
    pid_t pid = fork();
    if (pid < 0)
        fail("fork");
    if (pid == 0) {
        char path[PATH_BYTES + 64];
        (void)snprintf(path, sizeof path, "%s/%s", bin_folder, name);
        if (out)
            (void)dup2(ends[1], STDOUT_FILENO);
        execv(path, args);
        _exit(127);
    }
    if (out) {
        (void)close(ends[1]);
        *out = fdopen(ends[0], "r");
    }
    return pid;
}

static void finish(pid_t pid, const char *what)
{
    int status;
    if (waitpid(pid, &status, 0) != pid || !WIFEXITED(status) || WEXITSTATUS(status) != 0)
        fail(what);
}

static struct cost farm_cost(const struct options *o, uint32_t side, uint64_t spp, const char *out)
{
    char spp_text[32], size[32];
    (void)snprintf(spp_text, sizeof spp_text, "%llu", (unsigned long long)spp);
    (void)snprintf(size, sizeof size, "%ux%u", side, side);
    char *args[] = {
        "tilery", "render", (char *)o->scene, "-o",     (char *)out, "--workers", "2", "--threads",
        "1",      "--spp",  spp_text,         "--size", size,        "--quiet",   NULL};
    double begin = now_s(), begin_cpu = cpu_s(RUSAGE_CHILDREN);
    finish(start("tilery", args, NULL), "tilery render failed");
    return (struct cost){now_s() - begin, cpu_s(RUSAGE_CHILDREN) - begin_cpu};
}

/* The value of "key": "..." in one line of JSON. */
static void json_value(const char *line, const char *key, char *out, size_t out_bytes)
{
    const char *at = strstr(line, key);
    at = at ? strchr(at + strlen(key) + 1, '"') : NULL;
    const char *end = at ? strchr(at + 1, '"') : NULL;
    if (!end || (size_t)(end - at) > out_bytes)
        fail("a daemon's first line is not as documented");
    memcpy(out, at + 1, (size_t)(end - at - 1));
    out[end - at - 1] = '\0';
}

struct farm {
    pid_t master, workers[THREADS];
    FILE *outputs[THREADS + 1];
    char folder[64];
};

static void farm_start(struct farm *f)
{
    char line[256], listen_at[64], http[64], url[96];
    (void)snprintf(f->folder, sizeof f->folder, "/tmp/bench_farm.XXXXXX");
    if (!mkdtemp(f->folder))
        fail("mkdtemp");
    char *master_args[] = {"tilery-master", "--listen", "127.0.0.1:0", "--http", "127.0.0.1:0",
                           "--data",        f->folder,  "--log",       "warn",   NULL};
    f->master = start("tilery-master", master_args, &f->outputs[0]);
    if (!fgets(line, sizeof line, f->outputs[0]))
        fail("the master did not start");
    json_value(line, "\"listen\"", listen_at, sizeof listen_at);
    json_value(line, "\"http\"", http, sizeof http);
    for (int i = 0; i < THREADS; i++) {
        char *args[] = {"tilery-worker", "--master", listen_at, "--threads", "1",
                        "--log",         "warn",     NULL};
        f->workers[i] = start("tilery-worker", args, &f->outputs[i + 1]);
        if (!fgets(line, sizeof line, f->outputs[i + 1]))
            fail("a worker did not register");
    }
    (void)snprintf(url, sizeof url, "http://%s", http);
    (void)setenv("TILERY_MASTER", url, 1);
}

static void farm_stop(struct farm *f)
{
    for (int i = 0; i < THREADS; i++) {
        (void)kill(f->workers[i], SIGTERM);
        (void)waitpid(f->workers[i], NULL, 0);
    }
    (void)kill(f->master, SIGTERM);
    (void)waitpid(f->master, NULL, 0);
    for (int i = 0; i <= THREADS; i++)
        (void)fclose(f->outputs[i]);
    char command[128];
    (void)snprintf(command, sizeof command, "rm -rf '%s'", f->folder);
    if (system(command) != 0)
        fail("cannot remove the farm's folder");
}

/* Milliseconds a small job costs on a running farm besides its rendering. */
static double per_job_ms(const struct options *o, const char *out)
{
    char *args[] = {"tilery", "submit", (char *)o->scene, "--size",  "64x64", "--spp", "2",
                    "--wait", "-o",     (char *)out,      "--quiet", NULL};
    double begin = now_s();
    for (int i = 0; i < JOBS_PER_RUN; i++) {
        FILE *ignored;
        pid_t pid = start("tilery", args, &ignored);
        finish(pid, "tilery submit --wait failed");
        (void)fclose(ignored);
    }
    double farm = now_s() - begin, bare = 0;
    for (int i = 0; i < JOBS_PER_RUN; i++)
        bare += bare_cost(o, 64, 2).wall_s;
    return (farm - bare) / JOBS_PER_RUN * 1e3;
}

/* --- Figures ------------------------------------------------------------------ */

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

struct series {
    double values[RUNS_MAX];
    int count;
};

static double series_at(const struct series *s, double share)
{
    double sorted[RUNS_MAX];
    memcpy(sorted, s->values, (size_t)s->count * sizeof *sorted);
    qsort(sorted, (size_t)s->count, sizeof *sorted, compare_doubles);
    return sorted[(int)(share * (s->count - 1) + 0.5)];
}

static void json_case(FILE *to, const char *work, const char *peer, const char *unit,
                      const struct series *ours, const struct series *theirs,
                      const struct series *ratio)
{
    (void)fprintf(to,
                  "{\"scene\": \"report\", \"work\": \"%s\", \"threads\": %d, \"peer\": \"%s\", "
                  "\"unit\": \"%s\", \"ours\": %.6g, \"theirs\": %.6g, \"ratio\": {\"median\": "
                  "%.4f, \"min\": %.4f, \"max\": %.4f}, \"runs\": %d}",
                  work, THREADS, peer, unit, series_at(ours, 0.5), series_at(theirs, 0.5),
                  series_at(ratio, 0.5), series_at(ratio, 0), series_at(ratio, 1), ours->count);
}

static void push(struct series *s, double value)
{
    s->values[s->count++] = value;
}

/* The farm beside the bare loop, run by run. */
struct against {
    struct series bare, farm, ratio;
};

static void against_push(struct against *a, double bare, double farm)
{
    push(&a->bare, bare);
    push(&a->farm, farm);
    push(&a->ratio, bare / farm);
}

static void against_print(const char *what, const struct against *a)
{
    printf("%s median %+.2f %% (%+.2f to %+.2f)\n", what, (1 / series_at(&a->ratio, 0.5) - 1) * 100,
           (1 / series_at(&a->ratio, 1) - 1) * 100, (1 / series_at(&a->ratio, 0) - 1) * 100);
}

static void parse(int argc, char **argv, struct options *o)
{
    static const struct option table[] = {
        {"quick", no_argument, NULL, 'q'},       {"json", required_argument, NULL, 'j'},
        {"scene", required_argument, NULL, 's'}, {"spp", required_argument, NULL, 'n'},
        {"runs", required_argument, NULL, 'r'},  {0}};
    *o = (struct options){.scene = "scenes/glass_cbox.json", .spp = 64, .runs = 5};
    for (int c; (c = getopt_long(argc, argv, "", table, NULL)) != -1;) {
        if (c == 'q')
            o->quick = true;
        else if (c == 'j')
            o->json = optarg;
        else if (c == 's')
            o->scene = optarg;
        else if (c == 'n')
            o->spp = strtoull(optarg, NULL, 10);
        else if (c == 'r')
            o->runs = (int)strtol(optarg, NULL, 10);
        else
            exit(2);
    }
    if (o->quick)
        o->runs = 3;
    if (o->runs < 1 || o->runs > RUNS_MAX || o->spp < 1)
        fail("--runs is 1 to 99, --spp at least 1");
}

static void find_bin(void)
{
    ssize_t bytes = readlink("/proc/self/exe", bin_folder, sizeof bin_folder - 1);
    if (bytes <= 0)
        fail("cannot find the programs beside this one");
    bin_folder[bytes] = '\0';
    *strrchr(bin_folder, '/') = '\0';
}

int main(int argc, char **argv)
{
    struct options o;
    parse(argc, argv, &o);
    find_bin();
    char out[64];
    (void)snprintf(out, sizeof out, "/tmp/bench_farm.%d.exr", (int)getpid());

    struct against wall = {0}, cpu = {0};
    struct series job = {0}, zero = {0}, one = {0};
    for (int i = 0; i < o.runs; i++) {
        struct cost bare = bare_cost(&o, 512, o.spp), farm = farm_cost(&o, 512, o.spp, out);
        against_push(&wall, bare.wall_s, farm.wall_s);
        against_push(&cpu, bare.cpu_s, farm.cpu_s);
        printf("overhead  run %d: bare %.3f s, farm %.3f s, overhead %+.2f %%; processor %.3f s, "
               "%.3f s, %+.2f %%\n",
               i + 1, bare.wall_s, farm.wall_s, (farm.wall_s / bare.wall_s - 1) * 100, bare.cpu_s,
               farm.cpu_s, (farm.cpu_s / bare.cpu_s - 1) * 100);
        (void)fflush(stdout);
    }
    struct farm running;
    farm_start(&running);
    (void)per_job_ms(&o, out); /* warms the workers' caches */
    for (int i = 0; i < o.runs; i++) {
        push(&job, per_job_ms(&o, out));
        push(&zero, 20);
        push(&one, 20 / job.values[i]);
        printf("per job   run %d: %.1f ms besides the rendering\n", i + 1, job.values[i]);
    }
    farm_stop(&running);
    (void)unlink(out);
    against_print("overhead ", &wall);
    against_print("processor", &cpu);
    printf("per job   median %.1f ms (%.1f to %.1f)\n", series_at(&job, 0.5), series_at(&job, 0),
           series_at(&job, 1));

    FILE *json = o.json ? fopen(o.json, "w") : NULL;
    if (o.json && !json)
        fail("cannot write the JSON file");
    if (json) {
        struct utsname machine;
        (void)uname(&machine);
        (void)fprintf(json, "{\"machine\": \"%s %s, %ld cores\", \"cases\": [", machine.sysname,
                      machine.machine, sysconf(_SC_NPROCESSORS_ONLN));
        json_case(json, "render 512x512", "bare render_unit loop", "s", &wall.farm, &wall.bare,
                  &wall.ratio);
        (void)fputs(", ", json);
        json_case(json, "render 512x512", "bare render_unit loop", "processor s", &cpu.farm,
                  &cpu.bare, &cpu.ratio);
        (void)fputs(", ", json);
        json_case(json, "job on a running farm", "goal of 20 ms", "ms", &job, &zero, &one);
        (void)fputs("]}\n", json);
        if (fclose(json) != 0)
            fail("cannot write the JSON file");
    }
    return 0;
}
