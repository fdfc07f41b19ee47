/* common/job_spec.h: what a job asks for besides the scene, and how its samples
 * are cut into blocks.
 *
 * The client resolves defaults, scene file and options into one job_spec; it
 * travels as one small JSON object (API, store, JobInfo message), read by the one
 * checked parser here. Pure; any thread.
 */
#ifndef COMMON_JOB_SPEC_H
#define COMMON_JOB_SPEC_H

#include "common/aov.h"
#include "common/diag.h"
#include "common/err.h"
#include "common/tags.h"

/* X(enum suffix, name in options and JSON) */
#define JOB_INTEGRATORS(X)                                                                         \
    X(INTERSECTION_TEST, "intersection_test") X(PATH, "path") X(DIRECT, "direct") X(AO, "ao")
#define JOB_PROFILES(X) X(MIS, "MIS") X(NEE, "NEE") X(RW, "RW")
#define JOB_SAMPLERS(X) X(SOBOL, "sobol") X(HALTON, "halton") X(INDEPENDENT, "independent")
#define JOB_FILTERS(X)                                                                             \
    X(BOX, "box")                                                                                  \
    X(TENT, "tent")                                                                                \
    X(GAUSSIAN, "gaussian") X(MITCHELL, "mitchell") X(BLACKMAN_HARRIS, "blackman-harris")
#define JOB_BUILDERS(X)      X(SAH, "sah") X(MEDIAN, "median") X(SBVH, "sbvh") X(NONE, "none")
#define JOB_INTERSECTORS(X)  X(WOOP, "woop") X(MOLLER_TRUMBORE, "moller-trumbore")
#define JOB_LIGHT_CHOICES(X) X(TREE, "tree") X(POWER, "power") X(UNIFORM, "uniform")
#define JOB_PRECISIONS(X)    X(EXACT, "exact") X(FAST, "fast")
#define JOB_STOPS(X)                                                                               \
    X(SPP, "spp") X(ERROR, "error") X(TIME, "time") X(PLAN, "plan") X(PILOT, "pilot")

#define JOB_ENUM(suffix, name) JOB_CHOICE(suffix),
#define JOB_CHOICE(suffix)     JOB_INTEGRATOR_##suffix
enum job_integrator { JOB_INTEGRATORS(JOB_ENUM) JOB_INTEGRATOR_COUNT };
#undef JOB_CHOICE
#define JOB_CHOICE(suffix) JOB_PROFILE_##suffix
enum job_profile { JOB_PROFILES(JOB_ENUM) JOB_PROFILE_COUNT };
#undef JOB_CHOICE
#define JOB_CHOICE(suffix) JOB_SAMPLER_##suffix
enum job_sampler { JOB_SAMPLERS(JOB_ENUM) JOB_SAMPLER_COUNT };
#undef JOB_CHOICE
#define JOB_CHOICE(suffix) JOB_FILTER_##suffix
enum job_filter { JOB_FILTERS(JOB_ENUM) JOB_FILTER_COUNT };
#undef JOB_CHOICE
#define JOB_CHOICE(suffix) JOB_BUILDER_##suffix
enum job_builder { JOB_BUILDERS(JOB_ENUM) JOB_BUILDER_COUNT };
#undef JOB_CHOICE
#define JOB_CHOICE(suffix) JOB_INTERSECTOR_##suffix
enum job_intersector { JOB_INTERSECTORS(JOB_ENUM) JOB_INTERSECTOR_COUNT };
#undef JOB_CHOICE
#define JOB_CHOICE(suffix) JOB_PRECISION_##suffix
enum job_precision { JOB_PRECISIONS(JOB_ENUM) JOB_PRECISION_COUNT };
#undef JOB_CHOICE
#define JOB_CHOICE(suffix) JOB_LIGHT_CHOICE_##suffix
enum job_light_choice { JOB_LIGHT_CHOICES(JOB_ENUM) JOB_LIGHT_CHOICE_COUNT };
#undef JOB_CHOICE
#define JOB_CHOICE(suffix) JOB_STOP_##suffix
/* What ends the job: a number of samples; a measured error; a time; a plan that came with the job
 * (sample_plan.h); or its pilot, to predict the others from. */
enum job_stop { JOB_STOPS(JOB_ENUM) JOB_STOP_COUNT };
#undef JOB_CHOICE
#undef JOB_ENUM

extern const char *const job_integrator_names[JOB_INTEGRATOR_COUNT];
extern const char *const job_profile_names[JOB_PROFILE_COUNT];
extern const char *const job_sampler_names[JOB_SAMPLER_COUNT];
extern const char *const job_filter_names[JOB_FILTER_COUNT];
extern const char *const job_builder_names[JOB_BUILDER_COUNT];
extern const char *const job_intersector_names[JOB_INTERSECTOR_COUNT];
extern const char *const job_precision_names[JOB_PRECISION_COUNT];
extern const char *const job_light_choice_names[JOB_LIGHT_CHOICE_COUNT];
extern const char *const job_stop_names[JOB_STOP_COUNT];

/* Index of `name` in a table of names, or -1. */
int job_choice_find(const char *const *names, int count, const char *name);

