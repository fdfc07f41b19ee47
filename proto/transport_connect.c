/* Addresses and how connections begin: text to address, dialling, listening. Owns the lookups and
 * the sockets under way until a connection has one; loop thread only. See transport_impl.h. */
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "common/mem.h"
#include "proto/transport_impl.h"

enum { BACKLOG = 1024, PORT_BYTES = 6 };

void transport_address_text(const struct sockaddr *address, char *out, size_t bytes)
{
    char host[64] = "?";
    unsigned port = 0;
    bool six = address->sa_family == AF_INET6;
    if (six) {
        const struct sockaddr_in6 *in6 = (const struct sockaddr_in6 *)address;
        (void)uv_ip6_name(in6, host, sizeof host);
        port = ntohs(in6->sin6_port);
    } else if (address->sa_family == AF_INET) {
        const struct sockaddr_in *in = (const struct sockaddr_in *)address;
        (void)uv_ip4_name(in, host, sizeof host);
        port = ntohs(in->sin_port);
    }
    (void)snprintf(out, bytes, six ? "[%s]:%u" : "%s:%u", host, port);
}

bool transport_socket_address(int fd, char *out, size_t bytes)
{
    struct sockaddr_storage bound = {0};
    socklen_t bound_bytes = sizeof bound;
    int type = 0;
    socklen_t type_bytes = sizeof type;
    if (getsockopt(fd, SOL_SOCKET, SO_TYPE, &type, &type_bytes) != 0 || type != SOCK_STREAM ||
        getsockname(fd, (struct sockaddr *)&bound, &bound_bytes) != 0 ||
        (bound.ss_family != AF_INET && bound.ss_family != AF_INET6))
        return false;
    transport_address_text((struct sockaddr *)&bound, out, bytes);
    return true;
}

/* Cuts "HOST:PORT" or "[v6]:PORT"; false if it is neither or the port is no number up to 65535. */
static bool split_host_port(const char *text, char host[HOST_BYTES], char port[PORT_BYTES])
{
    const char *colon = strrchr(text, ':');
    if (!colon)
        return false;
    const char *begin = text, *end = colon;
    if (*begin == '[' && end > begin + 1 && end[-1] == ']') {
        begin++;
        end--;
    } else if (memchr(begin, ':', (size_t)(end - begin))) {
        return false; /* a bare v6 address: where does the port begin? */
    }
    size_t host_bytes = (size_t)(end - begin), port_bytes = strlen(colon + 1);
    if (host_bytes == 0 || host_bytes >= HOST_BYTES || port_bytes == 0 || port_bytes >= PORT_BYTES)
        return false;
    unsigned number = 0;
    for (const char *p = colon + 1; *p; p++) {
        if (*p < '0' || *p > '9')
            return false;
        number = number * 10 + (unsigned)(*p - '0');
    }
    memcpy(host, begin, host_bytes);
    host[host_bytes] = '\0';
    memcpy(port, colon + 1, port_bytes + 1);
    return number <= 65535;
}

bool transport_host_port_valid(const char *host_port)
{
    char host[HOST_BYTES], port[PORT_BYTES];
    return split_host_port(host_port, host, port);
}

/* --- Connecting ----------------------------------------------------------------- */

static void try_next_address(struct conn *c);

static void on_retry_closed(uv_handle_t *handle)
{
    struct conn *c = handle->data;
    c->handles--;
    if (c->state == CONN_CLOSING)
        conn_part_gone(c);
    else
        try_next_address(c);
}

static void on_connect(uv_connect_t *request, int status)
{
    struct conn *c = request->data;
    if (c->state == CONN_CLOSING)
        return;
    if (status == 0) {
        uv_freeaddrinfo(c->addresses);
        c->addresses = NULL;
        conn_opened(c);
        return;
    }
    c->tcp_live = false;
    uv_close((uv_handle_t *)&c->tcp, on_retry_closed);
}

