#include "client/http_client.h"

#include <curl/curl.h>
#include <errno.h>
#include <poll.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "common/mem.h"

enum {
    REPLY_BYTES_MAX = 256 << 20,
    CONNECT_MS = 5000,
    STALL_SECONDS = 30, /* a call without a byte for so long is given up */
};

struct http_client {
    CURL *easy;
    char *url;
    char *authorization; /* header line, or NULL */
    char *ca_file;       /* or NULL */
    bool direct;
    const volatile sig_atomic_t *interrupted;
    char error[CURL_ERROR_SIZE];
};

static char *base_url_of(const char *given)
{
    bool has_scheme = strncmp(given, "http://", 7) == 0 || strncmp(given, "https://", 8) == 0;
    if (!has_scheme && strstr(given, "://"))
        return NULL;
    size_t bytes = strlen(given);
    while (bytes > 0 && given[bytes - 1] == '/')
        bytes--;
    return mem_sprintf("%s%.*s", has_scheme ? "" : "http://", (int)bytes, given);
}

/* A host and perhaps a port; no path, and no user name, which would be a secret in a URL. */
static bool base_url_valid(const char *url)
{
    const char *host = strstr(url, "://") + 3;
    for (const char *p = host; *p; p++)
        if (*p <= ' ' || strchr("/@?#\\", *p) || *p == 0x7f)
            return false;
    return *host != '\0';
}

enum err http_client_new(const struct http_client_options *options, struct http_client **out)
{
    char *url = base_url_of(options->base_url);
    if (!url || !base_url_valid(url)) {
        mem_free(url);
        return ERR_INPUT;
    }
    struct http_client *c = mem_calloc(1, sizeof *c);
    if (!c) {
        mem_free(url);
        return ERR_NOMEM;
    }
    c->url = url;
    c->direct = options->direct;
    c->interrupted = options->interrupted;
    if (options->token)
        c->authorization = mem_sprintf("Authorization: Bearer %s", options->token);
    if (options->ca_file)
        c->ca_file = mem_sprintf("%s", options->ca_file);
    c->easy = curl_easy_init();
    if (!c->easy || (options->token && !c->authorization) || (options->ca_file && !c->ca_file)) {
        http_client_free(c);
        return ERR_NOMEM;
    }
    *out = c;
    return ERR_OK;
}

void http_client_free(struct http_client *c)
{
    if (!c)
        return;
    curl_easy_cleanup(c->easy);
    if (c->authorization)
        explicit_bzero(c->authorization, strlen(c->authorization));
    mem_free(c->authorization);
    mem_free(c->ca_file);
    mem_free(c->url);
    mem_free(c);
}

const char *http_client_url(const struct http_client *c)
{
    return c->url;
}

const char *http_client_error(const struct http_client *c)
{
    return c->error;
}

void http_reply_init(struct http_reply *r)
{
    *r = (struct http_reply){0};
}

void http_reply_release(struct http_reply *r)
{
    buf_release(&r->body);
    r->status = 0;
}

/* What one call needs while libcurl calls back. */
struct call {
    struct http_client *client;
    struct http_reply *reply;
    int body_fd;
    const char *header; /* wanted, or NULL */
    enum err failure;
};

static enum err write_all(int fd, const char *data, size_t bytes)
{
    while (bytes > 0) {
        ssize_t written = write(fd, data, bytes);
        if (written < 0 && errno == EINTR)
            continue;
        if (written < 0)
            return err_from_errno(errno);
        data += written;
        bytes -= (size_t)written;
    }
    return ERR_OK;
}

static size_t take_body(char *data, size_t size, size_t count, void *ctx)
{
    struct call *call = ctx;
    size_t bytes = size * count;
    long status = 0;
    (void)curl_easy_getinfo(call->client->easy, CURLINFO_RESPONSE_CODE, &status);
    if (call->body_fd && status >= 200 && status < 300) {
        call->failure = write_all(call->body_fd, data, bytes);
    } else if (call->reply->body.bytes + bytes > REPLY_BYTES_MAX) {
        call->failure = ERR_LIMIT;
    } else {
        buf_put(&call->reply->body, data, bytes);
        call->failure = buf_status(&call->reply->body);
    }
    return call->failure == ERR_OK ? bytes : 0;
}

