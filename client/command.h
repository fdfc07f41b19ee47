/* client/command.h: the commands of `tilery`, one function each.
 *
 * A command gets a checked command line and returns the exit status; everything that must
 * be said about a failure has been said. One thread.
 */
#ifndef CLIENT_COMMAND_H
#define CLIENT_COMMAND_H

#include "client/cli.h"

int command_run(struct cli *cli);

/* Pieces that several commands share. */
struct text_table;

/* A table on standard output, its NOTE cut to the window; false when that failed. */
bool command_put_table(const struct cli *cli, struct text_table *t);

/* PATCH of one job or worker with a JSON body; `said` is what it is called afterwards. */
int command_patch(struct cli *cli, const char *path, const struct buf *body, const char *said);

/* The farm's last reply as it came, on a line of its own; false when that failed. */
struct farm;
bool command_put_reply(const struct farm *f);

/* What `wait` shows and where, from --json, --quiet and --progress: an enum progress_mode. */
int command_progress_mode(const struct cli *cli);

int command_render(struct cli *cli);
int command_explain(struct cli *cli);
int command_doctor(struct cli *cli);
int command_tradeoff(struct cli *cli);
int command_import(struct cli *cli);
int command_compare(struct cli *cli);
int command_submit(struct cli *cli);
int command_jobs(struct cli *cli);
int command_status(struct cli *cli);
int command_watch(struct cli *cli);
int command_get(struct cli *cli);
int command_pause(struct cli *cli);
int command_resume(struct cli *cli);
int command_cancel(struct cli *cli);
int command_retry(struct cli *cli);
int command_priority(struct cli *cli);
int command_workers(struct cli *cli);
int command_drain(struct cli *cli);
int command_help(struct cli *cli);

#endif
