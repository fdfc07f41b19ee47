#include "master/http.h"

#include <arpa/inet.h>
#include <errno.h>
#include <inttypes.h>
#include <microhttpd.h>
#include <netdb.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "common/file_io.h"
#include "common/log.h"
#include "common/mem.h"
#include "master/http_impl.h"

enum {
    PEM_BYTES_MAX = 1 << 20,
    ROUNDS_MAX = 32,   /* of libmicrohttpd in one turn of the loop */
    STALL_MS_MAX = 16, /* between its turns when it asks for more and nothing arrives */
};

static const struct route routes[] = {
    {"GET", "/", http_get_page, 0, true},
    {"GET", "/app.js", http_get_script, 0, true},
    {"GET", "/viewer.js", http_get_viewer, 0, true},
    {"GET", "/icon.svg", http_get_icon, 0, true},
    {"GET", "/style.css", http_get_style, 0, true},
    {"GET", "/docs/errors", http_get_errors, 0, true},
    {"GET", "/healthz", http_get_health, 0, true},
    {"GET", "/metrics", http_get_metrics, 0, false},
    {"GET", "/api/v1/openapi.json", http_get_openapi, 0, true},
    {"POST", "/api/v1/session", http_post_session, HTTP_BODY_BYTES_MAX, true},
    {"POST", "/api/v1/chunks/missing", http_post_missing, HTTP_BODY_BYTES_MAX * 16, false},
    {"PUT", "/api/v1/chunks/{}", http_put_chunk, HTTP_CHUNK_BYTES_MAX, false},
    {"POST", "/api/v1/jobs", http_post_jobs, HTTP_BODY_BYTES_MAX * 16, false},
    {"GET", "/api/v1/jobs", http_get_jobs, 0, false},
    {"GET", "/api/v1/jobs/{}", http_get_job, 0, false},
    {"PATCH", "/api/v1/jobs/{}", http_patch_job, HTTP_BODY_BYTES_MAX, false},
    {"GET", "/api/v1/jobs/{}/frames", http_get_frames, 0, false},
    {"GET", "/api/v1/jobs/{}/picture.exr", http_get_exr, 0, false},
    {"GET", "/api/v1/jobs/{}/picture.png", http_get_png, 0, false},
    {"GET", "/api/v1/workers", http_get_workers, 0, false},
    {"PATCH", "/api/v1/workers/{}", http_patch_worker, HTTP_BODY_BYTES_MAX, false},
    {"GET", "/api/v1/farm", http_get_farm, 0, false},
    {"GET", "/api/v1/events", http_get_events, 0, false},
};

/* On every answer: nothing but our own files runs in the page, nobody frames it. */
static const char *const headers[][2] = {
    {"Content-Security-Policy",
     "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
     "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"},
    {"X-Content-Type-Options", "nosniff"},
    {"Referrer-Policy", "no-referrer"},
    {"Cross-Origin-Opener-Policy", "same-origin"},
    {"Cross-Origin-Resource-Policy", "same-origin"},
    {"Cache-Control", "no-store"},
};

/* --- Running libmicrohttpd in the loop ---------------------------------- */

static void on_timer(uv_timer_t *timer);

static void run_daemon(struct http *h)
{
    if (h->running) {
        h->kicked = true;
        return;
    }
    h->running = true;
    bool waits;
    MHD_UNSIGNED_LONG_LONG wait_ms;
    int rounds = 0;
    do {
        h->kicked = false;
        (void)MHD_run(h->daemon);
        waits = MHD_get_timeout(h->daemon, &wait_ms) == MHD_YES;
    } while ((h->kicked || (waits && wait_ms == 0)) && ++rounds < ROUNDS_MAX);
    h->running = false;
    if (h->kicked) {
        (void)uv_timer_start(&h->timer, on_timer, 0, 0);
        return;
    }
    if (!waits) {
        (void)uv_timer_stop(&h->timer);
        return;
    }
    /* "At once" is also what it says of a TLS handshake that somebody leaves half done: then
     * less and less often, until something arrives, and never before others had their turn. */
    if (wait_ms == 0) {
        wait_ms = h->stall_ms;
        h->stall_ms = h->stall_ms < STALL_MS_MAX ? h->stall_ms * 2 : STALL_MS_MAX;
    }
    (void)uv_timer_start(&h->timer, on_timer, wait_ms, 0);
}