static size_t take_header(char *data, size_t size, size_t count, void *ctx)
{
    struct call *call = ctx;
    size_t bytes = size * count, name = strlen(call->header);
    if (bytes <= name + 1 || data[name] != ':' || strncasecmp(data, call->header, name) != 0)
        return bytes;
    size_t from = name + 1, to = bytes;
    while (from < to && data[from] == ' ')
        from++;
    while (to > from && (unsigned char)data[to - 1] <= ' ')
        to--;
    (void)snprintf(call->reply->header, sizeof call->reply->header, "%.*s", (int)(to - from),
                   data + from);
    return bytes;
}

static int check_interrupt(void *ctx, curl_off_t total, curl_off_t now, curl_off_t up_total,
                           curl_off_t up_now)
{
    (void)total, (void)now, (void)up_total, (void)up_now;
    const struct http_client *c = ctx;
    return c->interrupted && *c->interrupted;
}

/* Options that calls and streams share. False when memory ran out. */
static bool set_common(struct http_client *c, CURL *easy, const char *path)
{
    char *url = mem_sprintf("%s%s", c->url, path);
    if (!url)
        return false;
    bool ok = curl_easy_setopt(easy, CURLOPT_URL, url) == CURLE_OK;
    mem_free(url);
    ok &= curl_easy_setopt(easy, CURLOPT_USERAGENT, "tilery/" TILERY_VERSION) == CURLE_OK;
    (void)curl_easy_setopt(easy, CURLOPT_PROTOCOLS_STR, "http,https");
    (void)curl_easy_setopt(easy, CURLOPT_NOSIGNAL, 1L);
    (void)curl_easy_setopt(easy, CURLOPT_CONNECTTIMEOUT_MS, (long)CONNECT_MS);
    (void)curl_easy_setopt(easy, CURLOPT_TCP_KEEPALIVE, 1L);
    (void)curl_easy_setopt(easy, CURLOPT_TCP_NODELAY, 1L);
    if (c->ca_file) {
        ok &= curl_easy_setopt(easy, CURLOPT_CAINFO, c->ca_file) == CURLE_OK;
        (void)curl_easy_setopt(easy, CURLOPT_CAPATH, NULL);
    }
    if (c->direct)
        (void)curl_easy_setopt(easy, CURLOPT_PROXY, "");
    return ok;
}

static struct curl_slist *append(struct curl_slist *list, const char *line, bool *ok)
{
    struct curl_slist *longer = curl_slist_append(list, line);
    *ok &= longer != NULL;
    return longer ? longer : list;
}

static struct curl_slist *headers_of(const struct http_client *c, const struct http_request *r,
                                     bool *ok)
{
    /* No "Expect: 100-continue": the master answers at once, and the wait would cost a second. */
    struct curl_slist *list = append(NULL, "Expect:", ok);
    char type[100];
    if (c->authorization)
        list = append(list, c->authorization, ok);
    if (r->header)
        list = append(list, r->header, ok);
    if (r->content_type) {
        (void)snprintf(type, sizeof type, "Content-Type: %s", r->content_type);
        list = append(list, type, ok);
    }
    return list;
}

static enum err err_of_curl(CURLcode code)
{
    switch (code) {
    case CURLE_OK:
        return ERR_OK;
    case CURLE_OUT_OF_MEMORY:
        return ERR_NOMEM;
    case CURLE_OPERATION_TIMEDOUT:
        return ERR_TIMEOUT;
    case CURLE_ABORTED_BY_CALLBACK:
        return ERR_CANCELLED;
    case CURLE_PEER_FAILED_VERIFICATION:
    case CURLE_SSL_CACERT_BADFILE:
    case CURLE_SSL_ISSUER_ERROR:
        return ERR_UNTRUSTED;
    case CURLE_SEND_ERROR:
    case CURLE_RECV_ERROR:
    case CURLE_GOT_NOTHING:
    case CURLE_PARTIAL_FILE:
        return ERR_CLOSED;
    default:
        return ERR_UNREACHABLE;
    }
}

