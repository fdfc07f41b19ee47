#include "tests/prop/test_accel_kit.h"

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"
#include "common/scene.h"

bool kit_long(int argc, char **argv)
{
    setvbuf(stdout, NULL, _IOLBF, 0);
    return argc > 1 && strcmp(argv[1], "--long") == 0;
}

static void random_point(uint64_t *state, double out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = 2.0 * gen_random(state) - 1.0;
}

/* A vertex, or a point on an edge, of some triangle of the first mesh. */
static void target(const struct trace_scene *s, uint64_t *state, bool edge, double out[3])
{
    const struct accel_mesh *m = &s->views[0];
    size_t triangle = (size_t)(gen_random(state) * m->triangle_count);
    const uint32_t *v = &m->indices[3 * triangle];
    double along = edge ? gen_random(state) : 0.0;
    for (int k = 0; k < 3; k++) {
        double a = (double)m->positions[3 * v[0] + (uint32_t)k];
        out[k] = a + along * ((double)m->positions[3 * v[1] + (uint32_t)k] - a);
    }
}

void kit_ray(const struct trace_scene *s, uint64_t *state, size_t i, struct ray *out)
{
    double to[3], from[3];
    random_point(state, from);
    if (i % 3 == 2)
        random_point(state, to);
    else
        target(s, state, i % 3 == 1, to);
    for (int k = 0; k < 3; k++) {
        double far = i % 29 == 0 ? 1e6 : i % 7 == 0 ? 5.0 : 1.0;
        out->org[k] = from[k] * far;
        if (i % 11 == 0) /* on a plane through the target */
            out->org[k] = k == (int)(i / 11 % 3) ? to[k] : out->org[k];
        if (i % 13 == 0) /* axis-parallel, through the target */
            out->org[k] = k == (int)(i / 13 % 3) ? out->org[k] : to[k];
        out->dir[k] = to[k] - out->org[k];
        if (out->dir[k] == 0.0 && i % 2)
            out->dir[k] = -0.0;
        out->dir[k] *= i % 17 == 0 ? 0x1p-300 : i % 19 == 0 ? 0x1p+200 : 1.0;
    }
    out->tmin = i % 23 == 0 ? -1.0 : i % 5 == 0 ? 0.25 : 0.0;
    out->tmax = i % 4 == 0 ? 1.0 : i % 37 == 0 ? 1e-3 : __builtin_inf();
}

static bool same_hit(const struct hit *a, const struct hit *b)
{
    if (a->object != b->object)
        return false;
    return a->object == SCENE_NONE ||
           (a->primitive == b->primitive && memcmp(&a->t, &b->t, sizeof a->t) == 0 &&
            memcmp(&a->b1, &b->b1, sizeof a->b1) == 0 &&
            memcmp(&a->b2, &b->b2, sizeof a->b2) == 0 && memcmp(a->ng, b->ng, sizeof a->ng) == 0);
}

/* Of the masked calls over every mask of a period of three: rays left out keep what they had. */
static size_t masked_differences(const struct accel *b, const struct ray *rays, size_t count,
                                 const struct hit *hits, const uint8_t *occluded)
{
    struct hit *masked_hits = mem_alloc_array(count, sizeof *masked_hits);
    uint8_t *active = mem_alloc_array(count, 1), *masked = mem_alloc_array(count, 1);
    size_t bad = 0;
    if (!masked_hits || !active || !masked)
        abort();
    for (unsigned pattern = 0; pattern < 8; pattern++) {
        const struct hit untouched = {.t = 1.25, .object = 77, .primitive = 99};
        for (size_t i = 0; i < count; i++) {
            active[i] = (uint8_t)(pattern & 1U << i % 3);
            masked_hits[i] = untouched;
            masked[i] = 77;
        }
        accel_closest_masked(b, rays, active, count, masked_hits);
        accel_occluded_masked(b, rays, active, count, masked);
        for (size_t i = 0; i < count; i++)
            bad += !same_hit(&masked_hits[i], active[i] ? &hits[i] : &untouched) ||
                   masked[i] != (active[i] ? occluded[i] : 77);
    }
    mem_free(masked_hits);
    mem_free(active);
    mem_free(masked);
    return bad;
}

