#include "client/predict.h"

#include <errno.h>
#include <math.h>
#include <string.h>

#include "client/human.h"
#include "client/signals.h"
#include "client/study_farm.h"
#include "common/json_put.h"
#include "common/mem.h"

/* Two-sided 80 % of a normal distribution. */
static const double QUANTILE = 1.2816;
/* Before a pilot has been seen, error falls as samples to this power, +- its deviation: eight
 * scenes did 1 (independent samples) to 1.9 (stratified ones, smooth pictures). */
static const double POWER = 1.3, POWER_SPREAD = 0.35;
/* A straight line is a model: what is left of it, of the logarithm. From a few samples to 16 errors
 * fall otherwise than beyond. */
static const double ERROR_SPREAD = 0.12, FEW_SPREAD = 0.8, TIME_SPREAD = 0.22, COST_SPREAD = 0.14;
/* Others on the machine stretch times, and not evenly: so much of the stretch's logarithm. */
static const double STRETCH_SPREAD = 0.06, STRETCH_COST_SPREAD = 0.06;
/* On a farm whose processor time is not to be seen. */
static const double STRETCH_UNKNOWN = 10;
/* How many pilots' worth of belief that has against the scatter that is seen. */
static const double TIME_BELIEF = 2;
/* A stated error scatters by more than it states. Measured. */
static const double STATED_SPREAD = 0.12;
/* A time limit: fewest samples of a pixel; what is not begun so long before is taken back
 * (job_plan.c), and the rest takes most of that; deviation in seconds and of the logarithm (limits
 * of 2 s took 1.56 to 1.76 s, of 10 s 9.6 to 10.9 s). */
static const double SPP_LEAST = 4, LIMIT_EARLY_S = 0.3, LIMIT_SPREAD_S = 0.1, LIMIT_SPREAD = 0.03;
/* A plan's picture has so many times the error that the pilots' line, gain and steps say: the gain
 * is seen by the noise that it was chosen by, and the pilots' sequences are made for their numbers
 * of samples. Measured over 32 renders. */
static const double PLAN_WORSE = 1.5;
/* A render to a target takes so many times the samples that this asks for: it goes by steps from
 * look to look, and a square gets four at the least. Measured over 16 renders. */
static const double TARGET_WORK = 1.2;
static const double PIVOT_SPP = 16, TARGET_PILOT_SPP = 2;
/* A claim, as claim.c makes it: its upper bound, of so many deviations and a doubt, must be under
 * the target; none is made while the deviation is more than the root of 1 / 8. Looks come in steps,
 * so that the error is a little less than that asks for, and where it falls steeply more so.
 * Measured. */
static const double CLAIM_QUANTILE = 2.3, CLAIM_DOUBT = 0.1, CLAIM_EFFECTIVE_MIN = 8;
static const double CLAIM_STEP = 1.03, CLAIM_SPREAD = 0.2;
static const double STEEP_POWER = 1.2, STEEP_STEP = 0.3;
/* 512 x 512 pixels: more would tell no more of cost and error a pixel. */
static const double PILOT_PIXELS_MAX = 512.0 * 512.0;

bool predict_wanted(const struct cli_line *line)
{
    return cli_has(line, CLI_SPP) || cli_has(line, CLI_TARGET_ERROR) ||
           cli_has(line, CLI_TIME_LIMIT);
}

static void spread(double value, double deviation, double *low, double *high)
{
    *low = value * exp(-QUANTILE * deviation);
    *high = value * exp(QUANTILE * deviation);
}

/* Bayesian weighted least squares; nothing is assumed of the level. */
struct error_fit predict_fit_error(const struct pilots *p)
{
    struct error_fit f = {.power = POWER};
    double w0 = 0, w1 = 0, w2 = 1 / (POWER_SPREAD * POWER_SPREAD), y0 = 0, y1 = POWER * w2;
    for (size_t i = 0; i < p->count; i++) {
        const struct pilot *q = &p->of[i];
        if (!(q->relmse > 0))
            continue;
        double doubt = q->deviation / q->relmse;
        double model = q->spp < PIVOT_SPP ? FEW_SPREAD : ERROR_SPREAD;
        double w = 1 / (doubt * doubt + model * model);
        double x = -log(q->spp / PIVOT_SPP), y = log(q->relmse);
        w0 += w;
        w1 += w * x;
        w2 += w * x * x;
        y0 += w * y;
        y1 += w * x * y;
        f.noise = doubt; /* of the largest, which is the last */
        f.known = true;
    }
    if (!f.known)
        return f;
    double determinant = w0 * w2 - w1 * w1; /* > 0: the belief in POWER adds to w2 */
    f.level = (w2 * y0 - w1 * y1) / determinant;
    f.power = (w0 * y1 - w1 * y0) / determinant;
    f.level_var = w2 / determinant;
    f.power_var = w0 / determinant;
    f.covariance = -w1 / determinant;
    /* More samples never make it worse. */
    f.power = f.power > 0.5 ? f.power : 0.5;
    return f;
}

