/* The workers: load, render, answer, keep answers until they are acknowledged; and their faults. */
#include "tests/sim/sim.h"

#include <string.h>

static const uint32_t NO_CONN = UINT32_MAX;

/* --- What they render -------------------------------------------------------------------- */

uint64_t spot_cost_us(const struct sim *sim, uint32_t job, uint32_t cell, uint32_t block)
{
    /* Patches of cells cost alike; a block adds little. */
    double patch = (double)(sim_hash(sim->c.seed + job, cell / 16) & 0xffff) / 65536.0;
    double own = (double)(sim_hash(sim->c.seed + job, cell * 512 + block) & 0xffff) / 65536.0;
    double factor = 1.0 + sim->c.cost_spread * (4.0 * patch * patch * patch + 0.2 * own);
    return 1 + (uint64_t)(sim->c.cost_us * factor);
}

void spot_pixels(uint64_t job, uint32_t cell, uint32_t block, float out[SIM_CELL_FLOATS])
{
    uint64_t h = sim_hash(job << 32 | block, cell);
    for (int i = 0; i < SIM_CELL_FLOATS; i++)
        out[i] = (float)(h >> (20 * i) & 0xfffff);
}

uint32_t pixels_hash(const float pixels[SIM_CELL_FLOATS])
{
    uint32_t bits[SIM_CELL_FLOATS];
    memcpy(bits, pixels, sizeof bits);
    uint64_t h = 1;
    for (int i = 0; i < SIM_CELL_FLOATS; i++)
        h = sim_hash(h, bits[i]);
    return (uint32_t)h;
}

/* The body of a unit: planes R, G, B over its cells, in plain floats or encoded. */
static void render_body(struct sim *sim, const struct sim_worker *w, struct sim_result *r)
{
    uint32_t cells = r->lease.unit.cell_count;
    float *planes = mem_alloc_array(cells, SIM_CELL_FLOATS * sizeof *planes);
    TL_ASSERT(planes);
    for (uint32_t i = 0; i < cells; i++) {
        float p[SIM_CELL_FLOATS];
        spot_pixels(r->lease.job, r->lease.unit.cell_begin + i, r->lease.unit.block, p);
        for (uint32_t k = 0; k < SIM_CELL_FLOATS; k++)
            planes[k * cells + i] = p[k];
    }
    if (w->liar && sim_chance(sim, 0.3))
        planes[sim_below(sim, cells)] += (float)(1 + (w->handle & 0xff));
    r->raw_bytes = (uint32_t)(cells * SIM_CELL_FLOATS * sizeof *planes);
    if (!sim->c.codec) {
        r->body = (unsigned char *)planes;
        r->body_bytes = r->raw_bytes;
        return;
    }
    enum err e =
        tile_codec_encode(planes, (size_t)cells * SIM_CELL_FLOATS, &r->body, &r->body_bytes);
    SIM_CHECK(sim, e == ERR_OK, "cannot encode %u cells: %s", cells, err_name(e));
    mem_free(planes);
}

/* --- Messages out -------------------------------------------------------------------------- */

static void tell_held(tilery_Hello *h, const struct sim_lease *l, tilery_HeldState state)
{
    if (h->held_count == LIMIT_HELD_TOLD)
        return;
    h->held[h->held_count++] = (tilery_Held){.job = l->job,
                                             .cell_begin = l->unit.cell_begin,
                                             .cell_count = l->unit.cell_count,
                                             .block = l->unit.block,
                                             .epoch = l->epoch,
                                             .state = state};
}

