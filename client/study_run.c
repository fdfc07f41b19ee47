#include "client/study_run.h"

#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "client/follow.h"
#include "client/human.h"
#include "client/signals.h"
#include "client/study_plan.h"
#include "client/study_recommend.h"
#include "common/half.h"
#include "common/mem.h"

enum {
    PILOT_SIDE = 48,
    PILOT_RENDERS = 4,
    PLANS = 4,
    PATIENCE = 4, /* a point may take so many times what was expected */
    TIMID = 3,    /* a plan for a third of the speed is made again */
    PILOT_SPP = 4,
    SETUP_REPEATS = 3,
    PRESET_REPEATS = 4,
    SEED_REFERENCE = 1000, /* seeds of repeats count up from the scene's, those of references too */
};

/* Of the time after the references, before recommendations are made. */
#define ROUNDS_SHARE 0.75
/* Of the budget, for one render of the pilot to be long enough. */
#define PILOT_SHARE 0.02
/* Of what is left, for the references; a plan that needs more was too bold. */
#define TRUTH_SHARE 0.35
/* As long as so much of the budget is left, a timid plan is worth making again. */
#define REPLAN_SHARE 0.8
/* Of what is left, for the first two renders of one point. */
#define POINT_SHARE 0.25
/* Writing tables, plot and page. */
#define CLOSING_S 0.8

struct run {
    struct study *s;
    struct study_farm *f;
    uint64_t seed;
    double end_s; /* of the budget; the farm's deadline may be nearer for a while */
    bool fixed;   /* the size was asked for */
    double wall_s[STUDY_POINTS_MAX]; /* what a render of the point took last */
    char plan_said[200];
};

static double left_s(const struct run *r)
{
    return r->end_s - follow_now_s();
}

static void show(struct run *r)
{
    double now_s = follow_now_s(), left = fmax(0, left_s(r));
    double total = r->end_s - r->f->start_s;
    struct progress_now now = {.state = "rendering",
                               .done = fmin(1, fmax(0, 1 - left / total)),
                               .has_left = true,
                               .left_s = {left, left},
                               .relmse = (double)NAN,
                               .workers = r->s->workers};
    progress_update(r->f->progress, &now, now_s);
}

static void put_number(struct study_setting *s, enum cli_option_id option, uint64_t v)
{
    s->option = option;
    (void)snprintf(s->text, sizeof s->text, "%" PRIu64, v);
}

/* Renders with the settings, the study's size, and the seed of that number. */
static int render(struct run *r, const struct study_setting *settings, uint32_t count,
                  uint32_t width, uint32_t height, uint64_t seed, struct study_render *out)
{
    struct study_setting all[STUDY_SETTINGS_MAX + 2];
    memcpy(all, settings, count * sizeof *all);
    put_number(&all[count++], CLI_SEED, r->seed + seed);
    if (!r->fixed) {
        all[count].option = CLI_SIZE_WH;
        (void)snprintf(all[count].text, sizeof all[count].text, "%ux%u", width, height);
        count++;
    }
    show(r);
    int status = study_farm_render(r->f, all, count, out);
    if (status == EXIT_DONE)
        r->s->render_count++;
    return status;
}

/* --- Pilot ------------------------------------------------------------------ */

/* What a job costs besides its samples: one pixel of one sample. Adds to *wall_s. */
static int measure_setup(struct run *r, enum job_builder tree, double *wall_s)
{
    struct study_setting settings[3] = {{CLI_SPP, "1"}, {CLI_CROP_XYWH, "0,0,1,1"}};
    struct study_render one;
    uint32_t *count = &r->s->setups[tree].count;
    settings[2].option = CLI_BUILDER;
    (void)snprintf(settings[2].text, sizeof settings[2].text, "%s", job_builder_names[tree]);
    if (*count >= STATS_MEDIAN_MAX)
        return EXIT_DONE;
    int status = study_farm_render(r->f, settings, tree == JOB_BUILDER_SAH ? 2 : 3, &one);
    if (status != EXIT_DONE)
        return status;
    r->s->setups[tree].core_s[(*count)++] = one.core_s;
    *wall_s += one.wall_s;
    mem_free(one.rgb);
    return EXIT_DONE;
}

