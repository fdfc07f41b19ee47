#include "client/study_recommend.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "client/study_plan.h"
#include "common/job_spec.h"

#define BIAS_SHARE   0.1   /* of the target that a bias may take */
#define GAIN_LEAST   1.03  /* less is not worth another setting */
#define HALF_SHARE   0.001 /* of the target that rounding to halves may take */
#define TARGET_SLACK 1.02  /* over the target that counts as reached */
#define SPP_MOST     1e9

/* True if it was shown that the point is too far from the truth for this target. */
static bool too_biased(const struct study_point *p, double target)
{
    return p->parts.bias2 > BIAS_SHARE * target && p->parts.bias2 > 2 * p->parts.bias2_se;
}

/* Two dozen settings are tried, so that one whose interval just clears 1 is likely among them by
 * chance: the gain must be so many half intervals over 1. */
#define SURELY 1.6

static bool surely_better(struct stats_interval gain)
{
    return gain.value > GAIN_LEAST && log(gain.value) > SURELY * log(gain.value / gain.low);
}

/* The best value of a knob for a target; NULL: the base's. */
static const struct study_point *best_of(const struct study *s, enum study_knob knob, double target)
{
    const struct study_point *best = NULL;
    bool base_fails = knob == KNOB_DEPTH && too_biased(&s->points[s->base], target);
    double best_gain = 0;
    for (uint32_t i = 0; i < s->point_count; i++) {
        const struct study_point *p = &s->points[i];
        if (p->knob != knob || !study_point_measured(p) || p->same_bits || too_biased(p, target))
            continue;
        struct stats_interval gain = study_gain(s, p);
        if (gain.value > best_gain && (base_fails || surely_better(gain))) {
            best = p;
            best_gain = gain.value;
        }
    }
    return best;
}

/* The same bits for less work: trees. */
static const struct study_point *best_tree(const struct study *s)
{
    for (uint32_t i = 0; i < s->point_count; i++) {
        const struct study_point *p = &s->points[i];
        if (p->knob == KNOB_BUILDER && study_point_measured(p) && surely_better(study_gain(s, p)))
            return p;
    }
    return NULL;
}

/* Ratios of a turned knob to the base. */
struct turned {
    double cost, variance, bias2;
};

static void turn(struct study_preset *out, const struct study *s, const struct study_point *p,
                 struct turned *t)
{
    const struct study_point *base = &s->points[s->base];
    const struct study_setting *setting = &p->settings[p->setting_count - 1];
    size_t used = strlen(out->why);
    TL_ASSERT(out->setting_count < STUDY_SETTINGS_MAX);
    out->settings[out->setting_count++] = *setting;
    t->cost *= p->cost.value / base->cost.value;
    if (base->parts.variance > 0 && p->parts.variance > 0)
        t->variance *= p->parts.variance / base->parts.variance;
    struct stats_interval gain = study_gain(s, p);
    (void)snprintf(out->why + used, sizeof out->why - used,
                   "%s%s %s gains %.2f (95 %%: %.2f to %.2f)", used ? "; " : "",
                   study_knob_words[p->knob], p->label, gain.value, gain.low, gain.high);
}

/* How variance falls with samples, from the ladder. */
static bool ladder_law(const struct study *s, struct stats_law *law)
{
    double n[STUDY_POINTS_MAX], variance[STUDY_POINTS_MAX];
    size_t count = 0;
    for (uint32_t i = 0; i < s->point_count; i++) {
        const struct study_point *p = &s->points[i];
        if (p->knob != KNOB_SPP || !study_point_measured(p))
            continue;
        n[count] = (double)p->spp;
        variance[count++] = p->parts.variance;
    }
    return stats_law_fit(n, variance, count, law);
}

/* Rounding to halves, measured on the base's own pictures. */
static bool half_is_free(const struct study *s, double target)
{
    const struct study_point *base = &s->points[s->base];
    for (uint32_t i = 0; i < s->point_count; i++) {
        const struct study_point *p = &s->points[i];
        if (p->half && p->repeats > 0 && p->clamped == 0)
            return fabs(p->error.value - base->error.value) < HALF_SHARE * target;
    }
    return false;
}

