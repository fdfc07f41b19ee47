/* Store: what was reported stored is there after a SIGKILL at any moment, whole or not at all;
 * damage is found; a full disk costs nothing that was stored. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "common/log.h"
#include "common/mem.h"
#include "master/store.h"

enum { JOB = 3, TILE = 8, SIDE = 64, BLOCKS_SPP = 100, UNIT_CELLS = 2 };

static char folder[64];
static struct job_spec spec;
static struct job_blocks blocks;
static struct grid grid;

/* --- A job whose results can be told by their sequence ------------------- */

static uint32_t units_per_block(void)
{
    return (grid.cell_count + UNIT_CELLS - 1) / UNIT_CELLS;
}

static uint32_t unit_count(void)
{
    return units_per_block() * blocks.count;
}

/* Sequence n (from 1) is unit n - 1, block by block. */
static struct unit unit_of(uint64_t sequence)
{
    uint32_t i = (uint32_t)(sequence - 1), begin = i % units_per_block() * UNIT_CELLS;
    uint32_t left = grid.cell_count - begin;
    return (struct unit){begin, left < UNIT_CELLS ? left : UNIT_CELLS, i / units_per_block()};
}

static size_t body_values(struct unit u)
{
    return (size_t)grid_pixels(&grid, u.cell_begin, u.cell_count) * FILM_CHANNELS;
}

static float value_of(uint64_t sequence, size_t i)
{
    return (float)(sequence * 1000 + i) * 0x1p-10F;
}

/* The test's bodies are plain floats: the store does not look into them. */
static unsigned char *body_of(uint64_t sequence, size_t *bytes)
{
    size_t values = body_values(unit_of(sequence));
    float *body = mem_alloc_array(values, sizeof *body);
    assert_non_null(body);
    for (size_t i = 0; i < values; i++)
        body[i] = value_of(sequence, i);
    *bytes = values * sizeof *body;
    return (unsigned char *)body;
}

static struct journal_result record_of(uint64_t sequence, size_t body_bytes)
{
    return (struct journal_result){.job = JOB,
                                   .sequence = sequence,
                                   .unit = unit_of(sequence),
                                   .worker = 1,
                                   .epoch = sequence,
                                   .samples = 1,
                                   .nonfinite_pixel = UINT64_MAX,
                                   .raw_bytes = (uint32_t)body_bytes,
                                   .body_bytes = (uint32_t)body_bytes};
}

static void put(struct store *s, uint64_t sequence, store_done *done, void *ctx)
{
    size_t bytes;
    unsigned char *body = body_of(sequence, &bytes);
    struct journal_result r = record_of(sequence, bytes);
    assert_int_equal(store_put_result(s, &r, body, done, ctx), ERR_OK);
}

static struct job_record job_row(void)
{
    struct job_record row = {.id = JOB,
                             .state = JOB_STATE_RENDERING,
                             .name = "a job",
                             .created_us = 1,
                             .totals.nonfinite_pixel = UINT64_MAX};
    row.spec_json = job_spec_to_json(&spec);
    assert_non_null(row.spec_json);
    return row;
}

/* --- Waiting for the thread ---------------------------------------------- */

static int wake_pipe[2];

static void wake(void *ctx)
{
    (void)ctx;
    (void)!write(wake_pipe[1], "", 1);
}

static void wait_wake(struct store *s)
{
    char c[64];
    struct pollfd p = {.fd = wake_pipe[0], .events = POLLIN};
    assert_true(poll(&p, 1, 20000) == 1);
    (void)!read(wake_pipe[0], c, sizeof c);
    store_poll(s);
}

struct outcome {
    uint64_t answered;
    enum err last;
};

static void note(void *ctx, enum err e)
{
    struct outcome *o = ctx;
    o->answered++;
    o->last = e;
}

static struct store *open_started(void)
{
    struct store *s;
    assert_int_equal(store_open(folder, &s), ERR_OK);
    assert_int_equal(store_start(s, wake, NULL), ERR_OK);
    return s;
}

