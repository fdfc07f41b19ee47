#include "proto/transport_tls.h"

#include <arpa/inet.h>
#include <errno.h>
#include <gnutls/gnutls.h>
#include <stdio.h>
#include <string.h>

#include "common/mem.h"

struct tls_party {
    gnutls_certificate_credentials_t credentials;
    bool master, demands_certificate;
};

struct tls_link {
    gnutls_session_t session;
    const unsigned char *input;
    size_t input_bytes;
    struct buf output;
    char problem[TLS_PROBLEM_BYTES];
};

/* --- Party ---------------------------------------------------------------------- */

static enum err party_new(bool master, struct tls_party **out)
{
    struct tls_party *p = mem_calloc(1, sizeof *p);
    if (!p)
        return ERR_NOMEM;
    p->master = master;
    if (gnutls_certificate_allocate_credentials(&p->credentials) < 0) {
        mem_free(p);
        return ERR_NOMEM;
    }
    *out = p;
    return ERR_OK;
}

void tls_party_free(struct tls_party *p)
{
    if (!p)
        return;
    gnutls_certificate_free_credentials(p->credentials);
    mem_free(p);
}

static enum err take_certificate(struct tls_party *p, const struct tls_files *files, char *problem)
{
    int status = gnutls_certificate_set_x509_key_file(p->credentials, files->certificate,
                                                      files->key, GNUTLS_X509_FMT_PEM);
    if (status >= 0)
        return ERR_OK;
    (void)snprintf(problem, TLS_PROBLEM_BYTES, "certificate %s with key %s: %s", files->certificate,
                   files->key, gnutls_strerror(status));
    return status == GNUTLS_E_MEMORY_ERROR ? ERR_NOMEM : ERR_INPUT;
}

static enum err take_ca(struct tls_party *p, const char *path, char *problem)
{
    int count = gnutls_certificate_set_x509_trust_file(p->credentials, path, GNUTLS_X509_FMT_PEM);
    if (count > 0)
        return ERR_OK;
    (void)snprintf(problem, TLS_PROBLEM_BYTES, "CA %s: %s", path,
                   count == 0 ? "holds no certificate" : gnutls_strerror(count));
    return count == GNUTLS_E_MEMORY_ERROR ? ERR_NOMEM : ERR_INPUT;
}

static enum err trust_system(struct tls_party *p, char *problem)
{
    if (gnutls_certificate_set_x509_system_trust(p->credentials) > 0)
        return ERR_OK;
    (void)snprintf(problem, TLS_PROBLEM_BYTES,
                   "this system trusts no certificate authority; name one with --tls-ca");
    return ERR_INPUT;
}

enum err tls_party_new_master(const struct tls_files *files, struct tls_party **out, char *problem)
{
    TL_ASSERT(files->certificate && files->key);
    struct tls_party *p = NULL;
    TL_TRY(party_new(true, &p));
    enum err e = take_certificate(p, files, problem);
    if (e == ERR_OK && files->ca) {
        p->demands_certificate = true;
        e = take_ca(p, files->ca, problem);
    }
    if (e == ERR_OK)
        *out = p;
    else
        tls_party_free(p);
    return e;
}

enum err tls_party_new_worker(const struct tls_files *files, struct tls_party **out, char *problem)
{
    TL_ASSERT(!files->certificate == !files->key);
    struct tls_party *p = NULL;
    TL_TRY(party_new(false, &p));
    enum err e = files->ca ? take_ca(p, files->ca, problem) : trust_system(p, problem);
    if (e == ERR_OK && files->certificate)
        e = take_certificate(p, files, problem);
    if (e == ERR_OK)
        *out = p;
    else
        tls_party_free(p);
    return e;
}

/* --- Link ----------------------------------------------------------------------- */

/* GnuTLS writes here what is for the socket. */
static ssize_t push(gnutls_transport_ptr_t ctx, const void *data, size_t bytes)
{
    struct tls_link *l = ctx;
    buf_put(&l->output, data, bytes);
    if (buf_status(&l->output) == ERR_OK)
        return (ssize_t)bytes;
    gnutls_transport_set_errno(l->session, ENOMEM);
    return -1;
}