static void say_hello(struct sim *sim, struct sim_worker *w)
{
    static struct message m;
    m = (struct message){.type = FRAME_HELLO};
    m.hello.protocol_min = PROTOCOL_VERSION_MIN;
    m.hello.protocol_max = PROTOCOL_VERSION_MAX;
    m.hello.threads = w->threads;
    m.hello.instance = w->handle;
    MESSAGE_TEXT(m.hello.name, "sim");
    for (size_t i = 0; i < w->unacked_count; i++)
        tell_held(&m.hello, &w->unacked[i].lease, tilery_HELD_RESULT);
    for (uint32_t i = 0; i < w->running_count; i++)
        tell_held(&m.hello, &w->running[i].lease, tilery_HELD_BEGUN);
    for (size_t i = 0; i < w->queue_count; i++)
        tell_held(&m.hello, &w->queue[i], tilery_HELD_WAITING);
    SIM_CHECK(sim, w->queue_count + w->running_count <= w->threads + LIMIT_HELD + 64,
              "worker %" PRIu64 " holds %zu leases that no master knows of", w->handle,
              w->queue_count + w->running_count);
    w->told_count = m.hello.held_count;
    memcpy(w->told, m.hello.held, sizeof w->told);
    net_send(sim, w->conn, SIDE_MASTER, &m, NULL, 0);
}

static void say_result(struct sim *sim, const struct sim_worker *w, const struct sim_result *r)
{
    static struct message m;
    m = (struct message){.type = FRAME_RESULT};
    m.result.job = r->lease.job;
    m.result.cell_begin = r->lease.unit.cell_begin;
    m.result.cell_count = r->lease.unit.cell_count;
    m.result.block = r->lease.unit.block;
    m.result.epoch = r->lease.epoch;
    m.result.samples = (uint64_t)(r->lease.unit.cell_count * sim->c.cell_cost) + 1;
    m.result.render_us = r->render_us;
    m.result.raw_bytes = r->raw_bytes;
    net_send(sim, w->conn, SIDE_MASTER, &m, r->body, r->body_bytes);
}

static void say_unit_failed(struct sim *sim, const struct sim_worker *w, const struct sim_lease *l)
{
    static struct message m;
    m = (struct message){.type = FRAME_UNIT_FAILED};
    m.unit_failed.job = l->job;
    m.unit_failed.epoch = l->epoch;
    MESSAGE_TEXT(m.unit_failed.error, "ERR_NOMEM");
    net_send(sim, w->conn, SIDE_MASTER, &m, NULL, 0);
}

static void say_of_job(struct sim *sim, const struct sim_worker *w, enum frame_type type,
                       uint64_t job)
{
    static struct message m;
    m = (struct message){.type = type};
    if (type == FRAME_JOB_READY)
        m.job_ready.job = job;
    else
        m.job_failed.job = job;
    net_send(sim, w->conn, SIDE_MASTER, &m, NULL, 0);
}

/* --- Rendering ------------------------------------------------------------------------------- */

static bool unit_has(const struct unit *u, uint32_t cell)
{
    return cell >= u->cell_begin && cell < u->cell_begin + u->cell_count;
}

static void queue_remove(struct sim_worker *w, size_t at)
{
    memmove(&w->queue[at], &w->queue[at + 1], (--w->queue_count - at) * sizeof *w->queue);
}

static void drop_queued(struct sim_worker *w, uint64_t job)
{
    for (size_t i = 0; i < w->queue_count;) {
        if (job == 0 || w->queue[i].job == job)
            queue_remove(w, i);
        else
            i++;
    }
}

/* The name of a chunk is the job whose picture it is. */
static void say_chunk_request(struct sim *sim, const struct sim_worker *w, uint64_t job)
{
    static struct message m;
    m = (struct message){.type = FRAME_CHUNK_REQUEST};
    m.chunk_request.sha256[0] = (uint8_t)job;
    sim->stats.asks++;
    net_send(sim, w->conn, SIDE_MASTER, &m, NULL, 0);
}

/* A unit has met a picture that is not there, and waits for it. */
static void ask_for_picture(struct sim *sim, struct sim_worker *w, uint64_t job)
{
    if (!w->asked[job - 1])
        say_chunk_request(sim, w, job);
    w->asked[job - 1] = true;
}

static void begin(struct sim *sim, uint32_t worker, const struct sim_running *r)
{
    sim_push(
        sim, sim->now_us + r->cost_us,
        (struct sim_event){
            .type = EV_RENDERED, .a = worker, .b = sim->workers[worker].life, .c = r->lease.epoch});
}

