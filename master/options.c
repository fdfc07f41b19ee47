#include "master/options.h"

#include <getopt.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/file_io.h"
#include "common/mem.h"
#include "proto/transport.h"

enum { TOKEN_BYTES_MIN = 8, TOKEN_BYTES_MAX = 256, DAY_S = 24 * 3600 };

static const char help[] =
    "usage: tilery-master [options]\n"
    "\n"
    "Takes jobs over HTTP, leases their tiles to workers, gathers the pictures.\n"
    "\n"
    "  --listen ADDR:PORT     for workers (127.0.0.1:7000; port 0: any)\n"
    "  --listen-socket FD     the same, on an inherited socket that is bound\n"
    "  --http ADDR:PORT       for people and programs (127.0.0.1:8080; port 0: any)\n"
    "  --data DIR             jobs, results, scenes (./tilery-data); one master each\n"
    "  --token-file F         first line: what workers and people must show\n"
    "  --tls-cert F           PEM: this master's certificate; all is TLS 1.3 then\n"
    "  --tls-key F            PEM: its key\n"
    "  --tls-client-ca F      PEM: workers must show a certificate of this authority\n"
    "  --insecure             allow other than loopback addresses without a token\n"
    "  --no-sync              do not wait for the disk: survives kill -9, not a power cut\n"
    "  --determinism-id HEX   accept only workers of this id (else the first one's)\n"
    "  --retention DAYS       keep ended jobs so long (0: for ever, the default)\n"
    "  --keep-lost SECONDS    list workers that left or were lost so long (3600)\n"
    "  --log LEVEL            error, warn, info, debug, trace (info)\n"
    "  --version, --help\n"
    "\n"
    "Prints {\"listen\": ..., \"http\": ...} once both are bound. SIGTERM stores what is\n"
    "in memory and exits 0; the next start goes on where it was.\n";

static bool wrong(int *status, const char *format, const char *what)
{
    (void)fprintf(stderr, "tilery-master: ");
    /* The formats are literals below, each with one %s. */
    (void)fprintf(stderr, format, what);
    (void)fprintf(stderr, "\n  see tilery-master --help  [usage]\n");
    *status = err_exit_status(ERR_USAGE);
    return false;
}

/* The first line of a file, without its end. */
static bool read_token(const char *path, char **out, int *status)
{
    char *text = NULL;
    size_t bytes = 0;
    enum err e = file_read(path, 1 << 16, &text, &bytes);
    if (e != ERR_OK) {
        (void)fprintf(stderr, "tilery-master: cannot read token file %s: %s  [token-file]\n", path,
                      file_read_why(path, e));
        *status = err_exit_status(ERR_USAGE);
        return false;
    }
    text[strcspn(text, "\r\n")] = '\0';
    bytes = strlen(text);
    if (bytes < TOKEN_BYTES_MIN || bytes > TOKEN_BYTES_MAX) {
        mem_free(text);
        return wrong(status, "token file %s: its first line must have 8 to 256 characters", path);
    }
    *out = text;
    return true;
}

/* True if the address names this machine only. */
static bool is_loopback(const char *addr_port)
{
    return strncmp(addr_port, "127.", 4) == 0 || strncmp(addr_port, "localhost:", 10) == 0 ||
           strncmp(addr_port, "[::1]:", 6) == 0;
}

static bool check_addresses(const struct options *o, int *status)
{
    if (!transport_host_port_valid(o->listen))
        return wrong(status, "--listen must be ADDR:PORT such as 127.0.0.1:7000, not \"%s\"",
                     o->listen);
    if (!transport_host_port_valid(o->http))
        return wrong(status, "--http must be ADDR:PORT such as 127.0.0.1:8080, not \"%s\"",
                     o->http);
    return true;
}

static bool check_exposed(const struct options *o, int *status)
{
    const char *exposed = !is_loopback(o->listen) ? o->listen
                          : !is_loopback(o->http) ? o->http
                                                  : NULL;
    if (!exposed || o->token || o->insecure)
        return true;
    return wrong(status,
                 "%s can be reached from other machines: give --token-file, or --insecure where "
                 "everyone who can reach it may use it",
                 exposed);
}

static bool check_tls(const struct options *o, int *status)
{
    const struct tls_files *t = &o->tls;
    if (!t->certificate != !t->key)
        return wrong(status, "%s is missing: a certificate is of no use without its key",
                     t->key ? "--tls-cert" : "--tls-key");
    if (t->ca && !t->certificate)
        return wrong(status, "%s asks for TLS: give --tls-cert and --tls-key", "--tls-client-ca");
    return true;
}

static bool parse_days(const char *text, uint32_t *seconds, int *status)
{
    char *end = NULL;
    double days = strtod(text, &end);
    if (end == text || *end || !(days >= 0 && days <= 10000))
        return wrong(status, "--retention must be 0 to 10000 days, not \"%s\"", text);
    double exact = days * DAY_S;
    *seconds = (uint32_t)exact;
    *seconds += (double)*seconds < exact; /* only 0 is for ever */
    return true;
}

static bool parse_seconds(const char *text, uint32_t *seconds, int *status)
{
    char *end = NULL;
    unsigned long v = strtoul(text, &end, 10);
    if (text[0] < '0' || text[0] > '9' || *end || v > UINT32_MAX)
        return wrong(status, "--keep-lost must be a whole number of seconds, not \"%s\"", text);
    *seconds = (uint32_t)v;
    return true;
}

