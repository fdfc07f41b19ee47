/* worker/main.c: the program tilery-worker: reads its options, wires the parts, runs the loop. */
#include <errno.h>
#include <getopt.h>
#include <inttypes.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <uv.h>

#include "common/determinism.h"
#include "common/file_io.h"
#include "common/log.h"
#include "common/process.h"
#include "common/tags.h"
#include "proto/transport.h"
#include "worker/render/render.h"
#include "worker/session.h"

static const char help[] =
    "usage: tilery-worker --master HOST:PORT [options]\n"
    "\n"
    "Renders what the master leases to it, until it is told to stop.\n"
    "\n"
    "  --master HOST:PORT  the master's --listen address\n"
    "  --tls               speak TLS 1.3, trust what this system trusts\n"
    "  --tls-ca F          speak TLS 1.3, trust the authority in this PEM file alone\n"
    "  --tls-cert F        PEM: this worker's certificate, for a master with --tls-client-ca\n"
    "  --tls-key F         PEM: its key\n"
    "  --threads N         render threads (the cores this process may use)\n"
    "  --build-threads N   threads that read and build a scene (as many; more where other\n"
    "                      workers of this host wait for what this one builds)\n"
    "  --name S            how the worker is shown (the host's name)\n"
    "  --tag T             a word that jobs may ask for; up to 8 times\n"
    "  --cache DIR         keep scenes' chunks and trees in DIR (else chunks in memory)\n"
    "  --trees DIR         keep trees in DIR all the same; of the workers that share DIR one\n"
    "                      builds a tree, and the others wait for it (the cache's folder)\n"
    "  --cache-size MIB    of chunks, and of trees, at most (20480 in DIR, 1024 in memory)\n"
    "  --eager             fetch all pictures and build all trees before the first unit (else\n"
    "                      large ones, where there are many, when paths of light meet them)\n"
    "  --memory MIB        for built scenes; the oldest unused go first (half of the machine's)\n"
    "  --determinism-id    print what must be equal on all workers of a farm, and exit\n"
    "  --log LEVEL         error, warn, info, debug or trace (info)\n"
    "  --version           print the version, and exit\n"
    "  --help              print this, and exit\n"
    "\n"
    "TILERY_TOKEN holds the farm's token where its master has a --token-file.\n"
    "SIGTERM: finishes what it holds, delivers it, and exits 0; a second one: at once.\n"
    "\n"
    "  tilery-worker --master 10.0.0.5:7000 --cache /var/cache/tilery\n";

enum { HOST_BYTES = 256, MIB = 1 << 20, CACHE_DISK_MIB = 20480, CACHE_MEMORY_MIB = 1024 };

struct program {
    uv_loop_t loop;
    uv_signal_t terminate, interrupt;
    struct pool *pool;
    struct chunk_cache *cache;
    struct session *session;
    struct tls_party *tls;
    int exit_status, signals;
    bool closing;

    /* Options. */
    const char *master, *name, *cache_folder, *tree_folder;
    const char *tags[LIMIT_TAGS];
    uint32_t tag_count, threads, build_threads;
    uint64_t cache_mib, memory_mib;
    bool print_id, wants_tls, eager;
    struct tls_files tls_files;
    char host[HOST_BYTES];
};

/* --- Options ------------------------------------------------------------------------ */

static int usage(const char *option, const char *text)
{
    (void)fprintf(stderr, "tilery-worker: %s: %s\n  see tilery-worker --help  [usage]\n", option,
                  text);
    return 2;
}

static bool parse_number(const char *text, uint64_t min, uint64_t max, uint64_t *out)
{
    char *end;
    errno = 0;
    unsigned long long n = strtoull(text, &end, 10);
    if (text[0] < '0' || text[0] > '9' || *end != '\0' || errno != 0 || n < min || n > max)
        return false;
    *out = n;
    return true;
}

static uint32_t cores(void)
{
    cpu_set_t set;
    int n = sched_getaffinity(0, sizeof set, &set) == 0 ? CPU_COUNT(&set) : 1;
    return n < 1 ? 1 : n > LIMIT_THREADS ? LIMIT_THREADS : (uint32_t)n;
}

