/* client/predict.h: seconds and error of a job before it is rendered, from a pilot.
 *
 * Two or three pilots (4, 16 and, where that is short or little beside the render, 64 samples a
 * pixel, each with its own seed) are rendered on a farm of our own children, as `tilery render`
 * would start them. How fast error falls is a property of the scene and its sampler, so it is
 * fitted to them; time is a part that does not grow and one that does. How much the machine is
 * shared with others is measured: time of threads over processor time. docs/ERROR.md has the
 * formulas and how often they were right. Main thread only. Tests: tests/unit/test_predict.c,
 * tests/e2e/test_e2e_adaptive.py.
 */
#ifndef CLIENT_PREDICT_H
#define CLIENT_PREDICT_H

#include "client/cli.h"
#include "common/buf.h"
#include "common/job_spec.h"

enum { PILOTS_MAX = 3 };

/* What one pilot measured. */
struct pilot {
    double spp, busy_s;       /* samples a pixel, and seconds from the scene's being there */
    double core_s;            /* that its threads spent at it, waiting for a processor or not */
    double cpu_s;             /* that the workers had a processor; NaN: not known */
    double relmse, deviation; /* its error, and the standard deviation of that */
};

/* What all of them did. */
struct pilots {
    struct pilot of[PILOTS_MAX];
    size_t count;
    double load_s;      /* before the first sample */
    double gain;        /* work of samples by error over that of equal samples */
    double pixel_ratio; /* of the picture over the pilots', which are smaller where it is large */
    bool heavy_tail;
};

/* ln relmse = level - power ln(spp / 16), with the covariance of the two. */
struct error_fit {
    double level, power, level_var, power_var, covariance;
    double noise; /* relative deviation of the stated error itself */
    bool known;   /* false: no pilot saw an error */
};

/* Seconds = fixed_s + spp_s spp; deviation of their logarithm. */
struct time_fit {
    double fixed_s, spp_s, deviation;
};

/* Of processor time, that of all workers: what the first pilot took over the others is fixed. */
struct cost_fit {
    double fixed_s, spp_s;
    double stretch; /* seconds of a thread over those it had a processor, >= 1 */
    bool known;
};

/* 80 % intervals. */
struct prediction {
    double spp_mean;
    double seconds, seconds_low, seconds_high;
    double core_s, core_low_s, core_high_s; /* processor time of the workers; NaN: not known */
    double relmse, relmse_low, relmse_high;
    bool heavy_tail; /* unpredictable: nothing but the samples' cost is known */
};

/* Pure: the fits, and what follows from them. */
struct error_fit predict_fit_error(const struct pilots *p);
struct cost_fit predict_fit_cost(const struct pilots *p);
struct time_fit predict_fit_time(const struct pilots *p);
struct prediction predict(const struct pilots *p, const struct job_spec *spec);

/* True when the command line asks for one: --spp, --target-error or --time-limit is given. */
bool predict_wanted(const struct cli_line *line);

/* Renders the pilot. The exit status; what is wrong has been said. */
TL_NODISCARD int predict_run(struct cli *cli, const struct job_spec *spec, struct prediction *out);

void predict_put_json(const struct prediction *p, struct buf *out);
void predict_put_text(const struct prediction *p, struct buf *out);

#endif