/* --- Reading back --------------------------------------------------------- */

struct found {
    uint64_t replayed;
    uint32_t notes[STORE_STEP_RESULT];
    bool wrong;
};

static enum err check_replay(void *ctx, struct film *film, const struct journal_result *r,
                             const unsigned char *body)
{
    struct found *found = ctx;
    struct unit u = unit_of(r->epoch);
    size_t bytes;
    unsigned char *expected = body_of(r->epoch, &bytes);
    if (memcmp(&u, &r->unit, sizeof u) != 0 || bytes != r->body_bytes ||
        memcmp(expected, body, bytes) != 0)
        found->wrong = true;
    found->replayed++;
    enum err e = film_add(film, r->unit, (float *)expected);
    if (e != ERR_OK)
        mem_free(expected);
    return e;
}

static struct film *load(struct store *s, struct found *found, struct checkpoint *at,
                         uint64_t *sequence)
{
    struct film *film;
    *found = (struct found){0};
    assert_int_equal(
        store_load_film(s, JOB, &grid, &blocks, check_replay, NULL, found, &film, at, sequence),
        ERR_OK);
    film_check(film);
    assert_false(found->wrong);
    return film;
}

static digest picture_of(const struct film *film)
{
    static float rgb[SIDE * SIDE * FILM_CHANNELS];
    film_picture(film, rgb);
    return digest_of(rgb, sizeof rgb);
}

/* --- Set-up --------------------------------------------------------------- */

static void remove_folder(void)
{
    char command[128];
    (void)snprintf(command, sizeof command, "rm -rf '%s'", folder);
    assert_int_equal(system(command), 0);
}

static int set_up(void **state)
{
    (void)state;
    (void)snprintf(folder, sizeof folder, "/tmp/tilery-test-store-XXXXXX");
    assert_non_null(mkdtemp(folder));
    job_spec_init(&spec);
    spec.width = spec.height = SIDE;
    spec.crop = (struct job_crop){0, 0, SIDE, SIDE};
    spec.spp = BLOCKS_SPP;
    spec.tile = TILE;
    blocks = job_blocks_of(spec.spp);
    assert_int_equal(grid_init(&grid, &spec), ERR_OK);
    assert_int_equal(pipe2(wake_pipe, O_NONBLOCK | O_CLOEXEC), 0);
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    grid_release(&grid);
    (void)close(wake_pipe[0]);
    (void)close(wake_pipe[1]);
    remove_folder();
    return 0;
}

/* --- Killed at any moment -------------------------------------------------- */

struct child {
    struct store *store;
    int report;
    uint64_t next, settled;
    struct film *film;
    bool checkpointing;
};

struct stored {
    struct child *child;
    uint64_t sequence;
};

static void child_stored(void *ctx, enum err e)
{
    struct stored *s = ctx;
    struct child *c = s->child;
    if (e != ERR_OK)
        _exit(2);
    size_t bytes;
    if (film_add(c->film, unit_of(s->sequence), (float *)body_of(s->sequence, &bytes)) != ERR_OK)
        _exit(3);
    c->settled = s->sequence;
    /* From here on the parent may rely on it. */
    if (write(c->report, &s->sequence, sizeof s->sequence) != (ssize_t)sizeof s->sequence)
        _exit(4);
    mem_free(s);
}

static void child_checkpointed(void *ctx, enum err e)
{
    struct child *c = ctx;
    if (e != ERR_OK)
        _exit(5);
    film_read_end(c->film);
    c->checkpointing = false;
}

