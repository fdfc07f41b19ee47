/* The master around the scheduler: connections in, journal behind, crashes between. */
#include "tests/sim/sim.h"

#include <string.h>

static const uint32_t NO_CONN = UINT32_MAX;

static uint64_t clock_ms(const struct sim *sim)
{
    return sim->m.clock_base_ms + sim->now_us / 1000;
}

static uint32_t conn_of(const struct sim *sim, uint64_t handle)
{
    if (handle >= sim->handle_capacity)
        return NO_CONN;
    uint32_t conn = sim->handle_conn[handle];
    return conn != NO_CONN && sim->conns[conn].open[SIDE_MASTER] ? conn : NO_CONN;
}

static void conn_set(struct sim *sim, uint64_t handle, uint32_t conn)
{
    while (handle >= sim->handle_capacity) {
        size_t old = sim->handle_capacity;
        sim->handle_conn =
            sim_grow(sim->handle_conn, old, &sim->handle_capacity, sizeof *sim->handle_conn);
        size_t capacity = old;
        sim->handle_worker =
            sim_grow(sim->handle_worker, old, &capacity, sizeof *sim->handle_worker);
        TL_ASSERT(capacity == sim->handle_capacity);
        for (size_t i = old; i < sim->handle_capacity; i++)
            sim->handle_conn[i] = sim->handle_worker[i] = NO_CONN;
    }
    sim->handle_conn[handle] = conn;
    sim->handle_worker[handle] = sim->conns[conn].worker;
}

/* --- Messages out ----------------------------------------------------------------------------- */

static void send_action(struct sim *sim, const struct sched_action *a)
{
    static struct message m;
    switch (a->type) {
    case SCHED_OPEN_JOB:
        m = (struct message){.type = FRAME_JOB_INFO};
        m.job_info.job = a->job;
        break;
    case SCHED_CLOSE_JOB:
        m = (struct message){.type = FRAME_JOB_END};
        m.job_end.job = a->job;
        break;
    case SCHED_LEASE:
        m = (struct message){.type = FRAME_LEASE};
        m.lease.job = a->job;
        m.lease.cell_begin = a->unit.cell_begin;
        m.lease.cell_count = a->unit.cell_count;
        m.lease.block = a->unit.block;
        m.lease.epoch = a->epoch;
        break;
    default:
        TL_ASSERT(a->type == SCHED_REVOKE);
        m = (struct message){.type = FRAME_REVOKE};
        m.revoke.job = a->job;
        m.revoke.epoch = a->epoch;
        break;
    }
    uint32_t conn = conn_of(sim, a->worker);
    SIM_CHECK(sim, conn != NO_CONN, "action %d for worker %" PRIu64 ", which is not connected",
              (int)a->type, a->worker);
    net_send(sim, conn, SIDE_WORKER, &m, NULL, 0);
}

static void acknowledge(struct sim *sim, uint64_t handle, uint64_t job, uint64_t epoch)
{
    static struct message m;
    m = (struct message){.type = FRAME_RESULT_ACK};
    m.result_ack.job = job;
    m.result_ack.epoch = epoch;
    net_send(sim, conn_of(sim, handle), SIDE_WORKER, &m, NULL, 0);
}

/* --- Actions ------------------------------------------------------------------------------------
 */

static void feed_later(struct sim *sim, struct sched_event e)
{
    struct sim_master *m = &sim->m;
    m->later = sim_grow(m->later, m->later_count, &m->later_capacity, sizeof *m->later);
    m->later[m->later_count++] = e;
}

static uint64_t fold(uint64_t sum, uint32_t hash)
{
    return sim_hash(sum, hash);
}

/* Bits of a run that was accepted before: the same, or a case for a third worker. */
static void compare(struct sim *sim, const struct sched_action *a)
{
    const struct sim_job *j = book_job(sim, a->job);
    uint32_t skip = a->unit.cell_begin - sim->m.answering->lease.unit.cell_begin;
    struct sched_mismatch m = {.unit = a->unit, .digest = 1, .digest_accepted = 1};
    for (uint32_t i = 0; i < a->unit.cell_count; i++) {
        uint64_t spot = spot_index(j, a->unit.cell_begin + i, a->unit.block);
        SIM_CHECK(sim, j->flags[spot] & SPOT_ACCEPTED, "compared with nothing");
        uint32_t hash = sim->m.answering_hash[skip + i];
        m.digest = fold(m.digest, hash);
        m.digest_accepted = fold(m.digest_accepted, j->hash[spot]);
        if (hash != j->hash[spot] && m.worker_accepted == 0)
            m.worker_accepted = j->worker[spot];
    }
    if (m.worker_accepted == 0)
        return;
    SIM_CHECK(sim, sim->c.liars > 0, "two honest workers differ");
    feed_later(sim, (struct sched_event){.type = SCHED_MISMATCH,
                                         .worker = sim->m.answering_handle,
                                         .job = a->job,
                                         .mismatch = m});
}