/* Logarithm's deviation at spp: of the line, and of what the render will state. */
static double error_doubt(const struct error_fit *f, double spp)
{
    double x = -log(spp / PIVOT_SPP);
    return sqrt(f->level_var + 2 * x * f->covariance + x * x * f->power_var + f->noise * f->noise +
                STATED_SPREAD * STATED_SPREAD);
}

static double error_at(const struct error_fit *f, double spp)
{
    return f->known ? exp(f->level - f->power * log(spp / PIVOT_SPP)) : 0;
}

struct cost_fit predict_fit_cost(const struct pilots *p)
{
    struct cost_fit f = {.stretch = 1, .known = p->count > 1};
    double stretch = 0;
    for (size_t i = 0; i < p->count; i++) {
        f.known = f.known && p->of[i].cpu_s > 0 && p->of[i].core_s > 0;
        stretch += log(p->of[i].core_s / p->of[i].cpu_s) / (double)p->count;
    }
    if (!f.known)
        return (struct cost_fit){.stretch = STRETCH_UNKNOWN};
    /* The first pilot read the scene besides; the others do not have that. */
    const struct pilot *first = &p->of[0], *last = &p->of[p->count - 1];
    f.stretch = stretch > 0 ? exp(stretch) : 1;
    f.spp_s = last->cpu_s / last->spp;
    if (p->count > 2) {
        double slope = (last->cpu_s - p->of[1].cpu_s) / (last->spp - p->of[1].spp);
        f.spp_s = slope > 0 && slope < f.spp_s ? slope : f.spp_s;
    }
    double fixed_s = first->cpu_s - first->spp * f.spp_s;
    f.fixed_s = fixed_s > 0 ? fixed_s : 0;
    return f;
}

static double busy_of(const struct pilot *p)
{
    return p->busy_s > 1e-6 ? p->busy_s : 1e-6;
}

/* Weighted by 1 / seconds^2: what disturbs a render disturbs it in proportion. */
struct time_fit predict_fit_time(const struct pilots *p)
{
    double w0 = 0, w1 = 0, w2 = 0, y0 = 0, y1 = 0, square = 0;
    for (size_t i = 0; i < p->count; i++) {
        double x = p->of[i].spp, y = busy_of(&p->of[i]), w = 1 / (y * y);
        w0 += w;
        w1 += w * x;
        w2 += w * x * x;
        y0 += w * y;
        y1 += w * x * y;
    }
    double determinant = w0 * w2 - w1 * w1;
    struct time_fit f = {.spp_s = y1 / w2};
    if (p->count > 1 && determinant > 0) {
        double fixed_s = (w2 * y0 - w1 * y1) / determinant;
        double spp_s = (w0 * y1 - w1 * y0) / determinant;
        if (fixed_s > 0 && spp_s > 0)
            f = (struct time_fit){.fixed_s = fixed_s, .spp_s = spp_s};
    }
    for (size_t i = 0; i < p->count; i++) {
        double off = log(busy_of(&p->of[i]) / (f.fixed_s + f.spp_s * p->of[i].spp));
        square += off * off;
    }
    double freedom = p->count > 2 ? (double)p->count - 2 : 0;
    double spread = hypot(TIME_SPREAD, STRETCH_SPREAD * log(predict_fit_cost(p).stretch));
    f.deviation = sqrt((TIME_BELIEF * spread * spread + square) / (TIME_BELIEF + freedom));
    return f;
}

/* By how much more the error is where samples grow by halves of an octave, as plans do: well
 * spread samples are so in powers of two. 1 + m of them are a whole set and sets of the parts of m,
 * each with the error that the power gives it; the mean over m = 0 and 1/2, by ratio. */