enum {
    JOB_COLOR_PLANES = 3,
    JOB_CELL_VALUES_MAX = 3 << 24, /* of all planes of one cell: 192 MiB as float */
};
enum { JOB_NAME_BYTES_MAX = 200 }; /* what people call a job, in UTF-8 */
enum { JOB_SIDE_MAX = 65535, JOB_TILE_MAX = 65535, JOB_DEPTH_MAX = 1 << 20 };
#define JOB_SPP_MAX (UINT64_C(1) << 40)
/* Bounds of spp where samples differ from square to square, and the default of --max-spp. */
#define JOB_ADAPTIVE_SPP_MIN     4
#define JOB_ADAPTIVE_SPP_MAX     (UINT64_C(1) << 32)
#define JOB_ADAPTIVE_SPP_DEFAULT (UINT64_C(1) << 16)
#define JOB_TIME_LIMIT_MAX_S     1e7

struct job_crop {
    uint32_t x, y, width, height; /* within the full picture, never empty */
};

struct job_spec {
    uint32_t width, height; /* of the full picture, 1..JOB_SIDE_MAX */
    struct job_crop crop;   /* the whole picture when not cropped; what is rendered and stored */
    uint64_t spp;           /* 1..JOB_SPP_MAX; but for JOB_STOP_SPP the most a pixel may get */
    enum job_stop stop;
    double target_error; /* relMSE; JOB_STOP_ERROR: > 0 */
    double time_limit_s; /* JOB_STOP_TIME: > 0 */
    uint64_t seed;
    uint32_t max_depth;  /* 1..JOB_DEPTH_MAX */
    double rr_threshold; /* 0: no roulette */
    uint32_t tile;       /* side of a cell in pixels; changes no bit */
    double verify; /* share of units rendered once more by another worker, 0..1; changes no bit */
    enum job_integrator integrator;
    enum job_profile profile;
    enum job_sampler sampler;
    enum job_filter filter;
    double filter_radius;      /* pixels, > 0 */
    double filter_alpha;       /* Gaussian */
    double filter_b, filter_c; /* Mitchell */
    enum job_builder builder;
    enum job_intersector intersector;
    enum job_precision precision;
    enum job_light_choice light_choice; /* one light is not chosen by a tree */
    uint32_t aov;                       /* set of aov.h */
    struct tags tags;                   /* only workers that have them all; changes no bit */
};

/* The format's defaults: 600x600, path, 32 spp, depth 12, rr 0.1, box 0.5, tile 16, sobol. */
void job_spec_init(struct job_spec *s);

/* True if every field is in range; with `problems` (may be NULL) says which are not. */
TL_NODISCARD bool job_spec_valid(const struct job_spec *s, struct diag_list *problems);

/* Planes of floats that a unit of the job has: R, G, B and those of its AOVs. */
uint32_t job_plane_count(const struct job_spec *s);

/* One line of JSON; you own it; NULL when out of memory. Seed as a string. */
TL_NODISCARD char *job_spec_to_json(const struct job_spec *s);

/* Reads what job_spec_to_json wrote, or a hostile text: unknown and duplicate keys, wrong types
 * and ranges are problems and ERR_INPUT. Absent keys take the default. */
TL_NODISCARD enum err job_spec_from_json(const char *text, size_t bytes, struct job_spec *out,
                                         struct diag_list *problems);

/* --- Sample blocks -------------------------------------------------------
 *
 * The samples of a pixel are (half, index) pairs: half 0 (A) holds ceil(spp/2) of
 * them, half 1 (B) the rest. A half is one independently scrambled sequence. Block
 * b belongs to half b & 1 and holds a contiguous range of that half's indices; the
 * numbers depend on spp alone. spp >= 2 has at least two blocks. */
struct job_blocks {
    uint32_t count; /* 1 when spp == 1, else even, at most JOB_BLOCKS_MAX */
    uint32_t pilot; /* of them are the pilot's; 0: every pixel gets all blocks, there is no pilot */
    uint64_t spp;
};
enum { JOB_BLOCKS_MAX = 256, JOB_BLOCK_SAMPLES = 16 /* while spp <= 4,096 */ };

struct job_block {
    uint32_t half;         /* 0 or 1 */
    bool pilot;            /* of sequences that are the pilot's own */
    uint64_t begin, count; /* indices within the half */
};

struct job_blocks job_blocks_of(uint64_t spp);
struct job_block job_block_at(const struct job_blocks *b, uint32_t block);

/* Where samples differ from square to square the blocks grow: a half has 2, 4, 6, 8, 10, 12, 14,
 * 16, 20, 24, 28, 32, 40, ... samples after its blocks 0, 1, 2, ..., four steps to an octave. The
 * first blocks are the pilot's (1 + 1 samples; 1 + 1 and 6 + 6 more where a time decides), with
 * sequences of its own. A cell gets the pilot and then as many of the blocks as the plan says. */
struct job_blocks job_spec_blocks(const struct job_spec *s);

/* Samples of a half after its first `blocks` blocks of the estimate: 0, 2, 4, ... */
uint64_t job_ladder(uint32_t blocks);

/* Samples of a pixel, pilot apart, after so many blocks of the job, pilot included. */
uint64_t job_blocks_samples(const struct job_blocks *b, uint32_t blocks);

/* Of the pilot. */
uint64_t job_pilot_samples(const struct job_blocks *b);

/* The number by which a sample is reported: 2 * index + half, in [0, spp). */
uint64_t job_sample_number(uint32_t half, uint64_t index);

#endif
