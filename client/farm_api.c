#include "client/farm_api.h"

#include <errno.h>
#include <string.h>
#include <strings.h>

#include "client/cli_settings.h"
#include "client/out_file.h"
#include "client/quiet_thread.h"
#include "client/signals.h"
#include "common/json_put.h"
#include "common/mem.h"

double reply_number(const struct json *object, const char *key, double fallback)
{
    const struct json *v = object ? json_get_member(object, key) : NULL;
    return v && v->type == JSON_NUMBER ? v->number : fallback;
}

const char *reply_text(const struct json *object, const char *key, const char *fallback)
{
    const struct json *v = object ? json_get_member(object, key) : NULL;
    return v && v->type == JSON_STRING ? v->text : fallback;
}

bool reply_range(const struct json *object, const char *key, double out[2])
{
    const struct json *v = object ? json_get_member(object, key) : NULL;
    if (!v || v->type != JSON_ARRAY || v->count != 2 || v->first->type != JSON_NUMBER ||
        v->first->next->type != JSON_NUMBER)
        return false;
    out[0] = v->first->number;
    out[1] = v->first->next->number;
    return true;
}

void reply_put(const struct json *v, struct buf *out)
{
    /* As deep as the parser allows: JSON_DEPTH_MAX. */
    switch (v->type) {
    case JSON_NULL:
        buf_printf(out, "null");
        break;
    case JSON_BOOL:
        buf_printf(out, v->truth ? "true" : "false");
        break;
    case JSON_NUMBER:
        json_put_number(out, v->number);
        break;
    case JSON_STRING:
        json_put_text(out, v->text);
        break;
    case JSON_ARRAY:
    case JSON_OBJECT:
        buf_printf(out, v->type == JSON_ARRAY ? "[" : "{");
        for (const struct json *m = v->first; m; m = m->next) {
            if (v->type == JSON_OBJECT) {
                json_put_text(out, m->key);
                buf_printf(out, ":");
            }
            reply_put(m, out);
            buf_printf(out, m->next ? "," : "");
        }
        buf_printf(out, v->type == JSON_ARRAY ? "]" : "}");
        break;
    }
}

static int no_memory(void)
{
    cli_error("no-memory", NULL, "out of memory");
    return EXIT_MACHINE;
}

static const char *origin_of(const struct cli *cli)
{
    switch (cli->origins[CLI_MASTER]) {
    case CLI_FROM_OPTION:
        return "--master";
    case CLI_FROM_ENVIRONMENT:
        return "TILERY_MASTER";
    default:
        return "settings file";
    }
}

int farm_open(struct farm *f, const struct cli *cli)
{
    *f = (struct farm){.origin = origin_of(cli)};
    if (!cli_has(&cli->line, CLI_MASTER)) {
        cli_error("no-master",
                  "set it to the URL of tilery-master's HTTP side, or render here: "
                  "tilery render S.json -o OUT.exr",
                  "no farm: TILERY_MASTER is not set");
        return EXIT_FARM;
    }
    struct diag_list problems;
    char *token = NULL;
    diag_init(&problems);
    enum err e = cli_settings_token(cli, &token, &problems);
    if (e != ERR_OK) {
        if (e == ERR_NOMEM)
            (void)no_memory();
        diag_print(&problems, stderr);
        diag_release(&problems);
        return e == ERR_NOMEM ? EXIT_MACHINE : EXIT_USAGE;
    }
    diag_release(&problems);
    const char *url = cli_text(&cli->line, CLI_MASTER);
    struct http_client_options options = {
        .base_url = url,
        .token = token,
        .ca_file = cli_has(&cli->line, CLI_TLS_CA) ? cli_text(&cli->line, CLI_TLS_CA) : NULL,
        .interrupted = &signals_interrupts};
    e = http_client_new(&options, &f->http);
    if (token)
        explicit_bzero(token, strlen(token));
    mem_free(token);
    if (e == ERR_OK)
        return EXIT_DONE;
    if (e == ERR_NOMEM)
        return no_memory();
    cli_error("bad-master", "as in http://10.0.0.5:8080", "%s is no URL of a master", f->origin);
    return EXIT_USAGE;
}