/* Puts results from `next` on, a few at a time, with a checkpoint now and then, until killed. */
static void child_run(struct child *c)
{
    for (uint64_t turn = 0; c->next <= unit_count(); turn++) {
        for (int i = 0; i < 3 && c->next <= unit_count(); i++) {
            struct stored *s = mem_alloc(sizeof *s);
            if (!s)
                _exit(6);
            *s = (struct stored){c, c->next};
            put(c->store, c->next++, child_stored, s);
        }
        if (turn % 16 == 7 && !c->checkpointing) {
            struct checkpoint at = {.job = JOB, .covered_sequence = c->settled};
            film_read_begin(c->film);
            c->checkpointing = true;
            if (store_put_checkpoint(c->store, &at, c->film, child_checkpointed, c) != ERR_OK)
                _exit(7);
        }
        wait_wake(c->store);
    }
    store_close(c->store);
    _exit(0);
}

static pid_t start_child(int *report)
{
    int ends[2];
    assert_int_equal(pipe(ends), 0);
    pid_t pid = fork();
    assert_true(pid >= 0);
    if (pid == 0) {
        (void)close(ends[0]);
        struct child c = {.report = ends[1]};
        struct found found;
        struct checkpoint at;
        if (store_open(folder, &c.store) != ERR_OK)
            _exit(8);
        c.film = load(c.store, &found, &at, &c.settled);
        c.next = c.settled + 1;
        if (store_start(c.store, wake, NULL) != ERR_OK)
            _exit(9);
        child_run(&c);
    }
    (void)close(ends[1]);
    *report = ends[0];
    return pid;
}

/* Everything acknowledged so far: the highest sequence, as they are acknowledged in order. */
static void read_reports(int report, uint64_t *highest)
{
    uint64_t sequence;
    while (read(report, &sequence, sizeof sequence) == (ssize_t)sizeof sequence) {
        assert_true(sequence == *highest + 1);
        *highest = sequence;
    }
}

static void check_kept(uint64_t acknowledged, uint64_t *kept)
{
    struct store *s;
    struct found found;
    struct checkpoint at;
    uint64_t sequence;
    assert_int_equal(store_open(folder, &s), ERR_OK);
    struct film *film = load(s, &found, &at, &sequence);
    /* What was acknowledged is there; what is there is a prefix, since results came in order. */
    assert_true(sequence >= acknowledged);
    for (uint64_t n = 1; n <= unit_count(); n++)
        assert_int_equal(film_has_any(film, unit_of(n)), n <= sequence);
    *kept = sequence;
    film_free(film);
    store_close(s);
}

enum { LIFE_NS_MIN = 2000000, LIFE_NS_MAX = 500000000 };

static void test_killed_at_any_moment(void **state)
{
    (void)state;
    uint64_t seed = (uint64_t)time(NULL), acknowledged = 0;
    uint32_t kills = 0;
    /* The child lives at most so long: less while it gets anywhere, more while it does not, so that
     * machines of any speed kill it while it opens, reads, stores and checkpoints. */
    uint64_t life_ns = LIFE_NS_MIN;
    print_message("seed %llu\n", (unsigned long long)seed);
    for (bool done = false; !done;) {
        int report, status;
        uint64_t before = acknowledged;
        pid_t pid = start_child(&report);
        seed = seed * UINT64_C(6364136223846793005) + 1;
        struct timespec t = {.tv_nsec = (long)((seed >> 33) % life_ns)};
        (void)nanosleep(&t, NULL);
        (void)kill(pid, SIGKILL);
        assert_true(waitpid(pid, &status, 0) == pid);
        read_reports(report, &acknowledged);
        (void)close(report);
        kills += WIFSIGNALED(status);
        assert_true(WIFSIGNALED(status) || WEXITSTATUS(status) == 0);
        check_kept(acknowledged, &acknowledged);
        if (acknowledged == before)
            life_ns = life_ns < LIFE_NS_MAX / 2 ? life_ns * 2 : LIFE_NS_MAX;
        else
            life_ns = life_ns > LIFE_NS_MIN * 2 ? life_ns / 2 : LIFE_NS_MIN;
        done = acknowledged >= unit_count() || kills >= 120;
    }
    print_message("%u kills, %llu of %u results\n", kills, (unsigned long long)acknowledged,
                  unit_count());
    assert_true(kills > 4 && acknowledged > 0);
}

