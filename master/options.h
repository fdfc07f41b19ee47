/* master/options.h: the command line of tilery-master. */
#ifndef MASTER_OPTIONS_H
#define MASTER_OPTIONS_H

#include "common/digest.h"
#include "common/log.h"
#include "proto/transport_tls.h"

struct options {
    const char *listen, *http, *data; /* of argv, or defaults */
    char *token;                      /* owned; NULL: none */
    struct tls_files tls;             /* certificate NULL: in clear */
    bool insecure, no_sync, determinism_pinned;
    digest determinism;
    enum log_level level;
    uint32_t retention_s;
};

/* False: the program is to end with *status (help was printed, or what is wrong). */
TL_NODISCARD bool options_parse(int argc, char **argv, struct options *out, int *status);
void options_release(struct options *o);

#endif
