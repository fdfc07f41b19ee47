/* The network: connections that keep their order, break, stall one way, and delay. */
#include "tests/sim/sim.h"

#include <string.h>

static const uint32_t NO_CONN = UINT32_MAX;

static void close_side(struct sim *sim, uint32_t conn, enum sim_side side)
{
    struct conn *c = &sim->conns[conn];
    if (!c->open[side])
        return;
    c->open[side] = false;
    frame_decoder_release(&c->decoder[side]);
    for (struct packet *p = c->held[side], *next; p; p = next) {
        next = p->next;
        mem_free(p);
    }
    c->held[side] = c->held_tail[side] = NULL;
}

uint32_t net_connect(struct sim *sim, uint32_t worker)
{
    sim->conns = sim_grow(sim->conns, sim->conn_count, &sim->conn_capacity, sizeof *sim->conns);
    uint32_t conn = (uint32_t)sim->conn_count++;
    struct conn *c = &sim->conns[conn];
    *c = (struct conn){.worker = worker,
                       .worker_life = sim->workers[worker].life,
                       .master_life = sim->m.life,
                       .open = {true, true}};
    frame_decoder_init(&c->decoder[SIDE_MASTER],
                       &(struct frame_rules){.peer_side = FRAME_SIDE_WORKER});
    frame_decoder_init(&c->decoder[SIDE_WORKER],
                       &(struct frame_rules){.peer_side = FRAME_SIDE_MASTER});
    return conn;
}

static void schedule(struct sim *sim, uint32_t conn, enum sim_side to, struct packet *p)
{
    struct conn *c = &sim->conns[conn];
    uint64_t at_us = sim->now_us + sim->c.latency_us + sim_spread(sim, sim->c.latency_us / 4 + 1);
    /* Now and then a packet is long on its way; those behind it wait. */
    if (!sim->healed && sim_chance(sim, 0.002))
        at_us += sim_spread(sim, 200000);
    if (at_us <= c->last_us[to])
        at_us = c->last_us[to] + 1;
    c->last_us[to] = at_us;
    sim_push(sim, at_us, (struct sim_event){.type = EV_PACKET, .a = conn, .b = to, .data = p});
}

void net_send(struct sim *sim, uint32_t conn, enum sim_side to, const struct message *m,
              const void *body, size_t body_bytes)
{
    if (conn == NO_CONN)
        return;
    enum sim_side from = to == SIDE_MASTER ? SIDE_WORKER : SIDE_MASTER;
    if (!sim->conns[conn].open[from])
        return;
    static unsigned char meta[MESSAGE_BYTES_MAX];
    size_t meta_bytes;
    enum err e = message_encode(m, meta, &meta_bytes);
    SIM_CHECK(sim, e == ERR_OK, "cannot encode a %s: %s", frame_type_name((int)m->type),
              err_name(e));
    struct packet *p = mem_alloc(sizeof *p + FRAME_HEADER_BYTES + meta_bytes + body_bytes);
    TL_ASSERT(p);
    p->next = NULL;
    p->bytes = FRAME_HEADER_BYTES + meta_bytes + body_bytes;
    frame_header_encode(&(struct frame_header){.type = m->type,
                                               .meta_bytes = (uint32_t)meta_bytes,
                                               .body_bytes = (uint32_t)body_bytes},
                        p->data);
    memcpy(p->data + FRAME_HEADER_BYTES, meta, meta_bytes);
    if (body_bytes > 0)
        memcpy(p->data + FRAME_HEADER_BYTES + meta_bytes, body, body_bytes);
    sim->stats.messages++;
    schedule(sim, conn, to, p);
}

void net_close(struct sim *sim, uint32_t conn, enum sim_side by, bool silently)
{
    if (conn == NO_CONN || !sim->conns[conn].open[by])
        return;
    struct conn *c = &sim->conns[conn];
    enum sim_side other = by == SIDE_MASTER ? SIDE_WORKER : SIDE_MASTER;
    close_side(sim, conn, by);
    uint64_t at_us = c->last_us[other] > sim->now_us ? c->last_us[other] : sim->now_us;
    if (silently) {
        at_us = sim->now_us + SIM_SILENCE_US;
        c->reset[other] = true;
    } else if (sim_chance(sim, 0.5)) {
        at_us = sim->now_us; /* a reset overtakes what is on its way */
        c->reset[other] = true;
    }
    sim_push(sim, at_us + sim->c.latency_us,
             (struct sim_event){.type = EV_CLOSED, .a = conn, .b = other});
}