/* --- Order and rows -------------------------------------------------------- */

static enum err keep_job(void *ctx, struct job_record *record)
{
    *(struct job_record *)ctx = *record;
    return ERR_OK;
}

static enum err count_event(void *ctx, uint64_t job, int64_t at_us, const char *text)
{
    (void)at_us;
    assert_int_equal(job, JOB);
    assert_non_null(strstr(text, "line "));
    ++*(uint32_t *)ctx;
    return ERR_OK;
}

static enum err check_key(void *ctx, const char *key, const digest *body, uint64_t job,
                          int64_t at_us)
{
    (void)ctx;
    (void)body;
    assert_string_equal(key, "a key");
    assert_int_equal(job, JOB);
    assert_true(at_us > 0);
    return ERR_OK;
}

static void test_rows(void **state)
{
    (void)state;
    struct store *s = open_started(), *other;
    struct job_record row = job_row(), back = {0};
    struct outcome o = {0};
    uint64_t value = 77, found_value = 0;
    digest body = digest_of("x", 1);
    row.stats.relmse = 0.25;
    row.totals.units = 5;
    assert_int_equal(store_open(folder, &other), ERR_STATE);
    assert_int_equal(store_put_new_job(s, &row, "a key", &body, note, &o), ERR_OK);
    assert_int_equal(store_put_value(s, "n", &value, sizeof value), ERR_OK);
    for (int i = 0; i < STORE_EVENTS_KEPT + 50; i++) {
        char text[32];
        (void)snprintf(text, sizeof text, "line %d", i);
        assert_int_equal(store_put_event(s, JOB, i, text), ERR_OK);
    }
    while (o.answered < 1)
        wait_wake(s);
    assert_int_equal(o.last, ERR_OK);
    store_close(s);

    assert_int_equal(store_open(folder, &s), ERR_OK);
    uint32_t events = 0;
    struct store_visitor jobs = {.ctx = &back, .job = keep_job, .key = check_key};
    struct store_visitor lines = {.ctx = &events, .event = count_event};
    assert_int_equal(store_load(s, &jobs), ERR_OK);
    assert_int_equal(store_load_events(s, JOB, 10000, &lines), ERR_OK);
    assert_int_equal(events, STORE_EVENTS_KEPT);
    assert_int_equal(store_load_value(s, "n", &found_value, sizeof found_value), ERR_OK);
    assert_int_equal(found_value, 77);
    assert_int_equal(store_load_value(s, "m", &found_value, sizeof found_value), ERR_NOT_FOUND);
    assert_string_equal(back.spec_json, row.spec_json);
    assert_int_equal(back.state, JOB_STATE_RENDERING);
    assert_true(back.stats.relmse == 0.25 && back.totals.units == 5);
    mem_free(back.spec_json);
    mem_free(row.spec_json);
    store_close(s);
}

static void put_all(uint64_t first, uint64_t last)
{
    struct store *s = open_started();
    struct outcome o = {0};
    for (uint64_t n = first; n <= last; n++)
        put(s, n, note, &o);
    while (o.answered < last - first + 1)
        wait_wake(s);
    assert_int_equal(o.last, ERR_OK);
    store_close(s);
}

/* A reset between results forgets what came before it, and not what came after. */
static void test_reset(void **state)
{
    (void)state;
    put_all(1, units_per_block());
    struct store *s = open_started();
    struct outcome o = {0};
    uint64_t next = units_per_block() + 1;
    assert_int_equal(store_put_reset(s, JOB, next, 0, UNIT_CELLS, note, &o), ERR_OK);
    while (o.answered < 1)
        wait_wake(s);
    store_close(s);
    struct found found;
    struct checkpoint at;
    uint64_t sequence;
    assert_int_equal(store_open(folder, &s), ERR_OK);
    struct film *film = load(s, &found, &at, &sequence);
    assert_int_equal(sequence, next);
    assert_false(film_has_any(film, unit_of(1)));
    assert_true(film_has_any(film, unit_of(2)));
    film_free(film);
    store_close(s);
}

