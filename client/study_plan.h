/* client/study_plan.h: which points a study renders, and how large, so that the budget is kept.
 *
 * Pure; one thread. Test: test_study.
 */
#ifndef CLIENT_STUDY_PLAN_H
#define CLIENT_STUDY_PLAN_H

#include "client/study.h"
#include "common/job_spec.h"

enum {
    STUDY_PIXELS_MIN = 24 * 24,
    STUDY_PIXELS_MAX = 256 * 256,       /* when the study chooses */
    STUDY_PIXELS_ASKED_MAX = 512 * 512, /* when --size or --crop does: all pictures are in memory */
    STUDY_BASE_SPP_MAX = 4096,
    STUDY_REPEATS_AIM = 4,
    STUDY_REFERENCE_FACTOR = 32, /* samples of each of the two references, in those of the base */
    STUDY_DEPTH_FLOOR = 64,      /* references follow paths at least so far */
};

/* What a pilot found. */
struct study_pilot {
    double samples_s;  /* pixel samples per second of the wall */
    double overhead_s; /* seconds that a job takes besides them */
    double
        setup_samples; /* samples that cost as much as a job's set-up; 0: it is not in the cost */
};

/* Size of the pictures and samples of the base. `spec` is the scene's job after the options;
 * `fixed`: its crop is kept, since it was asked for. */
void study_plan_size(struct study *s, const struct job_spec *spec, bool fixed,
                     const struct study_pilot *pilot, double seconds);

/* The points of a spec, most telling first; needs base_spp and lights. Knobs that do nothing
 * under the integrator or with so few lights are left out. */
void study_plan_points(struct study *s, const struct job_spec *spec);

/* Base renders that one repeat of all points, without presets, is worth. */
double study_plan_work(const struct study *s);

/* Adds a setting to a point; asserted to fit. */
void study_point_set(struct study_point *p, enum cli_option_id option, const char *text);

#endif