static uint64_t half_of_memory_mib(void)
{
    long pages = sysconf(_SC_PHYS_PAGES), page_bytes = sysconf(_SC_PAGESIZE);
    if (pages <= 0 || page_bytes <= 0)
        return 1024;
    return (uint64_t)pages * (uint64_t)page_bytes / 2 / MIB;
}

enum {
    OPTION_MASTER = 256,
    OPTION_TLS,
    OPTION_TLS_CA,
    OPTION_TLS_CERT,
    OPTION_TLS_KEY,
    OPTION_THREADS,
    OPTION_BUILD_THREADS,
    OPTION_NAME,
    OPTION_TAG,
    OPTION_CACHE,
    OPTION_TREES,
    OPTION_CACHE_SIZE,
    OPTION_EAGER,
    OPTION_MEMORY,
    OPTION_ID,
    OPTION_LOG,
    OPTION_VERSION,
    OPTION_HELP,
};

static const struct option long_options[] = {
    {"master", required_argument, NULL, OPTION_MASTER},
    {"tls", no_argument, NULL, OPTION_TLS},
    {"tls-ca", required_argument, NULL, OPTION_TLS_CA},
    {"tls-cert", required_argument, NULL, OPTION_TLS_CERT},
    {"tls-key", required_argument, NULL, OPTION_TLS_KEY},
    {"threads", required_argument, NULL, OPTION_THREADS},
    {"build-threads", required_argument, NULL, OPTION_BUILD_THREADS},
    {"name", required_argument, NULL, OPTION_NAME},
    {"tag", required_argument, NULL, OPTION_TAG},
    {"cache", required_argument, NULL, OPTION_CACHE},
    {"trees", required_argument, NULL, OPTION_TREES},
    {"cache-size", required_argument, NULL, OPTION_CACHE_SIZE},
    {"eager", no_argument, NULL, OPTION_EAGER},
    {"memory", required_argument, NULL, OPTION_MEMORY},
    {"determinism-id", no_argument, NULL, OPTION_ID},
    {"log", required_argument, NULL, OPTION_LOG},
    {"version", no_argument, NULL, OPTION_VERSION},
    {"help", no_argument, NULL, OPTION_HELP},
    {NULL, 0, NULL, 0},
};

/* -1: go on; else the exit status. */
enum { GO_ON = -1 };

static int take_number(const char *option, const char *text, uint64_t min, uint64_t max,
                       uint64_t *out)
{
    char line[128];
    if (parse_number(text, min, max, out))
        return GO_ON;
    (void)snprintf(line, sizeof line, "\"%.40s\" is no whole number from %" PRIu64 " to %" PRIu64,
                   text, min, max);
    return usage(option, line);
}

static int take_threads(const char *option, const char *text, uint32_t *out)
{
    uint64_t threads = 0;
    int status = take_number(option, text, 1, LIMIT_THREADS, &threads);
    if (status == GO_ON)
        *out = (uint32_t)threads;
    return status;
}

static int take_tag(struct program *p, const char *text)
{
    if (p->tag_count >= LIMIT_TAGS)
        return usage("--tag", "given more than 8 times");
    if (!tag_valid(text))
        return usage("--tag", "a tag is " TAG_EXPECTED);
    p->tags[p->tag_count++] = text;
    return GO_ON;
}

/* Any of the four asks for TLS: nobody who names a certificate wants to go without. */
static int take_tls(struct program *p, int option, const char *value)
{
    p->wants_tls = true;
    if (option == OPTION_TLS_CA)
        p->tls_files.ca = value;
    else if (option == OPTION_TLS_CERT)
        p->tls_files.certificate = value;
    else if (option == OPTION_TLS_KEY)
        p->tls_files.key = value;
    return GO_ON;
}