static void on_timer(uv_timer_t *timer)
{
    run_daemon(timer->data);
}

static void on_tick(uv_timer_t *timer)
{
    http_streams_tick(timer->data);
}

static void on_poll(uv_poll_t *poll, int status, int events)
{
    (void)status;
    (void)events;
    struct http *h = poll->data;
    h->stall_ms = 1;
    run_daemon(h);
}

void http_kick(struct http *h)
{
    if (h->kicked || h->stopping)
        return;
    h->kicked = true;
    if (!h->running)
        (void)uv_timer_start(&h->timer, on_timer, 0, 0);
}

/* --- Answers ------------------------------------------------------------ */

const char *request_query(struct request *r, const char *key)
{
    return MHD_lookup_connection_value(r->connection, MHD_GET_ARGUMENT_KIND, key);
}

const char *request_head(struct request *r, const char *key)
{
    return MHD_lookup_connection_value(r->connection, MHD_HEADER_KIND, key);
}

void request_header(struct request *r, const char *name, const char *value)
{
    if (r->response)
        (void)MHD_add_response_header(r->response, name, value);
}

static void answer(struct request *r, unsigned status, const char *type,
                   struct MHD_Response *response)
{
    TL_ASSERT(!r->answered);
    r->answered = true;
    r->status = status;
    r->response = response;
    if (type)
        request_header(r, "Content-Type", type);
    for (size_t i = 0; i < sizeof headers / sizeof *headers; i++)
        request_header(r, headers[i][0], headers[i][1]);
    if (status >= 400)
        r->http->counters.problems++;
    if (r->waiting) {
        r->waiting = false;
        MHD_resume_connection(r->connection);
        http_kick(r->http);
    }
}

/* libmicrohttpd frees with free(); our buffers come from mem.h, which is malloc behind a counter.
 */
static void free_body(void *data)
{
    mem_free(data);
}

void request_reply(struct request *r, unsigned status, const char *type, struct buf *body)
{
    struct MHD_Response *response = NULL;
    if (buf_status(body) == ERR_OK) {
        r->http->counters.bytes_out += body->bytes;
        response =
            MHD_create_response_from_buffer_with_free_callback(body->bytes, body->data, free_body);
        if (response)
            buf_init(body);
    }
    buf_release(body);
    answer(r, status, type, response);
}

void request_stream(struct request *r, struct MHD_Response *response)
{
    r->streams = true;
    answer(r, MHD_HTTP_OK, "text/event-stream", response);
}

static void put_problem_head(struct buf *b, unsigned status, const char *id, const char *detail,
                             const char *path)
{
    char title[64];
    (void)snprintf(title, sizeof title, "%s", id);
    for (char *c = title; *c; c++)
        if (*c == '-')
            *c = ' ';
    if (title[0] >= 'a' && title[0] <= 'z')
        title[0] = (char)(title[0] - 'a' + 'A');
    buf_printf(b, "{\"type\":\"/docs/errors#%s\",\"title\":\"%s\",\"status\":%u,\"detail\":", id,
               title, status);
    json_put_text(b, detail);
    buf_printf(b, ",\"instance\":");
    json_put_text(b, path);
}

void request_problems(struct request *r, unsigned status, const char *id, const char *detail,
                      const struct diag_list *problems)
{
    struct buf b;
    buf_init(&b);
    put_problem_head(&b, status, id, detail, r->path);
    if (problems) {
        buf_printf(&b, ",\"errors\":[");
        for (size_t i = 0; i < problems->count; i++) {
            const struct diag *d = &problems->items[i];
            buf_printf(&b, "%s{\"pointer\":", i ? "," : "");
            json_put_text(&b, d->path ? d->path : "$");
            buf_printf(&b, ",\"detail\":");
            json_put_text(&b, d->text);
            buf_printf(&b, ",\"hint\":");
            json_put_text(&b, d->hint);
            buf_printf(&b, ",\"id\":\"%s\"}", d->id);
        }
        buf_put_u8(&b, ']');
    }
    buf_printf(&b, "}\n");
    request_reply(r, status, "application/problem+json", &b);
    if (status == MHD_HTTP_UNAUTHORIZED)
        request_header(r, "WWW-Authenticate", "Bearer realm=\"tilery\"");
    if (status == MHD_HTTP_SERVICE_UNAVAILABLE || status == MHD_HTTP_TOO_MANY_REQUESTS)
        request_header(r, "Retry-After", "2");
}