/* Now and then one that hangs does so while it asks for more and more. */
static void ask_later(struct sim *sim, uint32_t worker, const struct sim_running *r)
{
    if (sim->c.late > 0)
        sim_push(
            sim, sim->now_us + 500000 + sim_spread(sim, 1000000),
            (struct sim_event){
                .type = EV_ASK, .a = worker, .b = sim->workers[worker].life, .c = r->lease.epoch});
}

/* Threads take the oldest leases of jobs whose scene is there. */
static void render_next(struct sim *sim, uint32_t worker)
{
    struct sim_worker *w = &sim->workers[worker];
    for (size_t i = 0; w->welcomed && i < w->queue_count && w->running_count < w->threads;) {
        struct sim_lease l = w->queue[i];
        if (w->load[l.job - 1] != LOAD_READY) {
            i++;
            continue;
        }
        queue_remove(w, i);
        struct sim_running *r = &w->running[w->running_count++];
        *r = (struct sim_running){.lease = l};
        for (uint32_t c = 0; c < l.unit.cell_count; c++)
            r->cost_us +=
                spot_cost_us(sim, (uint32_t)l.job - 1, l.unit.cell_begin + c, l.unit.block);
        r->cost_us = 1 + (uint64_t)((double)r->cost_us * w->slow);
        r->hung = w->zombie || (!sim->healed && sim_chance(sim, sim->c.hang_share));
        if (l.job == 1 && sim->c.poison_cell >= 0 &&
            unit_has(&l.unit, (uint32_t)sim->c.poison_cell)) {
            worker_kill(sim, worker, false, 100000 + sim_below(sim, 400000));
            return;
        }
        r->waits = !r->hung && w->late_left[l.job - 1] > 0 && sim_chance(sim, 0.3);
        if (r->hung)
            ask_later(sim, worker, r);
        else if (r->waits)
            ask_for_picture(sim, w, l.job);
        else
            begin(sim, worker, r);
    }
}

/* Units of the job that wait go on, or with `drop` end. */
static void end_waits(struct sim *sim, uint32_t worker, uint64_t job, bool drop)
{
    struct sim_worker *w = &sim->workers[worker];
    w->asked[job - 1] = false;
    for (uint32_t i = 0; i < w->running_count;) {
        struct sim_running *r = &w->running[i];
        bool mine = r->waits && r->lease.job == job;
        r->waits &= !mine;
        if (mine && drop) {
            *r = w->running[--w->running_count];
            continue;
        }
        if (mine)
            begin(sim, worker, r);
        i++;
    }
}

static void brought(struct sim *sim, uint32_t worker, uint64_t job)
{
    struct sim_worker *w = &sim->workers[worker];
    if (!w->asked[job - 1])
        return;
    if (!sim->healed && sim_chance(sim, sim->c.fail_share)) {
        w->load[job - 1] = LOAD_NONE;
        drop_queued(w, job);
        end_waits(sim, worker, job, true);
        say_of_job(sim, w, FRAME_JOB_FAILED, job);
    } else {
        w->late_left[job - 1]--;
        end_waits(sim, worker, job, false);
        if (w->welcomed)
            say_of_job(sim, w, FRAME_JOB_READY, job);
    }
    render_next(sim, worker);
}

static void on_chunk(struct sim *sim, uint32_t worker, uint64_t job)
{
    const struct sim_worker *w = &sim->workers[worker];
    if (w->asked[job - 1])
        sim_push(sim, sim->now_us + 1000 + sim_spread(sim, 300000),
                 (struct sim_event){.type = EV_BROUGHT, .a = worker, .b = w->life, .c = job});
}

/* A unit that hangs asks for what nobody waits for. */
static void ask_on(struct sim *sim, uint32_t worker, uint64_t epoch)
{
    const struct sim_worker *w = &sim->workers[worker];
    for (uint32_t i = 0; i < w->running_count; i++) {
        const struct sim_running *r = &w->running[i];
        if (r->lease.epoch != epoch || !r->hung)
            continue;
        if (w->welcomed)
            say_chunk_request(sim, w, r->lease.job);
        ask_later(sim, worker, r);
    }
}