/* Every cell of a job that the liar touched starts again; the scheduler is told of it. */
static void reset_touched(struct sim *sim, uint32_t job, uint64_t handle, bool tell)
{
    const struct sim_job *j = &sim->jobs[job];
    for (uint32_t cell = 0; cell < j->cells; cell++) {
        uint32_t begin = cell;
        while (cell < j->cells && book_touched(j, cell, handle))
            cell++;
        if (cell == begin)
            continue;
        uint32_t count = cell - begin;
        book_widen(j, &begin, &count);
        cell = begin + count - 1;
        book_reset(sim, job, begin, count);
        sim->jobs[job].done = false; /* told again */
        if (tell)
            feed_later(sim,
                       (struct sched_event){.type = SCHED_CELLS_RESET,
                                            .job = j->id,
                                            .unit = {.cell_begin = begin, .cell_count = count}});
    }
}

static void liar(struct sim *sim, const struct sched_action *a)
{
    uint32_t worker = a->worker < sim->handle_capacity ? sim->handle_worker[a->worker] : NO_CONN;
    SIM_CHECK(sim, worker != NO_CONN, "an unknown liar %" PRIu64, a->worker);
    SIM_CHECK(sim, sim->workers[worker].liar, "worker %" PRIu64 " is honest and called a liar",
              a->worker);
    sim->stats.liars_found++;
    book_note(sim, a, NOTE_LIAR);
    for (uint32_t i = 0; i < sim->c.jobs; i++)
        reset_touched(sim, i, a->worker, true);
    feed_later(sim, (struct sched_event){.type = SCHED_LIAR_SETTLED});
}

void master_retry(struct sim *sim, uint64_t job)
{
    if (!sim->m.alive)
        return;
    sim->failed_told &= ~(UINT32_C(1) << (job - 1));
    book_note(sim, &(struct sched_action){.job = job}, NOTE_FORGIVEN);
    master_feed(sim, &(struct sched_event){.type = SCHED_JOB_RETRY, .job = job});
}

static void job_news(struct sim *sim, const struct sched_action *a)
{
    struct sim_job *j = book_job(sim, a->job);
    if (a->type == SCHED_JOB_DONE) {
        SIM_CHECK(sim, j->accepted == (uint64_t)j->cells * j->blocks,
                  "job %" PRIu64 " is called done with %" PRIu64 " of %" PRIu64 " spots", a->job,
                  j->accepted, (uint64_t)j->cells * j->blocks);
        j->done = true;
        return;
    }
    sim->failed_told |= UINT32_C(1) << (a->job - 1);
    uint32_t poison = (uint32_t)sim->c.poison_cell;
    if (a->job == 1 && sim->c.poison_cell >= 0 && a->why == SCHED_WHY_UNIT_KILLS &&
        poison >= a->unit.cell_begin && poison < a->unit.cell_begin + a->unit.cell_count)
        sim->poison_named = true;
}

/* With --trace: one line an action. */
static void trace(const struct sim *sim, const struct sched_action *a)
{
    static const char *const names[] = {
        [SCHED_OPEN_JOB] = "open",      [SCHED_CLOSE_JOB] = "close",
        [SCHED_LEASE] = "lease",        [SCHED_REVOKE] = "revoke",
        [SCHED_ACCEPT] = "accept",      [SCHED_COMPARE] = "compare",
        [SCHED_VOTE] = "vote",          [SCHED_IGNORE] = "ignore",
        [SCHED_JOB_DONE] = "done",      [SCHED_JOB_FAILED] = "failed",
        [SCHED_WORKER_NEWS] = "news",   [SCHED_UNIT_LOST] = "unit-lost",
        [SCHED_DRAINED] = "drained",    [SCHED_LIAR] = "liar",
        [SCHED_CHECK_OPENED] = "check", [SCHED_CHECK_CLOSED] = "checked"};
    (void)printf("%12.6f %-9s worker %" PRIu64 " job %" PRIu64
                 " cells %u+%u block %u epoch %" PRIu64 " kind %d why %d state %d losses %u%s\n",
                 1e-6 * (double)sim->now_us, names[a->type], a->worker, a->job, a->unit.cell_begin,
                 a->unit.cell_count, a->unit.block, a->epoch, (int)a->kind, (int)a->why,
                 (int)a->state, a->losses, a->alone ? " alone" : "");
}

