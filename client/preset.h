/* client/preset.h: job options kept in a file, as `tilery tradeoff` writes and `--preset` reads.
 *
 *     # standard: relMSE 0.01 (95 %: 0.0094 to 0.0107)
 *     spp = 61
 *     max-depth = 8
 *     half = true
 *
 * Lines of `key = value`, keys named as options, # begins a comment: the form of the settings
 * files. Only what says how a picture is rendered may stand in one. What the command line gives
 * itself wins, and a --spp, --target-error or the like there replaces all that the file says about
 * when to stop. One thread. Tests: test_cli_settings, tests/e2e/test_e2e_tradeoff.py.
 */
#ifndef CLIENT_PRESET_H
#define CLIENT_PRESET_H

#include "client/cli.h"

/* True for the options that a preset may hold. */
bool preset_holds(enum cli_option_id id);

/* Reads --preset FILE into cli->line. The exit status: 3 for a file that is not right, and all that
 * is wrong has been said. */
TL_NODISCARD int preset_apply(struct cli *cli);

/* The text of a preset; exposed for tests. Cuts `text` up. */
void preset_read(struct cli *cli, const char *file, char *text, struct diag_list *problems);

#endif