static double between_powers(double power)
{
    enum { STEPS = 2 };
    double sum = 0;
    for (int step = 0; step < STEPS; step++) {
        double n = 1 + (double)step / STEPS, variance = 1;
        for (double part = 0.5, left = n - 1; left > 0; part /= 2) {
            if (part > left)
                continue;
            variance += part * part * pow(part, -power);
            left -= part;
        }
        sum += log(variance / (n * n) * pow(n, power));
    }
    return exp(sum / STEPS);
}

/* Relative deviation of what the render will state of its error: of pixels, of which it has more
 * than a pilot that was shrunk. */
static double stated_deviation(const struct pilots *p, const struct error_fit *error)
{
    return error->noise / sqrt(p->pixel_ratio > 1 ? p->pixel_ratio : 1);
}

/* How far below the target the error must be, on average. */
static double claim_of(const struct pilots *p, const struct error_fit *error)
{
    return CLAIM_STEP * exp(hypot(CLAIM_QUANTILE * stated_deviation(p, error), CLAIM_DOUBT));
}

/* Where a render to a target ends. */
static double claimed_error(const struct pilots *p, const struct error_fit *error, double target)
{
    double steep = error->power > STEEP_POWER ? error->power - STEEP_POWER : 0;
    return target / (claim_of(p, error) * (1 + STEEP_STEP * steep));
}

/* The pilot would make no claim, whatever its error. */
static bool claims_nothing(const struct pilots *p, const struct error_fit *error)
{
    double deviation = stated_deviation(p, error);
    return deviation * deviation * CLAIM_EFFECTIVE_MIN > 1;
}

/* Samples that reach an error, the pilot apart. */
static double spp_for(const struct error_fit *f, double error)
{
    return f->known ? PIVOT_SPP * exp((f->level - log(error)) / f->power) : 0;
}

/* What a job will do, before its doubts. */
struct course {
    double spp, rendered; /* of the picture; of a pilot that is dropped */
    double gain;          /* by which its error is less than that of equal samples */
    double spread;        /* of the samples' logarithm, beside what the error's fit leaves open */
    bool bounded;         /* by --max-spp */
};

static struct course course_of(const struct pilots *p, const struct job_spec *spec,
                               const struct error_fit *error, const struct time_fit *time)
{
    double gain = p->gain > 0 && p->gain < 1 ? p->gain : 1, max = (double)spec->spp;
    struct course c = {.spp = max, .gain = 1};
    if (spec->stop == JOB_STOP_ERROR) {
        gain *= PLAN_WORSE * between_powers(error->power);
        c.spp = TARGET_WORK * spp_for(error, spec->target_error / (claim_of(p, error) * gain));
        c.rendered = c.spp > TARGET_PILOT_SPP ? TARGET_PILOT_SPP : 0;
        c.spp = c.spp > TARGET_PILOT_SPP ? c.spp : TARGET_PILOT_SPP;
        c.gain = gain;
        /* It makes no claim until more pixels carry the error: anywhere from here to the bound. */
        if (claims_nothing(p, error) && c.spp < max) {
            c.spread = log(max / c.spp) / (2 * QUANTILE);
            c.spp = sqrt(c.spp * max);
        }
    } else if (spec->stop == JOB_STOP_TIME) {
        double busy_s = spec->time_limit_s - LIMIT_EARLY_S - p->load_s - time->fixed_s;
        bool dropped = time->spp_s * PIVOT_SPP < 0.12 * spec->time_limit_s;
        c.spp = (busy_s > 0 ? busy_s : 0) / time->spp_s - (dropped ? PIVOT_SPP : 0);
        c.rendered = dropped ? PIVOT_SPP : 0;
        c.spp = c.spp > SPP_LEAST ? c.spp : SPP_LEAST;
        c.gain = (dropped ? gain : 1) * PLAN_WORSE * between_powers(error->power);
    }
    c.bounded = c.spp > max;
    c.spp = c.bounded ? max : c.spp;
    return c;
}