static void act(struct sim *sim, const struct sched_action *a, bool *stored)
{
    if (sim->c.trace)
        trace(sim, a);
    switch (a->type) {
    case SCHED_LEASE:
        book_lease(sim, a);
        send_action(sim, a);
        break;
    case SCHED_OPEN_JOB:
    case SCHED_CLOSE_JOB:
    case SCHED_REVOKE:
        send_action(sim, a);
        break;
    case SCHED_ACCEPT:
        book_accept(sim, a);
        *stored = true;
        break;
    case SCHED_COMPARE:
        compare(sim, a);
        break;
    case SCHED_JOB_DONE:
    case SCHED_JOB_FAILED:
        job_news(sim, a);
        break;
    case SCHED_LIAR:
        liar(sim, a);
        break;
    case SCHED_DRAINED: {
        uint32_t conn = conn_of(sim, a->worker);
        if (conn != NO_CONN)
            sim_push(sim, sim->now_us + 10000,
                     (struct sim_event){.type = EV_LEFT,
                                        .a = sim->conns[conn].worker,
                                        .b = sim->conns[conn].worker_life});
        break;
    }
    case SCHED_CHECK_OPENED:
        book_note(sim, a, NOTE_CHECK_OPENED);
        break;
    case SCHED_CHECK_CLOSED:
        book_note(sim, a, NOTE_CHECK_CLOSED);
        break;
    case SCHED_UNIT_LOST:
        book_note(sim, a, NOTE_BLAME);
        break;
    case SCHED_IGNORE:
        SIM_CHECK(sim, a->why != SCHED_WHY_NO_UNIT, "a unit that was leased is called none");
        break;
    case SCHED_VOTE:
    case SCHED_WORKER_NEWS:
        break;
    }
}

/* --- Events
 * ---------------------------------------------------------------------------------------- */

static void commit_soon(struct sim *sim)
{
    struct sim_disk *d = &sim->disk;
    if (d->committing || d->pending_count == 0)
        return;
    d->committing = true;
    uint64_t us = 500 + sim_spread(sim, 1500);
    if (!sim->healed && sim_chance(sim, 0.01))
        us += sim_spread(sim, 500000);
    sim_push(sim, sim->now_us + us,
             (struct sim_event){.type = EV_COMMITTED, .b = sim->m.life, .c = d->bytes.bytes});
}

static void arm_tick(struct sim *sim)
{
    uint64_t due_ms = sched_deadline_ms(sim->m.s);
    if (due_ms == UINT64_MAX)
        return;
    uint64_t at_us = (due_ms - sim->m.clock_base_ms) * 1000;
    if (at_us < sim->now_us)
        at_us = sim->now_us;
    sim_push(sim, at_us,
             (struct sim_event){.type = EV_TICK, .b = sim->m.life, .c = ++sim->m.tick_ticket});
}

static void watch_progress(struct sim *sim)
{
    for (uint32_t i = 0; i < sim->c.jobs; i++) {
        struct sched_job_info info;
        if (!sched_job_info(sim->m.s, i + 1, &info))
            continue; /* a new master takes them up one by one */
        SIM_CHECK(sim, info.done >= sim->jobs[i].shown && info.done <= 1.0,
                  "progress of job %u went back", i + 1);
        SIM_CHECK(sim, info.spots_done == sim->jobs[i].accepted,
                  "job %u: the scheduler counts %" PRIu64 " spots, the book %" PRIu64, i + 1,
                  info.spots_done, sim->jobs[i].accepted);
        sim->jobs[i].shown = info.done;
    }
}

