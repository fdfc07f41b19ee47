/* client/cmd_submit.h: what submit and submit --frames share. One thread. */
#ifndef CLIENT_CMD_SUBMIT_H
#define CLIENT_CMD_SUBMIT_H

#include "client/farm_api.h"
#include "client/load.h"

/* -o, --png and --report: they go with --wait and could be written now. 2 or 5. */
TL_NODISCARD int cmd_submit_outputs(const struct cli *cli);

/* Sends a loaded scene as one job; `frame` NULL: it is none. Fills id. */
TL_NODISCARD int cmd_submit_send(struct farm *farm, const struct cli *cli, struct load *load,
                                 const struct farm_frame *frame, char id[FARM_ID_BYTES]);

/* The id of what was made, on standard output. False: that failed and was reported. */
TL_NODISCARD bool cmd_submit_print(const struct cli *cli, const char *id);

#endif