void request_problem(struct request *r, unsigned status, const char *id, const char *format, ...)
{
    char detail[512];
    va_list args;
    va_start(args, format);
    (void)vsnprintf(detail, sizeof detail, format, args);
    va_end(args);
    request_problems(r, status, id, detail, NULL);
}

void request_error(struct request *r, enum err e)
{
    switch (e) {
    case ERR_NOSPACE:
        request_problem(r, MHD_HTTP_INSUFFICIENT_STORAGE, "disk-full",
                        "the master's disk is full; nothing was lost, make room and try again");
        break;
    case ERR_LIMIT:
        request_problem(r, MHD_HTTP_UNPROCESSABLE_CONTENT, "over-limit", "%s", err_text(e));
        break;
    case ERR_CANCELLED:
    case ERR_NOMEM:
        request_problem(r, MHD_HTTP_SERVICE_UNAVAILABLE, "busy", "the master is out of memory");
        break;
    default:
        request_problem(r, MHD_HTTP_INTERNAL_SERVER_ERROR, "master-failed",
                        "the master's disk: %s; its log says more", err_text(e));
        break;
    }
}

struct later *request_later(struct request *r)
{
    TL_ASSERT(!r->later);
    r->later = mem_calloc(1, sizeof *r->later);
    if (r->later)
        r->later->request = r;
    else
        request_error(r, ERR_NOMEM);
    return r->later;
}

struct request *request_of(struct later *later)
{
    struct request *r = later->request;
    if (r)
        r->later = NULL;
    mem_free(later);
    return r;
}

void request_wait(struct request *r)
{
    if (r->answered)
        return; /* the answer came before it had to wait */
    r->waiting = true;
    MHD_suspend_connection(r->connection);
}

bool request_json(struct request *r, struct json_get *g, struct diag_list *problems,
                  const char *const *keys, size_t key_count)
{
    diag_init(problems);
    enum err e = http_body_open(g, r->body.data, r->body.bytes, keys, key_count, problems);
    if (e == ERR_OK)
        return true;
    if (e == ERR_NOMEM)
        request_error(r, e);
    else
        request_problems(r, MHD_HTTP_BAD_REQUEST, "bad-request",
                         "the body is not the JSON object asked for", problems);
    diag_release(problems);
    return false;
}

/* --- Refusing ----------------------------------------------------------- */

static bool same_text(const char *a, const char *b)
{
    digest x = digest_of(a, strlen(a)), y = digest_of(b, strlen(b));
    unsigned difference = 0;
    for (int i = 0; i < DIGEST_BYTES; i++)
        difference |= (unsigned)(x.bytes[i] ^ y.bytes[i]);
    return difference == 0;
}

bool http_token_good(const struct http *h, const char *token)
{
    return !h->token || same_text(token, h->token);
}

static bool has_token(struct request *r)
{
    const struct http *h = r->http;
    if (!h->token)
        return true;
    const char *head = request_head(r, "Authorization");
    if (head && strncasecmp(head, "Bearer ", 7) == 0 && same_text(head + 7, h->token))
        return true;
    const char *cookie = MHD_lookup_connection_value(r->connection, MHD_COOKIE_KIND, "tilery");
    return cookie && same_text(cookie, h->session);
}

/* The name in a Host header, without its port. */
static void host_name(const char *host, char *out, size_t bytes)
{
    (void)snprintf(out, bytes, "%s", host);
    char *end = out[0] == '[' ? strchr(out, ']') : strrchr(out, ':');
    if (end && *end == ']')
        end++;
    if (end)
        *end = '\0';
}

