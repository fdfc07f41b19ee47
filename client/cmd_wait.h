/* client/cmd_wait.h: staying with a job of a farm that others run: watch, submit --wait.
 *
 * Ctrl-C leaves the job alone and says how to stop it. One thread.
 */
#ifndef CLIENT_CMD_WAIT_H
#define CLIENT_CMD_WAIT_H

#include "client/farm_api.h"

struct cmd_wait {
    struct farm *farm;
    struct cli *cli;
    const char *job;
    bool preview; /* show the picture as it grows, where the terminal can */
};

/* Until the job ends; then -o, --png and --report are served and the end block is printed.
 * The exit status: the job's. */
int cmd_wait_run(struct cmd_wait *w);

/* What came before the job, where this process did it: seconds. */
struct cmd_start {
    double begun_at;   /* Unix time of the command's start */
    double read, pack; /* the scene's files; the package */
    double ready;      /* from the start until scene and farm were there */
    double send;       /* what the master lacked, and the job */
};

/* The report of an ended job: GET, --report FILE, the end block or the JSON end line, and the
 * words of a failure. `job_ok`: the state is "done". `start` (may be NULL) is told in the report as
 * "start", with "first_pixel", the time from the command's start to the job's first result. */
int cmd_wait_report(struct farm *farm, const struct cli *cli, const char *job, const char *title,
                    double start_s, const struct cmd_start *start, bool job_ok);

#endif