int farm_open_private(struct farm *f, const char *url, const char *token,
                      const volatile sig_atomic_t *interrupted)
{
    *f = (struct farm){.origin = "private", .is_private = true};
    struct http_client_options options = {
        .base_url = url, .token = token, .direct = true, .interrupted = interrupted};
    return http_client_new(&options, &f->http) == ERR_OK ? EXIT_DONE : no_memory();
}

void farm_release(struct farm *f)
{
    http_client_free(f->http);
    http_reply_release(&f->reply);
    *f = (struct farm){0};
}

void farm_json_release(struct farm_json *j)
{
    if (j->open)
        json_get_close(&j->json);
    diag_release(&j->problems);
    *j = (struct farm_json){0};
}

static enum err reply_parse(struct farm *f, struct farm_json *out)
{
    *out = (struct farm_json){0};
    diag_init(&out->problems);
    enum err e = json_get_open(&out->json, (const char *)f->reply.body.data, f->reply.body.bytes,
                               "reply", &out->problems);
    out->open = e == ERR_OK;
    if (e != ERR_OK)
        farm_json_release(out);
    return e == ERR_OK || e == ERR_NOMEM ? e : ERR_CORRUPT;
}

/* "#/objects/2/name" (RFC 6901) as "$.objects[2].name", the way our own messages say it. */
static void pointer_to_path(const char *pointer, char *out, size_t bytes)
{
    size_t used = (size_t)snprintf(out, bytes, "$");
    const char *at = pointer[0] == '#' ? pointer + 1 : pointer;
    while (*at == '/' && used < bytes) {
        size_t length = strcspn(++at, "/");
        bool number = length > 0 && strspn(at, "0123456789") >= length;
        int n = snprintf(out + used, bytes - used, number ? "[%.*s]" : ".%.*s", (int)length, at);
        used += n > 0 ? (size_t)n : 0;
        at += length;
    }
}

static void print_problem_errors(const struct json *problem)
{
    const struct json *errors = json_get_member(problem, "errors");
    if (!errors || errors->type != JSON_ARRAY)
        return;
    for (const struct json *e = errors->first; e; e = e->next) {
        char path[300];
        if (e->type != JSON_OBJECT)
            continue;
        pointer_to_path(reply_text(e, "pointer", "#"), path, sizeof path);
        (void)fprintf(stderr, "%s: %s\n", cli_safe(path),
                      cli_safe(reply_text(e, "detail", "is wrong")));
        const char *nearest = reply_text(e, "nearest", NULL);
        if (nearest)
            (void)fprintf(stderr, "  did you mean \"%s\"?\n", cli_safe(nearest));
    }
}

static int exit_of_status(const struct farm *f, long status)
{
    if (f->is_private && status >= 500)
        return EXIT_MACHINE;
    if (status == 422 || status == 400 || status == 413)
        return EXIT_INPUT;
    if (status == 409 || status == 412)
        return EXIT_FAILED;
    return EXIT_FARM;
}

/* A reply with an error status, in words; RFC 9457 bodies are read where there is one. */
static int explain_status(struct farm *f)
{
    long status = f->reply.status;
    const char *url = http_client_url(f->http);
    if (status == 401 || status == 403) {
        cli_error("bad-token", "compare it with the master's --token-file",
                  "%s refused the token (or wants one: TILERY_TOKEN)", url);
        return EXIT_FARM;
    }
    struct farm_json reply;
    if (reply_parse(f, &reply) != ERR_OK) {
        cli_error("bad-reply", NULL, "%s answered with HTTP status %ld", url, status);
        return exit_of_status(f, status);
    }
    const struct json *root = reply.json.root;
    const char *type = reply_text(root, "type", "about:blank");
    const char *id = strrchr(type, '#') ? strrchr(type, '#') + 1 : "refused";
    const char *text = reply_text(root, "detail", reply_text(root, "title", "refused"));
    print_problem_errors(root);
    cli_error(cli_safe(id), NULL, "%s", text);
    farm_json_release(&reply);
    return exit_of_status(f, status);
}