static bool host_known(const struct http *h, const char *host)
{
    char name[256];
    if (!h->loopback)
        return true;
    if (!host)
        return false;
    host_name(host, name, sizeof name);
    struct in_addr v4; /* a name may begin like one: 127.0.0.1.example.com */
    if (inet_pton(AF_INET, name, &v4) == 1)
        return ntohl(v4.s_addr) >> 24 == 127;
    return strcasecmp(name, "localhost") == 0 || strcmp(name, "[::1]") == 0;
}

static bool origin_known(struct request *r)
{
    const char *origin = request_head(r, "Origin"), *host = request_head(r, "Host");
    if (!origin)
        return true;
    const char *name = strstr(origin, "://");
    return name && host && strcasecmp(name + 3, host) == 0;
}

/* Matches a path; what stands for "{}" goes to `param`. */
static bool route_match(const char *pattern, const char *path, char param[HTTP_PARAM_BYTES])
{
    while (*pattern) {
        if (pattern[0] == '{') {
            size_t bytes = strcspn(path, "/");
            if (bytes == 0 || bytes >= HTTP_PARAM_BYTES)
                return false;
            memcpy(param, path, bytes);
            param[bytes] = '\0';
            path += bytes;
            pattern += 2;
        } else if (*pattern++ != *path++) {
            return false;
        }
    }
    return *path == '\0';
}

/* No route of the path takes the method: says which there are. */
static void refuse_method(struct request *r, const char *method, const char *allowed)
{
    if (strcmp(method, "OPTIONS") == 0) {
        struct buf none;
        buf_init(&none);
        request_reply(r, MHD_HTTP_NO_CONTENT, NULL, &none);
    } else {
        request_problem(r, MHD_HTTP_METHOD_NOT_ALLOWED, "method-not-allowed",
                        "%s is not possible here", method);
    }
    request_header(r, "Allow", allowed);
}

/* Finds the route, or answers why there is none. */
static void find_route(struct request *r, const char *method)
{
    char allowed[64] = "";
    size_t used = 0;
    for (size_t i = 0; i < sizeof routes / sizeof *routes; i++) {
        if (!route_match(routes[i].path, r->path, r->param))
            continue;
        bool get = strcmp(routes[i].method, "GET") == 0;
        if (strcmp(routes[i].method, method) == 0 || (get && strcmp(method, "HEAD") == 0)) {
            r->route = &routes[i];
            return;
        }
        used += (size_t)snprintf(allowed + used, sizeof allowed - used, "%s%s, ", routes[i].method,
                                 get ? ", HEAD" : "");
        TL_ASSERT(used < sizeof allowed - sizeof "OPTIONS");
    }
    if (used > 0) {
        (void)snprintf(allowed + used, sizeof allowed - used, "OPTIONS");
        refuse_method(r, method, allowed);
    } else {
        request_problem(r, MHD_HTTP_NOT_FOUND, "unknown-path",
                        "no such path; see /api/v1/openapi.json");
    }
}

static void check_request(struct request *r, const char *method)
{
    bool writes = strcmp(method, "GET") != 0 && strcmp(method, "HEAD") != 0;
    if (!http_framing_clear(r->connection)) {
        request_problem(r, MHD_HTTP_BAD_REQUEST, "bad-request",
                        "Host comes once, and so does Content-Length or Transfer-Encoding");
        request_header(r, "Connection", "close");
        return;
    }
    if (!host_known(r->http, request_head(r, "Host"))) {
        request_problem(r, MHD_HTTP_MISDIRECTED_REQUEST, "unknown-host",
                        "this master answers on loopback names only");
        return;
    }
    if (writes && !origin_known(r)) {
        request_problem(r, MHD_HTTP_FORBIDDEN, "foreign-origin",
                        "requests of other sites are refused");
        return;
    }
    find_route(r, method);
    if (r->route && !r->route->open && !has_token(r)) {
        r->route = NULL;
        request_problem(r, MHD_HTTP_UNAUTHORIZED, "bad-token",
                        "this farm asks for a token; compare it with the master's --token-file");
    }
}

