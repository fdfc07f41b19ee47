/* Who is right where Embree and we differ? __float128 decides, and it has to be us.
 *
 *   test_accel_oracle [--long]
 *
 * Also prints which kernels ran and how often the decision in double did, counted by
 * kernels compiled once more with counters. --long: 10^7 random rays a scene.
 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/mem.h"
#include "common/scene.h"
#include "tests/bench/trace_judge.h"
#include "tests/bench/trace_peer.h"
#include "tests/prop/test_accel_kit.h"
#include "worker/render/accel_parts.h"

static bool is_long;

/* --- Embree ------------------------------------------------------------------ */

/* How many hits of two trees differ in any bit. */
static size_t hits_differ(const struct hit *a, const struct hit *b, size_t count)
{
    size_t differ = 0;
    for (size_t i = 0; i < count; i++)
        differ += a[i].object != b[i].object ||
                  (a[i].object != SCENE_NONE && memcmp(&a[i], &b[i], sizeof a[i]) != 0);
    return differ;
}

static void check_scene(enum trace_scene_id id, size_t count)
{
    enum { JUDGED_MAX = 300, CHUNK = 1000 };
    static struct ray rays[CHUNK];
    static struct hit hits[CHUNK], again[CHUNK];
    const struct accel_options options = {.compact = true};
    struct trace_scene s;
    struct accel *compact = NULL;
    uint64_t seed = 77;
    size_t differ = 0, wrong_ours = 0, wrong_theirs = 0, judged = 0;
    assert_int_equal(trace_scene_make(&s, id), ERR_OK);
    struct accel *a = kit_build(&s.input, JOB_BUILDER_SAH, ACCEL_ISA_AUTO, NULL);
    struct trace_peer *peer = trace_peer_new(NULL, 1);
    assert_int_equal(accel_new(&s.input, &options, NULL, &compact), ERR_OK);
    assert_non_null(peer);
    trace_peer_build(peer, &s, PEER_MEDIUM, true);
    for (size_t i = 0; i < count; i += CHUNK) {
        float form[CHUNK][8];
        for (size_t j = 0; j < CHUNK; j++) { /* as floats, so that both sides see the same ray */
            for (int k = 0; k < 3; k++) {
                double to = 2.0 * gen_random(&seed) - 1.0;
                form[j][k] = (float)(2.0 * gen_random(&seed) - 1.0);
                form[j][4 + k] = (float)(to - (double)form[j][k]);
            }
            form[j][3] = 0.0f;
            form[j][7] = __builtin_inff();
            struct trace_rays one = {&form[j], 1};
            rays[j] = trace_rays_get(&one, 0);
        }
        accel_closest_batch(a, rays, CHUNK, hits);
        accel_closest_batch(compact, rays, CHUNK, again);
        assert_int_equal(hits_differ(hits, again, CHUNK), 0);
        for (size_t j = 0; j < CHUNK; j++) {
            struct trace_peer_hit theirs;
            trace_peer_closest(peer, form[j], &theirs);
            uint32_t ours = hits[j].object == SCENE_NONE ? SCENE_NONE : hits[j].primitive;
            uint32_t other = theirs.object == SCENE_NONE ? SCENE_NONE : theirs.primitive;
            if (ours == other)
                continue;
            differ++;
            if (judged++ >= JUDGED_MAX && !is_long)
                continue;
            wrong_ours += !trace_judge_closest(&s, &rays[j], ours);
            wrong_theirs += !trace_judge_closest(&s, &rays[j], other);
        }
    }
    printf("  %s: %zu rays, Embree (ROBUST) differs on %zu; wrong: we %zu, Embree %zu\n",
           trace_scene_names[id], count, differ, wrong_ours, wrong_theirs);
    assert_int_equal(wrong_ours, 0);
    trace_peer_free(peer);
    accel_free(compact);
    accel_free(a);
    trace_scene_release(&s);
}

static void test_against_embree(void **state)
{
    (void)state;
    check_scene(TRACE_CORNELL, is_long ? 10000000 : 200000);
    check_scene(TRACE_BALL70K, is_long ? 10000000 : 100000);
    check_scene(TRACE_NEEDLES, is_long ? 1000000 : 20000);
    if (is_long)
        check_scene(TRACE_BALL1M, 10000000);
}

/* --- Counters ------------------------------------------------------------------- */

uint64_t trace_count_nodes, trace_count_leaves, trace_count_decisions;
extern const struct trace_kernel counted_sse2, counted_avx2, counted_avx512;

static void count_kernel(struct accel *a, const char *scene, const struct trace_rays *rays,
                         const char *kind, bool shadow)
{
    const struct trace_kernel *plain = a->kernel;
    a->kernel = strcmp(plain->name, "avx512") == 0 ? &counted_avx512
                : strcmp(plain->name, "avx2") == 0 ? &counted_avx2
                                                   : &counted_sse2;
    assert_string_equal(a->kernel->name, plain->name);
    trace_count_nodes = trace_count_leaves = trace_count_decisions = 0;
    size_t hits = 0;
    for (size_t i = 0; i < rays->count; i++) {
        struct ray ray = trace_rays_get(rays, i);
        hits += accel_occluded(a, &ray);
    }
    if (!shadow) {
        trace_count_nodes = trace_count_leaves = trace_count_decisions = 0;
        for (size_t i = 0; i < rays->count; i++) {
            struct ray ray = trace_rays_get(rays, i);
            struct hit hit;
            accel_closest(a, &ray, &hit);
            hits -= hit.object != SCENE_NONE;
        }
        assert_int_equal(hits, 0);
    }
    double n = (double)rays->count;
    printf("  %-9s %-7s %-7s nodes %6.2f, leaves %6.2f, decisions in double %5.2f a ray\n", scene,
           kind, a->kernel->name, (double)trace_count_nodes / n, (double)trace_count_leaves / n,
           (double)trace_count_decisions / n);
    assert_true(trace_count_decisions > 0);
    assert_true(trace_count_decisions < trace_count_leaves);
    a->kernel = plain;
}

static void test_kernels_ran(void **state)
{
    (void)state;
    static const enum trace_scene_id scenes[] = {TRACE_CORNELL, TRACE_BALL70K, TRACE_NEEDLES};
    for (size_t i = 0; i < 3; i++) {
        struct trace_scene s;
        assert_int_equal(trace_scene_make(&s, scenes[i]), ERR_OK);
        for (int isa = ACCEL_ISA_SSE2; isa <= ACCEL_ISA_AVX512; isa++) {
            struct accel *a = kit_build(&s.input, JOB_BUILDER_SAH, (enum accel_isa)isa, NULL);
            for (int kind = 0; kind < TRACE_RAYS_COUNT; kind++) {
                struct trace_rays rays;
                assert_int_equal(trace_rays_make(&rays, a, scenes[i], (enum trace_rays_id)kind, 64),
                                 ERR_OK);
                count_kernel(a, trace_scene_names[scenes[i]], &rays, trace_rays_names[kind],
                             kind == TRACE_SHADOW);
                trace_rays_release(&rays);
            }
            accel_free(a);
        }
        trace_scene_release(&s);
    }
}

int main(int argc, char **argv)
{
    is_long = kit_long(argc, argv);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_kernels_ran),
        cmocka_unit_test(test_against_embree),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
