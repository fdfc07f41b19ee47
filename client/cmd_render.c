/* client/cmd_render.c: a render on a farm of our own children.
 *
 * The scene is read on a second thread while the children start, and the first wait is the
 * one for the job. Ctrl-C: the children are asked to end, nothing is left at OUT, exit 130.
 */
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "client/cli_help.h"
#include "client/cmd_wait.h"
#include "client/command.h"
#include "client/follow.h"
#include "client/load.h"
#include "client/out_file.h"
#include "client/private_farm.h"
#include "client/quiet_thread.h"
#include "client/signals.h"

enum {
    INTERRUPT_GRACE_MS = 2000, /* for children that have results on their way */
    HANDSHAKE_S = 20,
    PATIENCE_S = 20,      /* for a master that is being started again */
    BYTES_PER_PIXEL = 12, /* three floats; compression may save some, noise hardly */
    FILE_OVERHEAD_BYTES = 65536,
    FILM_BYTES_PER_PIXEL = 48, /* two halves of three doubles */
};

struct render {
    struct cli *cli;
    struct private_farm farm;
    bool farm_runs;
    struct farm api;
    struct load load;
    pthread_t loader;
    bool loading;      /* the thread has not been joined */
    int loaded_fds[2]; /* a byte when the scene is there */
    struct progress progress;
    double start_s;
    struct cmd_start start;
    char job[FARM_ID_BYTES];
    int status; /* set by a hook that stops the wait */
};

/* What is verified needs a second worker. */
static uint32_t worker_count(const struct cli_line *line)
{
    if (cli_has(line, CLI_WORKER_COUNT))
        return (uint32_t)cli_count(line, CLI_WORKER_COUNT);
    uint32_t workers = cli_default_workers();
    bool verify = cli_has(line, CLI_VERIFY) && cli_share(line, CLI_VERIFY) > 0;
    return verify && workers < 2 ? 2 : workers;
}

static int check_verify(const struct cli_line *line)
{
    if (!cli_has(line, CLI_VERIFY) || cli_share(line, CLI_VERIFY) == 0 || worker_count(line) > 1)
        return EXIT_DONE;
    cli_error("bad-value", "give --workers 2 or more",
              "--verify compares the bits of two workers, and there would be one");
    return EXIT_USAGE;
}

static int check_line(const struct cli_line *line)
{
    static const enum cli_option_id ids[] = {CLI_OUTPUT, CLI_PNG, CLI_REPORT};
    if (!cli_has(line, CLI_OUTPUT)) {
        cli_error("missing-option", "as in tilery render scene.json -o out.exr",
                  "render needs -o OUT.exr");
        return EXIT_USAGE;
    }
    int status = cli_check_outputs(line, ids, 3);
    return status == EXIT_DONE ? check_verify(line) : status;
}

/* Memory that can be had without swapping; 0: not known. */
static uint64_t memory_available(void)
{
    char line[128];
    unsigned long long kilobytes = 0;
    FILE *file = fopen("/proc/meminfo", "re");
    while (file && kilobytes == 0 && fgets(line, sizeof line, file))
        if (strncmp(line, "MemAvailable:", 13) == 0)
            kilobytes = strtoull(line + 13, NULL, 10);
    if (file)
        (void)fclose(file);
    return (uint64_t)kilobytes * 1024;
}

/* The film of the private master lies in memory. */
static int check_memory(uint64_t pixels)
{
    uint64_t needed = pixels * FILM_BYTES_PER_PIXEL, available = memory_available();
    if (available == 0 || needed <= available)
        return EXIT_DONE;
    cli_error("no-memory", "nothing was rendered yet; --crop renders a part, with the same bits",
              "out of memory: the picture needs %.1f GB, %.1f GB are free", (double)needed / 1e9,
              (double)available / 1e9);
    return EXIT_MACHINE;
}

/* Before hours are spent: memory and disk must have room for what the picture may need. */
static int check_room(const struct render *r)
{
    const char *path = cli_text(&r->cli->line, CLI_OUTPUT);
    const struct job_crop *c = &r->load.spec.crop;
    uint64_t pixels = (uint64_t)c->width * c->height;
    uint64_t bytes = pixels * BYTES_PER_PIXEL + FILE_OVERHEAD_BYTES;
    int status = check_memory(pixels);
    if (status != EXIT_DONE)
        return status;
    enum err e = out_file_check(path, bytes);
    return e == ERR_OK ? EXIT_DONE
                       : cli_cannot_write(path, e, errno, bytes, "nothing was rendered yet");
}

/* --- Starting ----------------------------------------------------------- */

static void *load_thread(void *ctx)
{
    struct render *r = ctx;
    load_scene(&r->load, &r->cli->line, false);
    ssize_t ignored = write(r->loaded_fds[1], "", 1);
    (void)ignored;
    return NULL;
}

