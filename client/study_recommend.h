/* client/study_recommend.h: from measurements to settings for a draft, a standard and a final
 * picture.
 *
 * Of each knob the value is taken whose cost x error is surely lower than the base's (more than 1.6
 * half 95 % intervals of the gain over 1, since many are tried) and whose bias^2 is not shown to be
 * over a tenth of the target; gains of several knobs are taken to multiply, and the samples follow
 * from the spp ladder's law. Whether that came true is measured: the recommendations are rendered
 * as points of their own where the budget lets them, and corrected once. What only exists for
 * comparing (intersectors, no tree) and what depends on the size of the picture (cells) is never
 * recommended.
 *
 * Pure; one thread. Test: test_study.
 */
#ifndef CLIENT_STUDY_RECOMMEND_H
#define CLIENT_STUDY_RECOMMEND_H

#include "client/study.h"

/* Fills s->presets from evaluated points. False: the base was not measured, there are none. */
bool study_recommend(struct study *s);

/* The cost of rendering one preset, in base renders. */
double study_preset_work(const struct study *s, const struct study_preset *p);

/* Adds a point that renders the preset. */
void study_preset_point(struct study *s, enum study_level level);

/* After those points were measured and evaluated: what they say replaces what was expected; where
 * the target was missed, the samples follow. */
void study_recommend_correct(struct study *s);

#endif