static void feed_one(struct sim *sim, const struct sched_event *e)
{
    struct sched_action a;
    bool stored = false;
    (void)sched_feed(sim->m.s, clock_ms(sim), e);
    while (sched_next(sim->m.s, &a))
        act(sim, &a, &stored);
    /* The last record of a result carries its acknowledgement; with nothing to store it is now. */
    if (e->type == SCHED_RESULT) {
        if (stored)
            sim->disk.pending[sim->disk.pending_count - 1].handle = e->worker;
        else
            acknowledge(sim, e->worker, e->job, e->result.epoch);
    }
}

void master_feed(struct sim *sim, const struct sched_event *e)
{
    struct sim_master *m = &sim->m;
    if (!m->alive)
        return;
    feed_one(sim, e);
    for (size_t i = 0; i < m->later_count; i++) {
        struct sched_event later = m->later[i];
        feed_one(sim, &later);
    }
    m->later_count = 0;
    sim->stats.events++;
    if (sim_below(sim, sim->c.check_every) == 0) {
        sched_check(m->s);
        watch_progress(sim);
    }
    if (sched_epoch_next(m->s) + SIM_EPOCHS_RESERVED / 2 > sim->disk.epoch_limit)
        sim->disk.epoch_limit += SIM_EPOCHS_RESERVED;
    commit_soon(sim);
    arm_tick(sim);
}

static void on_hello(struct sim *sim, uint32_t conn, const tilery_Hello *hello)
{
    static struct message m;
    struct sched_held held[LIMIT_HELD_TOLD];
    for (size_t i = 0; i < hello->held_count; i++) {
        const tilery_Held *h = &hello->held[i];
        held[i] = (struct sched_held){.job = h->job,
                                      .epoch = h->epoch,
                                      .unit = {h->cell_begin, h->cell_count, h->block},
                                      .state = (enum sched_held_state)h->state};
    }
    uint64_t handle = hello->instance;
    uint32_t old = conn_of(sim, handle);
    if (old != NO_CONN)
        net_close(sim, old, SIDE_MASTER, false);
    sim->conns[conn].handle = handle;
    conn_set(sim, handle, conn);
    m = (struct message){.type = FRAME_WELCOME};
    m.welcome.protocol = PROTOCOL_VERSION_MAX;
    m.welcome.heartbeat_ms = 1000;
    MESSAGE_TEXT(m.welcome.worker_id, "w");
    net_send(sim, conn, SIDE_WORKER, &m, NULL, 0);
    if (book_lied(sim, handle))
        master_feed(sim, &(struct sched_event){
                             .type = SCHED_WORKER_PAST, .worker = handle, .past = {.lied = true}});
    master_feed(sim, &(struct sched_event){.type = SCHED_WORKER_JOIN,
                                           .worker = handle,
                                           .join = {.threads = hello->threads,
                                                    .tags = sim->handle_worker[handle] % 2,
                                                    .held = held,
                                                    .held_count = hello->held_count}});
    master_feed(sim, &(struct sched_event){.type = SCHED_WORKER_RTT,
                                           .worker = handle,
                                           .rtt_us = 2 * (uint64_t)sim->c.latency_us});
}

static void on_result(struct sim *sim, uint64_t handle, const tilery_Result *r,
                      const unsigned char *body, size_t body_bytes)
{
    sim->stats.results++;
    struct sim_result result = {
        .lease = {
            .job = r->job,
            .epoch = r->epoch,
            .unit = {.cell_begin = r->cell_begin, .cell_count = r->cell_count, .block = r->block}}};
    uint32_t *hashes = mem_alloc_array(r->cell_count, sizeof *hashes);
    TL_ASSERT(hashes);
    SIM_CHECK(sim, body_hashes(sim, body, body_bytes, r->cell_count, hashes), "a result's body");
    uint64_t sum = 1;
    for (uint32_t i = 0; i < r->cell_count; i++)
        sum = fold(sum, hashes[i]);
    sim->m.answering = &result;
    sim->m.answering_handle = handle;
    sim->m.answering_hash = hashes;
    master_feed(sim, &(struct sched_event){.type = SCHED_RESULT,
                                           .worker = handle,
                                           .job = r->job,
                                           .result = {.unit = result.lease.unit,
                                                      .epoch = r->epoch,
                                                      .samples = r->samples,
                                                      .render_us = r->render_us,
                                                      .digest = sum}});
    sim->m.answering = NULL;
    mem_free(hashes);
}