/* A part of the rays, for one thread. */
struct part {
    const struct accel *accel;
    const struct ray *rays;
    struct hit *hits;
    size_t count;
};

enum { PART_RAYS = 64 };

static void part_trace(void *arg, size_t index)
{
    const struct part *p = arg;
    size_t end = (index + 1) * PART_RAYS < p->count ? (index + 1) * PART_RAYS : p->count;
    for (size_t i = index * PART_RAYS; i < end; i++)
        accel_closest(p->accel, &p->rays[i], &p->hits[i]);
}

struct hit *kit_hits(const struct accel *a, const struct ray *rays, size_t count)
{
    struct part p = {a, rays, mem_alloc_array(count, sizeof *p.hits), count};
    struct accel_runner runner = kit_runner(4);
    if (!p.hits)
        abort();
    runner.run(runner.ctx, (count + PART_RAYS - 1) / PART_RAYS, part_trace, &p);
    return p.hits;
}

size_t kit_disagreements(const struct hit *want, const struct accel *b, const struct ray *rays,
                         size_t count)
{
    struct hit *hits = mem_alloc_array(count, sizeof *hits);
    uint8_t *occluded = mem_alloc_array(count, 1);
    size_t bad = 0;
    if (!hits || !occluded)
        abort();
    accel_closest_batch(b, rays, count, hits);
    accel_occluded_batch(b, rays, count, occluded);
    for (size_t i = 0; i < count; i++) {
        struct hit got;
        accel_closest(b, &rays[i], &got);
        bool blocked = want[i].object != SCENE_NONE;
        bad += !same_hit(&want[i], &got) || !same_hit(&want[i], &hits[i]) ||
               accel_occluded(b, &rays[i]) != blocked || (occluded[i] != 0) != blocked;
    }
    const size_t some = 500; /* these are traced eight times more */
    bad += masked_differences(b, rays, count < some ? count : some, hits, occluded);
    mem_free(hits);
    mem_free(occluded);
    return bad;
}

size_t kit_differences(const struct accel *a, const struct accel *b, const struct ray *rays,
                       size_t count)
{
    struct hit *want = kit_hits(a, rays, count);
    size_t bad = kit_disagreements(want, b, rays, count);
    mem_free(want);
    return bad;
}

struct accel *kit_build(const struct accel_input *input, enum job_builder builder,
                        enum accel_isa isa, const struct accel_runner *runner)
{
    struct accel_options options = {.builder = builder, .isa = isa};
    struct accel *a = NULL;
    if (accel_new(input, &options, runner, &a) != ERR_OK)
        abort();
    return a;
}

/* --- The runner -------------------------------------------------------------- */

enum { THREADS_MAX = 8 };

struct job {
    size_t count, next;
    void (*fn)(void *arg, size_t index);
    void *arg;
};

static void *job_help(void *arg)
{
    struct job *j = arg;
    size_t i;
    while ((i = __atomic_fetch_add(&j->next, 1, __ATOMIC_RELAXED)) < j->count)
        j->fn(j->arg, j->count - 1 - i);
    return NULL;
}

static void runner_run(void *ctx, size_t count, void (*fn)(void *arg, size_t index), void *arg)
{
    struct job job = {count, 0, fn, arg};
    pthread_t threads[THREADS_MAX];
    size_t extra = (size_t)(uintptr_t)ctx - 1, made = 0;
    while (made < extra && pthread_create(&threads[made], NULL, job_help, &job) == 0)
        made++;
    job_help(&job);
    while (made > 0)
        pthread_join(threads[--made], NULL);
}

struct accel_runner kit_runner(uint32_t threads)
{
    return (struct accel_runner){runner_run, (void *)(uintptr_t)threads, threads};
}
