/* tilery-master: parses, wires, runs. */
#include <signal.h>
#include <stdio.h>
#include <sys/resource.h>

#include "common/process.h"
#include "master/durable.h"
#include "master/farm.h"
#include "master/http.h"
#include "master/options.h"

struct program {
    uv_loop_t loop;
    struct farm farm;
    struct http *http;
    struct tls_party *tls;
    uv_signal_t signals[2];
    bool stopping;
};

static void stop(struct program *p)
{
    if (p->stopping)
        return;
    p->stopping = true;
    log_info("master", "stopping");
    http_stop(p->http);
    farm_stop(&p->farm, NULL, NULL);
    for (int i = 0; i < 2; i++)
        uv_close((uv_handle_t *)&p->signals[i], NULL);
}

static void on_signal(uv_signal_t *signal, int number)
{
    (void)number;
    stop(signal->data);
}

static void watch_signals(struct program *p)
{
    static const int numbers[2] = {SIGTERM, SIGINT};
    for (int i = 0; i < 2; i++) {
        (void)uv_signal_init(&p->loop, &p->signals[i]);
        p->signals[i].data = p;
        (void)uv_signal_start(&p->signals[i], on_signal, numbers[i]);
    }
}

/* Every worker and every reader is a descriptor. */
static void raise_file_limit(void)
{
    struct rlimit limit;
    if (getrlimit(RLIMIT_NOFILE, &limit) != 0 || limit.rlim_cur == limit.rlim_max)
        return;
    limit.rlim_cur = limit.rlim_max;
    (void)setrlimit(RLIMIT_NOFILE, &limit);
}

static enum err read_tls(struct program *p, const struct options *o)
{
    char problem[TLS_PROBLEM_BYTES];
    if (!o->tls.certificate)
        return ERR_OK;
    enum err e = tls_party_new_master(&o->tls, &p->tls, problem);
    if (e == ERR_INPUT)
        (void)fprintf(stderr,
                      "tilery-master: %s\n  expected PEM files: see docs/OPERATIONS.md  [tls]\n",
                      problem);
    return e == ERR_INPUT ? ERR_USAGE : e;
}

static enum err start(struct program *p, const struct options *o)
{
    TL_TRY(read_tls(p, o));
    struct farm_options farm = {.listen = o->listen,
                                .listen_socket = o->listen_socket,
                                .data_dir = o->data,
                                .token = o->token,
                                .tls = p->tls,
                                .determinism_pinned = o->determinism_pinned,
                                .determinism = o->determinism,
                                .retention_s = o->retention_s,
                                .keep_lost_s = o->keep_lost_s};
    TL_TRY(farm_start(&p->farm, &p->loop, &farm));
    struct http_options http = {.address = o->http, .token = o->token, .tls = o->tls};
    return http_start(&p->farm, &http, &p->http);
}

int main(int argc, char **argv)
{
    static struct program p;
    struct options options;
    int status = 0;
    process_prepare();
    if (!options_parse(argc, argv, &options, &status))
        return status;
    log_set_level(options.level);
    if (options.no_sync)
        durable_forgo();
    raise_file_limit();
    if (uv_loop_init(&p.loop) != 0 || transport_start_pool(&p.loop) != ERR_OK)
        return err_exit_status(ERR_NOMEM);
    watch_signals(&p);
    enum err e = start(&p, &options);
    if (e == ERR_OK) {
        (void)printf("{\"listen\": \"%s\", \"http\": \"%s\"}\n", listener_address(p.farm.listener),
                     http_address(p.http));
        (void)fflush(stdout);
    } else {
        /* A folder in use or unwritable, an address taken: this machine's trouble. */
        status = e == ERR_USAGE ? err_exit_status(e) : err_exit_status(ERR_IO);
        stop(&p);
    }
    (void)uv_run(&p.loop, UV_RUN_DEFAULT);
    farm_release(&p.farm);
    tls_party_free(p.tls);
    (void)uv_loop_close(&p.loop);
    options_release(&options);
    return status;
}