/* --- Requests ----------------------------------------------------------- */

static struct request *request_new(struct http *h, struct MHD_Connection *c, const char *path)
{
    struct request *r = mem_calloc(1, sizeof *r);
    if (!r)
        return NULL;
    r->http = h;
    r->farm = h->farm;
    r->connection = c;
    r->path = path;
    buf_init(&r->body);
    r->next = h->requests;
    if (r->next)
        r->next->previous = r;
    h->requests = r;
    h->counters.requests++;
    return r;
}

static void request_free(struct request *r)
{
    if (r->previous)
        r->previous->next = r->next;
    else
        r->http->requests = r->next;
    if (r->next)
        r->next->previous = r->previous;
    if (r->later)
        r->later->request = NULL;
    r->http->body_bytes -= r->body_counted;
    if (r->response)
        MHD_destroy_response(r->response);
    buf_release(&r->body);
    mem_free(r);
}

static void take_body(struct request *r, const char *data, size_t bytes)
{
    if (r->answered)
        return; /* refused: the rest is read and dropped */
    if (r->body.bytes + bytes > r->route->body_max) {
        request_problem(r, MHD_HTTP_CONTENT_TOO_LARGE, "too-large",
                        "the body is over %" PRIu64 " bytes", r->route->body_max);
        return;
    }
    if (r->http->body_bytes + bytes > HTTP_UPLOAD_BYTES_MAX) {
        request_problem(r, MHD_HTTP_SERVICE_UNAVAILABLE, "busy", "too many uploads at once");
        return;
    }
    buf_put(&r->body, data, bytes);
    r->http->body_bytes += bytes;
    r->body_counted += bytes;
    r->body_progress += bytes;
    if (r->body_progress >= HTTP_PROGRESS_BYTES) {
        r->body_progress = 0;
        http_guest_idle(r->http, r->connection);
    }
    if (buf_status(&r->body) != ERR_OK)
        request_error(r, ERR_NOMEM);
}

static enum MHD_Result queue_answer(struct request *r)
{
    if (!r->response) {
        /* Out of memory even for the problem: end the connection. */
        return MHD_NO;
    }
    if (!r->streams)
        http_guest_reads(r->http, r->connection);
    return MHD_queue_response(r->connection, r->status, r->response);
}

static enum MHD_Result on_request(void *ctx, struct MHD_Connection *c, const char *path,
                                  const char *method, const char *version, const char *data,
                                  size_t *bytes, void **request)
{
    (void)version;
    struct http *h = ctx;
    struct request *r = *request;
    if (!r) {
        r = request_new(h, c, path);
        *request = r;
        if (!r)
            return MHD_NO;
        check_request(r, method);
        /* An early refusal is sent when the body was read, so that the client reads it. */
        return MHD_YES;
    }
    r->path = path;
    if (*bytes > 0) {
        if (r->route)
            take_body(r, data, *bytes);
        *bytes = 0;
        return MHD_YES;
    }
    if (!r->answered && !r->handled) {
        r->handled = true;
        http_guest_busy(c);
        r->route->handle(r);
        if (r->waiting)
            return MHD_YES;
    }
    return r->answered ? queue_answer(r) : MHD_YES;
}

static void on_completed(void *ctx, struct MHD_Connection *c, void **request,
                         enum MHD_RequestTerminationCode code)
{
    (void)code;
    http_guest_idle(ctx, c);
    if (*request)
        request_free(*request);
    *request = NULL;
}

/* --- Start and stop ------------------------------------------------------ */

/* "HOST:PORT" or "[v6]:PORT" into its two parts. */
static bool split_address(const char *text, char *host, size_t host_bytes, char *port,
                          size_t port_bytes)
{
    const char *colon = strrchr(text, ':');
    if (!colon || colon == text || !colon[1])
        return false;
    const char *begin = text[0] == '[' ? text + 1 : text;
    const char *end = text[0] == '[' ? colon - 1 : colon;
    if (end <= begin || (text[0] == '[' && *end != ']') || (size_t)(end - begin) >= host_bytes ||
        strlen(colon + 1) >= port_bytes || strspn(colon + 1, "0123456789") != strlen(colon + 1))
        return false;
    memcpy(host, begin, (size_t)(end - begin));
    host[end - begin] = '\0';
    (void)snprintf(port, port_bytes, "%s", colon + 1);
    return true;
}