/* "connection refused" rather than libcurl's sentence about ports and milliseconds. */
static void say_why(struct http_client *c, CURLcode code, enum err failure)
{
    long os_errno = 0;
    (void)curl_easy_getinfo(c->easy, CURLINFO_OS_ERRNO, &os_errno);
    if (code == CURLE_COULDNT_CONNECT && os_errno == ECONNREFUSED)
        (void)snprintf(c->error, sizeof c->error, "connection refused");
    else if (code == CURLE_COULDNT_RESOLVE_HOST)
        (void)snprintf(c->error, sizeof c->error, "no such host");
    else if (code == CURLE_OPERATION_TIMEDOUT)
        (void)snprintf(c->error, sizeof c->error, "no answer in time");
    else if (code == CURLE_GOT_NOTHING)
        (void)snprintf(c->error, sizeof c->error,
                       "closed without an answer; is that the master's --http address?");
    else if (!c->error[0])
        (void)snprintf(c->error, sizeof c->error, "%s",
                       failure == err_of_curl(code) ? curl_easy_strerror(code) : err_text(failure));
}

static void set_body(CURL *easy, const struct http_request *r)
{
    (void)curl_easy_setopt(easy, CURLOPT_CUSTOMREQUEST, r->method);
    if (!r->body)
        return;
    (void)curl_easy_setopt(easy, CURLOPT_POST, 1L);
    (void)curl_easy_setopt(easy, CURLOPT_POSTFIELDS, r->body);
    (void)curl_easy_setopt(easy, CURLOPT_POSTFIELDSIZE_LARGE, (curl_off_t)r->body_bytes);
}

enum err http_call(struct http_client *c, const struct http_request *request,
                   struct http_reply *reply)
{
    struct call call = {
        .client = c, .reply = reply, .body_fd = request->body_fd, .header = request->reply_header};
    bool ok = true;
    buf_clear(&reply->body);
    reply->status = 0;
    reply->header[0] = '\0';
    c->error[0] = '\0';
    curl_easy_reset(c->easy); /* keeps the connection */
    struct curl_slist *headers = headers_of(c, request, &ok);
    ok &= set_common(c, c->easy, request->path);
    set_body(c->easy, request);
    (void)curl_easy_setopt(c->easy, CURLOPT_HTTPHEADER, headers);
    (void)curl_easy_setopt(c->easy, CURLOPT_ERRORBUFFER, c->error);
    (void)curl_easy_setopt(c->easy, CURLOPT_WRITEFUNCTION, take_body);
    (void)curl_easy_setopt(c->easy, CURLOPT_WRITEDATA, &call);
    if (request->reply_header) {
        (void)curl_easy_setopt(c->easy, CURLOPT_HEADERFUNCTION, take_header);
        (void)curl_easy_setopt(c->easy, CURLOPT_HEADERDATA, &call);
    }
    (void)curl_easy_setopt(c->easy, CURLOPT_NOPROGRESS, 0L);
    (void)curl_easy_setopt(c->easy, CURLOPT_XFERINFOFUNCTION, check_interrupt);
    (void)curl_easy_setopt(c->easy, CURLOPT_XFERINFODATA, c);
    (void)curl_easy_setopt(c->easy, CURLOPT_LOW_SPEED_LIMIT, 1L);
    (void)curl_easy_setopt(c->easy, CURLOPT_LOW_SPEED_TIME, (long)STALL_SECONDS);

