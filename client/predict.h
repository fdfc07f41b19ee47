/* client/predict.h: seconds and error of a job before it is rendered, from a pilot.
 *
 * The pilot is rendered on a farm of our own children, as `tilery render` would start them; what
 * the master says of it (error, the gain of samples by error, thread-seconds) is carried forward:
 * error falls with the samples, time grows with them. docs/ERROR.md has the formulas and how often
 * they were right. Main thread only. Tests: tests/e2e/test_e2e_adaptive.py.
 */
#ifndef CLIENT_PREDICT_H
#define CLIENT_PREDICT_H

#include "client/cli.h"
#include "common/buf.h"
#include "common/job_spec.h"

/* What a pilot measured. */
struct pilot {
    double spp, core_s;       /* samples a pixel, and thread-seconds of them all */
    double load_s, threads;   /* before the first sample; at work */
    double relmse, deviation; /* its error, and the standard deviation of that */
    double gain;              /* work of samples by error over that of equal samples */
    bool heavy_tail;
};

/* 80 % intervals. */
struct prediction {
    double spp_mean;
    double seconds, seconds_low, seconds_high;
    double relmse, relmse_low, relmse_high;
    bool heavy_tail; /* unpredictable: nothing but the samples' cost is known */
};

/* Pure. */
struct prediction predict(const struct pilot *p, const struct job_spec *spec);

/* True when the command line asks for one: --spp, --target-error or --time-limit is given. */
bool predict_wanted(const struct cli_line *line);

/* Renders the pilot. The exit status; what is wrong has been said. */
TL_NODISCARD int predict_run(struct cli *cli, const struct job_spec *spec, struct prediction *out);

void predict_put_json(const struct prediction *p, struct buf *out);
void predict_put_text(const struct prediction *p, struct buf *out);

#endif