static void rendered(struct sim *sim, uint32_t worker, uint64_t epoch)
{
    struct sim_worker *w = &sim->workers[worker];
    uint32_t at = 0;
    while (at < w->running_count && w->running[at].lease.epoch != epoch)
        at++;
    if (at == w->running_count)
        return; /* it was told to stop */
    struct sim_running r = w->running[at];
    w->running[at] = w->running[--w->running_count];
    sim->stats.rendered_us += r.cost_us;
    if (!sim->healed && sim_chance(sim, sim->c.fail_share)) {
        if (w->welcomed)
            say_unit_failed(sim, w, &r.lease);
    } else {
        w->unacked =
            sim_grow(w->unacked, w->unacked_count, &w->unacked_capacity, sizeof *w->unacked);
        struct sim_result *result = &w->unacked[w->unacked_count++];
        *result = (struct sim_result){.lease = r.lease, .render_us = r.cost_us};
        render_body(sim, w, result);
        if (w->welcomed)
            say_result(sim, w, result);
    }
    render_next(sim, worker);
}

/* --- Messages in ------------------------------------------------------------------------------ */

static void forget_result(struct sim_worker *w, uint64_t epoch)
{
    for (size_t i = 0; i < w->unacked_count; i++) {
        if (w->unacked[i].lease.epoch != epoch)
            continue;
        mem_free(w->unacked[i].body);
        w->unacked[i] = w->unacked[--w->unacked_count];
        return;
    }
}

static void on_job_info(struct sim *sim, uint32_t worker, uint64_t job)
{
    struct sim_worker *w = &sim->workers[worker];
    if (w->load[job - 1] == LOAD_READY) { /* still here from before the connection broke */
        say_of_job(sim, w, FRAME_JOB_READY, job);
        return;
    }
    if (w->load[job - 1] == LOAD_LOADING)
        return;
    w->load[job - 1] = LOAD_LOADING;
    sim_push(sim, sim->now_us + 1000 + sim_spread(sim, 100000),
             (struct sim_event){.type = EV_LOADED, .a = worker, .b = w->life, .c = job});
}

static void loaded(struct sim *sim, uint32_t worker, uint64_t job)
{
    struct sim_worker *w = &sim->workers[worker];
    if (w->load[job - 1] != LOAD_LOADING)
        return;
    if (!sim->healed && sim_chance(sim, sim->c.fail_share)) {
        w->load[job - 1] = LOAD_NONE;
        drop_queued(w, job);
        say_of_job(sim, w, FRAME_JOB_FAILED, job);
        return;
    }
    w->load[job - 1] = LOAD_READY;
    if (w->welcomed)
        say_of_job(sim, w, FRAME_JOB_READY, job);
    render_next(sim, worker);
}

static void on_lease(struct sim *sim, uint32_t worker, const tilery_Lease *m)
{
    struct sim_worker *w = &sim->workers[worker];
    struct sim_lease l = {
        .job = m->job,
        .epoch = m->epoch,
        .unit = {.cell_begin = m->cell_begin, .cell_count = m->cell_count, .block = m->block}};
    SIM_CHECK(sim, w->load[l.job - 1] != LOAD_NONE || !w->welcomed || sim->c.fail_share > 0.0,
              "a lease of a job that worker %" PRIu64 " was not told of", w->handle);
    w->queue = sim_grow(w->queue, w->queue_count, &w->queue_capacity, sizeof *w->queue);
    w->queue[w->queue_count++] = l;
    render_next(sim, worker);
}

static void on_revoke(struct sim *sim, uint32_t worker, uint64_t epoch)
{
    struct sim_worker *w = &sim->workers[worker];
    for (size_t i = 0; i < w->queue_count; i++) {
        if (w->queue[i].epoch == epoch) {
            queue_remove(w, i);
            return;
        }
    }
    for (uint32_t i = 0; i < w->running_count; i++) {
        struct sim_running *r = &w->running[i];
        /* Often it stops; sometimes the result is on its way already. A hung thread stays so. */
        if (r->lease.epoch != epoch || r->hung || sim_chance(sim, 0.2))
            continue;
        sim->stats.wasted_us += r->cost_us / 2;
        w->running[i] = w->running[--w->running_count];
        render_next(sim, worker);
        return;
    }
}