    CURLcode code = ok ? curl_easy_perform(c->easy) : CURLE_OUT_OF_MEMORY;
    enum err failure = call.failure != ERR_OK ? call.failure : err_of_curl(code);
    if (failure != ERR_OK)
        say_why(c, code, failure);
    (void)curl_easy_getinfo(c->easy, CURLINFO_RESPONSE_CODE, &reply->status);
    (void)curl_easy_setopt(c->easy, CURLOPT_HTTPHEADER, NULL);
    curl_slist_free_all(headers);
    if (failure == ERR_OK) {
        buf_put_u8(&reply->body, 0);
        failure = buf_status(&reply->body);
        if (failure == ERR_OK)
            reply->body.bytes--;
    }
    return failure;
}

struct http_stream {
    CURLM *multi;
    CURL *easy;
    struct curl_slist *headers;
    http_stream_bytes *on_bytes;
    void *ctx;
    bool ended;
};

static size_t take_stream(char *data, size_t size, size_t count, void *ctx)
{
    struct http_stream *s = ctx;
    if (http_stream_status(s) == 200)
        s->on_bytes(s->ctx, data, size * count);
    return size * count;
}

enum err http_stream_open(struct http_client *c, const char *path, const char *last_event_id,
                          http_stream_bytes *on_bytes, void *ctx, struct http_stream **out)
{
    char resume[120];
    struct http_request request = {.method = "GET", .path = path};
    if (last_event_id && last_event_id[0]) {
        (void)snprintf(resume, sizeof resume, "Last-Event-ID: %s", last_event_id);
        request.header = resume;
    }
    struct http_stream *s = mem_calloc(1, sizeof *s);
    if (!s)
        return ERR_NOMEM;
    bool ok = true;
    s->on_bytes = on_bytes;
    s->ctx = ctx;
    s->multi = curl_multi_init();
    s->easy = curl_easy_init();
    s->headers = headers_of(c, &request, &ok);
    s->headers = append(s->headers, "Accept: text/event-stream", &ok);
    if (!s->multi || !s->easy || !ok || !set_common(c, s->easy, path)) {
        http_stream_close(s);
        return ERR_NOMEM;
    }
    (void)curl_easy_setopt(s->easy, CURLOPT_HTTPHEADER, s->headers);
    (void)curl_easy_setopt(s->easy, CURLOPT_WRITEFUNCTION, take_stream);
    (void)curl_easy_setopt(s->easy, CURLOPT_WRITEDATA, s);
    /* The master sends a comment each 15 s: three missed and the stream is dead. */
    (void)curl_easy_setopt(s->easy, CURLOPT_LOW_SPEED_LIMIT, 1L);
    (void)curl_easy_setopt(s->easy, CURLOPT_LOW_SPEED_TIME, 45L);
    if (curl_multi_add_handle(s->multi, s->easy) != CURLM_OK) {
        http_stream_close(s);
        return ERR_NOMEM;
    }
    *out = s;
    return ERR_OK;
}

void http_stream_close(struct http_stream *s)
{
    if (!s)
        return;
    if (s->multi && s->easy)
        (void)curl_multi_remove_handle(s->multi, s->easy);
    curl_easy_cleanup(s->easy);
    if (s->multi)
        (void)curl_multi_cleanup(s->multi);
    curl_slist_free_all(s->headers);
    mem_free(s);
}

bool http_stream_wait(struct http_stream *s, int fd, int timeout_ms)
{
    struct curl_waitfd extra = {.fd = fd, .events = CURL_WAIT_POLLIN};
    int running = 0;
    if (s->ended)
        return false;
    if (curl_multi_perform(s->multi, &running) != CURLM_OK || running == 0) {
        s->ended = true;
        return false;
    }
    (void)curl_multi_poll(s->multi, fd >= 0 ? &extra : NULL, fd >= 0 ? 1 : 0, timeout_ms, NULL);
    s->ended = curl_multi_perform(s->multi, &running) != CURLM_OK || running == 0;
    return !s->ended;
}

long http_stream_status(const struct http_stream *s)
{
    long status = 0;
    (void)curl_easy_getinfo(s->easy, CURLINFO_RESPONSE_CODE, &status);
    return status;
}