struct prediction predict(const struct pilots *p, const struct job_spec *spec)
{
    struct prediction out = {.heavy_tail = p->heavy_tail};
    struct error_fit error = predict_fit_error(p);
    struct time_fit time = predict_fit_time(p);
    struct cost_fit cost = predict_fit_cost(p);
    time.spp_s *= p->pixel_ratio;
    cost.spp_s *= p->pixel_ratio;
    struct course course = course_of(p, spec, &error, &time);
    out.spp_mean = course.spp;
    out.relmse = error_at(&error, course.spp) * course.gain;
    out.seconds = p->load_s + time.fixed_s + time.spp_s * (course.spp + course.rendered);
    out.core_s =
        cost.known ? cost.fixed_s + cost.spp_s * (course.spp + course.rendered) : (double)NAN;
    double doubt = error_doubt(&error, course.spp), time_doubt = time.deviation;
    double cost_doubt = hypot(COST_SPREAD, STRETCH_COST_SPREAD * log(cost.stretch));
    if (spec->stop == JOB_STOP_ERROR && !course.bounded) {
        double samples = hypot(doubt / error.power, course.spread);
        time_doubt = hypot(time_doubt, samples);
        cost_doubt = hypot(cost_doubt, samples);
        if (!claims_nothing(p, &error)) {
            double deviation = stated_deviation(p, &error);
            out.relmse = claimed_error(p, &error, spec->target_error);
            doubt = hypot(CLAIM_SPREAD, deviation);
        } else {
            doubt = hypot(doubt, error.power * course.spread);
        }
    } else if (spec->stop == JOB_STOP_TIME) {
        doubt = hypot(doubt, error.power * time.deviation);
        cost_doubt = hypot(cost_doubt, time.deviation);
        if (!course.bounded) {
            /* It ends at the limit, unless the fewest samples take longer. */
            double least_s = p->load_s + time.fixed_s + time.spp_s * SPP_LEAST;
            double limit_s = spec->time_limit_s, end_s = fmax(limit_s - LIMIT_EARLY_S, limit_s / 2);
            bool late = least_s > end_s;
            out.seconds = late ? least_s : end_s;
            time_doubt = late ? time_doubt : hypot(LIMIT_SPREAD_S / end_s, LIMIT_SPREAD);
        }
    }
    spread(out.seconds, time_doubt, &out.seconds_low, &out.seconds_high);
    spread(out.core_s, cost_doubt, &out.core_low_s, &out.core_high_s);
    spread(out.relmse, doubt, &out.relmse_low, &out.relmse_high);
    return out;
}

static void add_pilot(struct pilots *all, const struct json *report, double cpu_s)
{
    const struct json *error = json_get_member(report, "error");
    const struct json *seconds = json_get_member(report, "seconds");
    const struct json *heavy = json_get_member(error, "heavy_tail");
    double high = reply_number(error, "relmse_high", 0);
    double load_s = reply_number(seconds, "load", 0) + reply_number(seconds, "build", 0);
    struct pilot p = {.spp = reply_number(report, "spp_mean", 1),
                      .busy_s = reply_number(seconds, "total", 0) - load_s,
                      .core_s = reply_number(report, "core_seconds", 0),
                      .cpu_s = cpu_s,
                      .relmse = reply_number(error, "relmse", 0)};
    p.deviation = p.relmse > 0 ? p.relmse * log(high / p.relmse) / 1.96 : 0;
    if (all->count == 0)
        all->load_s = load_s; /* later ones find the scene there */
    all->heavy_tail = !heavy || heavy->type != JSON_BOOL || heavy->truth; /* the last, largest */
    all->of[all->count++] = p;
}

static uint32_t scaled(uint32_t side, double factor)
{
    double s = floor(side * factor);
    return s > 1 ? (uint32_t)s : 1;
}

static double pixels_of(const struct job_spec *spec)
{
    return (double)spec->crop.width * spec->crop.height;
}

/* The pilot of a large picture is the same view, smaller: its cost and error a pixel are nearly the
 * same, and its film fits everywhere. */
static void shrink(struct job_spec *s)
{
    double factor = sqrt(PILOT_PIXELS_MAX / pixels_of(s));
    if (factor >= 1)
        return;
    s->width = scaled(s->width, factor);
    s->height = scaled(s->height, factor);
    struct job_crop *c = &s->crop;
    *c = (struct job_crop){.x = (uint32_t)(c->x * factor),
                           .y = (uint32_t)(c->y * factor),
                           .width = scaled(c->width, factor),
                           .height = scaled(c->height, factor)};
    c->x = c->x < s->width ? c->x : s->width - 1;
    c->y = c->y < s->height ? c->y : s->height - 1;
    c->width = c->width < s->width - c->x ? c->width : s->width - c->x;
    c->height = c->height < s->height - c->y ? c->height : s->height - c->y;
}

