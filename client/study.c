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

void study_evaluate(struct study *s)
{
    double costs[STUDY_POINTS_MAX], errors[STUDY_POINTS_MAX];
    bool front[STUDY_POINTS_MAX];
    const struct study_point *base = &s->points[s->base];
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
