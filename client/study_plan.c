#include "client/study_plan.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

enum {
    BASE_SPP = 16,
    BASE_SPP_SMALL = 4,
    LADDER = 5,
    ADAPTIVE_SPP = 16 /* the most a pixel gets, in samples of the base */
};

/* Work of the points beside the ladder, before they are known: enough for a first guess. */
#define OTHER_POINTS 24.0
/* 1/16 + 1/4 + 1 + 4 + 16 */
#define LADDER_WORK 21.3
/* Base renders kept for rendering the recommendations. */
#define PRESET_WORK 24.0
/* The base costs so many set-ups, even when the plan grows by as much. */
#define SETUP_FACTOR 2.0
#define BOLD_FACTOR  2.5
/* Of the time, for what the pilot did not foresee. */
#define TIME_SHARE    0.85
#define SAMPLES_SHARE 0.4

static uint32_t at_least_1(double v)
{
    return v < 1 ? 1 : (uint32_t)v;
}

/* The scene's shape with about that many pixels, in steps of 8 where there is room. */
static void choose_size(struct study *s, double pixels)
{
    double aspect = (double)s->scene_width / s->scene_height;
    double width = sqrt(pixels * aspect), height = sqrt(pixels / aspect);
    if (pixels >= (double)s->scene_width * s->scene_height) {
        s->width = s->scene_width;
        s->height = s->scene_height;
        return;
    }
    s->width = at_least_1(width >= 16 ? floor(width / 8) * 8 : width);
    s->height = at_least_1(height >= 16 ? floor(height / 8) * 8 : height);
    s->reduced = true;
}

/* The power of two next below. */
static uint64_t power_below(double v)
{
    uint64_t n = 1;
    while ((double)(2 * n) <= v)
        n *= 2;
    return n;
}

void study_plan_size(struct study *s, const struct job_spec *spec, bool fixed,
                     const struct study_pilot *pilot, double seconds)
{
    double repeats = STUDY_REPEATS_AIM, jobs = repeats * (OTHER_POINTS + LADDER);
    double work =
        repeats * (LADDER_WORK + OTHER_POINTS - 1) + 2 * STUDY_REFERENCE_FACTOR + PRESET_WORK;
    /* Where jobs cost more than that besides their samples, there are fewer repeats in place. */
    double usable = TIME_SHARE * fmax(seconds - jobs * pilot->overhead_s, SAMPLES_SHARE * seconds);
    double samples = usable / work * pilot->samples_s; /* of one base render */
    /* Costs beside a large set-up are hard to see: rather fewer repeats than that. */
    samples = fmax(samples, fmin(SETUP_FACTOR * pilot->setup_samples, BOLD_FACTOR * samples));
    s->reduced = false;
    s->scene_width = spec->crop.width;
    s->scene_height = spec->crop.height;
    double scene_pixels = (double)s->scene_width * s->scene_height;
    double most = fmin(STUDY_PIXELS_MAX, scene_pixels), pixels = samples / BASE_SPP;
    if (fixed) {
        pixels = scene_pixels;
    } else if (pixels < STUDY_PIXELS_MIN) {
        pixels = fmax(samples / BASE_SPP_SMALL, STUDY_PIXELS_MIN);
    }
    choose_size(s, fixed ? pixels : fmin(pixels, most));
    double spp = samples / ((double)s->width * s->height);
    s->base_spp = power_below(fmin(fmax(spp, 2), STUDY_BASE_SPP_MAX));
    if (!fixed && s->base_spp > BASE_SPP && pixels < most)
        s->base_spp = BASE_SPP;
    s->reference_spp = s->base_spp * STUDY_REFERENCE_FACTOR;
    s->reference_depth = spec->max_depth > STUDY_DEPTH_FLOOR ? spec->max_depth : STUDY_DEPTH_FLOOR;
}

/* --- Points --------------------------------------------------------------- */

void study_point_set(struct study_point *p, enum cli_option_id option, const char *text)
{
    TL_ASSERT(p->setting_count < STUDY_SETTINGS_MAX);
    struct study_setting *s = &p->settings[p->setting_count++];
    s->option = option;
    (void)snprintf(s->text, sizeof s->text, "%s", text);
}

/* A point of the base's samples with one option turned. */
static struct study_point *add(struct study *s, enum study_knob knob, enum cli_option_id option,
                               const char *text)
{
    char spp[STUDY_TEXT_BYTES];
    TL_ASSERT(s->point_count < STUDY_POINTS_MAX);
    struct study_point *p = &s->points[s->point_count++];
    *p = (struct study_point){.knob = knob, .spp = s->base_spp, .work = 1};
    (void)snprintf(p->label, sizeof p->label, "%s", text);
    if (option != CLI_SPP) {
        (void)snprintf(spp, sizeof spp, "%" PRIu64, s->base_spp);
        study_point_set(p, CLI_SPP, spp);
    }
    study_point_set(p, option, text);
    return p;
}