static void settle_samples(struct study *s, struct study_preset *out, const struct stats_law *law,
                           const struct turned *t)
{
    const struct study_point *base = &s->points[s->base];
    struct stats_law ours = {.a = law->a * t->variance, .p = law->p};
    double room = fmax(out->target - t->bias2, out->target / 2);
    double spp = fmin(fmax(ceil(stats_law_solve(&ours, room)), 1), SPP_MOST);
    double share = (double)s->scene_width * s->scene_height / ((double)s->width * s->height);
    out->spp = (uint64_t)spp;
    out->expected_relmse = stats_law_at(&ours, spp) + t->bias2;
    out->expected_core_s = base->cost.value / (double)s->base_spp * spp * t->cost;
    out->scene_core_s = out->expected_core_s * share;
    out->settings[0].option = CLI_SPP;
    (void)snprintf(out->settings[0].text, sizeof out->settings[0].text, "%" PRIu64, out->spp);
}

static void recommend_level(struct study *s, enum study_level level, const struct stats_law *law)
{
    static const enum study_knob knobs[] = {KNOB_DEPTH, KNOB_PROFILE, KNOB_ROULETTE, KNOB_SAMPLER,
                                            KNOB_PRECISION};
    struct study_preset *out = &s->presets[level];
    struct turned t = {1, 1, 0};
    const struct study_point *depth = &s->points[s->base];
    *out = (struct study_preset){
        .target = study_level_targets[level], .setting_count = 1, .point = -1};
    for (size_t i = 0; i < sizeof knobs / sizeof *knobs; i++) {
        const struct study_point *best = best_of(s, knobs[i], out->target);
        if (!best)
            continue;
        turn(out, s, best, &t);
        depth = knobs[i] == KNOB_DEPTH ? best : depth;
    }
    const struct study_point *tree = best_tree(s);
    if (tree)
        turn(out, s, tree, &t);
    if (!out->why[0])
        (void)snprintf(out->why, sizeof out->why,
                       "the scene's own settings; nothing tried was surely better");
    if (depth->parts.bias2 > 2 * depth->parts.bias2_se)
        t.bias2 = depth->parts.bias2;
    out->half = level != STUDY_FINAL && half_is_free(s, out->target);
    settle_samples(s, out, law, &t);
}

bool study_recommend(struct study *s)
{
    struct stats_law law;
    s->has_presets = study_point_measured(&s->points[s->base]) && ladder_law(s, &law);
    for (int i = 0; s->has_presets && i < STUDY_LEVELS; i++)
        recommend_level(s, (enum study_level)i, &law);
    return s->has_presets;
}

double study_preset_work(const struct study *s, const struct study_preset *p)
{
    return p->expected_core_s / s->points[s->base].cost.value;
}

void study_preset_point(struct study *s, enum study_level level)
{
    TL_ASSERT(s->point_count < STUDY_POINTS_MAX);
    struct study_preset *preset = &s->presets[level];
    struct study_point *p = &s->points[s->point_count];
    *p = (struct study_point){
        .knob = KNOB_PRESET, .spp = preset->spp, .work = study_preset_work(s, preset)};
    (void)snprintf(p->label, sizeof p->label, "%s", study_level_names[level]);
    for (uint32_t i = 0; i < preset->setting_count; i++) {
        study_point_set(p, preset->settings[i].option, preset->settings[i].text);
        if (preset->settings[i].option == CLI_BUILDER)
            p->tree = (enum job_builder)job_choice_find(job_builder_names, JOB_BUILDER_NONE,
                                                        preset->settings[i].text);
    }
    preset->point = (int32_t)s->point_count++;
}

void study_recommend_correct(struct study *s)
{
    double share = (double)s->scene_width * s->scene_height / ((double)s->width * s->height);
    for (int i = 0; i < STUDY_LEVELS && s->has_presets; i++) {
        struct study_preset *preset = &s->presets[i];
        if (preset->point < 0)
            continue;
        const struct study_point *p = &s->points[preset->point];
        if (!study_point_measured(p)) {
            preset->point = -1;
            continue;
        }
        double factor = 1;
        preset->rendered_spp = p->spp;
        if (p->error.value > TARGET_SLACK * preset->target && !too_biased(p, preset->target))
            factor = ceil((double)p->spp * p->error.value / preset->target) / (double)p->spp;
        preset->spp = (uint64_t)((double)p->spp * factor + 0.5);
        preset->expected_relmse = p->error.value / factor;
        preset->expected_core_s = p->cost.value * factor;
        preset->scene_core_s = preset->expected_core_s * share;
        (void)snprintf(preset->settings[0].text, sizeof preset->settings[0].text, "%" PRIu64,
                       preset->spp);
    }
}