static void try_next_address(struct conn *c)
{
    struct addrinfo *address = c->address_next;
    int status = address ? uv_tcp_init(c->transport->loop, &c->tcp) : UV_EOF;
    if (status < 0) {
        uv_freeaddrinfo(c->addresses);
        c->addresses = NULL;
        conn_close(c, ERR_UNREACHABLE);
        return;
    }
    c->address_next = address->ai_next;
    c->tcp.data = c;
    c->tcp_live = true;
    c->handles++;
    c->connect.data = c;
    if (uv_tcp_connect(&c->connect, &c->tcp, address->ai_addr, on_connect) < 0) {
        c->tcp_live = false;
        uv_close((uv_handle_t *)&c->tcp, on_retry_closed);
    }
}

static void on_resolved(uv_getaddrinfo_t *request, int status, struct addrinfo *addresses)
{
    struct conn *c = request->data;
    c->resolving = false;
    c->addresses = c->address_next = addresses;
    if (c->state == CONN_CLOSING) {
        uv_freeaddrinfo(addresses);
        c->addresses = NULL;
        conn_part_gone(c);
        return;
    }
    if (status < 0)
        c->address_next = NULL;
    try_next_address(c);
}

enum err conn_connect(struct transport *t, const char *host_port,
                      const struct conn_options *options, struct conn **out)
{
    TL_ASSERT(!t->closing && options->handlers.on_message);
    char host[HOST_BYTES], port[PORT_BYTES];
    if (!split_host_port(host_port, host, port))
        return ERR_USAGE;
    struct conn *c = conn_new(t, options);
    if (!c)
        return ERR_NOMEM;
    (void)snprintf(c->peer, sizeof c->peer, "%s", host_port);
    memcpy(c->host, host, sizeof c->host);

    struct addrinfo hints = {.ai_family = AF_UNSPEC, .ai_socktype = SOCK_STREAM};
    c->resolve.data = c;
    c->resolving = uv_getaddrinfo(t->loop, &c->resolve, on_resolved, host, port, &hints) == 0;
    if (!c->resolving)
        conn_close(c, ERR_UNREACHABLE);
    *out = c;
    return ERR_OK;
}

/* --- Listening ------------------------------------------------------------------ */

/* A connection that nobody will hear of again. */
struct stranger {
    uv_tcp_t tcp;
};

static void on_stranger_closed(uv_handle_t *handle)
{
    mem_free(handle->data);
}

static void hang_up(struct listener *l)
{
    struct stranger *s = mem_calloc(1, sizeof *s);
    if (!s)
        return; /* it stays in libuv's hands until the next one is accepted */
    if (uv_tcp_init(l->transport->loop, &s->tcp) < 0) {
        mem_free(s);
        return;
    }
    s->tcp.data = s;
    (void)uv_accept((uv_stream_t *)&l->tcp, (uv_stream_t *)&s->tcp);
    uv_close((uv_handle_t *)&s->tcp, on_stranger_closed);
}

static void on_connection(uv_stream_t *server, int status)
{
    struct listener *l = server->data;
    if (l->closing)
        return;
    if (status < 0) {
        /* Out of descriptors: give up the reserve, so that the next accept gets the newcomer and
         * can hang up on it. Otherwise libuv would ask again without end. */
        if (l->reserve_fd >= 0)
            (void)close(l->reserve_fd);
        l->reserve_fd = -1;
        return;
    }
    if (l->reserve_fd < 0 || (l->conn_max > 0 && l->conn_count >= l->conn_max)) {
        hang_up(l);
        if (l->reserve_fd < 0)
            l->reserve_fd = open("/dev/null", O_RDONLY | O_CLOEXEC);
        return;
    }
    struct conn *c = conn_new(l->transport, &l->options);
    if (!c) {
        hang_up(l);
        return;
    }
    c->listener = l;
    l->conn_count++;
    (void)uv_tcp_init(l->transport->loop, &c->tcp); /* makes no socket: cannot fail */
    c->tcp.data = c;
    c->tcp_live = true;
    c->handles++;
    int accepted = uv_accept(server, (uv_stream_t *)&c->tcp);
    if (accepted < 0)
        conn_close(c, transport_error(accepted));
    else
        conn_opened(c);
}