enum {
    OPT_LISTEN = 256,
    OPT_LISTEN_SOCKET,
    OPT_HTTP,
    OPT_DATA,
    OPT_TOKEN,
    OPT_TLS_CERT,
    OPT_TLS_KEY,
    OPT_TLS_CLIENT_CA,
    OPT_INSECURE,
    OPT_NO_SYNC,
    OPT_DETERMINISM,
    OPT_RETENTION,
    OPT_KEEP_LOST,
    OPT_LOG,
    OPT_VERSION,
    OPT_HELP
};

static const struct option long_options[] = {
    {"listen", required_argument, NULL, OPT_LISTEN},
    {"listen-socket", required_argument, NULL, OPT_LISTEN_SOCKET},
    {"http", required_argument, NULL, OPT_HTTP},
    {"data", required_argument, NULL, OPT_DATA},
    {"token-file", required_argument, NULL, OPT_TOKEN},
    {"tls-cert", required_argument, NULL, OPT_TLS_CERT},
    {"tls-key", required_argument, NULL, OPT_TLS_KEY},
    {"tls-client-ca", required_argument, NULL, OPT_TLS_CLIENT_CA},
    {"insecure", no_argument, NULL, OPT_INSECURE},
    {"no-sync", no_argument, NULL, OPT_NO_SYNC},
    {"determinism-id", required_argument, NULL, OPT_DETERMINISM},
    {"retention", required_argument, NULL, OPT_RETENTION},
    {"keep-lost", required_argument, NULL, OPT_KEEP_LOST},
    {"log", required_argument, NULL, OPT_LOG},
    {"version", no_argument, NULL, OPT_VERSION},
    {"help", no_argument, NULL, OPT_HELP},
    {NULL, 0, NULL, 0},
};

/* Its address counts as if it had been given. */
static bool take_socket(struct options *o, const char *text, int *status)
{
    char *end = NULL;
    long fd = strtol(text, &end, 10);
    if (end == text || *end || fd < 3 || fd > INT_MAX ||
        !transport_socket_address((int)fd, o->socket_address, sizeof o->socket_address))
        return wrong(status, "--listen-socket must be a bound TCP socket's number, not \"%s\"",
                     text);
    o->listen_socket = (int)fd;
    o->listen = o->socket_address;
    return true;
}

/* One option; false: *status says how to end. */
static bool take(struct options *o, int option, int *status)
{
    switch (option) {
    case OPT_LISTEN:
        o->listen = optarg;
        return true;
    case OPT_LISTEN_SOCKET:
        return take_socket(o, optarg, status);
    case OPT_HTTP:
        o->http = optarg;
        return true;
    case OPT_DATA:
        o->data = optarg;
        return true;
    case OPT_TOKEN:
        mem_free(o->token);
        o->token = NULL;
        return read_token(optarg, &o->token, status);
    case OPT_TLS_CERT:
        o->tls.certificate = optarg;
        return true;
    case OPT_TLS_KEY:
        o->tls.key = optarg;
        return true;
    case OPT_TLS_CLIENT_CA:
        o->tls.ca = optarg;
        return true;
    case OPT_INSECURE:
        o->insecure = true;
        return true;
    case OPT_NO_SYNC:
        o->no_sync = true;
        return true;
    case OPT_DETERMINISM:
        o->determinism_pinned = true;
        return digest_from_hex(optarg, &o->determinism) ||
               wrong(status, "--determinism-id must be 64 hexadecimal digits, not \"%s\"", optarg);
    case OPT_RETENTION:
        return parse_days(optarg, &o->retention_s, status);
    case OPT_KEEP_LOST:
        return parse_seconds(optarg, &o->keep_lost_s, status);
    case OPT_LOG:
        return log_level_parse(optarg, &o->level) ||
               wrong(status, "--log must be error, warn, info, debug or trace, not \"%s\"", optarg);
    case OPT_VERSION:
        (void)printf("tilery-master %s\n", TILERY_VERSION);
        *status = 0;
        return false;
    case OPT_HELP:
        (void)fputs(help, stdout);
        *status = 0;
        return false;
    default: /* getopt has said what is wrong */
        (void)fprintf(stderr, "  see tilery-master --help  [usage]\n");
        *status = err_exit_status(ERR_USAGE);
        return false;
    }
}

bool options_parse(int argc, char **argv, struct options *out, int *status)
{
    *out = (struct options){.listen = "127.0.0.1:7000",
                            .http = "127.0.0.1:8080",
                            .data = "tilery-data",
                            .listen_socket = -1,
                            .keep_lost_s = 3600,
                            .level = LOG_INFO};
    for (int option; (option = getopt_long(argc, argv, "", long_options, NULL)) != -1;)
        if (!take(out, option, status)) {
            options_release(out);
            return false;
        }
    bool good = optind >= argc || wrong(status, "unexpected argument \"%s\"", argv[optind]);
    if (good)
        good = check_addresses(out, status) && check_exposed(out, status) && check_tls(out, status);
    if (!good)
        options_release(out);
    return good;
}

void options_release(struct options *o)
{
    mem_free(o->token);
    o->token = NULL;
}