/* A picture that a worker lacks; of its contents only the name matters here. */
static void give_chunk(struct sim *sim, uint32_t conn, const tilery_ChunkRequest *asked)
{
    static struct message m;
    static const char body[8];
    m = (struct message){.type = FRAME_CHUNK_DATA};
    memcpy(m.chunk_data.sha256, asked->sha256, sizeof m.chunk_data.sha256);
    m.chunk_data.raw_bytes = sizeof body;
    net_send(sim, conn, SIDE_WORKER, &m, body, sizeof body);
}

void master_message(struct sim *sim, uint32_t conn, const struct message *m,
                    const unsigned char *body, size_t body_bytes)
{
    uint64_t handle = sim->conns[conn].handle;
    if (m->type != FRAME_HELLO && conn_of(sim, handle) != conn)
        return;
    struct sched_event e = {.worker = handle};
    switch (m->type) {
    case FRAME_HELLO:
        on_hello(sim, conn, &m->hello);
        return;
    case FRAME_RESULT:
        on_result(sim, handle, &m->result, body, body_bytes);
        return;
    case FRAME_JOB_READY:
        e.type = SCHED_JOB_READY;
        e.job = m->job_ready.job;
        break;
    case FRAME_JOB_FAILED:
        e.type = SCHED_JOB_UNFIT;
        e.job = m->job_failed.job;
        break;
    case FRAME_UNIT_FAILED:
        e.type = SCHED_UNIT_FAILED;
        e.job = m->unit_failed.job;
        e.epoch = m->unit_failed.epoch;
        break;
    case FRAME_CHUNK_REQUEST:
        give_chunk(sim, conn, &m->chunk_request);
        e.type = SCHED_WORKER_ASKS;
        break;
    case FRAME_GOODBYE:
        e.type = SCHED_WORKER_LEFT;
        break;
    default:
        sim_fail(sim, "master got a %s", frame_type_name((int)m->type));
    }
    master_feed(sim, &e);
    if (m->type == FRAME_GOODBYE)
        net_close(sim, conn, SIDE_MASTER, false);
}

void master_conn_lost(struct sim *sim, uint32_t conn)
{
    uint64_t handle = sim->conns[conn].handle;
    /* It counts only if the worker has no newer connection. */
    if (handle != 0 && sim->m.alive && handle < sim->handle_capacity &&
        sim->handle_conn[handle] == conn)
        master_feed(sim, &(struct sched_event){.type = SCHED_WORKER_AWAY, .worker = handle});
}

void master_event(struct sim *sim, const struct sim_event *e)
{
    if (e->type == EV_MASTER_UP) {
        master_up(sim);
        return;
    }
    if (!sim->m.alive || e->b != sim->m.life)
        return;
    if (e->type == EV_TICK) {
        if (e->c == sim->m.tick_ticket)
            master_feed(sim, &(struct sched_event){.type = SCHED_TICK});
        return;
    }
    TL_ASSERT(e->type == EV_COMMITTED);
    sim->disk.committing = false;
    for (size_t i = 0; i < sim->disk.pending_count && sim->disk.pending[i].end <= e->c; i++) {
        const struct sim_pending *p = &sim->disk.pending[i];
        if (p->handle != 0)
            acknowledge(sim, p->handle, p->job, p->epoch);
    }
    book_committed(sim, e->c);
    commit_soon(sim);
}

/* --- Life
 * -------------------------------------------------------------------------------------------- */

/* What the disk has of a job, as runs of cells, by rising block. */
static struct sched_done *done_runs(const struct sim_job *j, size_t *count)
{
    struct sched_done *runs = NULL;
    size_t capacity = 0;
    *count = 0;
    for (uint32_t b = 0; b < j->blocks; b++) {
        for (uint32_t cell = 0; cell < j->cells; cell++) {
            uint32_t begin = cell;
            while (cell < j->cells && j->flags[spot_index(j, cell, b)] & SPOT_ACCEPTED)
                cell++;
            if (cell == begin)
                continue;
            runs = sim_grow(runs, *count, &capacity, sizeof *runs);
            runs[(*count)++] = (struct sched_done){.cell_begin = begin,
                                                   .cell_count = cell - begin,
                                                   .block_begin = b,
                                                   .block_end = b + 1};
        }
    }
    return runs;
}

