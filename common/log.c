#include "common/log.h"

#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "common/utf8.h"

enum { LINE_BYTES = 1000 };

static const char *const level_names[] = {"error", "warn", "info", "debug", "trace"};
static atomic_int level_max = LOG_WARN;

void log_set_level(enum log_level level)
{
    atomic_store(&level_max, (int)level);
}

bool log_level_parse(const char *name, enum log_level *out)
{
    for (size_t i = 0; i < sizeof level_names / sizeof *level_names; i++) {
        if (strcmp(name, level_names[i]) == 0) {
            *out = (enum log_level)i;
            return true;
        }
    }
    return false;
}

void log_write(enum log_level level, const char *module, const char *format, ...)
{
    if ((int)level > atomic_load_explicit(&level_max, memory_order_relaxed))
        return;

    char line[LINE_BYTES];
    struct timespec now;
    struct tm utc;
    (void)clock_gettime(CLOCK_REALTIME, &now);
    (void)gmtime_r(&now.tv_sec, &utc);
    size_t used = strftime(line, sizeof line, "%Y-%m-%dT%H:%M:%S", &utc);
    char head[80];
    int head_bytes = snprintf(head, sizeof head, "%-5s %s.%03ldZ %-7s ", level_names[level], line,
                              now.tv_nsec / 1000000, module);
    used = (size_t)head_bytes < sizeof head ? (size_t)head_bytes : sizeof head - 1;
    memcpy(line, head, used);

    va_list args;
    va_start(args, format);
    int text_bytes = vsnprintf(line + used, sizeof line - used - 1, format, args);
    va_end(args);
    if (text_bytes > 0)
        used += (size_t)text_bytes < sizeof line - used - 1 ? (size_t)text_bytes
                                                            : sizeof line - used - 2;
    line[used] = '\0';
    utf8_mask(
        line); /* foreign text (host names, file names) must not steer the reader's terminal */
    used = strlen(line);
    line[used++] = '\n';
    ssize_t ignored = write(STDERR_FILENO, line, used);
    (void)ignored;
}