/* More samples each time, until the time they take says something. */
static int measure_speed(struct run *r, const struct job_spec *spec, struct study_pilot *pilot)
{
    struct study_setting setting;
    struct study_render one = {0};
    double aspect = (double)spec->crop.width / spec->crop.height;
    uint32_t width = (uint32_t)fmax(1, PILOT_SIDE * sqrt(aspect));
    uint32_t height = (uint32_t)fmax(1, PILOT_SIDE / sqrt(aspect));
    double enough_s = fmin(fmax(PILOT_SHARE * r->s->budget_s, 0.1), 1);
    double setup_s =
        r->f->own_runs ? stats_median(r->s->setups[0].core_s, r->s->setups[0].count) : 0;
    uint64_t spp = r->fixed ? 1 : PILOT_SPP;
    for (int i = 0; i < PILOT_RENDERS && one.wall_s < enough_s; i++, spp *= 4) {
        put_number(&setting, CLI_SPP, spp);
        int status = render(r, &setting, 1, width, height, 0, &one);
        if (status != EXIT_DONE)
            return status;
        double busy_s = fmax(one.wall_s - pilot->overhead_s, one.wall_s / 2);
        double samples = (double)one.width * one.height * (double)spp;
        pilot->samples_s = samples / busy_s;
        pilot->setup_samples = samples * setup_s / fmax(one.core_s - setup_s, one.core_s / 4);
        mem_free(one.rgb);
    }
    return EXIT_DONE;
}

static int run_pilot(struct run *r, const struct job_spec *spec, struct study_pilot *pilot)
{
    int status = EXIT_DONE;
    double wall_s = 0;
    const int count = JOB_BUILDER_NONE * SETUP_REPEATS;
    for (int i = 0; i < count && status == EXIT_DONE; i++)
        status = measure_setup(r, (enum job_builder)(i % JOB_BUILDER_NONE), &wall_s);
    pilot->overhead_s = wall_s / count;
    return status == EXIT_DONE ? measure_speed(r, spec, pilot) : status;
}

/* Later plans are often the same again: each is said once. */
static void say_plan(struct run *r)
{
    char line[sizeof r->plan_said];
    (void)snprintf(line, sizeof line,
                   "%ux%u pixels%s, %u points around %" PRIu64 " spp; references of 2 x %" PRIu64
                   " spp",
                   r->s->width, r->s->height, r->s->reduced ? " (the budget allows no more)" : "",
                   r->s->point_count, r->s->base_spp, r->s->reference_spp);
    if (strcmp(line, r->plan_said) == 0)
        return;
    memcpy(r->plan_said, line, sizeof line);
    progress_event(r->f->progress, line, follow_now_s());
}

/* --- References and rounds -------------------------------------------------- */

/* Exact geometry, MIS, far paths; the scene's own sampler with seeds of their own. */
static int render_truth(struct run *r, const struct job_spec *spec)
{
    struct study_setting settings[5];
    float *pictures[2] = {NULL, NULL};
    struct study_render one;
    int status = EXIT_DONE;
    put_number(&settings[0], CLI_SPP, r->s->reference_spp);
    put_number(&settings[1], CLI_MAX_DEPTH, r->s->reference_depth);
    settings[2] = (struct study_setting){CLI_PRECISION, "exact"};
    settings[3] = (struct study_setting){CLI_INTERSECTOR, "woop"};
    settings[4] = (struct study_setting){CLI_PROFILE, "MIS"};
    for (uint64_t i = 0; i < 2 && status == EXIT_DONE; i++) {
        status = render(r, settings, spec->integrator == JOB_INTEGRATOR_PATH ? 5 : 4, r->s->width,
                        r->s->height, SEED_REFERENCE + i, &one);
        if (status == EXIT_DONE)
            pictures[i] = one.rgb;
    }
    if (status != EXIT_DONE) {
        mem_free(pictures[0]);
        return status;
    }
    r->s->width = one.width;
    r->s->height = one.height;
    if (study_truth_init(&r->s->truth, one.width, one.height, pictures[0], pictures[1]) == ERR_OK)
        return EXIT_DONE;
    cli_error("no-memory", NULL, "out of memory");
    return EXIT_MACHINE;
}

static int no_memory(void)
{
    cli_error("no-memory", NULL, "out of memory");
    return EXIT_MACHINE;
}

static int take(struct run *r, struct study_point *p, struct study_render *one)
{
    double relmse;
    if (study_sums_add(&p->sums, &r->s->truth, one->rgb, &relmse) != ERR_OK)
        return no_memory();
    p->relmse[p->repeats] = relmse;
    p->spent_core_s[p->repeats] = one->core_s;
    p->wall_s[p->repeats++] = one->wall_s;
    p->spp_mean = one->spp_mean;
    p->rays = one->rays;
    p->file_bytes = one->file_bytes;
    if (!p->picture) {
        (void)snprintf(p->sha256, sizeof p->sha256, "%s", one->sha256);
        p->picture = one->rgb;
        one->rgb = NULL;
    }
    return EXIT_DONE;
}

