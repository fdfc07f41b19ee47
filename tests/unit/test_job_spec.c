/* Job specs: defaults, round trip, hostile texts; the cut into sample blocks. */
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include "common/job_spec.h"
#include "common/mem.h"
#include "tests/unit/problem_check.h"

static enum err read_spec(const char *text, struct job_spec *out, struct diag_list *problems)
{
    diag_init(problems);
    return job_spec_from_json(text, strlen(text), out, problems);
}

static void defaults_are_valid(void **state)
{
    (void)state;
    struct job_spec s, back;
    struct diag_list problems;
    job_spec_init(&s);
    assert_true(job_spec_valid(&s, NULL));
    assert_int_equal(read_spec("{}", &back, &problems), ERR_OK);
    char *ours = job_spec_to_json(&s), *read = job_spec_to_json(&back);
    assert_string_equal(ours, read);
    mem_free(ours);
    mem_free(read);
    diag_release(&problems);
}

static void every_field_round_trips(void **state)
{
    (void)state;
    struct job_spec s = {.width = 1920,
                         .height = 1080,
                         .crop = {100, 80, 64, 32},
                         .spp = JOB_SPP_MAX,
                         .seed = UINT64_MAX,
                         .max_depth = 99,
                         .rr_threshold = 0.1,
                         .tile = 7,
                         .integrator = JOB_INTEGRATOR_AO,
                         .profile = JOB_PROFILE_RW,
                         .sampler = JOB_SAMPLER_INDEPENDENT,
                         .filter = JOB_FILTER_MITCHELL,
                         .filter_radius = 2.1,
                         .filter_alpha = 1 / 3.0,
                         .filter_b = -0.7,
                         .filter_c = 1e-9,
                         .builder = JOB_BUILDER_MEDIAN,
                         .intersector = JOB_INTERSECTOR_MOLLER_TRUMBORE,
                         .precision = JOB_PRECISION_FAST,
                         .light_choice = JOB_LIGHT_CHOICE_UNIFORM,
                         .aov = (UINT32_C(1) << AOV_COUNT) - 1,
                         .tags = {.words = {"big", "site-b"}, .count = 2}};
    struct job_spec back;
    struct diag_list problems;
    char *text = job_spec_to_json(&s);
    assert_non_null(text);
    assert_int_equal(read_spec(text, &back, &problems), ERR_OK);
    char *again = job_spec_to_json(&back);
    assert_string_equal(text, again);
    assert_true(back.seed == s.seed && back.spp == s.spp && back.filter_alpha == s.filter_alpha);
    assert_int_equal(back.aov, s.aov);
    assert_int_equal(back.tags.count, 2);
    assert_string_equal(back.tags.words[1], "site-b");
    mem_free(text);
    mem_free(again);
    diag_release(&problems);
}

static void crop_defaults_to_the_picture(void **state)
{
    (void)state;
    struct job_spec s;
    struct diag_list problems;
    assert_int_equal(read_spec("{\"width\": 30, \"height\": 20}", &s, &problems), ERR_OK);
    assert_int_equal(s.crop.width, 30);
    assert_int_equal(s.crop.height, 20);
    diag_release(&problems);
}

static void hostile_specs_are_refused(void **state)
{
    (void)state;
    static const struct {
        const char *text, *id, *path;
    } cases[] = {
        {"{\"width\": 65536}", "out-of-range", "$.width"},
        {"{\"width\": 0}", "out-of-range", "$.width"},
        {"{\"spp\": 0}", "out-of-range", "$.spp"},
        {"{\"spp\": 1e30}", "out-of-range", "$.spp"},
        {"{\"spp\": \"3\"}", "wrong-type", "$.spp"},
        {"{\"seed\": \"18446744073709551616\"}", "out-of-range", "$.seed"},
        {"{\"crop\": [0, 0, 601, 1]}", "out-of-range", "$.crop"},
        {"{\"crop\": [0.5, 0, 1, 1]}", "out-of-range", "$.crop"},
        {"{\"crop\": [600, 0, 1, 1]}", "out-of-range", "$.crop"},
        {"{\"filter_radius\": 0}", "out-of-range", "$.filter_radius"},
        {"{\"aov\": \"depth,dpth\"}", "out-of-range", "$.aov"},
        {"{\"aov\": 3}", "wrong-type", "$.aov"},
        {"{\"tags\": \"big,big\"}", "out-of-range", "$.tags"},
        {"{\"tags\": \"big, small\"}", "out-of-range", "$.tags"},
        {"{\"tags\": [\"big\"]}", "wrong-type", "$.tags"},
        {"{\"tile\": 5000, \"width\": 5000, \"height\": 5000}", "out-of-range", "$.tile"},
        {"{\"integrator\": \"bdpt\"}", "unknown-name", "$.integrator"},
        {"{\"with\": 3}", "unknown-key", "$.with"},
        {"{\"spp\": 1, \"spp\": 1}", "duplicate-key", "$.spp"},
        {"[]", "wrong-type", "$"},
        {"{} {}", "json-syntax", ""},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct job_spec s = {.width = 12345};
        struct diag_list problems;
        enum err e = read_spec(cases[i].text, &s, &problems);
        if (e != ERR_INPUT || !problem_find(&problems, cases[i].id, cases[i].path))
            fail_msg("%s: not refused as %s at %s", cases[i].text, cases[i].id, cases[i].path);
        assert_int_equal(s.width, 12345);
        diag_release(&problems);
    }
}

/* Every sample is in exactly one block, halves differ by at most one, none is empty. */
static void blocks_cover_each_sample_once(void **state)
{
    (void)state;
    static const uint64_t large[] = {
        4095, 4096, 4097, 8191, 1000003, UINT64_C(1) << 33, JOB_SPP_MAX - 1, JOB_SPP_MAX};
    for (uint64_t i = 1; i <= 600 + sizeof large / sizeof *large; i++) {
        uint64_t spp = i <= 600 ? i : large[i - 601];
        struct job_blocks b = job_blocks_of(spp);
        uint64_t next[2] = {0, 0};
        assert_true(b.count <= JOB_BLOCKS_MAX);
        assert_true(spp == 1 ? b.count == 1 : b.count >= 2 && b.count % 2 == 0);
        for (uint32_t k = 0; k < b.count; k++) {
            struct job_block block = job_block_at(&b, k);
            assert_int_equal(block.half, k & 1);
            assert_true(block.begin == next[block.half]);
            assert_true(block.count >= 1);
            assert_true(spp > 4096 || block.count <= JOB_BLOCK_SAMPLES);
            next[block.half] += block.count;
        }
        assert_true(next[0] == spp - spp / 2 && next[1] == spp / 2);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(defaults_are_valid),
        cmocka_unit_test(every_field_round_trips),
        cmocka_unit_test(crop_defaults_to_the_picture),
        cmocka_unit_test(hostile_specs_are_refused),
        cmocka_unit_test(blocks_cover_each_sample_once),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
