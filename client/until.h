/* client/until.h: what ends a job: --spp, --target-error, --time-limit or --plan.
 *
 * Pure but for the plan's file, which is read. Any thread.
 */
#ifndef CLIENT_UNTIL_H
#define CLIENT_UNTIL_H

#include "client/cli_option.h"

/* Puts it into the spec. On success *plan_json is the plan as the API takes it (you own it), or
 * NULL where there is none. ERR_INPUT: the file holds no plan; ERR_USAGE: it does not fit the
 * picture; problems say why. */
TL_NODISCARD enum err until_apply(const struct cli_line *line, struct job_spec *spec,
                                  char **plan_json, struct diag_list *problems);

/* Options that exclude each other; part of parsing a command line. */
void until_check(const struct cli_line *line, struct diag_list *problems);

#endif