static enum err count_note(void *ctx, enum store_step_kind kind, struct unit unit)
{
    assert_int_equal(unit.cell_begin, unit_of(1).cell_begin);
    struct found *found = ctx;
    found->notes[kind]++;
    return ERR_OK;
}

static enum err drop_job(void *ctx, struct job_record *record)
{
    (void)ctx;
    mem_free(record->spec_json);
    return ERR_OK;
}

static enum err keep_blame(void *ctx, uint64_t job, const struct sched_blame *blame)
{
    struct outcome *o = ctx;
    assert_int_equal(job, JOB);
    const struct unit expected = {3, 4, 5};
    assert_memory_equal(&blame->unit, &expected, sizeof expected);
    assert_true(blame->worker == 70 || (blame->worker == 71 && blame->alone));
    o->answered++;
    return ERR_OK;
}

static enum err keep_past(void *ctx, const struct worker_past *past)
{
    struct outcome *o = ctx;
    assert_int_equal(past->id, 9);
    assert_true(past->lied);
    assert_int_equal(past->pauses, 3);
    assert_int_equal(past->until_us, INT64_C(1) << 50);
    o->answered += 100;
    return ERR_OK;
}

/* What the scheduler must not forget: checks in the order of the journal, blame, and liars. */
static void test_checks_blame_and_pasts(void **state)
{
    (void)state;
    put_all(1, 1);
    struct store *s = open_started();
    struct outcome o = {0};
    assert_int_equal(store_put_check(s, JOB, 2, unit_of(1), true, note, &o), ERR_OK);
    assert_int_equal(store_put_check(s, JOB, 3, unit_of(1), false, note, &o), ERR_OK);
    const struct sched_blame blame[] = {{{3, 4, 5}, 70, false}, {{3, 4, 5}, 71, true}};
    for (int i = 0; i < 2; i++)
        assert_int_equal(store_put_blame(s, JOB, &blame[i]), ERR_OK);
    assert_int_equal(store_put_past(s, &(struct worker_past){9, false, 2, 5}), ERR_OK);
    assert_int_equal(store_put_past(s, &(struct worker_past){9, true, 3, INT64_C(1) << 50}),
                     ERR_OK);
    while (o.answered < 2)
        wait_wake(s);
    assert_int_equal(o.last, ERR_OK);
    store_close(s);

    struct found found = {0};
    struct checkpoint at;
    struct film *film = NULL;
    uint64_t sequence;
    assert_int_equal(store_open(folder, &s), ERR_OK);
    assert_int_equal(store_load_film(s, JOB, &grid, &blocks, check_replay, count_note, &found,
                                     &film, &at, &sequence),
                     ERR_OK);
    assert_int_equal(sequence, 3);
    assert_int_equal(found.notes[STORE_STEP_CHECK_OPENED], 1);
    assert_int_equal(found.notes[STORE_STEP_CHECK_CLOSED], 1);
    film_free(film);
    struct outcome kept = {0};
    struct store_visitor v = {
        .ctx = &kept, .job = drop_job, .key = check_key, .blame = keep_blame, .past = keep_past};
    assert_int_equal(store_load(s, &v), ERR_OK);
    assert_int_equal(kept.answered, 102);

    /* Forgiven: nothing is left of the blame. */
    assert_int_equal(store_start(s, wake, NULL), ERR_OK);
    assert_int_equal(store_forget_blame(s, JOB), ERR_OK);
    store_close(s);
    kept = (struct outcome){0};
    assert_int_equal(store_open(folder, &s), ERR_OK);
    assert_int_equal(store_load(s, &v), ERR_OK);
    assert_int_equal(kept.answered, 100);
    store_close(s);
}

/* --- Damage ------------------------------------------------------------- */

static long file_bytes(const char *path)
{
    struct stat st;
    return stat(path, &st) == 0 ? (long)st.st_size : -1;
}

