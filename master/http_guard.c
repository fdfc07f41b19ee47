/* master/http_guard.c: which connections stay when there are too many, and which requests can be
 * read in two ways. See http_impl.h. */
#include "master/http_impl.h"

#include "common/mem.h"

#include <microhttpd.h>
#include <sys/socket.h>

/* A connection, in the list of those that ask nothing, of those that are read an answer, or in
 * none while a request of its is worked on. */
struct guest {
    struct guest *previous, *next;
    struct guest_list *list;
    int fd;
};

static void unlist(struct guest *g)
{
    struct guest_list *list = g->list;
    if (!list)
        return;
    if (g->previous)
        g->previous->next = g->next;
    else
        list->first = g->next;
    if (g->next)
        g->next->previous = g->previous;
    else
        list->last = g->previous;
    g->list = NULL;
}

static void list_last(struct guest_list *list, struct guest *g)
{
    unlist(g);
    g->previous = list->last;
    g->next = NULL;
    if (g->previous)
        g->previous->next = g;
    else
        list->first = g;
    list->last = g;
    g->list = list;
}

static struct guest *guest_of(struct MHD_Connection *c)
{
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(c, MHD_CONNECTION_INFO_SOCKET_CONTEXT);
    return info ? info->socket_context : NULL;
}

/* Hangs up on who has said nothing of use for longest, or else has been reading for longest, or
 * else listens for longest. libmicrohttpd sees the end of that connection in its next turn, and
 * accepts again. */
static void make_room(struct http *h)
{
    struct guest *g = h->guests.idle.first ? h->guests.idle.first : h->guests.reading.first;
    if (!g) {
        http_streams_end_one(h);
        return;
    }
    unlist(g);
    (void)shutdown(g->fd, SHUT_RDWR);
}

void http_guest_notify(void *http, struct MHD_Connection *c, void **context,
                       enum MHD_ConnectionNotificationCode code)
{
    struct http *h = http;
    struct guest *g = *context;
    if (code == MHD_CONNECTION_NOTIFY_CLOSED) {
        /* At the limit libmicrohttpd stops accepting; only a turn of its starts it again. */
        if (h->guests.count-- >= h->guests.count_max)
            http_kick(h);
        if (g)
            unlist(g);
        mem_free(g);
        *context = NULL;
        return;
    }
    if (++h->guests.count >= h->guests.count_max)
        make_room(h);
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(c, MHD_CONNECTION_INFO_CONNECTION_FD);
    g = info ? mem_calloc(1, sizeof *g) : NULL;
    if (!g)
        return; /* only its idle timeout ends this one */
    g->fd = info->connect_fd;
    list_last(&h->guests.idle, g);
    *context = g;
}

void http_guest_busy(struct MHD_Connection *c)
{
    struct guest *g = guest_of(c);
    if (g)
        unlist(g);
}

void http_guest_idle(struct http *h, struct MHD_Connection *c)
{
    struct guest *g = guest_of(c);
    if (g)
        list_last(&h->guests.idle, g);
}

void http_guest_reads(struct http *h, struct MHD_Connection *c)
{
    struct guest *g = guest_of(c);
    if (g)
        list_last(&h->guests.reading, g);
}

/* --- Requests that can be read in two ways -------------------------------- */

struct framing {
    unsigned hosts, lengths, codings;
};

static enum MHD_Result count_header(void *framing, enum MHD_ValueKind kind, const char *key,
                                    const char *value)
{
    (void)kind;
    (void)value;
    struct framing *f = framing;
    f->hosts += strcasecmp(key, "Host") == 0;
    f->lengths += strcasecmp(key, "Content-Length") == 0;
    f->codings += strcasecmp(key, "Transfer-Encoding") == 0;
    return MHD_YES;
}

bool http_framing_clear(struct MHD_Connection *c)
{
    struct framing f = {0};
    (void)MHD_get_connection_values(c, MHD_HEADER_KIND, count_header, &f);
    return f.hosts <= 1 && f.lengths + f.codings <= 1;
}