/* The checks that are still of one worker's bits; others were cut anew since. */
static struct sched_open_check *open_checks(const struct sim_job *j, size_t *count)
{
    struct sched_open_check *checks = mem_alloc_array(j->check_count, sizeof *checks);
    TL_ASSERT(checks);
    *count = 0;
    for (size_t i = 0; i < j->check_count; i++) {
        struct unit u = j->checks[i];
        uint64_t first = spot_index(j, u.cell_begin, u.block);
        struct sched_open_check c = {.unit = u, .worker = j->worker[first], .digest = 1};
        bool whole = true;
        for (uint32_t k = 0; k < u.cell_count; k++) {
            whole &= j->flags[first + k] & SPOT_ACCEPTED && j->worker[first + k] == c.worker;
            c.digest = fold(c.digest, j->hash[first + k]);
        }
        if (whole)
            checks[(*count)++] = c;
    }
    return checks;
}

static void add_job(struct sim *sim, uint32_t job)
{
    struct sim_job *j = &sim->jobs[job];
    /* The master may have died between a liar's name and the cells that it touched. */
    for (size_t i = 0; i < sim->liar_count; i++)
        reset_touched(sim, job, sim->liars[i], false);
    size_t count, check_count;
    struct sched_done *runs = done_runs(j, &count);
    struct sched_open_check *checks = open_checks(j, &check_count);
    j->done = false;
    j->shown = 0.0;
    master_feed(sim, &(struct sched_event){.type = SCHED_JOB_ADD,
                                           .job = j->id,
                                           .add = {.cell_count = j->cells,
                                                   .block_count = j->blocks,
                                                   .cell_cost = sim->c.cell_cost,
                                                   .verify_share = sim->c.verify,
                                                   .quiet_ms = sim->m.life > 1 ? 600 : 0,
                                                   .priority = (int32_t)(job % 2),
                                                   .tags = sim->c.tags && job % 2 == 0,
                                                   .memory = j->memory,
                                                   .done = runs,
                                                   .done_count = count,
                                                   .blame = j->blame,
                                                   .blame_count = j->blame_count,
                                                   .checks = checks,
                                                   .check_count = check_count}});
    mem_free(runs);
    mem_free(checks);
    struct sched_job_info info;
    bool known = sched_job_info(sim->m.s, j->id, &info);
    SIM_CHECK(sim, known && info.spots_done == j->accepted,
              "job %u: %" PRIu64 " spots of %" PRIu64 " were restored", job + 1, info.spots_done,
              j->accepted);
}

void master_up(struct sim *sim)
{
    struct sim_master *m = &sim->m;
    struct sched_limits limits;
    sched_limits_init(&limits);
    limits.worker_count_max = sim->c.workers * 4 + 8;
    limits.job_count_max = SIM_JOBS_MAX;
    limits.lease_count_max = sim->c.workers * 24 + 64;
    limits.suspect_count_max = sim->c.workers * 4 + 16;
    limits.lease_ms_min = 2000;
    limits.load_ms = 40000;
    limits.pause_ms_min = 250;
    limits.pause_ms_max = 8000;
    limits.seed = sim->c.seed;
    m->life++;
    m->clock_base_ms = sim_below(sim, UINT64_C(1) << 40);
    arena_init(&m->arena);
    uint64_t first = sim->disk.epoch_limit;
    sim->disk.epoch_limit += SIM_EPOCHS_RESERVED;
    enum err e = sched_new(&m->arena, &limits, first, &m->s);
    SIM_CHECK(sim, e == ERR_OK, "cannot start the scheduler: %s", err_name(e));
    m->alive = true;
    book_recover(sim);
    for (uint32_t i = 0; i < sim->c.jobs; i++)
        add_job(sim, i);
}

void master_kill(struct sim *sim)
{
    struct sim_master *m = &sim->m;
    if (!m->alive)
        return;
    m->alive = false;
    m->later_count = 0;
    sim->stats.master_crashes++;
    for (uint32_t i = 0; i < sim->conn_count; i++)
        net_close(sim, i, SIDE_MASTER, sim_chance(sim, 0.2));
    for (size_t i = 0; i < sim->handle_capacity; i++)
        sim->handle_conn[i] = NO_CONN;
    book_crash(sim);
    arena_release(&m->arena);
    m->s = NULL;
    sim_push(sim, sim->now_us + 10000 + sim_spread(sim, 500000),
             (struct sim_event){.type = EV_MASTER_UP});
}

void master_free(struct sim *sim)
{
    if (sim->m.alive)
        arena_release(&sim->m.arena);
    mem_free(sim->m.later);
    mem_free(sim->handle_conn);
    mem_free(sim->handle_worker);
}