static int start_loader(struct render *r)
{
    if (pipe2(r->loaded_fds, O_CLOEXEC) != 0) {
        cli_error("machine", NULL, "no pipe: %s", strerror(errno));
        return EXIT_MACHINE;
    }
    int failed = quiet_thread_begin(&r->loader, load_thread, r);
    r->loading = failed == 0;
    if (failed)
        cli_error("machine", NULL, "no thread: %s", strerror(failed));
    return failed ? EXIT_MACHINE : EXIT_DONE;
}

static double unix_now_s(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_REALTIME, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static int farm_failed(struct render *r)
{
    cli_error("farm-failed", NULL, "the private farm failed: %s", r->farm.failure);
    return EXIT_MACHINE;
}

static int start_farm(struct render *r)
{
    const struct cli_line *line = &r->cli->line;
    uint32_t workers = worker_count(line);
    uint32_t threads = cli_has(line, CLI_THREADS) ? (uint32_t)cli_count(line, CLI_THREADS)
                                                  : cli_default_threads(workers);
    enum err e = private_farm_start(&r->farm, workers, threads);
    r->farm_runs = e == ERR_OK;
    return e == ERR_OK ? EXIT_DONE : farm_failed(r);
}

/* Both at once: the scene and the master's addresses. Ends early on a bad scene or Ctrl-C. */
static int wait_ready(struct render *r)
{
    bool connected = false;
    while (r->loading || !connected) {
        struct pollfd fds[3] = {
            {.fd = signals_fd(), .events = POLLIN},
            {.fd = r->loading ? r->loaded_fds[0] : -1, .events = POLLIN},
            {.fd = connected ? -1 : private_farm_fd(&r->farm), .events = POLLIN}};
        (void)poll(fds, 3, 1000);
        signals_clear();
        if (signals_interrupts > 0)
            return EXIT_INTERRUPTED;
        if (r->loading && fds[1].revents) {
            (void)pthread_join(r->loader, NULL);
            r->loading = false;
            int status = load_explain(&r->load, "no job made");
            if (status != EXIT_DONE)
                return status;
        }
        enum err e = connected ? ERR_AGAIN : private_farm_connect(&r->farm);
        connected |= e == ERR_OK;
        if (e == ERR_AGAIN && !connected && follow_now_s() - r->start_s > HANDSHAKE_S) {
            (void)snprintf(r->farm.failure, sizeof r->farm.failure,
                           "the master did not start within %d s", HANDSHAKE_S);
            return farm_failed(r);
        }
        if (e != ERR_OK && e != ERR_AGAIN)
            return farm_failed(r);
    }
    return EXIT_DONE;
}

static int submit(struct render *r)
{
    char url[80];
    double begun = follow_now_s();
    r->start.ready = begun - r->start_s;
    r->start.read = r->load.read_s;
    r->start.pack = r->load.pack_s;
    (void)snprintf(url, sizeof url, "http://%s", r->farm.http);
    int status = farm_open_private(&r->api, url, r->farm.token, &signals_interrupts);
    if (status != EXIT_DONE)
        return status;
    struct farm_job_request request = {.name = "render",
                                       .package = &r->load.package,
                                       .spec_json = r->load.spec_json,
                                       .plan_json = r->load.plan_json};
    status = farm_submit(&r->api, &request, r->job);
    r->start.send = follow_now_s() - begun;
    load_drop_package(&r->load);
    return status;
}

/* --- Waiting ------------------------------------------------------------ */

/* Children that ended are started again; the wait stops when that is of no use. */
static bool on_wake(void *ctx)
{
    struct render *r = ctx;
    uint32_t restarted = 0;
    signals_clear();
    if (signals_interrupts > 0) {
        r->status = EXIT_INTERRUPTED;
        return true;
    }
    if (private_farm_reap(&r->farm, &restarted) != ERR_OK) {
        progress_end(&r->progress);
        r->status = farm_failed(r);
        return true;
    }
    if (restarted > 0) {
        char line[500];
        (void)snprintf(line, sizeof line, "%s; it is started again", r->farm.failure);
        progress_event(&r->progress, line, follow_now_s());
    }
    return false;
}

/* The private master pauses a job that it cannot store. Nobody is there to make room and resume
 * it: for us that is the end. */
static int paused(struct render *r)
{
    char path[FARM_PATH_BYTES];
    struct farm_json reply;
    int status = farm_job_path(r->job, "", path);
    if (status == EXIT_DONE)
        status = farm_call(&r->api, "GET", path, NULL, &reply);
    if (status != EXIT_DONE)
        return status;
    const char *note = reply_text(reply.json.root, "note", "");
    if (strstr(note, err_text(ERR_NOSPACE)))
        (void)cli_cannot_write(r->farm.folder, ERR_NOSPACE, 0, 0,
                               "the output is as it was; TMPDIR may name a larger disk");
    else
        cli_error("farm-failed", NULL, "the private farm failed: %s", note);
    farm_json_release(&reply);
    return EXIT_MACHINE;
}

static int wait_job(struct render *r, bool *done)
{
    progress_init(&r->progress, (enum progress_mode)command_progress_mode(r->cli),
                  r->cli->json ? STDOUT_FILENO : STDERR_FILENO, r->start_s);
    if (r->progress.mode == PROGRESS_LINES)
        cli_say(r->cli, "%s: %ux%u, %s%llu spp, %u worker%s with %u thread%s",
                cli_safe(r->cli->line.arguments[0]), r->load.spec.crop.width,
                r->load.spec.crop.height, r->load.spec.stop == JOB_STOP_SPP ? "" : "at most ",
                (unsigned long long)r->load.spec.spp, r->farm.worker_count,
                r->farm.worker_count == 1 ? "" : "s", r->farm.threads,
                r->farm.threads == 1 ? "" : "s");
    struct follow follow = {.farm = &r->api,
                            .job = r->job,
                            .progress = &r->progress,
                            .wake_fd = signals_fd(),
                            .on_wake = on_wake,
                            .ctx = r,
                            .pause_ends = true,
                            .joins_expected = r->farm.worker_count,
                            .patience_s = PATIENCE_S};
    enum follow_end end = follow_job(&follow);
    progress_end(&r->progress);
    *done = end == FOLLOW_DONE;
    if (end == FOLLOW_PAUSED)
        return paused(r);
    if (end == FOLLOW_FARM_LOST)
        return signals_interrupts > 0 ? EXIT_INTERRUPTED : EXIT_MACHINE;
    return end == FOLLOW_STOPPED ? r->status : EXIT_DONE;
}

/* --- Ending ------------------------------------------------------------- */

/* When the disk at OUT fills up after all: the picture goes to the temporary folder. */
static void rescue(struct render *r)
{
    char path[PATH_MAX];
    const char *root = getenv("TMPDIR");
    (void)snprintf(path, sizeof path, "%s/tilery-saved-%ld.exr",
                   root && root[0] == '/' ? root : "/tmp", (long)getpid());
    if (farm_fetch_picture(&r->api, r->job, "picture.exr", path, NULL) == EXIT_DONE)
        (void)fprintf(stderr, "  nothing lost: the picture is at %s\n", path);
}

static int fetch(struct render *r)
{
    const struct cli_line *line = &r->cli->line;
    int status =
        farm_fetch_picture(&r->api, r->job, farm_exr_of(line), cli_text(line, CLI_OUTPUT), NULL);
    if (status == EXIT_MACHINE)
        rescue(r);
    if (status == EXIT_DONE && cli_has(line, CLI_PNG))
        status = farm_fetch_picture(&r->api, r->job, "picture.png", cli_text(line, CLI_PNG), NULL);
    return status;
}

static void stop_interrupted(struct render *r)
{
    if (!r->cli->quiet && r->farm_runs && signals_interrupts == 1)
        (void)fprintf(stderr, "stopping %u workers (again to kill)\n", r->farm.worker_count);
    if (r->farm_runs) {
        private_farm_ask_end(&r->farm);
        private_farm_end(&r->farm, INTERRUPT_GRACE_MS);
    }
    if (r->loading) {
        /* The loader cannot be stopped; with it still reading, nothing may be freed. */
        (void)fflush(NULL);
        _exit(EXIT_INTERRUPTED);
    }
}

static int run(struct render *r)
{
    bool done = false;
    int status = start_farm(r);
    if (status == EXIT_DONE)
        status = start_loader(r);
    if (status == EXIT_DONE)
        status = wait_ready(r);
    if (status == EXIT_DONE)
        status = check_room(r);
    if (status == EXIT_DONE)
        status = submit(r);
    if (status == EXIT_DONE)
        status = wait_job(r, &done);
    if (status == EXIT_DONE && done)
        status = fetch(r);
    if (status == EXIT_DONE)
        status = cmd_wait_report(&r->api, r->cli, r->job, cli_text(&r->cli->line, CLI_OUTPUT),
                                 r->start_s, &r->start, done);
    /* A call that was interrupted fails in its own way; what matters is that we were. */
    return signals_interrupts > 0 ? EXIT_INTERRUPTED : status;
}

int command_render(struct cli *cli)
{
    struct render r = {.cli = cli, .loaded_fds = {-1, -1}, .start_s = follow_now_s()};
    r.start.begun_at = unix_now_s();
    int status = check_line(&cli->line);
    if (status != EXIT_DONE)
        return status;
    if (signals_install() != ERR_OK) {
        cli_error("machine", NULL, "cannot watch for signals: %s", strerror(errno));
        return EXIT_MACHINE;
    }
    status = run(&r);
    if (status == EXIT_INTERRUPTED)
        stop_interrupted(&r);
    /* All that is wanted of it is here: it is not asked to put its things in order. */
    if (r.farm_runs && status != EXIT_INTERRUPTED)
        private_farm_end(&r.farm, 0);
    if (r.loading)
        (void)pthread_join(r.loader, NULL);
    farm_release(&r.api);
    load_release(&r.load);
    for (int i = 0; i < 2; i++)
        if (r.loaded_fds[i] >= 0)
            (void)close(r.loaded_fds[i]);
    return status;
}
