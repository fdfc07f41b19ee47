/* client/cli_settings.h: values of options that were not given on the command line.
 *
 * Order: option, environment (TILERY_ and the option's name in capitals), the user's file
 * ($XDG_CONFIG_HOME/tilery/config, else ~/.config/tilery/config), /etc/tilery/config,
 * default. A file has lines `key = value`, keys named as options, # begins a comment.
 * The token itself never stands in a settings file, only the path of one (token-file).
 */
#ifndef CLIENT_CLI_SETTINGS_H
#define CLIENT_CLI_SETTINGS_H

#include "client/cli.h"

/* Fills cli->line.values of the settings that the command takes. Problems (with file:line) make it
 * false; a missing file is none. */
TL_NODISCARD bool cli_settings_load(struct cli *cli, struct diag_list *problems);

/* One settings text; exposed for tests. `origin` marks what it sets; set values are kept. */
void cli_settings_read(struct cli *cli, enum cli_origin origin, const char *file, char *text,
                       struct diag_list *problems);

/* "tilery help settings": each setting, its value and where it came from. */
void cli_settings_print(const struct cli *cli, struct buf *out);

/* The farm's token: --token-file, TILERY_TOKEN, or the token-file setting. *token is NULL when
 * there is none; else yours, to be wiped. ERR_INPUT: a problem was added. */
TL_NODISCARD enum err cli_settings_token(const struct cli *cli, char **token,
                                         struct diag_list *problems);

#endif