static void add_ladder(struct study *s)
{
    for (int i = 0; i < LADDER; i++) {
        char text[STUDY_TEXT_BYTES];
        double factor = pow(4, i - LADDER / 2);
        double spp = (double)s->base_spp * factor;
        if (spp < 1)
            continue;
        (void)snprintf(text, sizeof text, "%.0f", spp);
        struct study_point *p = add(s, KNOB_SPP, CLI_SPP, text);
        p->spp = (uint64_t)spp;
        p->work = factor;
        p->own = i == LADDER / 2;
        if (p->own)
            s->base = s->point_count - 1;
    }
}

static void add_depths(struct study *s, const struct job_spec *spec)
{
    static const uint32_t depths[] = {1, 2, 3, 4, 6, 8, 16, 32};
    for (size_t i = 0; i < sizeof depths / sizeof *depths; i++) {
        char text[STUDY_TEXT_BYTES];
        if (depths[i] == spec->max_depth)
            continue;
        (void)snprintf(text, sizeof text, "%" PRIu32, depths[i]);
        add(s, KNOB_DEPTH, CLI_MAX_DEPTH, text);
    }
}

static void add_choices(struct study *s, enum study_knob knob, enum cli_option_id option,
                        const char *const *names, int count, int own)
{
    for (int i = 0; i < count; i++)
        if (i != own)
            add(s, knob, option, names[i]);
}

static void add_roulettes(struct study *s, const struct job_spec *spec)
{
    static const double thresholds[] = {0, 0.1, 0.5, 1};
    for (size_t i = 0; i < sizeof thresholds / sizeof *thresholds; i++) {
        char text[STUDY_TEXT_BYTES];
        if (fabs(thresholds[i] - spec->rr_threshold) < 1e-6)
            continue;
        (void)snprintf(text, sizeof text, "%g", thresholds[i]);
        add(s, KNOB_ROULETTE, CLI_RR_THRESHOLD, text);
    }
}

/* The base's error, and a quarter of it, asked for as errors. The texts are filled in when the base
 * has been measured. */
static void add_adaptive(struct study *s)
{
    static const char *const labels[] = {"as base", "base / 4"};
    for (int i = 0; i < 2; i++) {
        char most[STUDY_TEXT_BYTES];
        struct study_point *p = &s->points[s->point_count++];
        *p = (struct study_point){.knob = KNOB_ADAPTIVE, .work = i ? 4 : 1};
        (void)snprintf(p->label, sizeof p->label, "%s", labels[i]);
        study_point_set(p, CLI_TARGET_ERROR, "");
        p->spp = s->base_spp * ADAPTIVE_SPP * (i ? 4 : 1);
        (void)snprintf(most, sizeof most, "%" PRIu64, p->spp);
        study_point_set(p, CLI_MAX_SPP, most);
    }
}

static void add_tiles(struct study *s, const struct job_spec *spec)
{
    static const uint32_t sides[] = {8, 64};
    for (size_t i = 0; i < sizeof sides / sizeof *sides; i++) {
        char text[STUDY_TEXT_BYTES];
        (void)snprintf(text, sizeof text, "%" PRIu32, sides[i]);
        if (sides[i] != spec->tile)
            add(s, KNOB_TILE, CLI_TILE, text);
    }
}

void study_plan_points(struct study *s, const struct job_spec *spec)
{
    bool path = spec->integrator == JOB_INTEGRATOR_PATH;
    add_ladder(s);
    add_depths(s, spec);
    if (path) {
        add_choices(s, KNOB_PROFILE, CLI_PROFILE, job_profile_names, JOB_PROFILE_COUNT,
                    (int)spec->profile);
        if (s->lights > 1 && spec->profile != JOB_PROFILE_RW)
            add_choices(s, KNOB_LIGHTS, CLI_LIGHT_CHOICE, job_light_choice_names,
                        JOB_LIGHT_CHOICE_COUNT, (int)spec->light_choice);
        add_roulettes(s, spec);
    }
    add_choices(s, KNOB_SAMPLER, CLI_SAMPLER, job_sampler_names, JOB_SAMPLER_COUNT,
                (int)spec->sampler);
    add_adaptive(s);
    add_choices(s, KNOB_PRECISION, CLI_PRECISION, job_precision_names, JOB_PRECISION_COUNT,
                (int)spec->precision);
    add_choices(s, KNOB_INTERSECTOR, CLI_INTERSECTOR, job_intersector_names, JOB_INTERSECTOR_COUNT,
                (int)spec->intersector);
    uint32_t before = s->point_count;
    /* No tree at all is for tests: it would eat the budget. */
    add_choices(s, KNOB_BUILDER, CLI_BUILDER, job_builder_names, JOB_BUILDER_NONE,
                (int)spec->builder);
    for (uint32_t i = before; i < s->point_count; i++)
        s->points[i].tree = (enum job_builder)job_choice_find(job_builder_names, JOB_BUILDER_NONE,
                                                              s->points[i].label);
    add_tiles(s, spec);
    struct study_point *half = add(s, KNOB_OUTPUT, CLI_SPP, "half");
    half->setting_count = 0;
    half->half = true;
    half->work = 0;
}

double study_plan_work(const struct study *s)
{
    double work = 0;
    for (uint32_t i = 0; i < s->point_count; i++)
        work += s->points[i].work;
    return work;
}
