/* What a study concludes, against numbers that are known: quantiles from tables, pictures made with
 * a known bias and variance, and measurements whose best settings are plain. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#include "client/canvas.h"
#include "client/study_plan.h"
#include "client/study_plot.h"
#include "client/study_recommend.h"
#include "client/study_write.h"
#include "common/mem.h"

enum { SIDE = 48, VALUES = 3 * SIDE * SIDE };

static void near(double value, double expected, double tolerance)
{
    if (!(fabs(value - expected) <= tolerance))
        fail_msg("%.12g is not %.12g", value, expected);
}

/* splitmix64; normals as sums of twelve uniforms, whose variance is exactly 1. */
static uint64_t state_of_random = 1;

static double uniform(void)
{
    uint64_t z = (state_of_random += UINT64_C(0x9e3779b97f4a7c15));
    z = (z ^ z >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
    z = (z ^ z >> 27) * UINT64_C(0x94d049bb133111eb);
    return (double)((z ^ z >> 31) >> 11) * 0x1p-53;
}

static double normal(void)
{
    double sum = -6;
    for (int i = 0; i < 12; i++)
        sum += uniform();
    return sum;
}

static void test_quantiles(void **state)
{
    (void)state;
    near(stats_t95(2), 12.7062, 1e-4);
    near(stats_t95(5), 2.7764, 1e-4);
    near(stats_t95(12), 2.2010, 0.0022);
    near(stats_t95(16), 2.1314, 0.002);
    near(stats_t95(31), 2.0423, 0.001);
}

/* The interval holds the true mean in 95 % of 4,000 draws, within three standard errors. */
static void test_coverage(void **state)
{
    int inside = 0, draws = 4000;
    (void)state;
    for (int i = 0; i < draws; i++) {
        double v[6];
        for (int k = 0; k < 6; k++)
            v[k] = 10 + normal();
        struct stats_interval m = stats_mean(v, 6);
        inside += m.low <= 10 && m.high >= 10;
    }
    near((double)inside / draws, 0.95, 0.0105);
}

static void test_means(void **state)
{
    double v[] = {3, 1, 2, 9};
    (void)state;
    near(stats_median(v, 4), 2.5, 0);
    near(stats_median(v, 3), 2, 0);
    assert_true(isnan(stats_mean(v, 1).low));
    near(stats_mean(v, 1).value, 3, 0);
    assert_true(isnan(stats_mean(v, 0).value));
    double negative[] = {-1, -2};
    assert_true(isnan(stats_mean(negative, 2).low));
}

/* Half the cost at the same errors: a gain of exactly 2, whatever each repeat was like. */
static void test_gain(void **state)
{
    double base_cost[] = {1, 2, 3}, cost[] = {0.5, 1, 1.5}, error[] = {0.1, 0.7, 0.2};
    (void)state;
    struct stats_work base = {base_cost, error}, ours = {cost, error};
    struct stats_interval gain = stats_gain(base, ours, 3);
    near(gain.value, 2, 1e-12);
    near(gain.low, 2, 1e-6);
    error[1] = -0.1; /* an error that noise made negative: nothing can be said of both */
    double other[] = {0.1, 0.7, 0.2};
    ours.error = other;
    assert_true(isnan(stats_gain(base, ours, 3).value));
}

static void test_front(void **state)
{
    double cost[] = {1, 2, 2, 4, 8, 3}, error[] = {9, 5, 4, 4, 1, (double)NAN};
    bool front[6], expected[] = {true, false, true, false, true, false};
    (void)state;
    stats_front(cost, error, 6, front);
    for (int i = 0; i < 6; i++)
        assert_true(front[i] == expected[i]);
}

static void test_law(void **state)
{
    double n[] = {1, 4, 16, 64}, error[4];
    struct stats_law law;
    (void)state;
    for (int i = 0; i < 4; i++)
        error[i] = 0.3 * pow(n[i], -1.25);
    error[2] = (double)NAN;
    assert_true(stats_law_fit(n, error, 4, &law));
    near(law.a, 0.3, 1e-12);
    near(law.p, 1.25, 1e-12);
    near(stats_law_solve(&law, stats_law_at(&law, 37)), 37, 1e-9);
    assert_true(stats_law_fit(n, error, 1, &law));
    near(law.p, 1, 0);
    assert_false(stats_law_fit(n + 2, error + 2, 1, &law));
}

/* --- Bias and variance ------------------------------------------------------ */

static float *picture(double value, double sigma)
{
    float *rgb = mem_alloc_array(VALUES, sizeof *rgb);
    assert_non_null(rgb);
    for (int i = 0; i < VALUES; i++)
        rgb[i] = (float)(value + sigma * normal());
    return rgb;
}

static void make_truth(struct study_truth *t, double sigma)
{
    float *a = picture(1, sigma), *b = picture(1, sigma);
    assert_int_equal(study_truth_init(t, SIDE, SIDE, a, b), ERR_OK);
}

/* Pictures 0.05 too bright with noise of 0.2, references with noise of 0.03: everything is found,
 * and the references' own noise is in none of it. */
static void test_parts(void **state)
{
    struct study_truth truth;
    struct study_sums sums = {0};
    struct study_parts parts;
    double mean = 0, scale = 1 / 1.01; /* r^2 + 0.01 m^2 for r = m = 1 */
    (void)state;
    make_truth(&truth, 0.03);
    near(truth.relmse, scale * 0.03 * 0.03 / 2, 2e-5);
    for (int k = 0; k < 6; k++) {
        double one;
        float *rgb = picture(1.05, 0.2);
        assert_int_equal(study_sums_add(&sums, &truth, rgb, &one), ERR_OK);
        mean += one / 6;
        mem_free(rgb);
    }
    study_sums_parts(&sums, &truth, &parts);
    near(parts.variance, scale * 0.04, 0.0015);
    near(parts.bias2, scale * 0.0025, 0.0005);
    near(mean, scale * 0.0425, 0.0017);
    assert_true(parts.bias2 > 4 * parts.bias2_se);
    study_sums_release(&sums);
    study_truth_release(&truth);
}

/* Without a bias none is found: over 60 studies bias^2 is 0 on average, and over two standard
 * errors about as often as a normal variable is. */
static void test_no_bias(void **state)
{
    int over = 0;
    double sum = 0, squares = 0;
    (void)state;
    for (int study = 0; study < 60; study++) {
        struct study_truth truth;
        struct study_sums sums = {0};
        struct study_parts parts;
        make_truth(&truth, 0.05);
        for (int k = 0; k < 3; k++) {
            double one;
            float *rgb = picture(1, 0.3);
            assert_int_equal(study_sums_add(&sums, &truth, rgb, &one), ERR_OK);
            mem_free(rgb);
        }
        study_sums_parts(&sums, &truth, &parts);
        over += parts.bias2 > 2 * parts.bias2_se;
        sum += parts.bias2;
        squares += parts.bias2 * parts.bias2;
        study_sums_release(&sums);
        study_truth_release(&truth);
    }
    near(sum / 60, 0, 3 * sqrt(squares) / 60);
    assert_true(over <= 6);
}

static void test_nonfinite(void **state)
{
    struct study_truth truth;
    struct study_sums sums = {0};
    double one;
    (void)state;
    make_truth(&truth, 0);
    float *rgb = picture(1, 0);
    rgb[7] = NAN;
    rgb[9] = INFINITY;
    assert_int_equal(study_sums_add(&sums, &truth, rgb, &one), ERR_OK);
    assert_int_equal(sums.nonfinite, 2);
    near(one, 0, 0);
    mem_free(rgb);
    study_sums_release(&sums);
    study_truth_release(&truth);
}

/* --- Plan ------------------------------------------------------------------- */

static struct study study; /* large for a stack */

/* A scene of `lights` lights. */
static void plan_lit(uint64_t lights, uint32_t width, uint32_t height, bool fixed, double samples_s,
                     double seconds)
{
    struct job_spec spec;
    struct study_pilot pilot = {.samples_s = samples_s, .overhead_s = 0.02};
    job_spec_init(&spec);
    spec.width = spec.crop.width = width;
    spec.height = spec.crop.height = height;
    study = (struct study){.lights = lights};
    study_plan_size(&study, &spec, fixed, &pilot, seconds);
    study_plan_points(&study, &spec);
}

static void plan(uint32_t width, uint32_t height, bool fixed, double samples_s, double seconds)
{
    plan_lit(20, width, height, fixed, samples_s, seconds);
}

static void test_plan_size(void **state)
{
    (void)state;
    plan(1920, 1080, false, 1e6, 60);
    assert_true(study.reduced && study.width * study.height <= STUDY_PIXELS_MAX);
    near((double)study.width / study.height, 16 / 9.0, 0.15);
    plan(1920, 1080, false, 1e5, 1); /* hardly any time: small, few samples, but a plan */
    assert_true(study.width * study.height <= 2 * STUDY_PIXELS_MIN && study.base_spp >= 1);
    plan(32, 20, false, 1e8, 60); /* never larger than the scene; more samples in place */
    assert_true(study.width == 32 && study.height == 20 && !study.reduced);
    assert_true(study.base_spp > 16 && (study.base_spp & (study.base_spp - 1)) == 0);
    plan(300, 200, true, 1e5, 1);
    assert_true(study.width == 300 && study.height == 200 && !study.reduced);
}

static void test_plan_points(void **state)
{
    bool seen[KNOB_COUNT] = {false};
    (void)state;
    plan(600, 600, false, 1e6, 60);
    const struct study_point *base = &study.points[study.base];
    assert_true(base->own && base->knob == KNOB_SPP && base->spp == study.base_spp);
    for (uint32_t i = 0; i < study.point_count; i++) {
        const struct study_point *p = &study.points[i];
        struct diag_list problems;
        seen[p->knob] = true;
        assert_true(p->own == (i == study.base));
        diag_init(&problems);
        for (uint32_t k = 0; k < p->setting_count; k++)
            if (p->settings[k].text[0]) /* errors to aim at come later */
                assert_true(cli_value_check(p->settings[k].option, p->settings[k].text, &problems));
        diag_release(&problems);
    }
    for (int knob = 0; knob < KNOB_COUNT; knob++)
        if (knob != KNOB_PRESET)
            assert_true(seen[knob]);
}

/* How lights are chosen is tried where there is a choice. */
static void test_plan_lights(void **state)
{
    (void)state;
    for (uint64_t lights = 0; lights < 3; lights++) {
        uint32_t points = 0;
        plan_lit(lights, 600, 600, false, 1e6, 60);
        for (uint32_t i = 0; i < study.point_count; i++)
            points += study.points[i].knob == KNOB_LIGHTS;
        assert_int_equal(points, lights > 1 ? JOB_LIGHT_CHOICE_COUNT - 1 : 0);
    }
}

/* --- Recommendations -------------------------------------------------------- */

/* Four repeats: variance v, bias^2 and cost as given, all a little different. */
static void measure(struct study_point *p, double cost, double variance, double bias2)
{
    static const double wobble[] = {0.98, 1.01, 1.02, 0.99};
    for (p->repeats = 0; p->repeats < 4; p->repeats++) {
        p->core_s[p->repeats] = cost * wobble[p->repeats];
        p->relmse[p->repeats] = (variance + bias2) * wobble[3 - p->repeats];
    }
    p->cost = stats_cost(p->core_s, 4);
    p->error = stats_mean(p->relmse, 4);
    p->parts = (struct study_parts){variance, bias2, 0.0002};
}

static struct study_point *point_of(enum study_knob knob, const char *label)
{
    for (uint32_t i = 0; i < study.point_count; i++)
        if (study.points[i].knob == knob && strcmp(study.points[i].label, label) == 0)
            return &study.points[i];
    fail_msg("no point %s %s", study_knob_words[knob], label);
    return NULL;
}

/* Base: 16 spp, 1 s, relMSE 0.02; noise falls as 1/n. */
static void measure_all(void)
{
    plan(600, 600, false, 1e6, 60);
    study.base_spp = 16;
    for (uint32_t i = 0; i < study.point_count; i++) {
        struct study_point *p = &study.points[i];
        if (p->knob == KNOB_SPP) {
            p->spp = 16 * p->spp / study.points[study.base].spp;
            p->spp = p->spp ? p->spp : 1;
            measure(p, (double)p->spp / 16, 0.32 / (double)p->spp, 0);
        } else {
            measure(p, 1, 0.02, 0);
        }
    }
}

static const char *setting_of(const struct study_preset *p, enum cli_option_id id)
{
    for (uint32_t i = 0; i < p->setting_count; i++)
        if (p->settings[i].option == id)
            return p->settings[i].text;
    return NULL;
}

static void test_recommend_nothing(void **state)
{
    (void)state;
    measure_all();
    assert_true(study_recommend(&study));
    for (int i = 0; i < STUDY_LEVELS; i++)
        assert_int_equal(study.presets[i].setting_count, 1);
    assert_int_equal(study.presets[STUDY_DRAFT].spp, 4);
    assert_int_equal(study.presets[STUDY_STANDARD].spp, 32);
    assert_int_equal(study.presets[STUDY_FINAL].spp, 320);
    near(study.presets[STUDY_STANDARD].expected_core_s, 2, 0.05);
    assert_true(study.presets[STUDY_DRAFT].half && !study.presets[STUDY_FINAL].half);
}

/* A sampler of half the variance is taken at every level; a depth that saves half the work but has
 * a bias of 0.005 only where that is little; an intersector never, however fast. */
static void test_recommend_knobs(void **state)
{
    (void)state;
    measure_all();
    measure(point_of(KNOB_SAMPLER, "halton"), 1, 0.01, 0);
    measure(point_of(KNOB_DEPTH, "4"), 0.5, 0.02, 0.005);
    measure(point_of(KNOB_INTERSECTOR, "moller-trumbore"), 0.1, 0.02, 0);
    assert_true(study_recommend(&study));
    for (int i = 0; i < STUDY_LEVELS; i++) {
        assert_string_equal(setting_of(&study.presets[i], CLI_SAMPLER), "halton");
        assert_null(setting_of(&study.presets[i], CLI_INTERSECTOR));
    }
    assert_string_equal(setting_of(&study.presets[STUDY_DRAFT], CLI_MAX_DEPTH), "4");
    assert_null(setting_of(&study.presets[STUDY_STANDARD], CLI_MAX_DEPTH));
    assert_int_equal(study.presets[STUDY_STANDARD].spp, 16);
    /* (0.1 - 0.005) of room for a variance of 0.16 / n */
    assert_int_equal(study.presets[STUDY_DRAFT].spp, 2);
}

/* A base that is itself too far from the truth is left for a depth that is not, though it costs
 * more. */
static void test_recommend_biased_base(void **state)
{
    (void)state;
    measure_all();
    measure(&study.points[study.base], 1, 0.02, 0.004);
    measure(point_of(KNOB_DEPTH, "32"), 1.5, 0.02, 0);
    for (uint32_t i = 0; i < study.point_count; i++)
        if (study.points[i].knob == KNOB_DEPTH && strcmp(study.points[i].label, "32") != 0)
            measure(&study.points[i], 1, 0.02, 0.004);
    assert_true(study_recommend(&study));
    assert_null(setting_of(&study.presets[STUDY_DRAFT], CLI_MAX_DEPTH));
    assert_string_equal(setting_of(&study.presets[STUDY_FINAL], CLI_MAX_DEPTH), "32");
}

/* What a render of the preset found replaces what was expected, and corrects it. */
static void test_recommend_correct(void **state)
{
    (void)state;
    measure_all();
    assert_true(study_recommend(&study));
    study_preset_point(&study, STUDY_STANDARD);
    assert_int_equal(study.points[study.presets[STUDY_STANDARD].point].spp, 32);
    measure(&study.points[study.presets[STUDY_STANDARD].point], 2, 0.015, 0);
    study_recommend_correct(&study);
    assert_int_equal(study.presets[STUDY_STANDARD].spp, 48);
    assert_int_equal(study.presets[STUDY_STANDARD].rendered_spp, 32);
    assert_string_equal(setting_of(&study.presets[STUDY_STANDARD], CLI_SPP), "48");
    near(study.presets[STUDY_STANDARD].expected_core_s, 3, 0.1);
    assert_int_equal(study.presets[STUDY_DRAFT].rendered_spp, 0);
}

/* --- Drawing ---------------------------------------------------------------- */

static void put(struct canvas *c)
{
    struct canvas_line line = {2.5, 10.5, 17.5, 10.5, 1, INK_TEXT, false};
    struct canvas_mark mark = {.x = 10,
                               .y = 25,
                               .radius = 4,
                               .shape = SHAPE_SQUARE,
                               .ink = INK_SERIES,
                               .tooltip = "a <b> & \"c\""};
    struct canvas_words words = {.x = 2, .y = 38, .size = 9, .ink = INK_TEXT, .text = "a<b"};
    canvas_line(c, &line);
    canvas_mark(c, &mark);
    canvas_words(c, &words);
}

static void test_canvas(void **state)
{
    struct canvas c;
    struct buf out;
    unsigned char ink[3];
    (void)state;
    assert_int_equal(canvas_init_raster(&c, 20, 40), ERR_OK);
    put(&c);
    canvas_color(INK_TEXT, ink);
    near((double)c.rgb[3 * (10 * 20 + 10)], ink[0], 0); /* the middle of the line */
    near((double)c.rgb[3 * (5 * 20 + 10)], 255, 0);
    canvas_color(INK_SERIES, ink);
    near((double)c.rgb[3 * (25 * 20 + 10) + 2], ink[2], 0);
    buf_init(&out);
    assert_int_equal(canvas_finish_png(&c, &out), ERR_OK);
    buf_clear(&out);
    canvas_init_svg(&c, 20, 40, &out);
    put(&c);
    assert_int_equal(canvas_finish_svg(&c), ERR_OK);
    buf_put_u8(&out, 0);
    assert_non_null(strstr((const char *)out.data, "a &lt;b&gt; &amp; &quot;c&quot;"));
    assert_null(strstr((const char *)out.data, "a<b"));
    buf_release(&out);
}

/* Every printable letter has strokes within its cell. */
static void test_font(void **state)
{
    (void)state;
    for (int letter = '!'; letter < 127; letter++) {
        const char *p = font_strokes((char)letter);
        assert_true(p[0] != '\0');
        for (; *p; p++) {
            if (*p == ' ')
                continue;
            assert_true(p[0] >= '0' && p[0] <= '4' && p[1] >= '0' && p[1] <= '8');
            p++;
        }
    }
}

/* A study of which nothing is known yet can be drawn and written too. */
static void test_empty_study(void **state)
{
    struct canvas c;
    struct buf out;
    (void)state;
    plan(600, 600, false, 1e6, 60);
    study.scene = "scene.json";
    study_evaluate(&study);
    assert_false(study_recommend(&study));
    buf_init(&out);
    canvas_init_svg(&c, STUDY_PLOT_WIDTH, STUDY_PLOT_HEIGHT, &out);
    study_plot(&study, &c);
    assert_int_equal(canvas_finish_svg(&c), ERR_OK);
    study_put_json(&study, &out);
    study_put_csv(&study, &out);
    buf_put_u8(&out, 0);
    assert_null(strstr((const char *)out.data, "nan"));
    buf_release(&out);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_quantiles),
        cmocka_unit_test(test_coverage),
        cmocka_unit_test(test_means),
        cmocka_unit_test(test_gain),
        cmocka_unit_test(test_front),
        cmocka_unit_test(test_law),
        cmocka_unit_test(test_parts),
        cmocka_unit_test(test_no_bias),
        cmocka_unit_test(test_nonfinite),
        cmocka_unit_test(test_plan_size),
        cmocka_unit_test(test_plan_points),
        cmocka_unit_test(test_plan_lights),
        cmocka_unit_test(test_recommend_nothing),
        cmocka_unit_test(test_recommend_knobs),
        cmocka_unit_test(test_recommend_biased_base),
        cmocka_unit_test(test_recommend_correct),
        cmocka_unit_test(test_canvas),
        cmocka_unit_test(test_font),
        cmocka_unit_test(test_empty_study),
    };
    return cmocka_run_group_tests_name("study", tests, NULL, NULL);
}
