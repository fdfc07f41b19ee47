#include "client/study_farm.h"

#include <inttypes.h>
#include <math.h>
#include <poll.h>
#include <string.h>
#include <time.h>

#include "client/cli_help.h"
#include "client/follow.h"
#include "client/picture.h"
#include "client/signals.h"
#include "common/mem.h"

enum { HANDSHAKE_S = 20, PATIENCE_S = 20 };

static int farm_failed(const struct study_farm *f)
{
    cli_error("farm-failed", NULL, "the private farm failed: %s", f->own.failure);
    return EXIT_MACHINE;
}

/* --- Starting and ending ---------------------------------------------------- */

static int connect_own(struct study_farm *f)
{
    char url[80];
    double start_s = follow_now_s();
    for (;;) {
        enum err e = private_farm_connect(&f->own);
        if (e == ERR_OK)
            break;
        if (signals_interrupts > 0)
            return EXIT_INTERRUPTED;
        if (e == ERR_AGAIN && follow_now_s() - start_s > HANDSHAKE_S)
            (void)snprintf(f->own.failure, sizeof f->own.failure,
                           "the master did not start within %d s", HANDSHAKE_S);
        else if (e == ERR_AGAIN) {
            struct pollfd fds[2] = {{.fd = signals_fd(), .events = POLLIN},
                                    {.fd = private_farm_fd(&f->own), .events = POLLIN}};
            (void)poll(fds, 2, 1000);
            signals_clear();
            continue;
        }
        return farm_failed(f);
    }
    (void)snprintf(url, sizeof url, "http://%s", f->own.http);
    return farm_open_private(&f->api, url, f->own.token, &signals_interrupts);
}

/* One worker with all threads: each worker builds its own tree, and here jobs are short. */
static int start_own(struct study_farm *f)
{
    const struct cli_line *line = &f->cli->line;
    f->workers = cli_has(line, CLI_WORKER_COUNT) ? (uint32_t)cli_count(line, CLI_WORKER_COUNT) : 1;
    uint32_t threads = cli_has(line, CLI_THREADS) ? (uint32_t)cli_count(line, CLI_THREADS)
                                                  : cli_default_threads(f->workers);
    f->threads = threads * f->workers;
    if (private_farm_start(&f->own, f->workers, threads) != ERR_OK)
        return farm_failed(f);
    f->own_runs = true;
    return connect_own(f);
}

int study_farm_open(struct study_farm *f, struct cli *cli, struct progress *progress)
{
    *f = (struct study_farm){
        .cli = cli, .progress = progress, .start_s = follow_now_s(), .deadline_s = HUGE_VAL};
    load_scene(&f->load, &cli->line, false);
    int status = load_explain(&f->load, "nothing measured");
    if (status != EXIT_DONE)
        return status;
    bool named = cli_has(&cli->line, CLI_MASTER) && cli->origins[CLI_MASTER] == CLI_FROM_OPTION;
    return named ? farm_open(&f->api, cli) : start_own(f);
}

void study_farm_close(struct study_farm *f)
{
    if (f->own_runs)
        private_farm_end(&f->own, 0);
    farm_release(&f->api);
    load_release(&f->load);
    f->own_runs = false;
}

/* --- CPU time of the workers ------------------------------------------------ */

