#include "common/err.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>

#include "common/log.h"

static const struct {
    const char *name, *text;
    int exit_status;
} table[ERR_COUNT] = {
#define ERR_ROW(name_, status_, text_)                                                             \
    [ERR_##name_] = {.name = "ERR_" #name_, .text = text_, .exit_status = status_},
    ERR_MAP(ERR_ROW)
#undef ERR_ROW
};

const char *err_name(enum err e)
{
    TL_ASSERT((unsigned)e < ERR_COUNT);
    return table[e].name;
}

const char *err_text(enum err e)
{
    TL_ASSERT((unsigned)e < ERR_COUNT);
    return table[e].text;
}

int err_exit_status(enum err e)
{
    TL_ASSERT((unsigned)e < ERR_COUNT);
    return table[e].exit_status;
}

enum err err_from_errno(int errnum)
{
    switch (errnum) {
    case 0:
        return ERR_OK;
    case ENOSPC:
    case EDQUOT:
    case EFBIG:
        return ERR_NOSPACE;
    case ENOMEM:
        return ERR_NOMEM;
    case ENOENT:
        return ERR_NOT_FOUND;
    case EADDRINUSE:
    case EADDRNOTAVAIL:
        return ERR_ADDRESS;
    case ECONNREFUSED:
    case EHOSTUNREACH:
    case ENETUNREACH:
        return ERR_UNREACHABLE;
    case ETIMEDOUT:
        return ERR_TIMEOUT;
    case ECONNRESET:
    case EPIPE:
        return ERR_CLOSED;
    default:
        return ERR_IO;
    }
}

void err_trace(const char *file, int line, const char *expr, enum err e)
{
    log_write(LOG_DEBUG, "err", "climbs at=%s:%d error=%s expr=\"%s\"", file, line, err_name(e),
              expr);
}

void err_abort(const char *file, int line, const char *cond)
{
    (void)fprintf(stderr, "%s:%d: assertion failed: %s (a bug in tilery; please report it)\n", file,
                  line, cond);
    (void)fflush(stderr);
    abort();
}
