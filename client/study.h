/* client/study.h: a study of one scene: what is rendered, what came out.
 *
 * `tilery tradeoff` plans points (study_plan.h), renders each several times (study_run.h), and
 * writes what it found (study_write.h, study_plot.h, study_page.h) with recommendations
 * (study_recommend.h). A point is the base, which is the scene's own settings at a sample count
 * that the budget can pay for, with one knob turned. All pictures have one size. One thread.
 */
#ifndef CLIENT_STUDY_H
#define CLIENT_STUDY_H

#include "client/cli_option.h"
#include "client/study_error.h"
#include "client/study_stats.h"

enum {
    STUDY_REPEATS_MAX = 16,
    STUDY_SETTINGS_MAX = 12,
    STUDY_POINTS_MAX = 64,
    STUDY_TEXT_BYTES = 24,
    STUDY_HASH_BYTES = 65,
};

/* X(name, word in tables, what it is) */
#define STUDY_KNOBS(X)                                                                             \
    X(SPP, "spp", "samples per pixel")                                                             \
    X(DEPTH, "max-depth", "longest path")                                                          \
    X(ROULETTE, "rr-threshold", "Russian roulette below this weight")                              \
    X(PROFILE, "profile", "how path finds lights")                                                 \
    X(LIGHTS, "light-choice", "which of many lights")                                              \
    X(SAMPLER, "sampler", "sequence of sample points")                                             \
    X(ADAPTIVE, "target-error", "samples where the error is")                                      \
    X(PRECISION, "precision", "what decides hits")                                                 \
    X(INTERSECTOR, "intersector", "triangle test")                                                 \
    X(BUILDER, "builder", "tree over the triangles")                                               \
    X(TILE, "tile", "side of a cell")                                                              \
    X(OUTPUT, "output", "floats of the file")                                                      \
    X(PRESET, "preset", "the recommended settings, rendered")

enum study_knob {
#define STUDY_KNOB(name, word, text) KNOB_##name,
    STUDY_KNOBS(STUDY_KNOB)
#undef STUDY_KNOB
        KNOB_COUNT
};
extern const char *const study_knob_words[KNOB_COUNT];
extern const char *const study_knob_texts[KNOB_COUNT];

/* A value for an option, as the command line would give it. */
struct study_setting {
    enum cli_option_id option;
    char text[STUDY_TEXT_BYTES];
};

struct study_point {
    enum study_knob knob;
    char label[STUDY_TEXT_BYTES]; /* the knob's value */
    struct study_setting settings[STUDY_SETTINGS_MAX];
    uint32_t setting_count;
    uint64_t spp;          /* most samples per pixel */
    double work;           /* expected cost in base renders */
    bool own;              /* the scene's own value of the knob: the base */
    bool given_up;         /* it took far longer than expected, and is not tried again */
    bool half;             /* the base's pictures, rounded to half floats; nothing is rendered */
    uint64_t clamped;      /* values that no half holds, of all repeats */
    enum job_builder tree; /* whose set-up it pays for */
    /* Measured: */
    uint32_t repeats;
    double spent_core_s[STUDY_REPEATS_MAX]; /* as measured */
    double core_s[STUDY_REPEATS_MAX];       /* set-up taken out, by study_evaluate */
    double wall_s[STUDY_REPEATS_MAX], relmse[STUDY_REPEATS_MAX];
    double spp_mean;               /* of the last repeat */
    uint64_t rays, file_bytes;     /* the same */
    char sha256[STUDY_HASH_BYTES]; /* of the first repeat's pixels */
    float *picture;                /* owned: the first repeat's */
    struct study_sums sums;
    /* Worked out by study_evaluate: */
    struct stats_interval cost, error;
    struct study_parts parts;
    bool front;     /* no other point is both cheaper and better */
    bool same_bits; /* the first picture has the base's bits */
};

/* A recommendation. */
enum study_level { STUDY_DRAFT, STUDY_STANDARD, STUDY_FINAL, STUDY_LEVELS };
extern const char *const study_level_names[STUDY_LEVELS];
extern const double study_level_targets[STUDY_LEVELS]; /* relMSE */

struct study_preset {
    struct study_setting settings[STUDY_SETTINGS_MAX]; /* spp first */
    uint32_t setting_count;
    uint64_t spp;
    double target, expected_relmse, expected_core_s; /* at the study's size */
    double scene_core_s;                             /* at the scene's own size */
    uint64_t rendered_spp; /* samples with which it was rendered; 0: it was not */
    bool half;
    int32_t point; /* the point that rendered it; -1: only predicted */
    char why[400]; /* what was turned and what that gains; text for people */
};

struct study {
    const char *scene;                  /* the file's name; borrowed */
    uint32_t width, height;             /* of the pictures */
    uint32_t scene_width, scene_height; /* that a render without options would have */
    bool reduced;                       /* smaller than that */
    uint64_t base_spp, reference_spp;   /* of one of the two references */
    uint32_t reference_depth;
    double budget_s, spent_s;
    uint32_t workers, threads; /* threads of all workers */
    uint64_t lights;           /* of the scene: emitting triangles and spheres, and the others */
    bool own_farm;             /* core-seconds are CPU time of our workers; else as reported */
    bool interrupted;
    /* Of a job besides its samples: reading the scene, building the tree; by builder but none.
     * Measured again in each round, since machines get busier; medians by study_evaluate.
     */
    struct {
        double core_s[STATS_MEDIAN_MAX];
        uint32_t count;
        double median_s; /* 0 on a named farm, whose reports leave it out */
    } setups[JOB_BUILDER_NONE];
    uint32_t render_count;
    struct study_truth truth;
    struct study_point points[STUDY_POINTS_MAX];
    uint32_t point_count, base; /* index */
    struct study_preset presets[STUDY_LEVELS];
    bool has_presets;
};

/* Fills what follows from the measurements. */
void study_evaluate(struct study *s);

/* How much less work than the base the point needs for one error. */
struct stats_interval study_gain(const struct study *s, const struct study_point *p);

/* Enough repeats to say something. */
bool study_point_measured(const struct study_point *p);

void study_release(struct study *s);

#endif