static bool holds(const struct sim_worker *w, uint64_t epoch)
{
    for (size_t i = 0; i < w->queue_count; i++)
        if (w->queue[i].epoch == epoch)
            return true;
    for (uint32_t i = 0; i < w->running_count; i++)
        if (w->running[i].lease.epoch == epoch)
            return true;
    for (size_t i = 0; i < w->unacked_count; i++)
        if (w->unacked[i].lease.epoch == epoch)
            return true;
    return false;
}

/* As the worker does: what the Hello told of and is not there any more has failed. */
static void told_gone(struct sim *sim, struct sim_worker *w)
{
    for (uint32_t i = 0; i < w->told_count; i++)
        if (!holds(w, w->told[i].epoch))
            say_unit_failed(sim, w,
                            &(struct sim_lease){.job = w->told[i].job, .epoch = w->told[i].epoch});
    w->told_count = 0;
}

void worker_message(struct sim *sim, uint32_t worker, const struct message *m)
{
    struct sim_worker *w = &sim->workers[worker];
    switch (m->type) {
    case FRAME_WELCOME:
        w->welcomed = true;
        told_gone(sim, w);
        for (uint32_t i = 0; i < sim->c.jobs; i++)
            if (w->asked[i])
                say_chunk_request(sim, w, i + 1);
        render_next(sim, worker);
        for (size_t i = 0; i < w->unacked_count; i++)
            say_result(sim, w, &w->unacked[i]);
        break;
    case FRAME_JOB_INFO:
        on_job_info(sim, worker, m->job_info.job);
        break;
    case FRAME_JOB_END:
        w->load[m->job_end.job - 1] = LOAD_NONE;
        drop_queued(w, m->job_end.job);
        end_waits(sim, worker, m->job_end.job, true);
        break;
    case FRAME_CHUNK_DATA:
        on_chunk(sim, worker, m->chunk_data.sha256[0]);
        break;
    case FRAME_LEASE:
        on_lease(sim, worker, &m->lease);
        break;
    case FRAME_REVOKE:
        on_revoke(sim, worker, m->revoke.epoch);
        break;
    case FRAME_RESULT_ACK:
        forget_result(w, m->result_ack.epoch);
        break;
    default:
        sim_fail(sim, "worker got a %s", frame_type_name((int)m->type));
    }
}

/* --- Life ---------------------------------------------------------------------------------------
 */

static void connect_later(struct sim *sim, uint32_t worker)
{
    struct sim_worker *w = &sim->workers[worker];
    sim_push(sim, sim->now_us + 50000 + sim_below(sim, 500000),
             (struct sim_event){.type = EV_CONNECT, .a = worker, .b = w->life});
}

static void reborn(struct sim *sim, struct sim_worker *w)
{
    w->life++;
    w->alive = true;
    w->stopped = w->draining = w->welcomed = false;
    w->told_count = 0;
    w->conn = NO_CONN;
    if (w->handle == 0 || !sim->c.handles_kept)
        w->handle = sim->handle_next++;
    memset(w->load, 0, sizeof w->load);
    memset(w->asked, 0, sizeof w->asked);
    for (int i = 0; i < SIM_JOBS_MAX; i++)
        w->late_left[i] = sim->c.late;
}

void worker_init(struct sim *sim, uint32_t worker)
{
    struct sim_worker *w = &sim->workers[worker];
    *w = (struct sim_worker){.conn = NO_CONN,
                             .threads = 1 + (uint32_t)sim_below(sim, 4),
                             .slow = 0.7 + 0.6 * (double)sim_below(sim, 1000) / 1000.0,
                             .liar = worker < sim->c.liars};
    w->zombie = worker >= sim->c.liars && worker < sim->c.liars + sim->c.zombies;
    if (sim_chance(sim, 0.1))
        w->slow *= 10.0;
    sim_push(sim, sim_below(sim, 200000), (struct sim_event){.type = EV_WORKER_UP, .a = worker});
}

static void process_end(struct sim_worker *w)
{
    for (size_t i = 0; i < w->unacked_count; i++)
        mem_free(w->unacked[i].body);
    w->unacked_count = w->queue_count = 0;
    w->running_count = 0;
    w->alive = false;
}

