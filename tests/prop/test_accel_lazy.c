/* Trees that are built when a ray first meets them: the same bits as with all trees built, on any
 * kernel and any number of threads; what no ray meets is not built; lack of memory is told. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <pthread.h>
#include <stdio.h>
#include <string.h>

#include "common/mem.h"
#include "common/scene.h"
#include "tests/prop/test_accel_kit.h"
#include "worker/render/accel_parts.h"

enum { SIDE = 3, BALLS = SIDE * SIDE * SIDE, EXTRA = 3, OBJECTS = BALLS + EXTRA, MIN = 500 };

static bool is_long;

/* --- A scene of balls, side by side ----------------------------------------- */

struct balls {
    struct trace_scene s; /* for kit_ray */
    struct gen_mesh mesh[BALLS];
    struct accel_mesh views[BALLS];
    struct accel_object objects[OBJECTS];
};

/* Balls 1 and 2 are the same triangles, so that their hits tie; a sphere and an instance among
 * them; the last object is small and waits for nothing. */
static void balls_init(struct balls *b)
{
    memset(b, 0, sizeof *b);
    for (int i = 0; i < BALLS; i++) {
        int at = i == 2 ? 1 : i;
        const double center[3] = {at % SIDE - 1.0, at / SIDE % SIDE - 1.0, at / SIDE / SIDE - 1.0};
        gen_mesh_init(&b->mesh[i]);
        uint32_t side = i == BALLS - 1 ? 4 : 10;
        assert_int_equal(gen_ball(&b->mesh[i], side, center, 0.48, 0.1, (uint32_t)at + 1), ERR_OK);
        b->views[i] = (struct accel_mesh){b->mesh[i].positions, b->mesh[i].indices,
                                          (uint32_t)b->mesh[i].vertex_count,
                                          (uint32_t)b->mesh[i].triangle_count};
        b->objects[i < 10 ? i : i + 2] =
            (struct accel_object){.type = ACCEL_TRIANGLES, .mesh = (uint32_t)i};
    }
    b->objects[10] =
        (struct accel_object){.type = ACCEL_SPHERE, .center = {0.3, 0.2, 0.1}, .radius = 0.25};
    b->objects[11] = (struct accel_object){.type = ACCEL_INSTANCE,
                                           .mesh = BALLS - 1,
                                           .to_scene = {1, 0, 0, -2.5, 0, 1, 0, -1, 0, 0, 1, -1},
                                           .from_scene = {1, 0, 0, 2.5, 0, 1, 0, 1, 0, 0, 1, 1}};
    b->objects[OBJECTS - 1] =
        (struct accel_object){.type = ACCEL_SPHERE, .center = {0, 2, 0}, .radius = 0.5};
    b->s.views[0] = b->views[1]; /* what rays are aimed at */
    b->s.input = (struct accel_input){b->views, BALLS, b->objects, OBJECTS};
}

static void balls_release(struct balls *b)
{
    for (int i = 0; i < BALLS; i++)
        gen_mesh_release(&b->mesh[i]);
}

static void lock(void *ctx, uint32_t object)
{
    (void)object;
    assert_int_equal(pthread_mutex_lock(ctx), 0);
}

static void unlock(void *ctx, uint32_t object)
{
    (void)object;
    assert_int_equal(pthread_mutex_unlock(ctx), 0);
}

static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;

static struct accel *build_lazy_as(const struct accel_input *input, enum accel_isa isa,
                                   bool compact)
{
    struct accel_options options = {.isa = isa, .compact = compact};
    struct accel_locks locks = {lock, unlock, &mutex};
    struct accel_lazy_plan plan;
    struct accel *a = NULL;
    assert_int_equal(accel_lazy_choose(input, &options, NULL, MIN, &plan), ERR_OK);
    /* The instance's mesh has another use, and the sphere is none. */
    assert_int_equal(plan.lazy_count, BALLS - 1);
    assert_int_equal(accel_new_lazy(input, &options, NULL, &plan, &locks, &a), ERR_OK);
    accel_lazy_plan_release(&plan);
    return a;
}

static struct accel *build_lazy(const struct accel_input *input, enum accel_isa isa)
{
    return build_lazy_as(input, isa, false);
}

static struct accel *build_eager(const struct accel_input *input)
{
    struct accel_options options = {.builder = JOB_BUILDER_SAH};
    struct accel *a = NULL;
    assert_int_equal(accel_new(input, &options, NULL, &a), ERR_OK);
    return a;
}

static struct ray *make_rays(const struct trace_scene *s, size_t count, uint64_t seed)
{
    struct ray *rays = mem_alloc_array(count, sizeof *rays);
    assert_non_null(rays);
    for (size_t i = 0; i < count; i++)
        kit_ray(s, &seed, i, &rays[i]);
    return rays;
}