int farm_explain(struct farm *f, enum err e)
{
    const char *url = http_client_url(f->http);
    switch (e) {
    case ERR_OK:
        return explain_status(f);
    case ERR_NOMEM:
        return no_memory();
    case ERR_CANCELLED:
        return EXIT_INTERRUPTED;
    case ERR_CORRUPT:
        cli_error("bad-reply", "is that a tilery-master's HTTP port?",
                  "%s does not answer as a master does", url);
        return EXIT_FARM;
    case ERR_UNTRUSTED:
        cli_error("untrusted",
                  "name the farm's own authority with --tls-ca FILE or TILERY_TLS_CA; the URL's "
                  "host must stand in the certificate",
                  "no trust in the certificate of %s: %s", url, http_client_error(f->http));
        return EXIT_FARM;
    case ERR_NOSPACE:
    case ERR_IO:
        cli_error("cannot-write", NULL, "cannot store the reply: %s", strerror(errno));
        return EXIT_MACHINE;
    default:
        break;
    }
    if (f->is_private) {
        cli_error("master-lost", NULL, "the private master does not answer: %s",
                  http_client_error(f->http));
        return EXIT_MACHINE;
    }
    cli_error("no-master",
              "is tilery-master running? or render here: tilery render S.json -o OUT.exr",
              "no farm at %s (%s): %s", url, f->origin, http_client_error(f->http));
    return EXIT_FARM;
}

enum err farm_try(struct farm *f, const char *method, const char *path, struct farm_json *out)
{
    struct http_request request = {.method = method, .path = path};
    TL_TRY(http_call(f->http, &request, &f->reply));
    if (out && f->reply.status >= 200 && f->reply.status < 300)
        return reply_parse(f, out);
    return ERR_OK;
}

int farm_call(struct farm *f, const char *method, const char *path, const struct buf *body,
              struct farm_json *out)
{
    struct http_request request = {.method = method, .path = path};
    if (body) {
        if (buf_status(body) != ERR_OK)
            return no_memory();
        request.body = body->data;
        request.body_bytes = body->bytes;
        request.content_type = "application/json";
    }
    enum err e = http_call(f->http, &request, &f->reply);
    bool good = e == ERR_OK && f->reply.status >= 200 && f->reply.status < 300;
    if (good && out)
        e = reply_parse(f, out);
    return good && e == ERR_OK ? EXIT_DONE : farm_explain(f, e);
}