void worker_kill(struct sim *sim, uint32_t worker, bool silently, uint64_t back_us)
{
    struct sim_worker *w = &sim->workers[worker];
    if (!w->alive)
        return;
    sim->stats.crashes++;
    process_end(w);
    net_close(sim, w->conn, SIDE_WORKER, silently);
    w->conn = NO_CONN;
    sim_push(sim, sim->now_us + back_us, (struct sim_event){.type = EV_WORKER_UP, .a = worker});
}

void worker_leave(struct sim *sim, uint32_t worker)
{
    static struct message m;
    struct sim_worker *w = &sim->workers[worker];
    m = (struct message){.type = FRAME_GOODBYE};
    net_send(sim, w->conn, SIDE_MASTER, &m, NULL, 0);
    worker_kill(sim, worker, false, 500000);
}

void worker_stop(struct sim *sim, uint32_t worker, uint64_t us)
{
    struct sim_worker *w = &sim->workers[worker];
    if (!w->alive || w->stopped)
        return;
    w->stopped = true;
    w->stop_end_us = sim->now_us + us;
    sim_push(sim, w->stop_end_us,
             (struct sim_event){.type = EV_CONTINUE, .a = worker, .b = w->life});
    /* Its silence is noticed, if it lasts. */
    if (w->conn != NO_CONN && us > SIM_SILENCE_US)
        net_stall(sim, w->conn, SIDE_MASTER, us);
}

void worker_conn_lost(struct sim *sim, uint32_t worker, uint32_t conn)
{
    struct sim_worker *w = &sim->workers[worker];
    if (!w->alive || w->conn != conn)
        return;
    w->conn = NO_CONN;
    w->welcomed = false;
    connect_later(sim, worker);
}

/* A proxy that says things twice: results that were sent are sent again. */
void worker_resend_some(struct sim *sim, uint32_t worker)
{
    struct sim_worker *w = &sim->workers[worker];
    for (size_t i = 0; w->welcomed && i < w->unacked_count; i++)
        say_result(sim, w, &w->unacked[i]);
}

/* Hung threads come back to life, the stopped continue. */
void worker_heal(struct sim *sim, uint32_t worker)
{
    struct sim_worker *w = &sim->workers[worker];
    if (w->zombie)
        return;
    for (uint32_t i = 0; i < w->running_count; i++) {
        struct sim_running *r = &w->running[i];
        if (!r->hung)
            continue;
        r->hung = false;
        begin(sim, worker, r);
    }
}

static void try_connect(struct sim *sim, uint32_t worker)
{
    struct sim_worker *w = &sim->workers[worker];
    if (w->conn != NO_CONN)
        return;
    if (!sim->m.alive || (!sim->healed && sim_chance(sim, 0.1))) {
        connect_later(sim, worker);
        return;
    }
    w->conn = net_connect(sim, worker);
    say_hello(sim, w);
}

void worker_event(struct sim *sim, const struct sim_event *e)
{
    struct sim_worker *w = &sim->workers[e->a];
    if (e->type == EV_WORKER_UP) {
        if (w->alive)
            return;
        reborn(sim, w);
        connect_later(sim, e->a);
        return;
    }
    if (!w->alive || w->life != e->b)
        return;
    if (e->type == EV_CONTINUE) {
        w->stopped = false;
        return;
    }
    if (w->stopped) { /* happens when it continues */
        sim_push(sim, w->stop_end_us, *e);
        return;
    }
    switch (e->type) {
    case EV_CONNECT:
        try_connect(sim, e->a);
        break;
    case EV_LOADED:
        loaded(sim, e->a, e->c);
        break;
    case EV_RENDERED:
        rendered(sim, e->a, e->c);
        break;
    case EV_BROUGHT:
        brought(sim, e->a, e->c);
        break;
    case EV_ASK:
        ask_on(sim, e->a, e->c);
        break;
    case EV_LEFT:
        worker_leave(sim, e->a);
        break;
    default:
        TL_ASSERT(false);
    }
}

void worker_free(struct sim_worker *w)
{
    process_end(w);
    mem_free(w->queue);
    mem_free(w->unacked);
}