void net_stall(struct sim *sim, uint32_t conn, enum sim_side to, uint64_t us)
{
    struct conn *c = &sim->conns[conn];
    if (!c->open[to] || c->stalled[to])
        return;
    c->stalled[to] = true;
    c->stalled_us[to] = sim->now_us;
    struct sim_event e = {.type = EV_UNSTALL, .a = conn, .b = to, .c = sim->now_us};
    sim_push(sim, sim->now_us + us, e);
    e.type = EV_SILENT;
    sim_push(sim, sim->now_us + SIM_SILENCE_US, e);
}

static void lost(struct sim *sim, uint32_t conn, enum sim_side side)
{
    struct conn *c = &sim->conns[conn];
    if (!c->open[side])
        return;
    close_side(sim, conn, side);
    if (side == SIDE_MASTER)
        master_conn_lost(sim, conn);
    else
        worker_conn_lost(sim, c->worker, conn);
}

static void handle(struct sim *sim, uint32_t conn, enum sim_side side, const struct frame *f)
{
    static struct message m;
    enum err e = message_decode(f->header.type, f->meta, f->header.meta_bytes, &m);
    SIM_CHECK(sim, e == ERR_OK, "cannot decode a %s: %s", frame_type_name((int)f->header.type),
              err_name(e));
    if (side == SIDE_MASTER)
        master_message(sim, conn, &m, f->body, f->header.body_bytes);
    else
        worker_message(sim, sim->conns[conn].worker, &m);
}

/* Bytes arrive in pieces of any size. */
static void deliver(struct sim *sim, uint32_t conn, enum sim_side side, const struct packet *p)
{
    size_t at = 0;
    while (at < p->bytes && sim->conns[conn].open[side]) {
        size_t piece = p->bytes - at;
        if (piece > 1 && sim_chance(sim, 0.2))
            piece = 1 + sim_below(sim, piece - 1);
        size_t used;
        bool ready;
        struct frame f;
        enum err e = frame_decoder_feed(&sim->conns[conn].decoder[side], p->data + at, piece, &used,
                                        &ready, &f);
        SIM_CHECK(sim, e == ERR_OK, "a frame is refused: %s", err_name(e));
        at += used;
        if (ready)
            handle(sim, conn, side, &f);
    }
}

static void packet_event(struct sim *sim, struct sim_event *e)
{
    struct conn *c = &sim->conns[e->a];
    struct sim_worker *w = &sim->workers[c->worker];
    if (!c->open[e->b] || c->reset[e->b])
        return;
    bool arrived = e->c != 0; /* before the process was stopped: no stall can hold it */
    if (c->stalled[e->b] && !arrived) {
        e->data->next = NULL;
        if (c->held_tail[e->b])
            c->held_tail[e->b]->next = e->data;
        else
            c->held[e->b] = e->data;
        c->held_tail[e->b] = e->data;
        e->data = NULL;
        return;
    }
    if (e->b == SIDE_WORKER && w->stopped) {
        /* A stopped process reads nothing until it continues. */
        struct sim_event again = *e;
        again.c = 1;
        e->data = NULL;
        sim_push(sim, w->stop_end_us, again);
        return;
    }
    deliver(sim, e->a, (enum sim_side)e->b, e->data);
}

void net_event(struct sim *sim, struct sim_event *e)
{
    struct conn *c = &sim->conns[e->a];
    enum sim_side side = (enum sim_side)e->b;
    switch (e->type) {
    case EV_PACKET:
        packet_event(sim, e);
        break;
    case EV_CLOSED:
        if (c->stalled[side]) /* learns nothing before its silence is noticed */
            c->reset[side] = true;
        else
            lost(sim, e->a, side);
        break;
    case EV_SILENT:
        if (c->stalled[side] && c->stalled_us[side] == e->c) {
            enum sim_side other = side == SIDE_MASTER ? SIDE_WORKER : SIDE_MASTER;
            lost(sim, e->a, side);
            sim_push(sim, sim->now_us + sim->c.latency_us,
                     (struct sim_event){.type = EV_CLOSED, .a = e->a, .b = other});
        }
        break;
    case EV_UNSTALL:
        if (c->stalled[side] && c->stalled_us[side] == e->c) {
            /* What was held comes before what is still on its way. */
            c->stalled[side] = false;
            struct packet *p = c->held[side];
            c->held[side] = c->held_tail[side] = NULL;
            for (struct packet *next; p; p = next) {
                next = p->next;
                struct sim_event held = {.type = EV_PACKET, .a = e->a, .b = e->b, .data = p};
                packet_event(sim, &held);
                mem_free(held.data);
            }
            if (sim->conns[e->a].reset[side])
                lost(sim, e->a, side);
        }
        break;
    default:
        TL_ASSERT(false);
    }
    mem_free(e->data);
}

void net_free(struct sim *sim)
{
    for (uint32_t i = 0; i < sim->conn_count; i++) {
        close_side(sim, i, SIDE_MASTER);
        close_side(sim, i, SIDE_WORKER);
    }
    mem_free(sim->conns);
}