static enum err bind_socket(struct http *h, const struct addrinfo *at, int *out)
{
    int fd = socket(at->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (fd < 0)
        return err_from_errno(errno);
    int on = 1;
    (void)setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
    struct sockaddr_storage bound;
    socklen_t bytes = sizeof bound;
    char host[64], port[16];
    if (bind(fd, at->ai_addr, at->ai_addrlen) != 0 || listen(fd, 512) != 0 ||
        getsockname(fd, (struct sockaddr *)&bound, &bytes) != 0 ||
        getnameinfo((struct sockaddr *)&bound, bytes, host, sizeof host, port, sizeof port,
                    NI_NUMERICHOST | NI_NUMERICSERV) != 0) {
        enum err e = errno == EACCES ? ERR_ADDRESS : err_from_errno(errno);
        (void)close(fd);
        return e;
    }
    bool v6 = at->ai_family == AF_INET6;
    (void)snprintf(h->address, sizeof h->address, v6 ? "[%.45s]:%s" : "%.45s:%s", host, port);
    h->loopback = strncmp(host, "127.", 4) == 0 || strcmp(host, "::1") == 0;
    *out = fd;
    return ERR_OK;
}

static enum err listen_on(struct http *h, const char *addr_port, int *fd)
{
    char host[64], port[8];
    if (!split_address(addr_port, host, sizeof host, port, sizeof port))
        return ERR_USAGE;
    struct addrinfo hints = {.ai_socktype = SOCK_STREAM, .ai_flags = AI_PASSIVE}, *found = NULL;
    if (getaddrinfo(host, port, &hints, &found) != 0)
        return ERR_ADDRESS;
    enum err e = bind_socket(h, found, fd);
    freeaddrinfo(found);
    return e;
}

/* libmicrohttpd's part. With TLS it is handed the texts of the PEM files, which it copies. */
static struct MHD_Daemon *make_daemon(struct http *h, int fd, char *certificate, char *key)
{
    struct MHD_OptionItem tls[] = {
        {MHD_OPTION_HTTPS_MEM_CERT, 0, certificate},
        {MHD_OPTION_HTTPS_MEM_KEY, 0, key},
        {MHD_OPTION_HTTPS_PRIORITIES, 0, (void *)(uintptr_t)TLS_PRIORITIES},
        {MHD_OPTION_END, 0, NULL},
    };
    struct MHD_OptionItem none[] = {{MHD_OPTION_END, 0, NULL}};
    uint32_t people, workers;
    farm_connection_limits(FARM_PEOPLE_MAX, &people, &workers);
    h->guests.count_max = people;
    unsigned flags = MHD_USE_EPOLL | MHD_ALLOW_SUSPEND_RESUME | (h->secure ? MHD_USE_TLS : 0);
    return MHD_start_daemon(
        flags, 0, NULL, NULL, on_request, h, MHD_OPTION_LISTEN_SOCKET, fd,
        MHD_OPTION_NOTIFY_COMPLETED, on_completed, h, MHD_OPTION_NOTIFY_CONNECTION,
        http_guest_notify, h, MHD_OPTION_CONNECTION_LIMIT, (unsigned)people,
        MHD_OPTION_CONNECTION_TIMEOUT, (unsigned)HTTP_IDLE_S, MHD_OPTION_CONNECTION_MEMORY_LIMIT,
        (size_t)(64 * 1024), MHD_OPTION_ARRAY, h->secure ? tls : none, MHD_OPTION_END);
}

static enum err read_pem(const char *path, char **out)
{
    size_t bytes;
    enum err e = path ? file_read(path, PEM_BYTES_MAX, out, &bytes) : ERR_OK;
    if (e != ERR_OK)
        log_error("master", "cannot read file=%s error=\"%s\"", path, err_text(e));
    return e == ERR_NOMEM || e == ERR_OK ? e : ERR_INPUT;
}

static enum err start_microhttpd(struct http *h, int fd, const struct tls_files *tls)
{
    char *certificate = NULL, *key = NULL;
    h->secure = tls->certificate != NULL;
    enum err e = read_pem(tls->certificate, &certificate);
    if (e == ERR_OK)
        e = read_pem(tls->key, &key);
    if (e == ERR_OK) {
        h->daemon = make_daemon(h, fd, certificate, key);
        e = h->daemon ? ERR_OK : h->secure ? ERR_INPUT : ERR_NOMEM;
        if (e == ERR_INPUT)
            log_error("master", "HTTP takes no TLS certificate=%s key=%s", tls->certificate,
                      tls->key);
    }
    if (key)
        explicit_bzero(key, strlen(key));
    mem_free(key);
    mem_free(certificate);
    return e;
}

static enum err start_daemon(struct http *h, int fd, const struct tls_files *tls)
{
    TL_TRY(start_microhttpd(h, fd, tls));
    const union MHD_DaemonInfo *info = MHD_get_daemon_info(h->daemon, MHD_DAEMON_INFO_EPOLL_FD);
    if (!info || uv_poll_init(h->farm->loop, &h->poll, info->epoll_fd) != 0)
        return ERR_NOMEM;
    (void)uv_timer_init(h->farm->loop, &h->timer);
    h->poll.data = h;
    h->timer.data = h;
    (void)uv_timer_init(h->farm->loop, &h->tick);
    h->tick.data = h;
    (void)uv_timer_start(&h->tick, on_tick, HTTP_TICK_MS, HTTP_TICK_MS);
    h->handles_open = 3;
    (void)uv_poll_start(&h->poll, UV_READABLE, on_poll);
    return ERR_OK;
}

/* ERR_NOMEM: there must be no session that others can guess. */
static enum err make_session(struct http *h, const char *token)
{
    char *text = mem_sprintf("tilery session %" PRIu64 " %s", h->farm->id, token);
    if (!text)
        return ERR_NOMEM;
    digest d = digest_of(text, strlen(text));
    digest_to_hex(&d, h->session);
    mem_free(text);
    return ERR_OK;
}

enum err http_start(struct farm *f, const struct http_options *o, struct http **out)
{
    struct http *h = mem_calloc(1, sizeof *h);
    int fd = -1;
    if (!h)
        return ERR_NOMEM;
    h->farm = f;
    h->stall_ms = 1;
    h->token = o->token;
    enum err e = o->token ? make_session(h, o->token) : ERR_OK;
    if (e == ERR_OK)
        e = listen_on(h, o->address, &fd);
    if (e != ERR_OK) {
        log_error("master", "cannot listen for HTTP address=%s error=\"%s\"", o->address,
                  e == ERR_USAGE ? "not an ADDRESS:PORT" : err_text(e));
        mem_free(h);
        return e;
    }
    e = start_daemon(h, fd, &o->tls);
    if (e != ERR_OK) {
        if (h->daemon)
            MHD_stop_daemon(h->daemon);
        else
            (void)close(fd);
        mem_free(h);
        return e;
    }
    events_on_new(f->events, http_streams_wake, h);
    *out = h;
    return ERR_OK;
}

const char *http_address(const struct http *h)
{
    return h->address;
}

static void on_closed(uv_handle_t *handle)
{
    struct http *h = handle->data;
    if (--h->handles_open == 0)
        mem_free(h);
}

void http_stop(struct http *h)
{
    if (!h)
        return;
    h->stopping = true;
    events_on_new(h->farm->events, NULL, NULL);
    http_streams_close(h);
    for (struct request *r = h->requests; r; r = r->next)
        if (r->waiting && !r->answered)
            request_problem(r, MHD_HTTP_SERVICE_UNAVAILABLE, "stopping", "the master stops");
    (void)MHD_run(h->daemon);
    MHD_stop_daemon(h->daemon);
    uv_close((uv_handle_t *)&h->poll, on_closed);
    uv_close((uv_handle_t *)&h->timer, on_closed);
    uv_close((uv_handle_t *)&h->tick, on_closed);
}
