/* client/study_run.h: plans a study, renders it within its budget, and evaluates it.
 *
 * Order: a pilot (how fast, what a job costs besides samples), two references, then all points in
 * rounds: each round is one repeat of each point with the same seed for all, so that what a busy
 * machine does to one it does to all. Three quarters of the time later the recommendations are
 * made and rendered; what is left goes into more rounds. One thread.
 */
#ifndef CLIENT_STUDY_RUN_H
#define CLIENT_STUDY_RUN_H

#include "client/study_farm.h"

/* Whatever the status, `s` holds what was measured; study_has_results says whether that is of any
 * use. EXIT_INTERRUPTED after Ctrl-C. */
TL_NODISCARD int study_run(struct study *s, struct study_farm *f, double budget_s);

/* References and at least two repeats of the base are there. */
bool study_has_results(const struct study *s);

#endif
