/* client/private_farm.h: the master and workers that `tilery render` runs for itself.
 *
 * A folder under $TMPDIR (or /tmp), mode 0700, holds the token, the master's data and
 * everyone's log; it goes when the farm ends, and what a killed `tilery` left is swept by
 * the next. Children run on loopback ports chosen by the
 * system, that for workers bound here and inherited by each master, die with this process even if
 * it is killed (PR_SET_PDEATHSIG), and are started again a bounded number of times when they crash:
 * the master on the same ports and data, so that nothing acknowledged is rendered again. Main
 * thread only (the death signal follows the thread that forked).
 */
#ifndef CLIENT_PRIVATE_FARM_H
#define CLIENT_PRIVATE_FARM_H

#include <limits.h>
#include <sys/types.h>

#include "common/err.h"

enum { PRIVATE_WORKERS_MAX = 256, PRIVATE_RESTARTS_MAX = 3, PRIVATE_TOKEN_BYTES = 65 };

struct private_child {
    pid_t pid;  /* 0: not running */
    int out_fd; /* its standard output */
    uint32_t restarts;
    char name[16]; /* "master", "worker-1" */
};

struct private_farm {
    char folder[PATH_MAX / 2];
    char bin[PATH_MAX / 2]; /* where the daemons lie: beside this program */
    char token[PRIVATE_TOKEN_BYTES];
    char listen[64], http[64]; /* addresses really bound */
    struct private_child master;
    struct private_child *workers; /* owned */
    uint32_t worker_count, threads;
    uint32_t build_threads; /* of the worker that builds what all wait for */
    int listen_fd;          /* where workers connect; the master's, whichever runs */
    int lock_fd;            /* held while we live: tells sweepers that the folder is in use */
    char failure[400];      /* what went wrong, in words */
};

/* Makes the folder and the socket for workers, and starts master and workers at once: who connects
 * before the master listens waits in the socket's queue. Does not wait for them. On failure
 * `failure` says why and private_farm_end has been done. */
TL_NODISCARD enum err private_farm_start(struct private_farm *f, uint32_t worker_count,
                                         uint32_t threads);

/* Reads the master's line if it has come. ERR_AGAIN: not yet (wait on
 * private_farm_fd). ERR_IO: the master failed; `failure` says how. */
TL_NODISCARD enum err private_farm_connect(struct private_farm *f);

/* Readable when the master has said its line or died. */
int private_farm_fd(const struct private_farm *f);

/* Collects children that ended and starts them again. ERR_IO: one of them crashed too often, or
 * the master cannot be started again; `failure` says which and quotes its log. *restarted (may be
 * NULL) counts what was started again. */
TL_NODISCARD enum err private_farm_reap(struct private_farm *f, uint32_t *restarted);

/* Asks all children to end; does not wait. */
void private_farm_ask_end(struct private_farm *f);

/* Waits up to grace_ms for children that were asked to end, kills what is left, removes the folder,
 * releases. */
void private_farm_end(struct private_farm *f, int grace_ms);

#endif
