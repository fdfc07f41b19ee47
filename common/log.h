/* common/log.h: one line an event on standard error.
 *
 *   info  2026-11-22T17:40:01.123Z master  worker joined id=w3 host=beta threads=8
 *
 * Levels are frequencies: error (someone must act), warn (survived), info (once
 * per job or peer), debug (per unit), trace (per frame). Nothing is logged in
 * the pixel loop. Any thread; a line is written by one write(2).
 */
#ifndef COMMON_LOG_H
#define COMMON_LOG_H

#include "common/err.h"

enum log_level { LOG_ERROR, LOG_WARN, LOG_INFO, LOG_DEBUG, LOG_TRACE };

/* Lines above `level` are dropped. Default: LOG_WARN. */
void log_set_level(enum log_level level);

/* "error", "warn", "info", "debug", "trace"; false if `name` is none of them. */
TL_NODISCARD bool log_level_parse(const char *name, enum log_level *out);

/* `module` is a short constant; the text is "event key=value ...". Lines are cut at 1,000 bytes,
 * what utf8_mask takes becomes '?'. */
void log_write(enum log_level level, const char *module, const char *format, ...) TL_PRINTF(3, 4);

#define log_error(module, ...) log_write(LOG_ERROR, module, __VA_ARGS__)
#define log_warn(module, ...)  log_write(LOG_WARN, module, __VA_ARGS__)
#define log_info(module, ...)  log_write(LOG_INFO, module, __VA_ARGS__)
#define log_debug(module, ...) log_write(LOG_DEBUG, module, __VA_ARGS__)

#endif