static void flip(const char *path, long bit)
{
    unsigned char c;
    int fd = open(path, O_RDWR);
    assert_true(fd >= 0);
    assert_int_equal(pread(fd, &c, 1, bit / 8), 1);
    c ^= (unsigned char)(1 << (bit % 8));
    assert_int_equal(pwrite(fd, &c, 1, bit / 8), 1);
    (void)close(fd);
}

/* Any flipped bit costs one result; the index forgets it, so that it does not come back. */
static void test_flipped_bits(void **state)
{
    (void)state;
    char path[128];
    enum { RESULTS = 6 };
    put_all(1, RESULTS);
    (void)snprintf(path, sizeof path, "%s/jobs/%d/seg-1", folder, JOB);
    long bits = file_bytes(path) * 8;
    /* Index and file are put back each time, so that one life is tried again and again. */
    char keep[512], restore[512];
    (void)snprintf(keep, sizeof keep, "cp '%s/store.db' '%s/keep.db' && cp '%s' '%s/keep.seg'",
                   folder, folder, path, folder);
    (void)snprintf(restore, sizeof restore,
                   "cp '%s/keep.db' '%s/store.db' && cp '%s/keep.seg' '%s'", folder, folder, folder,
                   path);
    assert_int_equal(system(keep), 0);
    for (long bit = 5; bit < bits; bit += bits / 97) {
        struct store *s;
        struct found found;
        struct checkpoint at;
        uint64_t sequence;
        flip(path, bit);
        assert_int_equal(store_open(folder, &s), ERR_OK);
        for (int i = 0; i < 2; i++) {
            film_free(load(s, &found, &at, &sequence));
            assert_int_equal(found.replayed, RESULTS - 1);
        }
        store_close(s);
        assert_int_equal(system(restore), 0);
    }
}

/* A file cut anywhere keeps the results before the cut; a tail behind the index is removed. */
static void test_cut_and_tail(void **state)
{
    (void)state;
    char path[128];
    enum { RESULTS = 4 };
    put_all(1, RESULTS);
    (void)snprintf(path, sizeof path, "%s/jobs/%d/seg-1", folder, JOB);
    long whole = file_bytes(path), each = whole / RESULTS;
    int fd = open(path, O_WRONLY | O_APPEND);
    assert_true(fd >= 0);
    assert_int_equal(write(fd, "torn tail of a crash", 20), 20);
    (void)close(fd);
    struct store *s;
    struct found found;
    struct checkpoint at;
    uint64_t sequence;
    assert_int_equal(store_open(folder, &s), ERR_OK);
    film_free(load(s, &found, &at, &sequence));
    assert_int_equal(found.replayed, RESULTS);
    assert_int_equal(file_bytes(path), whole);
    store_close(s);

    assert_int_equal(truncate(path, 2 * each + each / 2), 0);
    assert_int_equal(store_open(folder, &s), ERR_OK);
    film_free(load(s, &found, &at, &sequence));
    assert_int_equal(found.replayed, 2);
    store_close(s);
}

static void checkpoint_now(struct store *s, struct film *film, uint64_t sequence, enum err expected)
{
    struct outcome o = {0};
    struct checkpoint at = {.job = JOB, .covered_sequence = sequence, .totals.units = sequence};
    film_read_begin(film);
    assert_int_equal(store_put_checkpoint(s, &at, film, note, &o), ERR_OK);
    while (o.answered < 1)
        wait_wake(s);
    film_read_end(film);
    assert_int_equal(o.last, expected);
}

/* A checkpoint replaces the segments it covers, and holds the same picture; when it is damaged
 * the job starts again instead of going on wrongly. */
