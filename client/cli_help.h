/* client/cli_help.h: help texts and shell completion, made from the tables of cli_option.h.
 * Appends to a buf, whose failure the caller checks. One thread. */
#ifndef CLIENT_CLI_HELP_H
#define CLIENT_CLI_HELP_H

#include "client/cli.h"

/* What bare `tilery` and --help print. */
void cli_help_overview(struct buf *out);

/* The short help of a command: usage, examples, its options by section. */
void cli_help_short(enum cli_command_id id, struct buf *out);

/* The same with a line for each option. */
void cli_help_long(enum cli_command_id id, struct buf *out);

/* A completion script for bash. */
void cli_help_completion(struct buf *out);

/* tilery(1) in man's language. */
void cli_help_man(struct buf *out);

/* What --workers and --threads are on this machine when not given; workers 0: not given. */
uint32_t cli_default_workers(void);
uint32_t cli_default_threads(uint32_t workers);

#endif