static int render_pilot(struct study_farm *farm, const struct job_spec *spec, struct pilots *all)
{
    static const uint64_t SPP[PILOTS_MAX] = {4, 16, 64};
    struct farm_json report;
    struct job_spec pilot = *spec;
    bool by_error = all->count == 1; /* it is the one that the master plans by */
    shrink(&pilot);
    all->pixel_ratio = pixels_of(spec) / pixels_of(&pilot);
    pilot.stop = by_error ? JOB_STOP_PILOT : JOB_STOP_SPP;
    pilot.spp = by_error ? JOB_ADAPTIVE_SPP_DEFAULT : SPP[all->count];
    pilot.seed += all->count;
    pilot.target_error = pilot.time_limit_s = 0;
    double before_s = study_farm_cpu_s(farm);
    int status = study_farm_report(farm, &pilot, &report);
    if (status != EXIT_DONE)
        return status;
    if (by_error)
        all->gain = reply_number(report.json.root, "adaptive_gain", 1);
    add_pilot(all, report.json.root, study_farm_cpu_s(farm) - before_s);
    farm_json_release(&report);
    return EXIT_DONE;
}

/* The largest pilot pays beyond the reach of the others, where it is short or little beside the
 * render. */
static bool worth_large(const struct pilots *all, const struct job_spec *spec)
{
    enum { SHORT_S = 5, NEAR_SPP = 24, LITTLE_SPP = 512 };
    double spp = predict(all, spec).spp_mean;
    return spp >= LITTLE_SPP || (spp >= NEAR_SPP && 4 * all->of[1].busy_s < SHORT_S);
}

int predict_run(struct cli *cli, const struct job_spec *spec, struct prediction *out)
{
    struct study_farm farm;
    struct progress progress;
    struct pilots all = {.gain = 1, .pixel_ratio = 1};
    if (signals_install() != ERR_OK) {
        cli_error("machine", NULL, "cannot watch for signals: %s", strerror(errno));
        return EXIT_MACHINE;
    }
    progress_init(&progress, PROGRESS_NONE, -1, 0);
    int status = study_farm_open(&farm, cli, &progress);
    for (size_t i = 0; i < PILOTS_MAX && status == EXIT_DONE; i++)
        if (i < 2 || worth_large(&all, spec))
            status = render_pilot(&farm, spec, &all);
    if (status == EXIT_DONE)
        *out = predict(&all, spec);
    study_farm_close(&farm);
    return status;
}

void predict_put_json(const struct prediction *p, struct buf *out)
{
    const struct {
        const char *key;
        double value;
    } fields[] = {
        {"spp_mean", p->spp_mean},
        {"seconds", p->seconds},
        {"seconds_low", p->seconds_low},
        {"seconds_high", p->seconds_high},
        {"core_seconds", p->core_s},
        {"core_seconds_low", p->core_low_s},
        {"core_seconds_high", p->core_high_s},
        {"relmse", p->relmse},
        {"relmse_low", p->relmse_low},
        {"relmse_high", p->relmse_high},
    };
    buf_printf(out, "{\"heavy_tail\":%s", p->heavy_tail ? "true" : "false");
    for (size_t i = 0; i < sizeof fields / sizeof *fields; i++) {
        buf_printf(out, ",\"%s\":", fields[i].key);
        json_put_number(out, fields[i].value);
    }
    buf_printf(out, "}");
}

void predict_put_text(const struct prediction *p, struct buf *out)
{
    char a[HUMAN_BYTES], b[HUMAN_BYTES], c[HUMAN_BYTES];
    human_duration(p->seconds, a);
    human_duration(p->seconds_low, b);
    human_duration(p->seconds_high, c);
    buf_printf(out, "cost      %s (80 %%: %s to %s)", a, b, c);
    if (isfinite(p->core_s)) {
        human_duration(p->core_s, a);
        buf_printf(out, ", %s of processors", a);
    }
    buf_printf(out, ", %.0f spp on average\n", p->spp_mean);
    human_error(p->relmse, a);
    human_error(p->relmse_low, b);
    human_error(p->relmse_high, c);
    if (p->heavy_tail)
        buf_printf(out, "error     unpredictable: heavy tail, the pilot saw few spikes\n");
    else
        buf_printf(out, "error     relMSE %s (80 %%: %s to %s)\n", a, b, c);
}