static int take_option(struct program *p, int option, const char *value)
{
    enum log_level level;
    switch (option) {
    case OPTION_MASTER:
        p->master = value;
        return transport_host_port_valid(value)
                   ? GO_ON
                   : usage("--master", "expected HOST:PORT, as in 10.0.0.5:7000");
    case OPTION_TLS:
    case OPTION_TLS_CA:
    case OPTION_TLS_CERT:
    case OPTION_TLS_KEY:
        return take_tls(p, option, value);
    case OPTION_THREADS:
        return take_threads("--threads", value, &p->threads);
    case OPTION_BUILD_THREADS:
        return take_threads("--build-threads", value, &p->build_threads);
    case OPTION_NAME:
        p->name = value;
        return value[0] && strlen(value) <= 64 ? GO_ON : usage("--name", "has 1 to 64 bytes");
    case OPTION_TAG:
        return take_tag(p, value);
    case OPTION_CACHE:
        p->cache_folder = value;
        return value[0] ? GO_ON : usage("--cache", "expected a folder");
    case OPTION_TREES:
        p->tree_folder = value;
        return value[0] ? GO_ON : usage("--trees", "expected a folder");
    case OPTION_CACHE_SIZE:
        return take_number("--cache-size", value, 1, UINT64_C(1) << 32, &p->cache_mib);
    case OPTION_MEMORY:
        return take_number("--memory", value, 1, UINT64_C(1) << 32, &p->memory_mib);
    case OPTION_EAGER:
        p->eager = true;
        return GO_ON;
    case OPTION_ID:
        p->print_id = true;
        return GO_ON;
    case OPTION_LOG:
        if (!log_level_parse(value, &level))
            return usage("--log", "expected error, warn, info, debug or trace");
        log_set_level(level);
        return GO_ON;
    case OPTION_VERSION:
        (void)puts("tilery-worker " TILERY_VERSION);
        return 0;
    case OPTION_HELP:
        (void)fputs(help, stdout);
        return 0;
    default:
        (void)fprintf(stderr, "  see tilery-worker --help  [usage]\n");
        return 2;
    }
}

static int parse_options(struct program *p, int argc, char **argv)
{
    log_set_level(LOG_INFO);
    for (;;) {
        int option = getopt_long(argc, argv, "", long_options, NULL);
        if (option == -1)
            break;
        int status = take_option(p, option, optarg);
        if (status != GO_ON)
            return status;
    }
    if (optind < argc)
        return usage(argv[optind], "is no option of this program");
    if (!p->master && !p->print_id)
        return usage("--master", "is needed: the master's --listen address");

    if (!p->tls_files.certificate != !p->tls_files.key)
        return usage(p->tls_files.key ? "--tls-cert" : "--tls-key",
                     "is needed: a certificate and its key go together");

    if (gethostname(p->host, sizeof p->host - 1) != 0 || p->host[0] == '\0')
        (void)snprintf(p->host, sizeof p->host, "unknown");
    if (!p->name)
        p->name = p->host;
    if (p->threads == 0)
        p->threads = cores();
    if (p->build_threads < p->threads)
        p->build_threads = p->threads;
    if (p->cache_mib == 0)
        p->cache_mib = p->cache_folder ? CACHE_DISK_MIB : CACHE_MEMORY_MIB;
    if (p->memory_mib == 0)
        p->memory_mib = half_of_memory_mib();
    return GO_ON;
}

/* --- Running ------------------------------------------------------------------------ */

static int fail(const char *what, enum err e)
{
    (void)fprintf(stderr, "tilery-worker: %s: %s\n", what, err_text(e));
    return 5;
}

static int fail_folder(const char *path, enum err e)
{
    (void)fprintf(stderr, "tilery-worker: cannot use the folder %s: %s\n", path,
                  file_folder_why(path, e));
    return 5;
}

static enum err own_determinism_id(digest *out)
{
    struct render_scratch *scratch;
    unsigned char bits[32];
    TL_TRY(render_scratch_new(&scratch));
    enum err e = render_self_test(scratch, bits);
    render_scratch_free(scratch);
    if (e == ERR_OK)
        *out = determinism_id(bits);
    return e;
}

static int read_tls(struct program *p)
{
    char problem[TLS_PROBLEM_BYTES];
    if (!p->wants_tls)
        return GO_ON;
    enum err e = tls_party_new_worker(&p->tls_files, &p->tls, problem);
    if (e == ERR_INPUT)
        return usage("TLS", problem);
    return e == ERR_OK ? GO_ON : fail("TLS", e);
}

static const char *cpu_name(void)
{
    __builtin_cpu_init();
    return __builtin_cpu_supports("avx512f") ? "avx512"
           : __builtin_cpu_supports("avx2")  ? "avx2"
                                             : "sse2";
}