static void on_listener_closed(uv_handle_t *handle)
{
    struct listener *l = handle->data;
    struct transport *t = l->transport;
    struct conn *c;
    TAILQ_FOREACH(c, &t->conns, in_conns)
    if (c->listener == l)
        c->listener = NULL;
    TAILQ_REMOVE(&t->listeners, l, in_listeners);
    if (l->reserve_fd >= 0)
        (void)close(l->reserve_fd);
    mem_free(l);
    transport_maybe_done(t);
}

void listener_close(struct listener *l)
{
    if (l->closing)
        return;
    l->closing = true;
    uv_close((uv_handle_t *)&l->tcp, on_listener_closed);
}

static struct listener *make_listener(struct transport *t, uint32_t conn_max,
                                      const struct conn_options *options)
{
    TL_ASSERT(!t->closing && options->handlers.on_message);
    struct listener *l = mem_calloc(1, sizeof *l);
    if (!l)
        return NULL;
    l->transport = t;
    l->options = *options;
    l->conn_max = conn_max;
    l->reserve_fd = open("/dev/null", O_RDONLY | O_CLOEXEC);
    (void)uv_tcp_init(t->loop, &l->tcp); /* makes no socket: cannot fail */
    l->tcp.data = l;
    TAILQ_INSERT_TAIL(&t->listeners, l, in_listeners);
    return l;
}

static enum err give_listener(struct listener *l, enum err e, struct listener **out)
{
    if (e == ERR_OK)
        *out = l;
    else
        listener_close(l);
    return e;
}

static enum err start_listening(struct listener *l)
{
    int status = uv_listen((uv_stream_t *)&l->tcp, BACKLOG, on_connection);
    if (status < 0)
        return status == UV_ENOMEM ? ERR_NOMEM : ERR_ADDRESS;
    struct sockaddr_storage bound = {0};
    int bound_bytes = sizeof bound;
    status = uv_tcp_getsockname(&l->tcp, (struct sockaddr *)&bound, &bound_bytes);
    transport_address_text((struct sockaddr *)&bound, l->address, sizeof l->address);
    return status < 0 ? ERR_IO : ERR_OK;
}

/* Binds the first address that the name stands for. */
static enum err bind_and_listen(struct listener *l, const char *host, const char *port)
{
    struct addrinfo hints = {
        .ai_family = AF_UNSPEC, .ai_socktype = SOCK_STREAM, .ai_flags = AI_PASSIVE};
    uv_getaddrinfo_t request;
    if (uv_getaddrinfo(l->transport->loop, &request, NULL, host, port, &hints) < 0)
        return ERR_ADDRESS;
    int status = UV_EADDRNOTAVAIL;
    if (request.addrinfo)
        status = uv_tcp_bind(&l->tcp, request.addrinfo->ai_addr, 0);
    uv_freeaddrinfo(request.addrinfo);
    if (status < 0)
        return status == UV_ENOMEM ? ERR_NOMEM : ERR_ADDRESS;
    return start_listening(l);
}

enum err listener_new(struct transport *t, const char *addr_port, uint32_t conn_max,
                      const struct conn_options *options, struct listener **out)
{
    char host[HOST_BYTES], port[PORT_BYTES];
    if (!split_host_port(addr_port, host, port))
        return ERR_USAGE;
    struct listener *l = make_listener(t, conn_max, options);
    if (!l)
        return ERR_NOMEM;
    return give_listener(l, bind_and_listen(l, host, port), out);
}

enum err listener_adopt(struct transport *t, int fd, uint32_t conn_max,
                        const struct conn_options *options, struct listener **out)
{
    struct listener *l = make_listener(t, conn_max, options);
    (void)fcntl(fd, F_SETFD, FD_CLOEXEC); /* it was inherited, and goes no further */
    if (!l || uv_tcp_open(&l->tcp, fd) < 0) {
        (void)close(fd);
        return l ? give_listener(l, ERR_ADDRESS, out) : ERR_NOMEM;
    }
    return give_listener(l, start_listening(l), out);
}

const char *listener_address(const struct listener *l)
{
    return l->address;
}
