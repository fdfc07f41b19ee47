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
/* Spread of the logarithm that is left when the pilot is right: of time (other programs, the end of
 * a render) and of error (samples better spread than independent ones). */
static const double TIME_SPREAD = 0.2, ERROR_SPREAD = 0.4;
/* Error falls as samples to this power: 1 for independent ones, up to 1.9 from 16 to 64 samples in
 * smooth scenes; the middle of what eight scenes did. */
static const double POWER = 1.3;
/* What a claim costs: its upper bound must be under the target, and looks come in steps. */
static const double CLAIM_FACTOR = 1.2;
/* 512 x 512 pixels: more would tell no more of cost and error a pixel. */
static const double PILOT_PIXELS_MAX = 512.0 * 512.0;
/* Where a render to a target ends, of the target. */
static const double CLAIM_ERROR = 0.85;

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

struct prediction predict(const struct pilot *p, const struct job_spec *spec)
{
    struct prediction out = {.heavy_tail = p->heavy_tail};
    double core_per_spp = p->core_s / p->spp, doubt = p->relmse > 0 ? p->deviation / p->relmse : 0;
    double gain = p->gain > 0 && p->gain < 1 ? p->gain : 1, spp = (double)spec->spp, rendered = 0;
    double time_doubt = TIME_SPREAD, max = spp;
    if (spec->stop == JOB_STOP_SPP) {
        gain = 1;
    } else if (spec->stop == JOB_STOP_ERROR) {
        spp = p->spp * pow(CLAIM_FACTOR * p->relmse * gain / spec->target_error, 1 / POWER);
        time_doubt = sqrt(TIME_SPREAD * TIME_SPREAD + ERROR_SPREAD * ERROR_SPREAD + doubt * doubt);
        rendered = spp > p->spp ? p->spp : 0; /* the pilot, dropped */
        spp = spp > p->spp ? spp : p->spp;
    } else {
        double busy_s = spec->time_limit_s - p->load_s;
        spp = (busy_s > 0 ? busy_s : 0) * p->threads / core_per_spp;
        bool dropped = p->core_s / p->threads < 0.12 * spec->time_limit_s;
        gain = dropped ? gain : 1;
        spp = dropped ? spp - p->spp : spp;
        spp = spp > 4 ? spp : 4;
    }
    bool bounded = spp > max;
    out.spp_mean = bounded ? max : spp;
    out.relmse = p->relmse * gain * pow(p->spp / out.spp_mean, POWER);
    if (spec->stop == JOB_STOP_ERROR && !bounded)
        out.relmse = CLAIM_ERROR * spec->target_error;
    out.seconds = p->load_s + core_per_spp * (out.spp_mean + rendered) / p->threads;
    if (spec->stop == JOB_STOP_TIME && !bounded)
        out.seconds = out.seconds > spec->time_limit_s ? out.seconds : spec->time_limit_s;
    spread(out.seconds, time_doubt, &out.seconds_low, &out.seconds_high);
    double error_doubt = sqrt(ERROR_SPREAD * ERROR_SPREAD + doubt * doubt);
    spread(out.relmse, error_doubt, &out.relmse_low, &out.relmse_high);
    return out;
}

static struct pilot pilot_of(const struct json *report, double threads)
{
    const struct json *error = json_get_member(report, "error");
    const struct json *seconds = json_get_member(report, "seconds");
    const struct json *heavy = json_get_member(error, "heavy_tail");
    double high = reply_number(error, "relmse_high", 0);
    double load_s = reply_number(seconds, "load", 0) + reply_number(seconds, "build", 0);
    struct pilot p = {.spp = reply_number(report, "spp_mean", 1),
                      .core_s = reply_number(report, "core_seconds", 0),
                      .load_s = load_s,
                      .threads = threads,
                      .relmse = reply_number(error, "relmse", 0),
                      .gain = reply_number(report, "adaptive_gain", 1),
                      .heavy_tail = !heavy || heavy->type != JSON_BOOL || heavy->truth};
    p.deviation = (high - p.relmse) / 1.96;
    return p;
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

int predict_run(struct cli *cli, const struct job_spec *spec, struct prediction *out)
{
    struct study_farm farm;
    struct progress progress;
    struct farm_json report;
    struct job_spec pilot = *spec;
    if (signals_install() != ERR_OK) {
        cli_error("machine", NULL, "cannot watch for signals: %s", strerror(errno));
        return EXIT_MACHINE;
    }
    progress_init(&progress, PROGRESS_NONE, -1, 0);
    int status = study_farm_open(&farm, cli, &progress);
    if (status == EXIT_DONE) {
        shrink(&pilot);
        pilot.stop = JOB_STOP_PILOT;
        pilot.spp = JOB_ADAPTIVE_SPP_DEFAULT;
        pilot.target_error = pilot.time_limit_s = 0;
        status = study_farm_report(&farm, &pilot, &report);
    }
    if (status == EXIT_DONE) {
        struct pilot p = pilot_of(report.json.root, farm.threads);
        p.core_s *= pixels_of(spec) / pixels_of(&pilot);
        *out = predict(&p, spec);
        farm_json_release(&report);
    }
    study_farm_close(&farm);
    return status;
}

void predict_put_json(const struct prediction *p, struct buf *out)
{
    const struct {
        const char *key;
        double value;
    } fields[] = {
        {"spp_mean", p->spp_mean},         {"seconds", p->seconds}, {"seconds_low", p->seconds_low},
        {"seconds_high", p->seconds_high}, {"relmse", p->relmse},   {"relmse_low", p->relmse_low},
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
    human_left(p->seconds_low, p->seconds_high, b);
    buf_printf(out, "cost      %s (80 %%: %s), %.0f spp on average\n", a, b, p->spp_mean);
    human_error(p->relmse, a);
    human_error(p->relmse_low, b);
    human_error(p->relmse_high, c);
    if (p->heavy_tail)
        buf_printf(out, "error     unpredictable: heavy tail, the pilot saw few spikes\n");
    else
        buf_printf(out, "error     relMSE %s (80 %%: %s to %s)\n", a, b, c);
}