int farm_job_path(const char *id, const char *tail, char out[FARM_PATH_BYTES])
{
    size_t bytes = strlen(id);
    bool plain =
        bytes > 0 && bytes < FARM_ID_BYTES &&
        strspn(id, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_") == bytes;
    if (!plain) {
        cli_error("unknown-job", "see tilery jobs", "no job \"%s\"", id);
        return EXIT_FARM;
    }
    (void)snprintf(out, FARM_PATH_BYTES, "/api/v1/jobs/%s%s", id, tail);
    return EXIT_DONE;
}

/* The farm has no whole picture of the job: how far it is, or how it ended. */
static int explain_unfinished(struct farm *f, const char *job)
{
    char path[FARM_PATH_BYTES], hint[FARM_ID_BYTES + 60];
    struct farm_json reply;
    int status = farm_job_path(job, "", path);
    if (status == EXIT_DONE)
        status = farm_call(f, "GET", path, NULL, &reply);
    if (status != EXIT_DONE)
        return status;
    const char *state = reply_text(reply.json.root, "state", "");
    double share = 100 * reply_number(reply.json.root, "done", 0);
    bool cancelled = strcmp(state, "cancelled") == 0, failed = strcmp(state, "failed") == 0;
    (void)snprintf(hint, sizeof hint, "%s: tilery %s %s",
                   cancelled || failed ? "to try it again" : "to wait for it",
                   cancelled || failed ? "retry" : "watch", job);
    cli_error("unfinished", hint, "%s %s %s, %.1f %% done: there is no whole picture", job,
              cancelled ? "was"
              : failed  ? "has"
                        : "is",
              cli_safe(state), share);
    farm_json_release(&reply);
    return EXIT_FAILED;
}

const char *farm_exr_of(const struct cli_line *line)
{
    return cli_flag(line, CLI_HALF) ? FARM_HALF : "picture.exr";
}

/* A picture that lost light says so, also under --quiet. */
static void say_clamped(const char *path, const char *count)
{
    uint64_t clamped;
    if (cli_parse_count(count, UINT64_MAX, &clamped) && clamped > 0)
        cli_warn("%s: %llu values over 65504 do not fit into half floats and became 65504", path,
                 (unsigned long long)clamped);
}

int farm_fetch_picture(struct farm *f, const char *job, const char *what, const char *path,
                       const char *rescue)
{
    char url[FARM_PATH_BYTES], tail[40];
    struct out_file out;
    (void)snprintf(tail, sizeof tail, "/%s", what);
    int status = farm_job_path(job, tail, url);
    if (status != EXIT_DONE)
        return status;
    enum err e = out_file_begin(&out, path);
    if (e != ERR_OK)
        return cli_cannot_write(path, e, errno, 0, rescue);
    struct http_request request = {
        .method = "GET", .path = url, .body_fd = out.fd, .reply_header = "X-Tilery-Clamped"};
    e = http_call(f->http, &request, &f->reply);
    if (e == ERR_OK && f->reply.status == 200)
        e = out_file_commit(&out);
    else if (e == ERR_OK && f->reply.status == 409)
        status = explain_unfinished(f, job);
    else
        status = e == ERR_NOSPACE || e == ERR_IO ? EXIT_MACHINE : farm_explain(f, e);
    out_file_abort(&out);
    if (e == ERR_NOSPACE || e == ERR_IO)
        status = cli_cannot_write(path, e, e == ERR_IO ? errno : 0, 0, rescue);
    if (status == EXIT_DONE)
        say_clamped(path, f->reply.header);
    return status;
}

static const struct package_chunk *chunk_find(const struct package *p, const char *hex)
{
    digest name;
    if (!digest_from_hex(hex, &name))
        return NULL;
    for (size_t i = 0; i < p->count; i++)
        if (digest_equal(&p->chunks[i].name, &name))
            return &p->chunks[i];
    return NULL;
}

/* A chunk as it travels, made while the one before is on its way. */
struct squeeze {
    const struct package_chunk *chunk;
    struct buf frame;
    enum err error;
    pthread_t thread;
    bool runs;
};

enum { SQUEEZE_AHEAD_BYTES_MIN = 256 << 10 }; /* of a chunk that is worth a thread */

static void *squeeze_run(void *ctx)
{
    struct squeeze *s = ctx;
    s->error = chunk_compress(s->chunk->data, s->chunk->bytes, &s->frame);
    return NULL;
}

static void squeeze_begin(struct squeeze *s, const struct package_chunk *chunk)
{
    *s = (struct squeeze){.chunk = chunk};
    buf_init(&s->frame);
    s->runs = chunk->bytes >= SQUEEZE_AHEAD_BYTES_MIN &&
              quiet_thread_begin(&s->thread, squeeze_run, s) == 0;
    if (!s->runs)
        (void)squeeze_run(s);
}

static enum err squeeze_end(struct squeeze *s)
{
    if (s->runs)
        (void)pthread_join(s->thread, NULL);
    return s->error;
}

static int frame_send(struct farm *f, const struct package_chunk *chunk, const struct buf *frame)
{
    char hex[DIGEST_HEX_BYTES], path[FARM_PATH_BYTES];
    digest_to_hex(&chunk->name, hex);
    (void)snprintf(path, sizeof path, "/api/v1/chunks/%s", hex);
    struct http_request request = {.method = "PUT",
                                   .path = path,
                                   .body = frame->data,
                                   .body_bytes = frame->bytes,
                                   .content_type = "application/zstd"};
    enum err e = http_call(f->http, &request, &f->reply);
    bool good = e == ERR_OK && f->reply.status >= 200 && f->reply.status < 300;
    return good ? EXIT_DONE : farm_explain(f, e);
}

/* `chunks` (not none) in turn. */
static int chunks_send(struct farm *f, const struct package_chunk *const *chunks, size_t count)
{
    struct squeeze turns[2];
    int status = EXIT_DONE;
    squeeze_begin(&turns[0], chunks[0]);
    for (size_t i = 0; i < count; i++) {
        struct squeeze *now = &turns[i % 2], *next = &turns[(i + 1) % 2];
        enum err e = squeeze_end(now);
        if (e != ERR_OK && status == EXIT_DONE)
            status = no_memory();
        bool more = status == EXIT_DONE && i + 1 < count;
        if (more)
            squeeze_begin(next, chunks[i + 1]);
        if (status == EXIT_DONE)
            status = frame_send(f, now->chunk, &now->frame);
        buf_release(&now->frame);
        if (!more)
            break;
    }
    return status;
}

static int missing_ask(struct farm *f, const struct package *p, struct farm_json *out)
{
    struct buf body;
    buf_init(&body);
    buf_printf(&body, "{\"sha256\":[");
    for (size_t i = 0; i < p->count; i++) {
        char hex[DIGEST_HEX_BYTES];
        digest_to_hex(&p->chunks[i].name, hex);
        buf_printf(&body, "%s\"%s\"", i ? "," : "", hex);
    }
    buf_printf(&body, "]}");
    int status = farm_call(f, "POST", "/api/v1/chunks/missing", &body, out);
    buf_release(&body);
    return status;
}

/* Those of the package that the reply names; NULL: out of memory. */
static const struct package_chunk **missing_take(const struct package *p, const struct json *root,
                                                 size_t *count)
{
    const struct json *missing = json_get_member(root, "missing");
    const struct json *v = missing && missing->type == JSON_ARRAY ? missing->first : NULL;
    const struct package_chunk **chunks = mem_alloc_array(p->count, sizeof *chunks);
    *count = 0;
    for (; v && chunks && *count < p->count; v = v->next) {
        const struct package_chunk *chunk = v->type == JSON_STRING ? chunk_find(p, v->text) : NULL;
        if (chunk)
            chunks[(*count)++] = chunk;
    }
    return chunks;
}

static int package_send(struct farm *f, const struct package *p)
{
    struct farm_json reply;
    size_t count;
    int status = missing_ask(f, p, &reply);
    if (status != EXIT_DONE)
        return status;
    const struct package_chunk **chunks = missing_take(p, reply.json.root, &count);
    farm_json_release(&reply);
    if (!chunks)
        return no_memory();
    if (count > 0)
        status = chunks_send(f, chunks, count);
    mem_free((void *)chunks);
    return status;
}

static int job_post(struct farm *f, const struct farm_job_request *request, char id[FARM_ID_BYTES])
{
    struct buf body;
    char hex[DIGEST_HEX_BYTES];
    struct farm_json reply;
    digest_to_hex(&request->package->chunks[0].name, hex);
    buf_init(&body);
    buf_printf(&body, "{\"name\":");
    json_put_text(&body, request->name);
    buf_printf(&body, ",\"package\":\"%s\",\"spec\":%s,\"priority\":%lld", hex, request->spec_json,
               (long long)request->priority);
    if (request->frame)
        buf_printf(&body, ",\"frame\":%u", request->frame->number);
    if (request->frame && request->frame->shot)
        buf_printf(&body, ",\"shot\":\"%s\"", request->frame->shot);
    if (request->plan_json)
        buf_printf(&body, ",\"plan\":%s", request->plan_json);
    buf_put_u8(&body, '}');
    int status = farm_call(f, "POST", "/api/v1/jobs", &body, &reply);
    buf_release(&body);
    if (status != EXIT_DONE)
        return status;
    (void)snprintf(id, FARM_ID_BYTES, "%s", cli_safe(reply_text(reply.json.root, "id", "")));
    farm_json_release(&reply);
    if (id[0])
        return EXIT_DONE;
    return farm_explain(f, ERR_CORRUPT);
}

int farm_submit(struct farm *f, const struct farm_job_request *request, char id[FARM_ID_BYTES])
{
    int status = package_send(f, request->package);
    return status == EXIT_DONE ? job_post(f, request, id) : status;
}