/* The base's picture in 16 bits is a point of its own, at the base's cost. */
static int take_half(struct run *r, const struct study_render *base)
{
    struct study_point *half = NULL;
    for (uint32_t i = 0; i < r->s->point_count; i++)
        half = r->s->points[i].half ? &r->s->points[i] : half;
    if (!half || half->repeats >= STUDY_REPEATS_MAX)
        return EXIT_DONE;
    size_t values = 3 * (size_t)base->width * base->height;
    struct study_render copy = *base;
    copy.rgb = mem_alloc_array(values, sizeof *copy.rgb);
    if (!copy.rgb)
        return no_memory();
    for (size_t i = 0; i < values; i++) {
        if (fabsf(base->rgb[i]) > HALF_MAX)
            half->clamped++;
        copy.rgb[i] = half_round(base->rgb[i]);
    }
    copy.file_bytes = half->repeats == 0 ? study_farm_half_bytes(r->f) : half->file_bytes;
    int status = take(r, half, &copy);
    mem_free(copy.rgb);
    return status;
}

/* A point that asks for an error asks for one that the base had. False: not known yet. */
static bool ready(struct run *r, struct study_point *p)
{
    const struct study_point *base = &r->s->points[r->s->base];
    if (p->half || p->given_up)
        return false;
    if (p->knob != KNOB_ADAPTIVE || p->settings[0].text[0])
        return true;
    if (base->repeats == 0 || !(base->relmse[0] > 0))
        return false;
    (void)snprintf(p->settings[0].text, sizeof p->settings[0].text, "%.3g",
                   base->relmse[0] / p->work);
    return true;
}

/* Seconds that the point's next render will take, as far as one can know. */
static double expected_s(const struct run *r, uint32_t i)
{
    const struct study_point *p = &r->s->points[i];
    double base_s = r->wall_s[r->s->base];
    return p->repeats > 0 ? r->wall_s[i] : base_s * fmax(1, p->work);
}

static int render_point(struct run *r, uint32_t i)
{
    struct study_point *p = &r->s->points[i];
    struct study_render one;
    double now_s = follow_now_s();
    r->f->deadline_s =
        fmin(r->end_s, now_s + PATIENCE * expected_s(r, i) + POINT_SHARE * (r->end_s - now_s));
    int status =
        render(r, p->settings, p->setting_count, r->s->width, r->s->height, p->repeats + 1, &one);
    r->f->deadline_s = r->end_s;
    p->given_up = status == STUDY_OUT_OF_TIME && follow_now_s() < r->end_s;
    if (status != EXIT_DONE)
        return p->given_up ? EXIT_DONE : status;
    r->wall_s[i] = one.wall_s;
    if (i == r->s->base)
        status = take_half(r, &one);
    if (status == EXIT_DONE)
        status = take(r, p, &one);
    mem_free(one.rgb);
    return status;
}

/* The set-up again, while there is time: it changes with the machine as all else does. */
static int round_setup(struct run *r, double until_s)
{
    double ignored = 0;
    bool late = follow_now_s() + r->wall_s[r->s->base] > until_s;
    int status = EXIT_DONE;
    for (int tree = 0; tree < JOB_BUILDER_NONE && status == EXIT_DONE && !late; tree++)
        status = measure_setup(r, (enum job_builder)tree, &ignored);
    return status;
}

/* Rounds over the points [from, to) until none fits before `until_s` or all have `repeats`. */
static int rounds(struct run *r, uint32_t from, uint32_t to, uint32_t repeats, double until_s)
{
    for (uint32_t round = 0; round < repeats; round++) {
        bool any = false;
        int status = round_setup(r, until_s);
        for (uint32_t i = from; i < to && status == EXIT_DONE; i++) {
            struct study_point *p = &r->s->points[i];
            if (p->repeats > round || !ready(r, p))
                continue;
            any = true;
            double room_s = until_s - follow_now_s();
            bool costly = p->repeats == 0 && 2 * expected_s(r, i) > POINT_SHARE * room_s;
            if (expected_s(r, i) > room_s || (costly && i != r->s->base))
                continue;
            status = render_point(r, i);
        }
        if (status != EXIT_DONE)
            return status;
        if (!any && round > 0 && follow_now_s() > until_s)
            break;
    }
    return EXIT_DONE;
}

/* --- Recommendations -------------------------------------------------------- */

