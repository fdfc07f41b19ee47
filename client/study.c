#include "client/study.h"

#include <math.h>
#include <string.h>

#include "common/mem.h"

#define STUDY_KNOB_WORD(name, word, text) word,
#define STUDY_KNOB_TEXT(name, word, text) text,
const char *const study_knob_words[KNOB_COUNT] = {STUDY_KNOBS(STUDY_KNOB_WORD)};
const char *const study_knob_texts[KNOB_COUNT] = {STUDY_KNOBS(STUDY_KNOB_TEXT)};
const char *const study_level_names[STUDY_LEVELS] = {"draft", "standard", "final"};

/* A relMSE of 0.01 is noise of a tenth of a pixel's light: seen when looked for. */
const double study_level_targets[STUDY_LEVELS] = {0.1, 0.01, 0.001};

bool study_point_measured(const struct study_point *p)
{
    return p->repeats >= 2;
}

struct stats_interval study_gain(const struct study *s, const struct study_point *p)
{
    const struct study_point *base = &s->points[s->base];
    uint32_t count = p->repeats < base->repeats ? p->repeats : base->repeats;
    return stats_gain((struct stats_work){base->core_s, base->relmse},
                      (struct stats_work){p->core_s, p->relmse}, count);
}

/* What is less than this share of the time spent drowns in what the set-up varies by. */
#define CORE_SHARE_LEAST 0.02

static void take_setups_out(struct study *s)
{
    for (int i = 0; i < JOB_BUILDER_NONE; i++)
        s->setups[i].median_s = s->own_farm && s->setups[i].count
                                    ? stats_median(s->setups[i].core_s, s->setups[i].count)
                                    : 0;
    for (uint32_t i = 0; i < s->point_count; i++) {
        struct study_point *p = &s->points[i];
        for (uint32_t k = 0; k < p->repeats; k++)
            p->core_s[k] = fmax(p->spent_core_s[k] - s->setups[p->tree].median_s,
                                CORE_SHARE_LEAST * p->spent_core_s[k]);
    }
}

void study_evaluate(struct study *s)
{
    double costs[STUDY_POINTS_MAX], errors[STUDY_POINTS_MAX];
    bool front[STUDY_POINTS_MAX];
    const struct study_point *base = &s->points[s->base];
    take_setups_out(s);
    for (uint32_t i = 0; i < s->point_count; i++) {
        struct study_point *p = &s->points[i];
        p->cost = stats_cost(p->core_s, p->repeats);
        p->error = stats_mean(p->relmse, p->repeats);
        study_sums_parts(&p->sums, &s->truth, &p->parts);
        p->same_bits = p->repeats > 0 && i != s->base && !p->half && base->repeats > 0 &&
                       strcmp(p->sha256, base->sha256) == 0;
        costs[i] = study_point_measured(p) ? p->cost.value : (double)NAN;
        errors[i] = p->error.value;
    }
    stats_front(costs, errors, s->point_count, front);
    for (uint32_t i = 0; i < s->point_count; i++)
        s->points[i].front = front[i];
}

void study_release(struct study *s)
{
    for (uint32_t i = 0; i < s->point_count; i++) {
        mem_free(s->points[i].picture);
        study_sums_release(&s->points[i].sums);
    }
    study_truth_release(&s->truth);
    *s = (struct study){0};
}
