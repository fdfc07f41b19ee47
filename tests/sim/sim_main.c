/* sim_farm: runs seeds of the simulated farm.
 *
 *   sim_farm [--count N] [--first SEED]   N seeds from SEED on (200 from 1)
 *   sim_farm --seconds S [--first SEED]   as many as fit; says how many
 *   sim_farm --seed SEED                  one, with its figures; --trace SEED: and every action
 *   sim_farm --workers N                  N workers on one large job; one in ten has a fault
 *
 * Exit 0: all held. 1: one did not; it is printed. 2: wrong usage.
 */
#include "tests/sim/sim.h"

#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static volatile uint64_t seed_now;

/* An assertion of the production code: say which seed it was. */
static void on_abort(int number)
{
    char text[96];
    int bytes =
        snprintf(text, sizeof text, "sim: seed %llu failed\n  again: sim_farm --seed %llu\n",
                 (unsigned long long)seed_now, (unsigned long long)seed_now);
    if (bytes > 0)
        (void)!write(STDERR_FILENO, text, (size_t)bytes);
    (void)signal(number, SIG_DFL);
    (void)raise(number);
}

static double seconds_now(void)
{
    struct timespec t;
    (void)clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void add(struct sim_stats *sum, const struct sim_stats *s)
{
    sum->events += s->events;
    sum->messages += s->messages;
    sum->results += s->results;
    sum->leases += s->leases;
    sum->copies += s->copies;
    sum->checks += s->checks;
    sum->crashes += s->crashes;
    sum->master_crashes += s->master_crashes;
    sum->liars_found += s->liars_found;
    sum->asks += s->asks;
    sum->virtual_us += s->virtual_us;
    sum->ideal_us += s->ideal_us;
    sum->spots += s->spots;
    sum->wasted_us += s->wasted_us;
    sum->rendered_us += s->rendered_us;
}

static void print_stats(const struct sim_stats *s, double seconds)
{
    (void)printf("  %.1f s for %.0f s of farm time (ideal %.0f); %" PRIu64 " events (%.0f/s), "
                 "%" PRIu64 " messages, %" PRIu64 " spots\n"
                 "  %" PRIu64 " leases, %" PRIu64 " copies, %" PRIu64 " checks; killed: %" PRIu64
                 " workers, %" PRIu64 " masters; liars found: %" PRIu64
                 "; pictures asked for: %" PRIu64 "\n",
                 seconds, 1e-6 * (double)s->virtual_us, 1e-6 * (double)s->ideal_us, s->events,
                 (double)s->events / (seconds > 0.0 ? seconds : 1.0), s->messages, s->spots,
                 s->leases, s->copies, s->checks, s->crashes, s->master_crashes, s->liars_found,
                 s->asks);
}

static int run_seeds(uint64_t first, uint64_t count, double seconds)
{
    struct sim_stats sum = {0};
    double began = seconds_now();
    uint64_t done = 0;
    while (seconds > 0.0 ? seconds_now() - began < seconds : done < count) {
        seed_now = first + done;
        struct sim_config c = sim_config_of(seed_now);
        struct sim_stats s = sim_run(&c);
        add(&sum, &s);
        done++;
    }
    (void)printf("sim: %" PRIu64 " seeds from %" PRIu64 ", 0 failed\n", done, first);
    print_stats(&sum, seconds_now() - began);
    return 0;
}

static void print_config(const struct sim_config *c)
{
    (void)printf("sim: seed %" PRIu64 ": %u workers (%u lie, %u hang), %u jobs:", c->seed,
                 c->workers, c->liars, c->zombies, c->jobs);
    for (uint32_t i = 0; i < c->jobs; i++)
        (void)printf(" %ux%u", c->cells[i], c->blocks[i]);
    (void)printf(
        "; verify %.2f, spot %.0f us, latency %u us, faults for %.1f s every %.2f s%s%s%s%s\n",
        c->verify, c->cost_us, c->latency_us, 1e-6 * (double)c->fault_us,
        1e-6 * (double)c->fault_every_us, c->master_crashes ? ", master dies" : "",
        c->poison_cell >= 0 ? ", poison" : "", c->tags ? ", tags" : "",
        c->late > 0 ? ", late pictures" : "");
}

static int run_one(uint64_t seed, bool trace)
{
    double began = seconds_now();
    seed_now = seed;
    struct sim_config c = sim_config_of(seed);
    c.trace = trace;
    print_config(&c);
    struct sim_stats s = sim_run(&c);
    print_stats(&s, seconds_now() - began);
    return 0;
}

/* 2^20 cells x 4 blocks, 20 seconds of work for each thread, faults in the first 15. */
static int run_large(uint32_t workers)
{
    double began = seconds_now();
    struct sim_config c = {.seed = 1,
                           .workers = workers,
                           .jobs = 1,
                           .cells = {1 << 20},
                           .blocks = {4},
                           .cost_spread = 0.5,
                           .latency_us = 500,
                           .poison_cell = -1,
                           .check_every = 1 << 30,
                           .fault_us = 15000000,
                           .fault_every_us = 150000000 / workers + 1};
    c.cost_us = 1e6 * 20.0 * 2.5 * workers / (4.0 * c.cells[0]);
    c.cell_cost = c.cost_us;
    print_config(&c);
    struct sim_stats s = sim_run(&c);
    print_stats(&s, seconds_now() - began);
    return 0;
}

static int usage(void)
{
    (void)fprintf(stderr, "usage: sim_farm [--count N | --seconds S] [--first SEED]\n"
                          "       sim_farm --seed SEED | --trace SEED | --workers N\n");
    return 2;
}

static bool number(const char *text, uint64_t *out)
{
    char *rest;
    *out = text ? strtoull(text, &rest, 10) : 0;
    return text && *text >= '0' && *text <= '9' && *rest == '\0';
}

int main(int argc, char **argv)
{
    uint64_t first = 1, count = 200, seconds = 0, value;
    (void)signal(SIGABRT, on_abort);
    for (int i = 1; i < argc; i += 2) {
        if (!number(i + 1 < argc ? argv[i + 1] : NULL, &value))
            return usage();
        if (strcmp(argv[i], "--seed") == 0)
            return run_one(value, false);
        if (strcmp(argv[i], "--trace") == 0)
            return run_one(value, true);
        if (strcmp(argv[i], "--workers") == 0 && value > 0 && value <= 100000)
            return run_large((uint32_t)value);
        if (strcmp(argv[i], "--count") == 0)
            count = value;
        else if (strcmp(argv[i], "--seconds") == 0)
            seconds = value;
        else if (strcmp(argv[i], "--first") == 0)
            first = value;
        else
            return usage();
    }
    return run_seeds(first, count, (double)seconds);
}