static void add_presets(struct run *r)
{
    struct study *s = r->s;
    double share_s = left_s(r);
    study_evaluate(s);
    if (!study_recommend(s))
        return;
    for (int i = 0; i < STUDY_LEVELS; i++) {
        double each_s = study_preset_work(s, &s->presets[i]) * r->wall_s[s->base] * 1.3 + 0.05;
        if (PRESET_REPEATS * each_s > share_s && 2 * each_s > share_s)
            continue;
        share_s -= PRESET_REPEATS * each_s;
        r->wall_s[s->point_count] = each_s;
        study_preset_point(s, (enum study_level)i);
    }
}

static double truth_samples(const struct study *s)
{
    return 2 * (double)s->reference_spp * s->width * s->height;
}

/* No larger pictures and not more samples are to be had. */
static bool at_most(const struct study *s)
{
    return (uint64_t)s->width * s->height >= STUDY_PIXELS_MAX && s->base_spp >= STUDY_BASE_SPP_MAX;
}

/* Machines get busier after a pilot: a plan whose references do not come in time is replaced by a
 * smaller one. */
static int plan_and_truth(struct run *r, const struct job_spec *spec)
{
    struct study_pilot pilot = {0};
    int status = run_pilot(r, spec, &pilot);
    for (int i = 0; i < PLANS && (status == EXIT_DONE || status == STUDY_OUT_OF_TIME); i++) {
        r->s->point_count = 0;
        study_plan_size(r->s, spec, r->fixed, &pilot, left_s(r));
        study_plan_points(r->s, spec);
        say_plan(r);
        r->f->deadline_s = follow_now_s() + TRUTH_SHARE * left_s(r);
        double begun_s = follow_now_s();
        status = render_truth(r, spec);
        r->f->deadline_s = r->end_s;
        double speed = truth_samples(r->s) / (follow_now_s() - begun_s);
        bool timid = status == EXIT_DONE && speed > TIMID * pilot.samples_s && !at_most(r->s) &&
                     left_s(r) > REPLAN_SHARE * r->s->budget_s;
        if (status != STUDY_OUT_OF_TIME && !timid)
            break;
        /* What was just seen may be a calm moment: half of it. */
        pilot.samples_s = timid ? speed / 2 : pilot.samples_s / 4;
        if (timid && i + 1 < PLANS)
            study_truth_release(&r->s->truth);
    }
    return status;
}

static int run_all(struct run *r, const struct job_spec *spec)
{
    int status = plan_and_truth(r, spec);
    if (status != EXIT_DONE)
        return status;
    char line[120], text[HUMAN_BYTES];
    human_error(r->s->truth.relmse, text);
    (void)snprintf(line, sizeof line, "references are there; relMSE of their mean %s", text);
    progress_event(r->f->progress, line, follow_now_s());
    uint32_t points = r->s->point_count;
    double until_s = follow_now_s() + ROUNDS_SHARE * left_s(r);
    /* Without the base nothing can be said. */
    status = rounds(r, r->s->base, r->s->base + 1, 2, r->end_s);
    if (status == EXIT_DONE)
        status = rounds(r, 0, points, STUDY_REPEATS_MAX, until_s);
    if (status != EXIT_DONE)
        return status;
    add_presets(r);
    status = rounds(r, points, r->s->point_count, PRESET_REPEATS, r->end_s);
    if (status == EXIT_DONE)
        status = rounds(r, 0, r->s->point_count, STUDY_REPEATS_MAX, r->end_s);
    return status;
}

bool study_has_results(const struct study *s)
{
    return s->truth.weight && s->point_count > 0 && study_point_measured(&s->points[s->base]);
}

int study_run(struct study *s, struct study_farm *f, double budget_s)
{
    const struct cli_line *line = &f->cli->line;
    struct job_spec spec = f->load.spec;
    struct run r = {.s = s, .f = f, .seed = spec.seed};
    r.fixed = cli_has(line, CLI_SIZE_WH) || cli_has(line, CLI_CROP_XYWH);
    s->budget_s = budget_s;
    s->workers = f->workers;
    s->lights = f->load.light_count;
    s->threads = f->threads;
    s->own_farm = f->own_runs;
    r.end_s = f->start_s + budget_s - fmin(CLOSING_S, 0.1 * budget_s);
    f->deadline_s = r.end_s;
    int status = run_all(&r, &spec);
    s->interrupted = signals_interrupts > 0;
    s->spent_s = follow_now_s() - f->start_s;
    if (study_has_results(s)) {
        study_evaluate(s);
        if (!s->has_presets)
            (void)study_recommend(s);
        study_recommend_correct(s);
    }
    return status == STUDY_OUT_OF_TIME ? EXIT_DONE : status;
}