static void test_checkpoint(void **state)
{
    (void)state;
    char path[128];
    struct store *s;
    struct found found;
    struct checkpoint at;
    uint64_t sequence;
    uint64_t last = units_per_block() * 3 + 5;
    put_all(1, last);
    assert_int_equal(store_open(folder, &s), ERR_OK);
    struct film *film = load(s, &found, &at, &sequence);
    digest expected = picture_of(film);
    assert_int_equal(store_start(s, wake, NULL), ERR_OK);
    checkpoint_now(s, film, sequence, ERR_OK);
    film_free(film);
    store_close(s);
    (void)snprintf(path, sizeof path, "%s/jobs/%d/seg-1", folder, JOB);
    assert_int_equal(file_bytes(path), -1);

    assert_int_equal(store_open(folder, &s), ERR_OK);
    film = load(s, &found, &at, &sequence);
    digest loaded = picture_of(film);
    assert_true(digest_equal(&expected, &loaded));
    assert_int_equal(found.replayed, 0);
    assert_int_equal(at.totals.units, last);
    assert_int_equal(sequence, last);
    film_free(film);

    (void)snprintf(path, sizeof path, "%s/jobs/%d/film", folder, JOB);
    long bits = file_bytes(path) * 8;
    for (long bit = 3; bit < bits; bit += bits / 61) {
        flip(path, bit);
        film = load(s, &found, &at, &sequence);
        assert_int_equal(film_present_count(film), 0);
        film_free(film);
        flip(path, bit);
    }
    store_close(s);
}

/* --- A full disk ---------------------------------------------------------- */

static void set_file_limit(rlim_t bytes)
{
    struct rlimit limit;
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &limit), 0);
    limit.rlim_cur = bytes;
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &limit), 0);
}

static void test_full_disk(void **state)
{
    (void)state;
    (void)signal(SIGXFSZ, SIG_IGN);
    struct store *s = open_started();
    struct outcome o = {0};
    uint64_t n = 1;
    for (; n <= 10; n++)
        put(s, n, note, &o);
    while (o.answered < 10)
        wait_wake(s);
    assert_int_equal(o.last, ERR_OK);
    struct stat st;
    char path[128];
    (void)snprintf(path, sizeof path, "%s/jobs/%d/seg-1", folder, JOB);
    assert_int_equal(stat(path, &st), 0);
    /* No file may grow beyond a little more: the next results do not fit. */
    set_file_limit((rlim_t)st.st_size + 500);
    o = (struct outcome){0};
    put(s, n, note, &o);
    while (o.answered < 1)
        wait_wake(s);
    assert_int_equal(o.last, ERR_NOSPACE);
    set_file_limit(RLIM_INFINITY);
    o = (struct outcome){0};
    for (int i = 0; i < 5; i++)
        put(s, n++, note, &o);
    while (o.answered < 5)
        wait_wake(s);
    assert_int_equal(o.last, ERR_OK);
    store_close(s);

    struct found found;
    struct checkpoint at;
    uint64_t sequence;
    assert_int_equal(store_open(folder, &s), ERR_OK);
    struct film *film = load(s, &found, &at, &sequence);
    assert_int_equal(found.replayed, 15);
    assert_int_equal(store_start(s, wake, NULL), ERR_OK);
    /* Nor does a checkpoint that does not fit cost the one that was there. */
    checkpoint_now(s, film, sequence, ERR_OK);
    digest expected = picture_of(film);
    set_file_limit(30000);
    checkpoint_now(s, film, sequence, ERR_NOSPACE);
    set_file_limit(RLIM_INFINITY);
    film_free(film);
    store_close(s);
    assert_int_equal(store_open(folder, &s), ERR_OK);
    film = load(s, &found, &at, &sequence);
    digest loaded = picture_of(film);
    assert_true(digest_equal(&expected, &loaded));
    film_free(film);
    store_close(s);
}

int main(void)
{
    log_set_level(LOG_ERROR);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(test_rows, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_reset, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_checks_blame_and_pasts, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_flipped_bits, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_cut_and_tail, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_checkpoint, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_full_disk, set_up, tear_down),
        cmocka_unit_test_setup_teardown(test_killed_at_any_moment, set_up, tear_down),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