/* --- Tests ------------------------------------------------------------------- */

static void test_same_bits(void **state)
{
    (void)state;
    static const enum accel_isa isas[] = {ACCEL_ISA_SSE2, ACCEL_ISA_AVX2, ACCEL_ISA_AVX512};
    struct balls b;
    balls_init(&b);
    size_t count = is_long ? 200000 : 3000;
    struct ray *rays = make_rays(&b.s, count, 42);
    struct accel *eager = build_eager(&b.s.input);
    for (int i = 0; i < 6; i++) {
        struct accel *lazy = build_lazy_as(&b.s.input, isas[i % 3], i / 3);
        assert_int_equal(kit_differences(eager, lazy, rays, count), 0);
        struct accel_stats s;
        accel_stats_get(lazy, &s);
        assert_int_equal(s.lazy_built, s.lazy_count);
        /* Once more, with all of them there. */
        assert_int_equal(kit_differences(eager, lazy, rays, count), 0);
        accel_free(lazy);
    }
    accel_free(eager);
    mem_free(rays);
    balls_release(&b);
}

/* tmin below zero is left to the kernel without SIMD. */
static void test_same_bits_plain(void **state)
{
    (void)state;
    struct balls b;
    balls_init(&b);
    struct ray *rays = make_rays(&b.s, 500, 43);
    for (int i = 0; i < 500; i++)
        rays[i].tmin = -0.25;
    struct accel *eager = build_eager(&b.s.input);
    struct accel *lazy = build_lazy(&b.s.input, ACCEL_ISA_AUTO);
    assert_int_equal(kit_differences(eager, lazy, rays, 500), 0);
    accel_free(eager);
    accel_free(lazy);
    mem_free(rays);
    balls_release(&b);
}

/* Rays that stay within one column of balls build no more than that column. */
static void test_only_what_is_met(void **state)
{
    (void)state;
    struct balls b;
    balls_init(&b);
    struct accel *lazy = build_lazy(&b.s.input, ACCEL_ISA_AUTO);
    struct accel_stats s;
    accel_stats_get(lazy, &s);
    uint64_t before = s.bytes;
    assert_int_equal(s.lazy_built, 0);

    /* Past all of them. */
    struct ray ray = {.org = {-5, 0.02, 5}, .dir = {1, 0, 0}, .tmax = 1e30};
    struct hit hit;
    accel_closest(lazy, &ray, &hit);
    accel_stats_get(lazy, &s);
    assert_int_equal(hit.object, SCENE_NONE);
    assert_int_equal(s.lazy_built, 0);

    /* The nearest of three stops it, so that the two behind are not built. */
    ray = (struct ray){.org = {0.02, 0.03, 5}, .dir = {0, 0, -1}, .tmax = 1e30};
    accel_closest(lazy, &ray, &hit);
    accel_stats_get(lazy, &s);
    assert_int_equal(s.lazy_built, 1);
    assert_true(s.bytes > before);

    /* A shadow ray from behind is stopped by what is built already. */
    ray = (struct ray){.org = {0.02, 0.03, -5}, .dir = {0, 0, 1}, .tmax = 1e30};
    uint8_t occluded[1];
    assert_true(accel_occluded(lazy, &ray));
    accel_occluded_batch(lazy, &ray, 1, occluded);
    assert_int_equal(occluded[0], 1);
    accel_stats_get(lazy, &s);
    assert_int_equal(s.lazy_built, 1);
    accel_free(lazy);
    balls_release(&b);
}

struct thread_work {
    const struct accel *accel;
    const struct ray *rays;
    struct hit *hits;
    size_t count;
    bool backwards;
};

static void *trace_all(void *arg)
{
    struct thread_work *w = arg;
    for (size_t i = 0; i < w->count; i++) {
        size_t at = w->backwards ? w->count - 1 - i : i;
        accel_closest(w->accel, &w->rays[at], &w->hits[at]);
    }
    return NULL;
}

