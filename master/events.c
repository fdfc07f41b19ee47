#include "master/events.h"

#include <inttypes.h>

#include "common/mem.h"

struct event {
    uint64_t job;
    char *type, *data; /* owned; NULL: lost for want of memory */
    size_t bytes;
};

struct events {
    uint64_t epoch;
    uint64_t newest, oldest; /* sequences kept: oldest..newest, none when oldest > newest */
    size_t bytes;
    struct event ring[EVENTS_KEPT];
    void (*wake)(void *ctx);
    void *wake_ctx;
};

enum err events_new(uint64_t epoch, struct events **out)
{
    struct events *e = mem_calloc(1, sizeof *e);
    if (!e)
        return ERR_NOMEM;
    e->epoch = epoch;
    e->oldest = 1;
    *out = e;
    return ERR_OK;
}

static void drop_oldest(struct events *e)
{
    struct event *event = &e->ring[e->oldest % EVENTS_KEPT];
    e->bytes -= event->bytes;
    mem_free(event->type);
    mem_free(event->data);
    *event = (struct event){0};
    e->oldest++;
}

void events_free(struct events *e)
{
    if (!e)
        return;
    while (e->oldest <= e->newest)
        drop_oldest(e);
    mem_free(e);
}

void events_on_new(struct events *e, void (*wake)(void *ctx), void *ctx)
{
    e->wake = wake;
    e->wake_ctx = ctx;
}

void events_add(struct events *e, uint64_t job, const char *type, const char *data)
{
    while (e->oldest <= e->newest &&
           (e->newest - e->oldest + 1 >= EVENTS_KEPT || e->bytes > EVENTS_BYTES_KEPT))
        drop_oldest(e);
    struct event *event = &e->ring[++e->newest % EVENTS_KEPT];
    *event = (struct event){.job = job, .type = mem_strdup(type), .data = mem_sprintf("%s", data)};
    for (const char *c = event->data; c && *c; c++)
        event->bytes++;
    e->bytes += event->bytes;
    if (e->wake)
        e->wake(e->wake_ctx);
}

uint64_t events_epoch(const struct events *e)
{
    return e->epoch;
}

uint64_t events_newest(const struct events *e)
{
    return e->newest;
}

bool events_next(const struct events *e, uint64_t *sequence, uint64_t job, struct buf *out)
{
    if (*sequence + 1 < e->oldest || *sequence > e->newest) {
        *sequence = e->newest;
        buf_printf(out, "id: %" PRIu64 "-%" PRIu64 "\nevent: reset\ndata: {}\n\n", e->epoch,
                   e->newest);
        return true;
    }
    while (*sequence < e->newest) {
        const struct event *event = &e->ring[++*sequence % EVENTS_KEPT];
        if (job != 0 && event->job != EVENTS_ALL_JOBS && event->job != job)
            continue;
        bool lost = !event->type || !event->data;
        buf_printf(out, "id: %" PRIu64 "-%" PRIu64 "\nevent: %s\ndata: %s\n\n", e->epoch, *sequence,
                   lost ? "reset" : event->type, lost ? "{}" : event->data);
        return true;
    }
    return false;
}