/* GnuTLS asks here for what came from the socket; it keeps a record that is cut off. */
static ssize_t pull(gnutls_transport_ptr_t ctx, void *out, size_t bytes)
{
    struct tls_link *l = ctx;
    if (l->input_bytes == 0) {
        gnutls_transport_set_errno(l->session, EAGAIN);
        return -1;
    }
    if (bytes > l->input_bytes)
        bytes = l->input_bytes;
    memcpy(out, l->input, bytes);
    l->input += bytes;
    l->input_bytes -= bytes;
    return (ssize_t)bytes;
}

static int pull_ready(gnutls_transport_ptr_t ctx, unsigned ms)
{
    (void)ms; /* never waits: the loop does */
    const struct tls_link *l = ctx;
    return l->input_bytes > 0;
}

/* Without a client CA a worker shows its token alone. */
static void be_master(const struct tls_party *p, struct tls_link *l)
{
    if (!p->demands_certificate)
        return;
    gnutls_certificate_server_set_request(l->session, GNUTLS_CERT_REQUIRE);
    gnutls_session_set_verify_cert(l->session, NULL, 0);
}

/* A name is also sent along, so that a master behind several can be told from them. */
static int be_worker(const char *host, struct tls_link *l)
{
    struct in6_addr ignored;
    bool is_address =
        inet_pton(AF_INET, host, &ignored) == 1 || inet_pton(AF_INET6, host, &ignored) == 1;
    gnutls_session_set_verify_cert(l->session, host, 0);
    return is_address ? 0 : gnutls_server_name_set(l->session, GNUTLS_NAME_DNS, host, strlen(host));
}

enum err tls_link_new(const struct tls_party *p, const char *host, struct tls_link **out)
{
    TL_ASSERT(p->master == !host);
    struct tls_link *l = mem_calloc(1, sizeof *l);
    if (!l)
        return ERR_NOMEM;
    buf_init(&l->output);
    unsigned side = p->master ? GNUTLS_SERVER : GNUTLS_CLIENT;
    if (gnutls_init(&l->session, side | GNUTLS_NONBLOCK | GNUTLS_NO_SIGNAL | GNUTLS_NO_TICKETS) <
        0) {
        mem_free(l);
        return ERR_NOMEM;
    }
    int status = gnutls_priority_set_direct(l->session, TLS_PRIORITIES, NULL);
    if (status >= 0)
        status = gnutls_credentials_set(l->session, GNUTLS_CRD_CERTIFICATE, p->credentials);
    if (p->master)
        be_master(p, l);
    else if (status >= 0)
        status = be_worker(host, l);
    if (status < 0) {
        tls_link_free(l);
        return ERR_NOMEM;
    }
    gnutls_transport_set_ptr(l->session, l);
    gnutls_transport_set_push_function(l->session, push);
    gnutls_transport_set_pull_function(l->session, pull);
    gnutls_transport_set_pull_timeout_function(l->session, pull_ready);
    gnutls_handshake_set_timeout(l->session, GNUTLS_INDEFINITE_TIMEOUT); /* the transport's timer */
    *out = l;
    return ERR_OK;
}

void tls_link_free(struct tls_link *l)
{
    if (!l)
        return;
    gnutls_deinit(l->session);
    buf_release(&l->output);
    mem_free(l);
}

/* The certificate of the other side did not pass: what was the matter with it. */
static void say_untrusted(struct tls_link *l)
{
    gnutls_datum_t text = {0};
    unsigned why = gnutls_session_get_verify_cert_status(l->session);
    if (gnutls_certificate_verification_status_print(why, GNUTLS_CRT_X509, &text, 0) < 0)
        return;
    (void)snprintf(l->problem, sizeof l->problem, "%s", (const char *)text.data);
    gnutls_free(text.data);
}