static void test_threads(void **state)
{
    (void)state;
    enum { THREADS = 6, COUNT = 3000 };
    struct balls b;
    balls_init(&b);
    struct ray *rays = make_rays(&b.s, COUNT, 44);
    struct accel *eager = build_eager(&b.s.input);
    for (int round = 0; round < (is_long ? 50 : 4); round++) {
        struct accel *lazy = build_lazy(&b.s.input, ACCEL_ISA_AUTO);
        struct thread_work work[THREADS];
        pthread_t threads[THREADS];
        for (int i = 0; i < THREADS; i++) {
            work[i] = (struct thread_work){lazy, rays, NULL, COUNT, i % 2};
            work[i].hits = mem_calloc(COUNT, sizeof *work[i].hits);
            assert_non_null(work[i].hits);
            assert_int_equal(pthread_create(&threads[i], NULL, trace_all, &work[i]), 0);
        }
        for (int i = 0; i < THREADS; i++)
            assert_int_equal(pthread_join(threads[i], NULL), 0);
        for (size_t k = 0; k < COUNT; k++) {
            struct hit want;
            accel_closest(eager, &rays[k], &want);
            for (int i = 0; i < THREADS; i++) {
                const struct hit *got = &work[i].hits[k];
                assert_int_equal(got->object, want.object);
                if (want.object == SCENE_NONE)
                    continue;
                assert_int_equal(got->primitive, want.primitive);
                assert_memory_equal(&got->t, &want.t, sizeof want.t);
            }
        }
        for (int i = 0; i < THREADS; i++)
            mem_free(work[i].hits);
        accel_free(lazy);
    }
    accel_free(eager);
    mem_free(rays);
    balls_release(&b);
}

/* An allocation fails while a tree is built: told, and the next ray builds it. */
static void test_no_memory(void **state)
{
    (void)state;
    struct balls b;
    balls_init(&b);
    struct accel *eager = build_eager(&b.s.input);
    struct ray ray = {.org = {0.02, 0.03, 5}, .dir = {0, 0, -1}, .tmax = 1e30};
    struct hit want, got;
    accel_closest(eager, &ray, &want);
    uint64_t fails = 0;
    for (uint64_t n = 0;; n++) {
        struct accel *lazy = build_lazy(&b.s.input, ACCEL_ISA_AUTO);
        mem_fail_after(n);
        accel_closest(lazy, &ray, &got);
        mem_fail_after(UINT64_MAX);
        bool failed = accel_failures(lazy) > 0;
        fails += failed;
        accel_closest(lazy, &ray, &got);
        assert_int_equal(got.object, want.object);
        assert_memory_equal(&got.t, &want.t, sizeof want.t);
        accel_free(lazy);
        if (!failed)
            break;
    }
    assert_true(fails >= 4);
    for (uint64_t n = 0;; n++) {
        struct accel_options options = {.builder = JOB_BUILDER_SAH};
        struct accel_locks locks = {lock, unlock, &mutex};
        struct accel_lazy_plan plan;
        struct accel *lazy = NULL;
        mem_fail_after(n);
        enum err e = accel_lazy_choose(&b.s.input, &options, NULL, MIN, &plan);
        if (e == ERR_OK && plan.lazy_count > 0)
            e = accel_new_lazy(&b.s.input, &options, NULL, &plan, &locks, &lazy);
        mem_fail_after(UINT64_MAX);
        accel_lazy_plan_release(&plan);
        if (e == ERR_OK) {
            accel_free(lazy);
            break;
        }
        assert_int_equal(e, ERR_NOMEM);
    }
    accel_free(eager);
    balls_release(&b);
}

/* None waits in a scene where that would not pay. */
static void test_choice(void **state)
{
    (void)state;
    struct balls b;
    balls_init(&b);
    struct accel_lazy_plan plan;
    struct accel_options options = {.builder = JOB_BUILDER_MEDIAN};
    assert_int_equal(accel_lazy_choose(&b.s.input, &options, NULL, MIN, &plan), ERR_OK);
    assert_int_equal(plan.lazy_count, 0);
    options = (struct accel_options){.precision = JOB_PRECISION_FAST};
    assert_int_equal(accel_lazy_choose(&b.s.input, &options, NULL, MIN, &plan), ERR_OK);
    assert_int_equal(plan.lazy_count, 0);
    options = (struct accel_options){.builder = JOB_BUILDER_SAH};
    assert_int_equal(accel_lazy_choose(&b.s.input, &options, NULL, 5000, &plan), ERR_OK);
    assert_int_equal(plan.lazy_count, 0);

    /* All at one place: every ray would meet all of them. */
    struct balls heap;
    balls_init(&heap);
    for (int i = 0; i < BALLS; i++)
        heap.views[i] = heap.views[0];
    assert_int_equal(accel_lazy_choose(&heap.s.input, &options, NULL, MIN, &plan), ERR_OK);
    assert_int_equal(plan.lazy_count, 0);
    balls_release(&heap);
    balls_release(&b);
}

int main(int argc, char **argv)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_same_bits),        cmocka_unit_test(test_same_bits_plain),
        cmocka_unit_test(test_only_what_is_met), cmocka_unit_test(test_threads),
        cmocka_unit_test(test_no_memory),        cmocka_unit_test(test_choice),
    };
    is_long = kit_long(argc, argv);
    return cmocka_run_group_tests(tests, NULL, NULL);
}