double study_farm_cpu_s(const struct study_farm *f)
{
    double sum = 0;
    for (uint32_t i = 0; f->own_runs && i < f->own.worker_count; i++) {
        clockid_t clock;
        struct timespec now;
        if (f->own.workers[i].pid == 0 || clock_getcpuclockid(f->own.workers[i].pid, &clock) != 0 ||
            clock_gettime(clock, &now) != 0)
            return (double)NAN;
        sum += (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
    }
    return f->own_runs ? sum : (double)NAN;
}

/* --- One render ------------------------------------------------------------- */

struct waiting {
    struct study_farm *farm;
    int status;
    bool restarted; /* a worker crashed: its CPU time is lost */
};

static bool on_wake(void *ctx)
{
    struct waiting *w = ctx;
    uint32_t restarted = 0;
    signals_clear();
    if (signals_interrupts > 0)
        w->status = EXIT_INTERRUPTED;
    else if (follow_now_s() > w->farm->deadline_s)
        w->status = STUDY_OUT_OF_TIME;
    else if (w->farm->own_runs && private_farm_reap(&w->farm->own, &restarted) != ERR_OK)
        w->status = farm_failed(w->farm);
    w->restarted |= restarted > 0;
    progress_tick(w->farm->progress, follow_now_s());
    return w->status != EXIT_DONE;
}

/* A job of ours that nobody waits for any more. Ctrl-C makes calls fail: this one must not. */
static void cancel(struct study_farm *f, const char *job)
{
    static const char body[] = "{\"state\":\"cancelled\"}";
    char path[FARM_PATH_BYTES];
    sig_atomic_t interrupts = signals_interrupts;
    if (farm_job_path(job, "", path) != EXIT_DONE)
        return;
    struct http_request request = {.method = "PATCH",
                                   .path = path,
                                   .body = body,
                                   .body_bytes = sizeof body - 1,
                                   .content_type = "application/json"};
    signals_interrupts = 0;
    (void)!http_call(f->api.http, &request, &f->api.reply);
    signals_interrupts += interrupts;
}

static int ended_badly(struct study_farm *f, const char *job, enum follow_end end)
{
    if (end == FOLLOW_FARM_LOST)
        return signals_interrupts > 0 ? EXIT_INTERRUPTED : f->own_runs ? EXIT_MACHINE : EXIT_FARM;
    progress_hide(f->progress);
    cli_error("job-failed", "what was measured before is written", "job %s of the study %s", job,
              end == FOLLOW_PAUSED ? "was paused" : "failed");
    return EXIT_FAILED;
}

static int wait_job(struct study_farm *f, const char *job, bool *restarted)
{
    struct progress silent;
    struct waiting waiting = {.farm = f, .status = EXIT_DONE};
    progress_init(&silent, PROGRESS_NONE, -1, follow_now_s());
    struct follow follow = {.farm = &f->api,
                            .job = job,
                            .progress = &silent,
                            .wake_fd = signals_fd(),
                            .on_wake = on_wake,
                            .ctx = &waiting,
                            .pause_ends = true,
                            .joins_expected = UINT32_MAX,
                            .patience_s = PATIENCE_S};
    enum follow_end end = follow_job(&follow);
    *restarted = waiting.restarted;
    if (end == FOLLOW_STOPPED) {
        /* Our own farm ends with us; but when only the time is over, it goes on. */
        if (!f->own_runs || waiting.status == STUDY_OUT_OF_TIME)
            cancel(f, job);
        return waiting.status;
    }
    return end == FOLLOW_DONE ? EXIT_DONE : ended_badly(f, job, end);
}

static int take_report(struct study_farm *f, const char *job, struct study_render *out)
{
    char path[FARM_PATH_BYTES];
    struct farm_json reply;
    int status = farm_job_path(job, "", path);
    if (status == EXIT_DONE)
        status = farm_call(&f->api, "GET", path, NULL, &reply);
    if (status != EXIT_DONE)
        return status;
    const struct json *r = reply.json.root;
    double busy_s = reply_number(r, "core_seconds", (double)NAN);
    out->core_s = isnan(out->core_s) ? busy_s : out->core_s;
    out->spp_mean = reply_number(r, "spp_mean", (double)NAN);
    out->rays = (uint64_t)reply_number(r, "rays", 0);
    (void)snprintf(out->sha256, sizeof out->sha256, "%s", reply_text(r, "image_sha256", ""));
    farm_json_release(&reply);
    return EXIT_DONE;
}

static int take_picture(struct study_farm *f, const char *job, struct study_render *out)
{
    char path[FARM_PATH_BYTES];
    struct diag_list problems;
    struct picture picture = {0};
    int status = farm_job_path(job, "/picture.exr", path);
    if (status == EXIT_DONE)
        status = farm_call(&f->api, "GET", path, NULL, NULL);
    if (status != EXIT_DONE)
        return status;
    diag_init(&problems);
    enum err e = picture_from_exr("the farm's picture", f->api.reply.body.data,
                                  f->api.reply.body.bytes, &picture, &problems);
    if (problems.count)
        (void)cli_problems(&problems, NULL);
    diag_release(&problems);
    if (e == ERR_NOMEM)
        cli_error("no-memory", NULL, "out of memory");
    if (e != ERR_OK)
        return EXIT_MACHINE;
    out->width = picture.width;
    out->height = picture.height;
    out->rgb = picture.rgb;
    out->file_bytes = f->api.reply.body.bytes;
    return EXIT_DONE;
}

static int submit(struct study_farm *f, const struct study_setting *settings,
                  uint32_t setting_count, char job[FARM_ID_BYTES])
{
    struct cli_line line = f->cli->line;
    for (uint32_t i = 0; i < setting_count; i++)
        line.values[settings[i].option] = settings[i].text;
    int status = load_respec(&f->load, &line);
    if (status != EXIT_DONE)
        return load_explain(&f->load, "nothing measured");
    struct farm_job_request request = {
        .name = "tradeoff", .package = &f->load.package, .spec_json = f->load.spec_json};
    return farm_submit(&f->api, &request, job);
}

int study_farm_render(struct study_farm *f, const struct study_setting *settings,
                      uint32_t setting_count, struct study_render *out)
{
    char job[FARM_ID_BYTES];
    bool restarted = false;
    struct study_render r = {0};
    double start_s = follow_now_s(), cpu_s = study_farm_cpu_s(f);
    int status = submit(f, settings, setting_count, job);
    if (status == EXIT_DONE)
        status = wait_job(f, job, &restarted);
    r.wall_s = follow_now_s() - start_s;
    r.core_s = restarted ? (double)NAN : study_farm_cpu_s(f) - cpu_s;
    if (status == EXIT_DONE)
        status = take_report(f, job, &r);
    if (status == EXIT_DONE)
        status = take_picture(f, job, &r);
    if (status == EXIT_DONE)
        *out = r;
    (void)snprintf(f->last_job, sizeof f->last_job, "%s", status == EXIT_DONE ? job : "");
    return signals_interrupts > 0 && status != EXIT_DONE ? EXIT_INTERRUPTED : status;
}

int study_farm_report(struct study_farm *f, const struct job_spec *spec, struct farm_json *report)
{
    char job[FARM_ID_BYTES], path[FARM_PATH_BYTES];
    bool restarted = false;
    char *json = job_spec_to_json(spec);
    if (!json) {
        cli_error("no-memory", NULL, "out of memory");
        return EXIT_MACHINE;
    }
    struct farm_job_request request = {
        .name = "pilot", .package = &f->load.package, .spec_json = json};
    int status = farm_submit(&f->api, &request, job);
    mem_free(json);
    if (status == EXIT_DONE)
        status = wait_job(f, job, &restarted);
    if (status == EXIT_DONE)
        status = farm_job_path(job, "", path);
    if (status == EXIT_DONE)
        status = farm_call(&f->api, "GET", path, NULL, report);
    return signals_interrupts > 0 && status != EXIT_DONE ? EXIT_INTERRUPTED : status;
}

uint64_t study_farm_half_bytes(struct study_farm *f)
{
    char path[FARM_PATH_BYTES];
    if (!f->last_job[0] || farm_job_path(f->last_job, "/" FARM_HALF, path) != EXIT_DONE ||
        farm_try(&f->api, "GET", path, NULL) != ERR_OK || f->api.reply.status != 200)
        return 0;
    return f->api.reply.body.bytes;
}