static bool is_about_certificates(gnutls_alert_description_t alert)
{
    switch (alert) {
    case GNUTLS_A_BAD_CERTIFICATE:
    case GNUTLS_A_UNSUPPORTED_CERTIFICATE:
    case GNUTLS_A_CERTIFICATE_REVOKED:
    case GNUTLS_A_CERTIFICATE_EXPIRED:
    case GNUTLS_A_CERTIFICATE_UNKNOWN:
    case GNUTLS_A_CERTIFICATE_REQUIRED:
    case GNUTLS_A_UNKNOWN_CA:
    case GNUTLS_A_ACCESS_DENIED:
        return true;
    default:
        return false;
    }
}

/* A status below 0 that ends the link, as an error with its words. */
static enum err failure(struct tls_link *l, int status)
{
    (void)snprintf(l->problem, sizeof l->problem, "%s", gnutls_strerror(status));
    switch (status) {
    case GNUTLS_E_MEMORY_ERROR:
    case GNUTLS_E_PUSH_ERROR:
        return ERR_NOMEM;
    case GNUTLS_E_CERTIFICATE_VERIFICATION_ERROR:
    case GNUTLS_E_CERTIFICATE_ERROR:
        say_untrusted(l);
        return ERR_UNTRUSTED;
    case GNUTLS_E_NO_CERTIFICATE_FOUND:
    case GNUTLS_E_CERTIFICATE_REQUIRED:
        return ERR_UNTRUSTED;
    case GNUTLS_E_FATAL_ALERT_RECEIVED: {
        gnutls_alert_description_t alert = gnutls_alert_get(l->session);
        const char *name = gnutls_alert_get_name(alert);
        (void)snprintf(l->problem, sizeof l->problem, "the other side says: %s",
                       name ? name : "unknown alert");
        return is_about_certificates(alert) ? ERR_UNTRUSTED : ERR_CORRUPT;
    }
    default:
        return ERR_CORRUPT;
    }
}

void tls_link_feed(struct tls_link *l, const unsigned char *data, size_t bytes)
{
    TL_ASSERT(l->input_bytes == 0);
    l->input = data;
    l->input_bytes = bytes;
}

enum err tls_link_shake(struct tls_link *l)
{
    int status;
    do
        status = gnutls_handshake(l->session);
    while (status < 0 && status != GNUTLS_E_AGAIN && !gnutls_error_is_fatal(status));
    if (status >= 0)
        return ERR_OK;
    if (status == GNUTLS_E_AGAIN)
        return ERR_AGAIN;
    enum err e = failure(l, status);
    (void)gnutls_alert_send_appropriate(l->session, status);
    l->input_bytes = 0;
    return e;
}

enum err tls_link_open(struct tls_link *l, unsigned char *out, size_t capacity, size_t *bytes)
{
    *bytes = 0;
    for (;;) {
        ssize_t got = gnutls_record_recv(l->session, out + *bytes, capacity - *bytes);
        if (got > 0) {
            *bytes += (size_t)got;
            TL_ASSERT(*bytes < capacity);
        } else if (got == 0) {
            l->input_bytes = 0;
            return ERR_CLOSED;
        } else if (got == GNUTLS_E_AGAIN) {
            return ERR_OK;
        } else if (gnutls_error_is_fatal((int)got)) {
            l->input_bytes = 0;
            return failure(l, (int)got);
        }
    }
}

enum err tls_link_seal(struct tls_link *l, const unsigned char *data, size_t bytes)
{
    while (bytes > 0) {
        ssize_t sent = gnutls_record_send(l->session, data, bytes);
        if (sent < 0)
            return failure(l, (int)sent);
        data += sent;
        bytes -= (size_t)sent;
    }
    return ERR_OK;
}

void tls_link_bye(struct tls_link *l)
{
    (void)gnutls_bye(l->session, GNUTLS_SHUT_WR);
}

struct buf *tls_link_output(struct tls_link *l)
{
    return &l->output;
}

const char *tls_link_problem(const struct tls_link *l)
{
    return l->problem;
}
