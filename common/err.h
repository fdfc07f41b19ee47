/* common/err.h: the kinds of failure, assertions, and how an error climbs.
 *
 * Three kinds of trouble, never mixed: a bug of ours aborts (TL_ASSERT), the
 * world's trouble is an `enum err` that is returned and handled, the user's
 * input is described in a `struct diag_list` (diag.h).
 *
 * A function that returns `enum err` writes its outputs only on success and
 * leaves its object as it was on failure. Any thread.
 */
#ifndef COMMON_ERR_H
#define COMMON_ERR_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* X(name, exit status of a program that stops because of it, text) */
#define ERR_MAP(X)                                                                                 \
    X(OK, 0, "no error")                                                                           \
    X(USAGE, 2, "wrong usage")                                                                     \
    X(INPUT, 3, "bad input")                                                                       \
    X(LIMIT, 3, "over a limit")                                                                    \
    X(CORRUPT, 3, "damaged data")                                                                  \
    X(UNSUPPORTED, 3, "not supported")                                                             \
    X(UNREACHABLE, 4, "cannot be reached")                                                         \
    X(REFUSED, 4, "refused")                                                                       \
    X(NOT_FOUND, 4, "not found")                                                                   \
    X(VERSION, 4, "version mismatch")                                                              \
    X(TIMEOUT, 4, "timed out")                                                                     \
    X(CLOSED, 4, "connection closed")                                                              \
    X(UNTRUSTED, 4, "certificate not accepted")                                                    \
    X(STATE, 1, "not possible in this state")                                                      \
    X(NOMEM, 5, "out of memory")                                                                   \
    X(IO, 5, "input/output error")                                                                 \
    X(NOSPACE, 5, "disk full")                                                                     \
    X(ADDRESS, 5, "address in use, or not of this machine")                                        \
    X(AGAIN, 5, "queue full")                                                                      \
    X(CANCELLED, 1, "cancelled")

enum err {
#define ERR_ENUM(name, status, text) ERR_##name,
    ERR_MAP(ERR_ENUM)
#undef ERR_ENUM
        ERR_COUNT
};

/* "ERR_NOMEM" and "out of memory"; static strings. */
const char *err_name(enum err e);
const char *err_text(enum err e);

/* The exit status of the contract (0..5) for a program that stops with e. */
int err_exit_status(enum err e);

/* The kind of an errno value: ENOSPC and EDQUOT NOSPACE, ENOMEM NOMEM, EADDRINUSE ADDRESS,
 * ECONNREFUSED UNREACHABLE, and so on; else IO. */
enum err err_from_errno(int errnum);

#define TL_NODISCARD    __attribute__((warn_unused_result))
#define TL_NORETURN     __attribute__((noreturn))
#define TL_PRINTF(f, a) __attribute__((format(printf, f, a)))

/* Returns the error of `expr` to the caller; in debug builds logs where it passed. */
#ifdef TL_DEBUG
#define TL_TRY(expr)                                                                               \
    do {                                                                                           \
        enum err try_err_ = (expr);                                                                \
        if (try_err_ != ERR_OK) {                                                                  \
            err_trace(__FILE__, __LINE__, #expr, try_err_);                                        \
            return try_err_;                                                                       \
        }                                                                                          \
    } while (0)
#else
#define TL_TRY(expr)                                                                               \
    do {                                                                                           \
        enum err try_err_ = (expr);                                                                \
        if (try_err_ != ERR_OK)                                                                    \
            return try_err_;                                                                       \
    } while (0)
#endif

/* Always on. Never about anything that came from outside the process. */
#define TL_ASSERT(cond)                                                                            \
    do {                                                                                           \
        if (__builtin_expect(!(cond), 0))                                                          \
            err_abort(__FILE__, __LINE__, #cond);                                                  \
    } while (0)

/* On in debug builds; for the trace loop. */
#ifdef TL_DEBUG
#define TL_DASSERT(cond) TL_ASSERT(cond)
#else
#define TL_DASSERT(cond) ((void)sizeof(!(cond)))
#endif

void err_trace(const char *file, int line, const char *expr, enum err e);
TL_NORETURN void err_abort(const char *file, int line, const char *cond);

#endif
