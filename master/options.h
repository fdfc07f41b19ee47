/* master/options.h: the command line of tilery-master. */
#ifndef MASTER_OPTIONS_H
#define MASTER_OPTIONS_H

#include "common/digest.h"
#include "common/log.h"
#include "proto/transport_tls.h"

struct options {
    const char *listen, *http, *data; /* of argv, or defaults */
    char socket_address[64];          /* where it is bound */
    char *token;                      /* owned; NULL: none */
    struct tls_files tls;             /* certificate NULL: in clear */
    int listen_socket;                /* a bound socket to be used instead of listen; -1: none */
    bool insecure, no_sync, determinism_pinned;
    digest determinism;
    enum log_level level;
    uint32_t retention_s, keep_lost_s;
};

/* False: the program is to end with *status (help was printed, or what is wrong). */
TL_NODISCARD bool options_parse(int argc, char **argv, struct options *out, int *status);
void options_release(struct options *o);

#endif