/* Nothing is left to deliver. A scene that is still being built can neither be stopped nor be worth
 * waiting for; files are whole at any moment. */
static void on_session_closed(void *ctx)
{
    struct program *p = ctx;
    if (pool_serving(p->pool))
        _exit(p->exit_status);
    pool_close(p->pool, NULL, NULL);
}

static void shut_down(struct program *p, int exit_status)
{
    if (p->closing)
        return;
    p->closing = true;
    p->exit_status = exit_status;
    uv_close((uv_handle_t *)&p->terminate, NULL);
    uv_close((uv_handle_t *)&p->interrupt, NULL);
    session_close(p->session, on_session_closed, p);
}

static void on_ended(void *ctx, int exit_status)
{
    shut_down(ctx, exit_status);
}

static void on_signal(uv_signal_t *handle, int number)
{
    struct program *p = handle->data;
    if (p->signals++ == 0)
        session_drain(p->session);
    else
        shut_down(p, number == SIGINT ? 130 : 128 + number);
}

static void on_registered(void *ctx, const char *worker_id)
{
    (void)ctx;
    (void)printf("{\"worker\": \"%s\"}\n", worker_id);
    (void)fflush(stdout);
}

static int run(struct program *p, const struct session_options *options)
{
    if (uv_signal_init(&p->loop, &p->terminate) < 0 || uv_signal_init(&p->loop, &p->interrupt) < 0)
        return fail("cannot catch signals", ERR_IO);
    p->terminate.data = p->interrupt.data = p;
    (void)uv_signal_start(&p->terminate, on_signal, SIGTERM);
    (void)uv_signal_start(&p->interrupt, on_signal, SIGINT);

    enum err e = session_new(&p->loop, options, &p->session);
    if (e != ERR_OK)
        return fail("cannot start", e);
    (void)uv_run(&p->loop, UV_RUN_DEFAULT);
    session_free(p->session);
    chunk_cache_free(p->cache);
    tls_party_free(p->tls);
    (void)uv_loop_close(&p->loop);
    return p->exit_status;
}

int main(int argc, char **argv)
{
    static struct program p;
    process_prepare();
    int status = parse_options(&p, argc, argv);
    if (status != GO_ON)
        return status;

    digest id;
    enum err e = own_determinism_id(&id);
    if (e != ERR_OK)
        return fail("the self-test did not run", e);
    if (p.print_id) {
        char hex[DIGEST_HEX_BYTES];
        digest_to_hex(&id, hex);
        (void)puts(hex);
        return 0;
    }
    status = read_tls(&p);
    if (status != GO_ON)
        return status;
    if (uv_loop_init(&p.loop) < 0)
        return fail("cannot make an event loop", ERR_IO);
    e = transport_start_pool(&p.loop);
    if (e != ERR_OK)
        return fail("cannot start the threads of the event loop", e);
    e = chunk_cache_new(p.cache_folder, p.cache_mib * MIB, &p.cache);
    if (e != ERR_OK)
        return p.cache_folder ? fail_folder(p.cache_folder, e) : fail("chunk cache", e);
    if (p.tree_folder)
        e = chunk_cache_keep_trees(p.cache, p.tree_folder, p.cache_mib * MIB);
    if (e != ERR_OK)
        return fail_folder(p.tree_folder, e);
    e = pool_new(&p.loop, p.threads, p.build_threads, &p.pool);
    if (e != ERR_OK)
        return fail("cannot start the render threads", e);

    const char *token = getenv("TILERY_TOKEN");
    struct session_options options = {
        .master = p.master,
        .tls = p.tls,
        .name = p.name,
        .host = p.host,
        .cpu = cpu_name(),
        .token = token ? token : "",
        .tags = p.tags,
        .tag_count = p.tag_count,
        .determinism_id = id,
        .pool = p.pool,
        .cache = p.cache,
        .scene_bytes_max = p.memory_mib * MIB,
        .eager = p.eager,
        .registered = on_registered,
        .ended = on_ended,
        .ctx = &p,
    };
    log_info("worker", "started master=%s threads=%" PRIu32 " cpu=%s version=" TILERY_VERSION,
             p.master, p.threads, options.cpu);
    return run(&p, &options);
}
